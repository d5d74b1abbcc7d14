"""All steps in a real browser: from an uploaded log to a compiled C filter."""

import shlex
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sigmaswarm
from importing.logs import ORIGIN
from processes import COMMAND, Process
from sigmaswarm.drives.drive import Drive
from support import make_drive, quickly

expect = pytest.importorskip("playwright.sync_api").expect
expect.set_options(timeout=60_000)
DURATION = 60.0
LOCATION = {"altitude": 100.0, "horizontalAccuracy": 2.0, "speed": -1.0, "bearing": -1.0}
"""Columns of the fixes; negative values mean unknown."""


def six_axes() -> Drive:
    """Simulate a drive with all axes of the IMU."""
    return sigmaswarm.simulate("urban", gps="white-1m", duration=DURATION)


def degrees(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    from sigmaswarm.geodesy import enu_to_geodetic

    places = np.column_stack([drive.gps.x, drive.gps.y, np.zeros(len(drive.gps))])
    lat, lon, _ = enu_to_geodetic(places, ORIGIN).T
    return lat, lon


def odd_csv(folder: Path) -> list[Path]:
    """Write IMU columns with unknown names, in g and deg/s, and the fixes in a separate file."""
    drive = make_drive(duration=DURATION, gps_rate=5.0, seed=3)
    folder.mkdir()
    imu, (lat, lon) = drive.imu, degrees(drive)
    columns = {
        "stamp_ms": imu.time * 1e3,
        "vorn": imu.ax / 9.80665,
        "seite": imu.ay / 9.80665,
        "dreh": np.degrees(imu.gz),
    }
    pl.DataFrame(columns).write_csv(folder / "imu.csv")
    pl.DataFrame({"stamp_ms": drive.gps.time * 1e3, "lat": lat, "lon": lon}).write_csv(folder / "gps.csv")
    return sorted(folder.iterdir())


def phone(folder: Path) -> list[Path]:
    """Write an export of Sensor Logger: screen up, top edge forward."""
    drive, ns = six_axes(), 1_700_000_000 * 10**9
    folder.mkdir()
    lat, lon = degrees(drive)
    times = {
        "imu": ns + np.round(drive.imu.time * 1e9).astype(np.int64),
        "gps": ns + np.round(drive.gps.time * 1e9).astype(np.int64),
    }
    imu = drive.imu
    assert imu.az is not None
    assert imu.gx is not None
    assert imu.gy is not None
    tables = {
        "TotalAcceleration": {"time": times["imu"], "z": imu.az, "y": imu.ax, "x": -imu.ay},
        "Gyroscope": {"time": times["imu"], "z": imu.gz, "y": imu.gx, "x": -imu.gy},
        "Location": {"time": times["gps"], "longitude": lon, "latitude": lat}
        | {n: 0 * lat + v for n, v in LOCATION.items()},
    }
    for name, columns in tables.items():
        pl.DataFrame(columns).write_csv(folder / f"{name}.csv")
    return sorted(folder.iterdir())


def bag(folder: Path) -> list[Path]:
    """Write a ROS 2 bag."""
    bags = pytest.importorskip("importing.bags")
    drive = six_axes()
    lat, lon = degrees(drive)
    speed, course = np.full(len(lat), 8.0), np.zeros(len(lat))
    gps = type(drive.gps)(
        drive.gps.time, drive.gps.x, drive.gps.y, lat, lon, 0 * lat, 0 * lat + 1, 0 * lat + 1, speed, course
    )
    whole = Drive("bag", drive.imu, gps, drive.truth, "wgs84", ORIGIN)
    sent = [m for m in bags.messages(whole) if m[0] in ("/imu/data", "/gps/fix")]
    bags.write_ros(folder, iter(sent))
    return sorted(folder.iterdir())


def drop(page: Any, files: list[Path]) -> None:
    """Choose files with the + of the drop zone, and wait until they have been read."""
    page.locator("input[type=file]").first.set_input_files(files)
    page.get_by_text("Contents of the log").wait_for()
    settle(page)


def settle(page: Any) -> None:
    """Wait until all files are read and written."""
    page.wait_for_timeout(400)
    page.wait_for_function("!document.querySelector('.message.wait')")


def pick(page: Any, label: str, option: str) -> None:
    page.get_by_role("combobox", name=label).click()
    page.get_by_role("option", name=option, exact=True).click()


ODD = (
    ("vorn", "ax", "IMU: ax forward", "g"),
    ("seite", "ay", "IMU: ay left", "g"),
    ("dreh", "gz", "IMU: gz yaw rate", "deg/s"),
)


def name_columns(page: Any) -> None:
    """Select the meaning of the columns."""
    command = page.locator("pre")
    for column, target, use, unit in ODD:
        pick(page, f"Use of {column}", use)
        expect(command).to_contain_text(f"imu.{target}={column}")
        pick(page, f"Unit of {column}", unit)
        expect(command).to_contain_text(f"{column}*9.80665" if unit == "g" else f"radians({column})")
    settle(page)


def find_mounting(page: Any) -> None:
    """Press the button that the note names, and add an offset."""
    page.get_by_text("press 'Find the mounting in the log'").wait_for()
    page.get_by_role("button", name="Find the mounting in the log").click()
    page.get_by_text("deg was estimated from the log").wait_for()
    settle(page)
    set_offset(page)


def set_offset(page: Any) -> None:
    """Enter a value, and leave the page before the log is read again with it."""
    page.get_by_text("More settings").click()
    page.get_by_label("Seconds to add").fill("0.02")


SIZES = {"particles": 8, "generations": 3, "seed": 5}


def tune_and_export(page: Any, folder: Path) -> None:
    """From a checked drive, tune, evaluate, export, and run a compiled C filter."""
    page.get_by_role("link", name="Next: tune a filter").click()
    page.get_by_text("Filter: planar5").wait_for()
    for name, size in SIZES.items():  # without a pause
        page.get_by_label(name, exact=True).fill(str(size))
    page.get_by_role("button", name="Start").click()
    page.get_by_role("link", name="Next: evaluate the filter").click()
    (tuned,) = (folder / "tunings").iterdir()
    assert SIZES.items() <= sigmaswarm.Tuning.load(tuned).config.model_dump().items()
    page.get_by_role("button", name="Evaluate").click()
    report = page.frame_locator("iframe")
    report.get_by_role("heading", name="Evaluation of planar5").wait_for()
    page.get_by_role("link", name="Next: export the filter").click()
    page.get_by_role("button", name="Write C99").click()
    page.get_by_text("wrote 1").wait_for()
    (exported,) = (folder / "exports").iterdir()
    compiler = shutil.which("cc")
    if compiler:
        build = page.locator("pre").first.inner_text()
        subprocess.run(["sh", "-c", build], check=True)
        assert len(pl.read_csv(exported / "estimate.csv")) > 100


@pytest.mark.parametrize(
    ("write", "prepare", "onward"),
    quickly(
        [
            (w, p, far)
            for w, p in ((odd_csv, name_columns), (phone, find_mounting), (bag, set_offset))
            for far in (0, 1)
        ],
        lambda write, _, onward: write is not bag and onward == (write is odd_csv),
    ),
)
def test_road(write: Any, prepare: Any, onward: int, tmp_path: Path, serve: Any, tab: Any):
    """The shown command makes the same drive; ``onward`` continues to a filter in C."""
    files = write(tmp_path / "log")
    served = serve(tmp_path / "bench")
    page = tab(served.url)
    drop(page, files)
    prepare(page)
    page.get_by_role("button", name="Make the drive").click()
    page.get_by_role("link", name="Next: check the drive").wait_for()
    assert page.locator(".message.bad").all_inner_texts() == []
    line = page.locator("pre").inner_text()
    page.get_by_role("link", name="Next: check the drive").click()
    page.get_by_role("heading", name="No serious finding").wait_for()
    if onward:
        tune_and_export(page, served.folder)
    (made,) = [
        name for name in sorted(p.name for p in (served.folder / "drives").iterdir()) if "-t" not in name
    ]
    words = shlex.split(line.replace(str(served.folder / "drives" / made), str(tmp_path / "again")))
    again = Process(COMMAND, words[1:])
    again.communicate()
    assert again.wait() == 0
    for table in ("imu", "gps"):
        again = (tmp_path / "again" / f"{table}.csv").read_bytes()
        assert again == (served.folder / "drives" / made / f"{table}.csv").read_bytes()


def test_killed_server_and_two_tabs(tmp_path: Path, serve: Any, tab: Any):
    """Both tabs show one tuning; after a kill, it is resumed with the bits of an uninterrupted tuning."""
    options = {"model": "planar5", "particles": 8, "generations": 40}
    drive = make_drive(duration=DURATION, gps_rate=5.0, seed=3, name="monday")
    sigmaswarm.write_drive(drive, tmp_path / "bench" / "drives" / "monday")
    first = serve(tmp_path / "bench", pause=1.0, options=options, plan={"monday": "tune on it"})
    one, two = tab(first.url + "tune"), tab(first.url + "tune")
    one.get_by_text("Filter: planar5").wait_for()
    one.get_by_role("button", name="Start").click()
    two.get_by_role("button", name="Stop").click()
    for page in (one, two):
        page.get_by_text("monday: not finished").wait_for()
    one.get_by_role("button", name="Resume").click()
    two.get_by_text("of 40").wait_for()
    saved = tmp_path / "bench" / "tunings" / "monday"
    first.end(signal.SIGKILL)
    assert not (saved / "tuning.toml").exists()
    second = serve(tmp_path / "bench")
    page = tab(second.url + "tune")
    page.get_by_role("button", name="Resume").click()
    page.get_by_role("link", name="Next: evaluate the filter").wait_for()
    drive = sigmaswarm.read_drive(tmp_path / "bench" / "drives" / "monday")
    alone = sigmaswarm.tune(drive, **options)
    assert sigmaswarm.Tuning.load(saved).parameters == alone.parameters
