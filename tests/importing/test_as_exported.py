"""Logs as users export them: read correctly, or rejected with an option that reads them."""

import datetime
import json
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.io import savemat

from importing.logs import imported
from sigmaswarm.drives.drive import Drive, Gps, Imu
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic, geodetic_to_enu
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.row_times import _gaps_of, gaps_by_distance
from sigmaswarm.importing.source import TableChoice
from sigmaswarm.workbench.columns import assign
from support import diagonal, make_drive, several, some

N, HZ, EVERY = 800, 20, 4
T = np.arange(N) / HZ
ORIGIN = (48.0, 11.0, 500.0)
EPOCH = 1_714_000_000
Columns = dict[str, np.ndarray]
TURNING = 0.4 * np.sin(T / 3)


def road(v: Any = 8.0, gz: np.ndarray = TURNING) -> tuple[Columns, Columns, Columns]:
    """Columns of IMU and fixes, and the path in m."""
    course = 0.5 + np.cumsum(gz) / HZ
    east, north = (np.cumsum(v * f(course)) / HZ for f in (np.cos, np.sin))
    imu = {"ax": 0.1 * np.sin(T), "ay": v * gz, "az": 9.81 + 0 * T, "gx": 0 * T, "gy": 0 * T, "gz": gz}
    lat, lon, _ = enu_to_geodetic(np.column_stack([east, north, 0 * T]), ORIGIN)[::EVERY].T
    return imu, {"lat": lat, "lon": lon}, {"x": east, "y": north}


IMU, FIXES, PATH = road()


def write(
    folder: Path,
    imu: Columns | None = None,
    gps: Columns | None = None,
    clock: Callable[[np.ndarray], object] = lambda t: t,
    head: str = "t",
    gps_clock: Callable[[np.ndarray], object] | None = None,
) -> None:
    pl.DataFrame({head: clock(T), **(imu or IMU)}).write_csv(folder / "imu.csv")
    pl.DataFrame({head: (gps_clock or clock)(T[::EVERY]), **(gps or FIXES)}).write_csv(folder / "gps.csv")


def require_right(folder: Path, fixes: int = N // EVERY, **options: object) -> None:
    """The rates, and the times and places of IMU and fixes, are those that were written."""
    drive = imported(folder, **options).drive
    assert len(drive.imu) == N
    np.testing.assert_allclose(drive.imu.time - drive.imu.time[0], T, atol=0.06)
    np.testing.assert_allclose(drive.imu.gz, IMU["gz"], atol=1e-3)
    assert len(drive.gps) == fixes
    time = drive.gps.time - drive.imu.time[0]
    for name in ("x", "y"):
        off = getattr(drive.gps, name) - np.interp(time, T, PATH[name])
        np.testing.assert_allclose(off - np.median(off), 0, atol=0.7)


def options_in(said: str) -> list[list[str]]:
    return [re.findall(r'"([^"]+)"', part) for part in said.split("--map ")[1:]]


def without_unit(folder: Path, per_m_s2: float, noise: float = 0.0) -> None:
    """Write accelerations in another unit, as whole numbers, with noise in m/s2."""
    rng = np.random.default_rng(1)
    forces = {a: (IMU[a] + noise * rng.standard_normal(N)) * per_m_s2 for a in ("ax", "ay", "az")}
    write(folder, imu=IMU | {a: np.round(force) for a, force in forces.items()})


@pytest.mark.parametrize(
    ("unit", "per_m_s2", "noise"),
    diagonal([("cm/s2", 100), ("mg", 1.03e3 / 9.80665), ("cm/s2", 100.5), ("mg", 1e3 / 9.80665)], [0.0, 1.5]),
)
def test_gravity_shows_whether_accelerations_are_in_cm_s2_or_mg(
    tmp_path: Path, unit: str, per_m_s2: float, noise: float
):
    without_unit(tmp_path, per_m_s2, noise)
    got = imported(tmp_path)
    assert any(f"accelerations are read as {unit}" in note for note in got.notes)
    assert np.median(got.drive.imu.az) == pytest.approx(
        9.8 * per_m_s2 / {"cm/s2": 100, "mg": 1e3 / 9.80665}[unit], 0.01
    )


def test_accelerations_between_cm_s2_and_mg_are_refused_with_options_for_both(tmp_path: Path):
    without_unit(tmp_path, 990 / 9.81)
    with pytest.raises(InputError, match=r"in cm/s2 or mg, since gravity .* about 990") as caught:
        imported(tmp_path)
    options = [re.findall(r'"(imu\.[^"]+)"', part) for part in str(caught.value).split("--map ")[1:]]
    assert [
        float(np.median(imported(tmp_path, maps=maps).drive.imu.az)) for maps in options
    ] == pytest.approx([9.90, 9.71], abs=0.01)
    proposed = inspect_request(Request(tmp_path))
    assert "in cm/s2 or mg" in " ".join(proposed.notes)


@pytest.mark.parametrize("per_m_s2", [1e3, 1 / 0.3048, 1e6 / 9.80665])
def test_the_remedy_for_other_units_of_acceleration_is_that_of_gravity(tmp_path: Path, per_m_s2: float):
    without_unit(tmp_path, per_m_s2)
    with pytest.raises(InputError, match="unknown unit") as caught:
        imported(tmp_path)
    (maps,) = options_in(str(caught.value))
    assert np.median(imported(tmp_path, maps=maps).drive.imu.az) == pytest.approx(9.81, 0.01)


SIX, PLACES = np.column_stack([*IMU.values()]), np.column_stack([*FIXES.values()])
METERS = np.column_stack([*PATH.values()])[::EVERY]
MATRICES: dict[str, Columns] = {
    "times in the first columns": {"imu": np.c_[T, SIX], "gps": np.c_[T[::EVERY], PLACES]},
    "meters": {"data": np.c_[T, SIX], "gnss": np.c_[T[::EVERY], METERS]},
    "two matrices of the IMU": {
        "acc": np.c_[T, SIX[:, :3]],
        "gyr": np.c_[T, SIX[:, 3:]],
        "fix": np.c_[T[::EVERY], PLACES],
    },
    "times outside": {"t": T, "imu": SIX, "tg": T[::EVERY], "gps": PLACES},
    "no times of the IMU": {"imu": SIX, "gps": np.c_[T[::EVERY], PLACES]},
    "transposed": {"imu": np.c_[T, SIX].T, "gps": np.c_[T[::EVERY], PLACES].T},
}


@pytest.mark.parametrize("form", some(MATRICES))
def test_the_proposal_for_plain_matrices_works(tmp_path: Path, form: str):
    savemat(tmp_path / "log.mat", MATRICES[form])
    found = inspect_request(Request(tmp_path / "log.mat"))
    assert found.works and "COLUMN" not in found.proposal + found.evidence
    maps = [f"{name}={text}" for name, text in found.settings["maps"].items()]
    require_right(tmp_path / "log.mat", maps=maps, choice=TableChoice(found.settings["tables"]))


def test_a_position_that_rises_is_no_time(tmp_path: Path):
    """The other columns of a position are read as its axes if the table has a time."""
    place = np.c_[np.sort(PATH["x"]), PATH["y"], 0 * T]
    savemat(tmp_path / "log.mat", {"imu": {"t": T, **IMU}, "gps": {"time": T, "pos": place}})
    np.testing.assert_allclose(imported(tmp_path / "log.mat").drive.gps.x, place[:, 0])


STRAIGHT = road(gz=0 * T)


def write_rates(folder: Path, unit: str, columns: Columns) -> None:
    """Write rates in deg/s with a unit in their names."""
    rates = {f"{n} ({unit})": np.degrees(c) if n[0] == "g" else c for n, c in columns.items()}
    write(folder, imu={n if n[0] == "g" else n[:2]: c for n, c in rates.items()}, gps=STRAIGHT[1])


@pytest.mark.parametrize(
    "unit", some(["grad/s", "Grad/s", "grad/sek", "Grad pro Sekunde", "gr/s", "grade/s"], 3)
)
def test_grad_per_second_may_be_degrees_or_gradians(tmp_path: Path, unit: str):
    write_rates(tmp_path, unit, STRAIGHT[0] | {"gx": 0.02 * np.sin(T)})
    with pytest.raises(InputError, match=r"degrees per second.*gradians per second") as caught:
        imported(tmp_path)
    message = str(caught.value)
    for form, factor in (("radians({})", 1.0), ("{}*pi/200", 0.9)):
        options = {f"imu.{n}": f"imu.{n}={form.format(f'`{n} ({unit})`')}" for n in ("gx", "gy", "gz")}
        assert all(f'--map "{option}"' in message for option in options.values())
        got = imported(tmp_path, maps=[*options.values()]).drive.imu
        np.testing.assert_allclose(got.gx, 0.02 * factor * np.sin(T), atol=1e-9)


@pytest.mark.parametrize("unit", some(["grados/s", "gradi/s", "graus/s", "graden/s", "degrés/s", "°/sek"]))
def test_degrees_in_other_languages(tmp_path: Path, unit: str):
    write_rates(tmp_path, unit, STRAIGHT[0] | {"gx": 0.02 * np.sin(T)})
    np.testing.assert_allclose(imported(tmp_path).drive.imu.gx, 0.02 * np.sin(T), atol=1e-9)


GERMAN = str.maketrans(",.", ".,")


def clock(t: float) -> str:
    return f"{int(t // 60) % 60:02d}:{t % 60:06.3f}"


def dates(t: np.ndarray, form: str) -> list[str]:
    return [
        datetime.datetime.fromtimestamp(EPOCH + round(s, 3), datetime.UTC).strftime(form) for s in t.tolist()
    ]


CLOCKS: dict[str, tuple[Callable[[np.ndarray], object], str]] = {
    "mm:ss.0 of a spreadsheet": (lambda t: [f"{int(s) // 60:02d}:{s % 60:06.3f}" for s in t + 50], "t"),
    "over the hour": (lambda t: [f"{int(s) // 60 % 60:02d}:{s % 60:06.3f}" for s in t + 3590], "t"),
    "Julian date": (lambda t: 2460425.25 + np.round(t / 86400, 9), "time"),
    "date": (lambda t: 45406.5 + np.round(t / 86400, 10), "Date"),
    "a signed counter": (lambda t: (np.round((t - 20) * 1e6).astype(int) + 2**32) % 2**32 - 2**31, "micros"),
    "a counter of 31 bits": (lambda t: np.round((t - 20) * 1e6).astype(int) % 2**31, "micros"),
    "a counter of 24 bits": (lambda t: np.round((t + 5) * 1e6).astype(int) % 2**24, "micros"),
    "24 bits of ms": (lambda t: np.round((t - 20) * 1e3).astype(int) % 2**24, "millis"),
    "16 bits of ms": (lambda t: np.round((t + 50) * 1e3).astype(int) % 2**16, "t"),
    "seconds of the minute": (lambda t: np.round(t + 30, 3) % 60, "sec"),
    "ms of the minute": (lambda t: np.round((t + 30) * 1e3).astype(int) % 60_000, "ms"),
    "durations in s": (lambda t: [f"{s:g} sec" for s in t + 1], "t"),
    "durations in ms": (lambda t: [f"{s * 1e3:.0f} ms" for s in t], "Time"),
    "durations in min": (lambda t: [f"{s / 60:.6f} min" for s in t], "Time"),
    "over 24 hours": (lambda t: [f"{h}:{clock(s)}" for s in t - 20 for h in [24 - (s < 0)]], "Time"),
    "days and a clock": (lambda t: [f"1 day, 00:{clock(s)}" for s in t], "time"),
    "days, hours": (lambda t: [f"2:07:{clock(s)}" for s in t], "time"),
    "thousands of ms": (lambda t: [f"{s * 1e3:,.1f}" for s in t + 980], "time (ms)"),
    "millions of us": (lambda t: [f"{round(s * 1e6):,}" for s in t + 3], "time_us"),
    "thousands between blanks": (lambda t: [f"{s:,.3f}".replace(",", " ") for s in t + 980], "t"),
    "thousands, Swiss": (lambda t: [f"{s:,.3f}".replace(",", "'") for s in t + 980], "t"),
    "thousands, German": (lambda t: [f"{s * 1e3:,.1f}".translate(GERMAN) for s in t + 980], "Zeit (ms)"),
    "Europe": (lambda t: dates(t, "%Y-%m-%d %H:%M:%S.%f CEST"), "Zeitstempel"),
    "Berlin": (lambda t: dates(t, "%Y-%m-%dT%H:%M:%S.%f+02:00[Europe/Berlin]"), "time"),
    "a zone of hours": (lambda t: dates(t, "%Y-%m-%dT%H:%M:%S.%f+02"), "time"),
    "ctime": (lambda t: dates(t, "%a %b %d %H:%M:%S.%f %Y"), "time"),
    "a comma after the date": (lambda t: dates(t, "%d %b %Y, %H:%M:%S.%f GMT"), "horodatage"),
    "half a day": (lambda t: np.round(t - 20, 3) % 43_200, "time"),
}


@pytest.mark.parametrize("name", some(CLOCKS))
def test_clocks(tmp_path: Path, name: str):
    clock, head = CLOCKS[name]
    write(tmp_path, clock=clock, head=head)
    require_right(tmp_path)


def decimal(period: float, scale: float, begin: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a clock in units of 1/``scale`` s that wraps after ``period``, s, and begins at ``begin``, s."""
    return lambda t: np.round((t + begin) * scale).astype(np.int64) % round(period * scale)


@pytest.mark.parametrize(
    ("period", "begin", "scale"),
    diagonal([(10.0, 0.0), (10.0, 3.0), (100.0, 72.0), (1e3, 970.0), (1e6, 1e6 - 9)], [1e3, 1e6, 1e9]),
)
@pytest.mark.parametrize("head", some(["t", "ticks"]))
def test_decimal_counters(tmp_path: Path, head: str, period: float, begin: float, scale: float):
    name = {1e3: "ms", 1e6: "us", 1e9: "ns"}[scale]
    write(tmp_path, clock=decimal(period, scale, begin), head="t" if head == "t" else f"time_{name}")
    require_right(tmp_path)
    assert any(f"a counter of {period:.0f} s wraps" in note for note in imported(tmp_path).notes)


@pytest.mark.parametrize(("hz", "begin"), diagonal([1, 2, 4, 5], [0.0, 0.3, 0.5]))
def test_fixes_of_a_counter_that_wraps_each_second_are_refused(tmp_path: Path, hz: int, begin: float):
    """The number of seconds between two fixes is unknown; in one table, the rows of the IMU show it."""
    clock, k = decimal(1.0, 1e6, begin), np.arange(0, N // EVERY, HZ // EVERY // hz or 1)
    imu, fixes = pl.DataFrame({"t": clock(T), **IMU}), pl.DataFrame({n: c[k] for n, c in FIXES.items()})
    imu.write_csv(tmp_path / "imu.csv")
    late = 0.01 * np.random.default_rng(hz).standard_normal(len(k)) * (hz < 4)
    gps = fixes.with_columns(t=clock(T[::EVERY][k] + late))
    gps.write_csv(tmp_path / "gps.csv")
    with pytest.raises(InputError, match=r"ambiguous|do not overlap"):
        imported(tmp_path)
    row = pl.Series("row", EVERY * k)
    log = imu.with_row_index("row").join(fixes.with_columns(row), on="row", how="left", maintain_order="left")
    log.drop("row").write_csv(tmp_path / "log.csv")
    (tmp_path / "imu.csv").unlink()
    (tmp_path / "gps.csv").unlink()
    require_right(tmp_path / "log.csv", len(k))


def test_recordings_that_end_near_a_decimal_period_are_separate(tmp_path: Path):
    """A pause within a counter of 10 s, or recordings from 0 with this duration, do not show the number of wraps."""
    for clock in (lambda t: np.where(t < 20, t, t + 3.7) % 10, lambda t: np.round(t / 2, 3) % 10):
        write(tmp_path, clock=clock)
        with pytest.raises(InputError, match="recordings"):
            imported(tmp_path)


RESTARTED: Columns = {
    "t": np.round(T + 50, 3) % 60,
    "millis": np.round((T + 53) * 1e3).astype(int) % 2**16,
    "micros": np.round((T + 5) * 1e6).astype(int) % 2**24,
}


@pytest.mark.parametrize(("head", "first"), diagonal(RESTARTED, (70, 110, 150)))
def test_a_clock_that_restarts_before_the_first_fix(tmp_path: Path, head: str, first: int):
    """The fixes begin 14 to 30 s after the IMU; the clocks restart after 10 to 13 s, and micros every 17 s."""
    imu = pl.DataFrame({head: RESTARTED[head], **IMU})
    gps = pl.DataFrame({head: RESTARTED[head][::EVERY], **FIXES})[first:]
    imu.join(gps, on=head, how="left", maintain_order="left").write_csv(tmp_path / "log.csv")
    require_right(tmp_path / "log.csv", N // EVERY - first)
    (tmp_path / "log.csv").unlink()
    imu.write_csv(tmp_path / "imu.csv")
    gps.write_csv(tmp_path / "gps.csv")
    require_right(tmp_path, N // EVERY - first)


def test_recordings_of_a_minute_are_no_seconds_of_the_minute(tmp_path: Path):
    write(tmp_path, clock=lambda t: 3 * t % 60)
    with pytest.raises(
        InputError, match=r"2 recordings .*; import each recording separately: --part 1 to --part 2"
    ):
        imported(tmp_path)


def test_names_of_zones_are_hours(tmp_path: Path):
    for zone, ahead in (("EDT", -4), ("JST", 9), ("+0530", 5.5), ("-03", -3)):
        write(
            tmp_path,
            clock=lambda t, by=ahead, zone=zone: dates(t + by * 3600, f"%Y-%m-%d %H:%M:%S.%f {zone}"),
        )
        assert imported(tmp_path).drive.metadata["time_origin_s"] == EPOCH


def test_numbers_with_separators_of_thousands_and_decimal_commas(tmp_path: Path):
    cells = {"Zeit": T + 980, **IMU}
    rows = zip(*([f"{v:,.4f}".translate(GERMAN) for v in c.tolist()] for c in cells.values()), strict=True)
    (tmp_path / "imu.csv").write_text("\n".join([";".join(cells), *map(";".join, rows)]) + "\n")
    cells = {"Zeit": T[::EVERY] + 980, **FIXES, "alt": 1000 + 0 * T[::EVERY]}
    rows = zip(*([f"{v:,.9f}".translate(GERMAN) for v in c.tolist()] for c in cells.values()), strict=True)
    (tmp_path / "gps.csv").write_text("\n".join([";".join(cells), *map(";".join, rows)]) + "\n")
    require_right(tmp_path)
    np.testing.assert_allclose(imported(tmp_path).drive.gps.alt, 1000)


LANGUAGES = {
    "German": (
        "Zeitstempel",
        "Beschleunigung {} (m/s²)",
        "Drehgeschwindigkeit {} (rad/s)",
        "Breite (°)",
        "Länge (°)",
    ),
    "French": (
        "horodatage",
        "Accélération {} (m/s²)",
        "Vitesse angulaire {} (rad/s)",
        "Latitude",
        "Longitude",
    ),
    "French, of a spreadsheet": (
        "Temps (s)",
        "Accélération {} (m/s²)",
        "Vitesse de rotation {} (rad/s)",
        "lat",
        "lon",
    ),
    "Spanish": ("tiempo", "aceleración_{}", "velocidad_angular_{}", "latitud", "longitud"),
    "Italian": ("tempo", "accelerazione_{}", "velocità_angolare_{}", "latitudine", "longitudine"),
    "Portuguese": ("tempo", "aceleração_{}", "velocidade_angular_{}", "latitude", "longitude"),
    "OxTS": ("Time (s)", "Accel {} (m/s²)", "Ang rate {} (rad/s)", "Pos lat (deg)", "Pos lon (deg)"),
    "GoPro": (
        "cts",
        "Accelerometer ({}) [m/s2]",
        "Gyroscope ({}) [rad/s]",
        "GPS (Lat.) [deg]",
        "GPS (Long.) [deg]",
    ),
}


@pytest.mark.parametrize("language", some(LANGUAGES))
def test_names_of_other_languages_and_vendors(tmp_path: Path, language: str):
    time, acceleration, rate, lat, lon = LANGUAGES[language]
    names = [*map(acceleration.format, "xyz"), *map(rate.format, "xyz")]
    write(
        tmp_path,
        dict(zip(names, IMU.values(), strict=True)),
        {lat: FIXES["lat"], lon: FIXES["lon"]},
        head=time,
    )
    require_right(tmp_path)
    np.testing.assert_allclose(imported(tmp_path).drive.imu.ax, IMU["ax"])


def test_day_and_time_of_day_in_german(tmp_path: Path):
    for name, columns, time in (("imu", IMU, T), ("gps", FIXES, T[::EVERY])):
        days = {"Datum": dates(time, "%d.%m.%Y"), "Uhrzeit": dates(time, "%H:%M:%S.%f")}
        pl.DataFrame(days | columns).write_csv(tmp_path / f"{name}.csv")
    require_right(tmp_path)


def test_the_unit_of_a_time_of_week_follows_from_its_size(tmp_path: Path):
    imu, gps = ({"GpsWeek": np.full(n, 2311), **columns} for n, columns in ((N, IMU), (N // EVERY, FIXES)))
    write(tmp_path, imu, gps, lambda t: np.round((t + 342418) * 1e9).astype(int), "GpsTow")
    require_right(tmp_path)


def test_small_steps_of_whole_numbers_are_no_ms(tmp_path: Path):
    """Hundredths of a second at 50 Hz have steps of 2; numbers of rows have steps of 1."""
    write(tmp_path, clock=lambda t: np.round(t * 20).astype(int))
    with pytest.raises(
        InputError, match="increases by 1 per row, so it may count ms, hundredths of a second, or rows"
    ):
        imported(tmp_path)
    write(tmp_path, clock=lambda t: np.round(t * 60).astype(int))
    with pytest.raises(InputError, match=r'"t\*1e-2" for 33.33 Hz'):
        imported(tmp_path)


APART: dict[str, tuple[Callable[[np.ndarray], object], Callable[[np.ndarray], object]]] = {
    "zones": (lambda t: t + EPOCH + 7200, lambda t: t + EPOCH),
    "midnight": (lambda t: t + EPOCH, lambda t: t + EPOCH % 86400),
    "week": (lambda t: t + EPOCH, lambda t: t + (EPOCH - 315964800 + 18) % 604800),
    "GPS time": (lambda t: t + EPOCH, lambda t: t + EPOCH - 315964800 + 18),
    "IMU with GPS time": (lambda t: t + EPOCH - 315964800 + 18, lambda t: t + EPOCH),
    "IMU with the week": (lambda t: t + (EPOCH - 315964800 + 18) % 604800, lambda t: t + EPOCH),
}


@pytest.mark.parametrize("name", some(APART))
def test_offsets_between_clocks_are_proposed(tmp_path: Path, name: str):
    """The fixes begin 3 s after the IMU, which the offset of two beginnings would hide."""
    write(tmp_path, clock=APART[name][0], gps_clock=lambda t: APART[name][1](t + 3))
    with pytest.raises(InputError, match="convert both to one clock: add --gps-offset") as caught:
        imported(tmp_path)
    offset = float(re.findall(r"--gps-offset (-?[\d.]+) if (?!both)", str(caught.value))[0])
    drive = imported(tmp_path, recipe=Recipe(gps_offset_s=offset)).drive
    assert drive.gps.time[0] - drive.imu.time[0] == pytest.approx(3.0, abs=1e-3)


FLAGS = [
    *(
        ("fix_type", 1, 3),
        ("num_sats", 0, 9),
        ("status", "V", "A"),
        ("valid", "False", "True"),
        ("fix_status", -1, 0),
    ),
    *(
        ("fix", "NO FIX", "3D"),
        ("mode", "No Fix", "GPS Fix"),
        ("pos_type", "NONE", "SINGLE"),
        ("fix", "", "2D"),
    ),
    *(
        ("gps_status", "UNAVAILABLE", "AVAILABLE"),
        ("gps_fix_type", "NO_FIX", "RTK_FIXED"),
        ("sol_status", "INSUFFICIENT_OBS", "SOL_COMPUTED"),
    ),
]


@pytest.mark.parametrize(("name", "bad", "good", "tenths", "noise"), diagonal(FLAGS, [1, 4, 6], [0.0, 2e-3]))
def test_flags(tmp_path: Path, name: str, bad: object, good: object, tenths: int, noise: float):
    """Fixes without a fix are 200 m off, or scatter; more than a fifth of them are left out as well."""
    wrong = np.arange(N // EVERY) // 2 % 10 < tenths
    off = np.random.default_rng(1).normal(2e-3 * (not noise), noise, N // EVERY)
    fixes = FIXES | {"lat": FIXES["lat"] + wrong * off}
    write(tmp_path, gps=fixes | {name: np.array([bad if w else good for w in wrong])})
    require_right(tmp_path, N // EVERY * (10 - tenths) // 10)


@pytest.mark.parametrize(("name", "other", "best"), [("fix", 0, 1), ("fix", "none", "RTK"), ("status", "V", "A"),
                                                     ("gps_status", "invalid", "valid")])  # fmt: skip
def test_flags_that_the_positions_contradict(tmp_path: Path, name: str, other: object, best: object):
    flags = np.array([other if k // 20 % 2 else best for k in range(N // EVERY)])
    write(tmp_path, gps=FIXES | {name: flags})
    require_right(tmp_path)
    (said,) = [note for note in imported(tmp_path).notes if "100 of 200 fixes are used, although" in note]
    assert len(imported(tmp_path, maps=options_in(said)[0]).drive.gps) == N // EVERY // 2


@pytest.mark.parametrize(
    ("name", "first", "then"),
    diagonal(["mode", "state"], [("NONE", "AUTO"), ("NONE", "FOLLOW_GPS"), ("INVALID", "ACTIVE")]),
)
def test_words_of_an_autopilot_are_no_flags(tmp_path: Path, name: str, first: str, then: str):
    write(tmp_path, gps=FIXES | {name: np.array([then if k > 30 else first for k in range(N // EVERY)])})
    require_right(tmp_path)


@pytest.mark.parametrize("flags", [("3D", "DR"), ("MANUAL", "AUTO"), ("12", "LOST")])
def test_words_of_other_columns_are_no_flags(tmp_path: Path, flags: tuple[str, str]):
    write(tmp_path, gps=FIXES | {"mode": np.array([flags[k // 10 % 20 == 3] for k in range(N // EVERY)])})
    require_right(tmp_path)


@pytest.mark.parametrize("text", ["INVALID", "*****", "-1"])
def test_placeholders_before_the_first_fix(tmp_path: Path, text: str):
    cells = {n: np.array([text if k < 40 else f"{v:.9f}" for k, v in enumerate(c)]) for n, c in FIXES.items()}
    write(tmp_path, gps=cells)
    require_right(tmp_path, N // EVERY - 40)


def rows() -> list[str]:
    held = {n: np.repeat(c, EVERY) for n, c in FIXES.items()}
    return [
        ",".join(map(repr, row))
        for row in zip(*(c.tolist() for c in (T, *IMU.values(), *held.values())), strict=True)
    ]


@pytest.mark.parametrize(
    "tail", [lambda k: "," * (k % 2), lambda k: "," * (k > 500), lambda k: ",,", lambda k: ", "]
)
def test_empty_cells_at_the_end_of_rows(tmp_path: Path, tail: Callable[[int], str]):
    lines = [f"{row}{tail(k)}" for k, row in enumerate(rows())]
    (tmp_path / "log.csv").write_text("\n".join(["t,ax,ay,az,gx,gy,gz,lat,lon", *lines]) + "\n")
    require_right(tmp_path / "log.csv")
    lines[600] = rows()[600] + ",7"
    (tmp_path / "log.csv").write_text("\n".join(["t,ax,ay,az,gx,gy,gz,lat,lon", *lines]) + "\n")
    with pytest.raises(InputError, match="row 602: has 10 cells"):
        imported(tmp_path / "log.csv")


LINES: dict[str, Callable[[list[str]], list[str]]] = {
    "a header again": lambda lines: [*lines[:500], lines[0], *lines[500:]],
    "a blank line and a header": lambda lines: [*lines[:500], "", lines[0], *lines[500:]],
    "a footer": lambda lines: [*lines, "End of log", "800 rows"],
    "a statistic": lambda lines: [*lines, "Mean,0.1,0.2,9.8,0,0,0,48,11", "Max,1,1,1,1,1,1,49,12"],
    "padding": lambda lines: [*lines, "\0" * 512],
}


@pytest.mark.parametrize("case", LINES)
def test_lines_that_are_no_rows(tmp_path: Path, case: str):
    lines = LINES[case](["t,ax,ay,az,gx,gy,gz,lat,lon", *rows()])
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    require_right(tmp_path / "log.csv")
    assert any("since the time is missing" in note for note in imported(tmp_path / "log.csv").notes)


@pytest.mark.parametrize("name", ["ax", "lat"])
def test_a_row_with_a_time_and_no_number_is_refused(tmp_path: Path, name: str):
    head = ["t", "ax", "ay", "az", "gx", "gy", "gz", "lat", "lon"]
    lines = [row.split(",") for row in rows()]
    lines[400][head.index(name)] = "fault"
    (tmp_path / "log.csv").write_text("\n".join([",".join(line) for line in [head, *lines]]) + "\n")
    with pytest.raises(InputError, match=f"row 401 of the data, column {name}: 'fault' is not a number"):
        imported(tmp_path / "log.csv")


STRAY: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "the beginning of 1970": lambda t: 0.0 * t,
    "an hour ago": lambda t: t - 3600,
    "a day later": lambda t: t + 86400,
}


@pytest.mark.parametrize(("case", "count"), diagonal(STRAY, (1, 5, 15)))
def test_few_wrong_times_are_no_recording(tmp_path: Path, case: str, count: int):
    write(tmp_path, clock=lambda t: t + EPOCH)
    table = pl.read_csv(tmp_path / "gps.csv")
    time = table["t"].to_numpy().copy()
    time[100 : 100 + count] = STRAY[case](time[100 : 100 + count])
    table.with_columns(t=time).write_csv(tmp_path / "gps.csv")
    require_right(tmp_path, N // EVERY - count)
    assert any(
        n.endswith("left out, since the time is far from that of the adjacent rows")
        and f" {count} row{'s' * (count > 1)} " in n
        for n in imported(tmp_path).notes
    )


@pytest.mark.parametrize(
    "rows", [slice(0, 5), slice(-5, None)], ids=["before the clock was set", "at the end"]
)
def test_few_times_of_another_year_at_an_end_are_left_out(tmp_path: Path, rows: slice):
    write(tmp_path, clock=lambda t: t + EPOCH)
    table = pl.read_csv(tmp_path / "gps.csv")
    time = table["t"].to_numpy().copy()
    time[rows] += -EPOCH if rows.start == 0 else EPOCH
    table.with_columns(t=time).write_csv(tmp_path / "gps.csv")
    require_right(tmp_path, N // EVERY - 5)


FRACTIONS: dict[str, Callable[[float], str]] = {
    "ms without zeros": lambda t: f"{int(t) + EPOCH}.{round(t * 1e3) % 1000}",
    "us without zeros": lambda t: f"{int(t)}.{round(t * 1e6) % 1_000_000}",
    "of times of day": lambda t: f"10:{clock(int(t))[:5]}.{round(t * 1e3) % 1000}",
    "alone": lambda t: f"{round(t * 1e6) % 1_000_000}",
}


@pytest.mark.parametrize("case", some(FRACTIONS))
def test_rows_are_counted_where_fractions_are_wrong(tmp_path: Path, case: str):
    pl.DataFrame({"t": [FRACTIONS[case](round(t, 3)) for t in T.tolist()], **IMU}).write_csv(
        tmp_path / "imu.csv"
    )
    pl.DataFrame({"time": T[::EVERY], **FIXES}).write_csv(tmp_path / "gps.csv")
    with pytest.raises(InputError, match=r"(the clock goes back|another clock).* the row number: --map") as c:
        imported(tmp_path)
    require_right(tmp_path, maps=options_in(str(c.value))[0])


@pytest.mark.parametrize(("names", "south"), diagonal(["{}", "ecef_{}", "ECEF {}"], [1, -1]))
def test_coordinates_from_the_center_of_the_earth(tmp_path: Path, names: str, south: int):
    lat, lon = np.radians(south * FIXES["lat"]), np.radians(FIXES["lon"] - 100)
    radius = 6378137 / np.sqrt(1 - 6.69437999014e-3 * np.sin(lat) ** 2) + 400
    place = [radius * np.cos(lat) * np.cos(lon), radius * np.cos(lat) * np.sin(lon)]
    place.append((radius - (radius - 400) * 6.69437999014e-3) * np.sin(lat))
    write(tmp_path, gps=dict(zip(map(names.format, "xyz"), place, strict=True)))
    got = imported(tmp_path).drive.gps
    assert got.lat is not None and got.lon is not None
    np.testing.assert_allclose(got.lat, south * FIXES["lat"], atol=1e-9)
    np.testing.assert_allclose(got.lon, FIXES["lon"] - 100, atol=1e-9)


@pytest.mark.parametrize(
    "corner", [(555_000, 6_323_000), (3_500_000, 5_320_000)], ids=["UTM", "Gauss-Krueger"]
)
def test_eastings_and_northings_as_far_as_the_center_of_the_earth_are_meters(
    tmp_path: Path, corner: tuple[float, float]
):
    east, north = (PATH[name][::EVERY] + start for name, start in zip("xy", corner, strict=True))
    write(tmp_path, gps={"x": east, "y": north, "z": 20 + 0 * east})
    require_right(tmp_path)


COPIES: dict[str, Callable[[int], np.ndarray]] = {
    "each row twice": lambda n: np.repeat(np.arange(n), 2),
    "some rows twice": lambda n: np.sort(np.r_[np.arange(n), np.arange(0, n, 7)]),
    "a block twice": lambda n: np.r_[np.arange(n // 2), np.arange(n // 4, n)],
    "a block at the end": lambda n: np.r_[np.arange(n), np.arange(n // 2, n // 2 + 50)],
}


@pytest.mark.parametrize("case", some(COPIES))
def test_copies_of_rows_are_left_out(tmp_path: Path, case: str):
    write(tmp_path)
    for file in (tmp_path / "imu.csv", tmp_path / "gps.csv"):
        table = pl.read_csv(file)
        table[COPIES[case](len(table))].write_csv(file)
    require_right(tmp_path)
    assert any("since other rows have the same content" in note for note in imported(tmp_path).notes)


@pytest.mark.parametrize("names", [("linear_acceleration.{}", "accel_{}"), ("acc_{}", "lin_acc_{}"),
                                   ("linear_acc_{}", "Acceleration {} (m/s2)")])  # fmt: skip
def test_acceleration_with_gravity_goes_before_linear_acceleration(tmp_path: Path, names: tuple[str, str]):
    columns = {
        name.format(i): IMU[f"a{i}"] - (9.81 if i == "z" and name.startswith("lin") else 0)
        for name in names
        for i in "xyz"
    }
    write(tmp_path, columns | {n: IMU[n] for n in ("gx", "gy", "gz")})
    require_right(tmp_path)
    np.testing.assert_allclose(imported(tmp_path).drive.imu.az, 9.81)


@pytest.mark.parametrize("folder", ["", "log/", "a/b/"])
def test_a_zip_of_tables(tmp_path: Path, folder: str):
    write(tmp_path)
    with zipfile.ZipFile(tmp_path / "log.zip", "w") as archive:
        for name in ("imu.csv", "gps.csv"):
            archive.write(tmp_path / name, folder + name)
        archive.writestr("__MACOSX/._imu.csv", "x")
    require_right(tmp_path / "log.zip")


def test_a_zip_of_two_drives_is_refused_and_a_folder_in_it_is_read(tmp_path: Path):
    for day in ("monday", "tuesday"):
        (tmp_path / day).mkdir()
        write(tmp_path / day)
    with zipfile.ZipFile(tmp_path / "log.zip", "w") as archive:
        for file in sorted(tmp_path.glob("*/*.csv")):
            archive.write(file, file.relative_to(tmp_path).as_posix())
    with pytest.raises(InputError, match=r"tables in several folders \(monday, tuesday\); unpack it"):
        imported(tmp_path / "log.zip")
    require_right(tmp_path / "monday")


def test_a_row_of_sources_below_the_header(tmp_path: Path):
    above = [
        "t,x_acc,y_acc,z_acc,gx,gy,gz,lat,lon",
        "s,m/s2,m/s2,m/s2,rad/s,rad/s,rad/s,deg,deg",
        ",".join(["100: a"] * 9),
    ]
    (tmp_path / "log.csv").write_text("\n".join(["exported by x", *above, *rows()]) + "\n")
    require_right(tmp_path / "log.csv")


@pytest.mark.parametrize("axes", ["roll_rate PitchRate yaw_rate",
                                  "gyro_rad[0] gyro_rad[1] gyro_rad[2]", "AsX(rad/s) AsY(rad/s) AsZ(rad/s)",
                                  "roll_rate_radps pitch_rate_radps yaw_rate_radps"])  # fmt: skip
def test_names_of_rates(tmp_path: Path, axes: str):
    rates = dict(zip(axes.split(), (IMU["gx"] + 0.5, IMU["gy"] + 0.25, IMU["gz"]), strict=True))
    write(tmp_path, {n: IMU[n] for n in ("ax", "ay", "az")} | rates)
    require_right(tmp_path)
    got = imported(tmp_path).drive.imu
    assert (got.gx[0], got.gy[0]) == pytest.approx((0.5, 0.25))


def test_measured_positions_go_before_estimates(tmp_path: Path):
    write(tmp_path)
    (tmp_path / "gps.csv").rename(tmp_path / "raw_gps.csv")
    pl.DataFrame({"t": T, "lat": 48 + 1e-5 * T, "lon": 11 + 0 * T}).write_csv(tmp_path / "gps_filtered.csv")
    require_right(tmp_path)


HZS = {
    **{"mrad/s": 1e-3, "rpm": np.pi / 30, "rev/s": 2 * np.pi, "deg/h": np.pi / 648e3, "mdps": np.pi / 180e3},
    **{"deg/min": np.pi / 10800, "0.1 deg/s": np.pi / 1800, "counts, 16.4 per deg/s": np.pi / 180 / 16.4},
    **{f"counts, {per} per deg/s": np.pi / 180 / per for per in (131, 65.5, 32.8)},
}


@pytest.mark.parametrize(("unit", "form"), diagonal(HZS, ["three", "yaw_rate", "tilted", "unknown"]))
def test_the_turns_of_the_fixes_show_the_unit_of_rates(tmp_path: Path, unit: str, form: str):
    rates = {n: IMU[n] / HZS[unit] for n in ("gx", "gy", "gz")}
    if form == "tilted":
        rates = {"gx": -0.8 * rates["gz"], "gy": rates["gy"], "gz": 0.6 * rates["gz"]}
    rates = {n: np.round(c) if "counts" in unit else c for n, c in rates.items()}
    names = {"yaw_rate": {"gz": "yaw_rate"}, "unknown": {n: f"{n} [U/min]" for n in rates}}
    columns = {name: rates[n] for n, name in names.get(form, {n: n for n in rates}).items()}
    write(tmp_path, {n: IMU[n] for n in ("ax", "ay", "az")} | columns)
    with pytest.raises(InputError, match=r"the turns of the path show that the unit of .* is ") as caught:
        imported(tmp_path)
    assert unit in str(caught.value)
    shown = inspect_request(Request(tmp_path))
    remedy = str(caught.value).partition("the turns of the path")[2]
    assert not shown.faults or any(remedy in note for note in shown.notes)  # the same as of --show
    right = 0.6 * IMU["gz"] if form == "tilted" else IMU["gz"]
    found = [imported(tmp_path, maps=maps).drive.imu.gz for maps in options_in(str(caught.value))]
    assert any(np.allclose(gz, right, atol=0.6 * HZS[unit] if "counts" in unit else 1e-6) for gz in found)


def test_raw_rates_without_fixes_keep_the_example(tmp_path: Path):
    write(tmp_path, IMU | {"gz": np.round(IMU["gz"] * 180 / np.pi * 131)})
    (tmp_path / "gps.csv").unlink()
    with pytest.raises(InputError, match=r"raw counts.* for example --map .*131"):
        imported(tmp_path / "imu.csv")


@pytest.mark.parametrize("per", [8192, 16384])
def test_raw_counts_that_are_mapped_unchanged_are_refused_with_their_scale(tmp_path: Path, per: int):
    """Names that are not recognized state no unit, and nor does a choice in the workbench."""
    counts = {n: np.round(IMU[n] / 9.80665 * per) for n in ("ax", "ay", "az")}
    counts |= {n: np.round(np.degrees(IMU[n]) * 65.5) for n in ("gx", "gy", "gz")}
    write(tmp_path, {f"{n}_s": counts[n] for n in counts})
    maps = [f"imu.{n}={n}_s" for n in counts]
    with pytest.raises(
        InputError, match=r"the turns of the path show .* is counts, 65.5 per deg/s"
    ) as caught:
        imported(tmp_path, maps=maps)
    forces, rates = options_in(str(caught.value))
    got = imported(tmp_path, maps=[*forces, *rates]).drive.imu
    np.testing.assert_allclose(got.az, IMU["az"], atol=1e-2)
    np.testing.assert_allclose(got.gz, IMU["gz"], atol=1e-3)


def test_a_choice_for_a_column_of_counts_has_the_unit_of_the_note(tmp_path: Path):
    write(tmp_path, {n: np.round(v / 9.80665 * 8192) if n[0] == "a" else v for n, v in IMU.items()})
    seen, chosen = inspect_request(Request(tmp_path)), dict[str, Any]()
    assign(chosen, seen, "imu.csv", "ay", "imu.ay")
    assert chosen["maps"] == {"imu.ay": "ay*9.80665/8192"}


def test_a_time_without_a_known_name_is_proposed_in_seconds(tmp_path: Path):
    """The current folder has a name in messages, too."""
    write(tmp_path, head="unix_ms", clock=lambda t: np.round((1.7e9 + t) * 1e3).astype(np.int64))
    require_right(tmp_path)
    write(tmp_path, head="zaehler", clock=lambda t: np.round((1.7e9 + t) * 1e3).astype(np.int64))
    with pytest.raises(InputError, match=r'specify it with --map "imu.t=zaehler\*1e-3"'):
        imported(tmp_path)
    times = ["imu.t=zaehler*1e-3", "gps.t=row/5"]
    with (
        chdir(tmp_path),
        pytest.raises(InputError, match=rf"^{tmp_path.name}: .*17000000\d\d\.\d to") as caught,
    ):
        imported(Path(), maps=times)
    assert "e+09" not in str(caught.value)


SLOW = 0.06 * np.sin(T / 6)
SPINS = np.where(np.abs(T % 20 - 10) < 2, 6.0, 0.4 * np.sin(T))


@pytest.mark.parametrize(
    ("v", "gz", "scale"), [(8.0, SLOW, 180 / np.pi), (np.where(SPINS > 1, 0, 1.5), SPINS, 1.0)]
)
def test_slow_rates_in_degrees_and_fast_ones_in_radians(tmp_path: Path, v: Any, gz: np.ndarray, scale: float):
    """Without fixes, rates above 5 are deg/s. A robot that spins on the spot shows no course."""
    imu, fixes, _ = road(v, gz)
    write(tmp_path, imu | {"gz": gz * scale}, fixes)
    with pytest.raises(
        InputError, match="the turns of the path show that the unit of gx, gy, gz is"
    ) as caught:
        imported(tmp_path)
    (maps,) = options_in(str(caught.value))
    np.testing.assert_allclose(imported(tmp_path, maps=maps).drive.imu.gz, gz, atol=1e-9)


@pytest.mark.parametrize(("share", "ratio", "noted"), [(0.87, 1.02, 0), (0.87, 57.3, 1), (0.3, 1.0, 1)])
def test_turns_that_explain_most_of_the_course_confirm_the_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, share: float, ratio: float, noted: int
):
    monkeypatch.setattr("sigmaswarm.importing.imu_units.turn_ratio", lambda _: (share, ratio))
    write(tmp_path)
    assert sum("no turn of the path confirms" in note for note in imported(tmp_path).notes) == noted


def test_rates_that_no_turn_confirms_are_told_with_the_way(tmp_path: Path):
    write(tmp_path)
    assert not any("no turn of the path confirms it" in note for note in imported(tmp_path).notes)
    imu, fixes, _ = road(0.3, 0.001 * np.sin(T))
    write(tmp_path, imu, fixes)
    (said,) = (note for note in imported(tmp_path).notes if "no turn of the path confirms it" in note)
    got = imported(tmp_path, maps=options_in(said)[0])
    np.testing.assert_allclose(got.drive.imu.gz, np.radians(imu["gz"]), atol=1e-12)
    assert not any("no turn of the path confirms it" in note for note in got.notes)


@pytest.mark.parametrize(("ticks", "head"), several([(1e5, "ticks"), (1e5, "t"), (1e5, "timestamp")]))
def test_the_turns_of_the_fixes_show_the_unit_of_the_times(tmp_path: Path, ticks: float, head: str):
    """Ticks of 10 us look like us of an IMU at 200 Hz."""
    write(tmp_path, clock=lambda t: np.round((t + 3) * ticks).astype(int), head=head)
    with pytest.raises(InputError, match="the unit of the times is likely 10 times the assumed") as caught:
        imported(tmp_path)
    require_right(tmp_path, maps=options_in(str(caught.value))[0])


def test_turns_of_the_fixes_do_not_refuse_stated_units(tmp_path: Path):
    """A mapping of the user, a unit in the name, and a gyro that measures 1.3 times too much stay as they are."""
    for name, scale, maps in (("gz", 20.0, ["imu.gz=gz*0.5"]), ("gz [rad/s]", 57.3, []), ("gz", 1.3, [])):
        write(tmp_path, {n: c for n, c in IMU.items() if n[0] == "a"} | {name: scale * IMU["gz"]})
        imported(tmp_path, maps=maps)


@pytest.mark.parametrize(
    ("per_g", "per_degree"), several([(16384, 131), (8192, 65.5), (2048, 16.4), (4096, 32.8)])
)
def test_raw_counts_of_both_sensors_are_one_message(tmp_path: Path, per_g: float, per_degree: float):
    scales = {"a": per_g / 9.80665, "g": per_degree * 180 / np.pi}
    write(tmp_path, {n: np.round(c * scales[n[0]]).astype(int) for n, c in IMU.items()})
    with pytest.raises(InputError, match=r"raw counts.*16-bit sensors.*raw counts") as caught:
        imported(tmp_path)
    accelerations, *rates = options_in(str(caught.value))
    (maps,) = (maps for maps in rates if f"/{per_degree:g})" in maps[0])
    got = imported(tmp_path, maps=[*accelerations, *maps]).drive.imu
    for name, values in IMU.items():
        np.testing.assert_allclose(getattr(got, name), values, atol=1 / scales[name[0]])


@pytest.mark.parametrize(("scale", "option"), [(1e3, 0), (1e2, 1)])
def test_positions_in_mm_and_cm_are_refused(tmp_path: Path, scale: float, option: int):
    write(tmp_path, gps={n: np.round(scale * p[::EVERY]) for n, p in PATH.items()})
    with pytest.raises(InputError, match=r"the fixes move at .* x and y are not in m") as caught:
        imported(tmp_path)
    require_right(tmp_path, maps=options_in(str(caught.value))[option])


def test_other_units_of_an_imu_get_the_scale_that_gravity_shows(tmp_path: Path):
    write(tmp_path, {n: c / 0.3048 if n[0] == "a" else c for n, c in IMU.items()})
    with pytest.raises(InputError, match="gravity has a value of about 32") as caught:
        imported(tmp_path)
    (maps,) = options_in(str(caught.value))
    np.testing.assert_allclose(imported(tmp_path, maps=maps).drive.imu.ay, IMU["ay"], rtol=0.03, atol=1e-9)


def test_the_speed_of_a_slow_robot_is_compared_with_its_positions(tmp_path: Path):
    imu, fixes, _ = road(0.9)
    write(tmp_path, imu, fixes | {"speed": np.full(N // EVERY, 3.24)})
    got = imported(tmp_path)
    assert got.drive.gps.speed is None
    assert any("if it is in km/h" in note for note in got.notes)
    write(tmp_path, imu, fixes | {"speed": np.full(N // EVERY, 0.9)})
    assert imported(tmp_path).drive.gps.speed is not None


def test_the_proposed_origin_of_a_far_truth_fits_to_the_centimeter(tmp_path: Path):
    """North at a place 5 km to the east differs by 0.9 mrad."""
    write(tmp_path)
    far = geodetic_to_enu(FIXES["lat"], FIXES["lon"], 0.0, (48.02, 11.07, 0.0))
    pl.DataFrame({"t": T[::EVERY], "x": far[:, 0], "y": far[:, 1]}).write_csv(tmp_path / "truth.csv")
    (origin,) = re.findall(r"--origin (\S+) fits", " ".join(imported(tmp_path).notes))
    drive = imported(tmp_path, recipe=Recipe(origin=tuple(map(float, origin.split(","))))).drive
    np.testing.assert_allclose(drive.gps.x, drive.truth.x, atol=0.02)
    pl.DataFrame({"t": T, "x": PATH["x"] + 691e3, "y": PATH["y"] + 5325e3}).write_csv(tmp_path / "truth.csv")
    assert any("probably has coordinates of a map (UTM)" in note for note in imported(tmp_path).notes)


def records(table: Columns) -> list[dict[str, object]]:
    return pl.DataFrame({**table}).to_dicts()


def with_kind(kind: str, table: Columns) -> list[dict[str, object]]:
    return [{"sensor": kind, **{k: str(v) for k, v in row.items()}} for row in records(table)]


def nested(i: int) -> str:
    row = {k: float(v[i]) for k, v in IMU.items()}
    fix = {"gps": {k: float(v[i // EVERY]) for k, v in FIXES.items()}} if i % EVERY == 0 else {}
    acc, gyro = {k[1]: row[k] for k in ("ax", "ay", "az")}, [row[k] for k in ("gx", "gy", "gz")]
    return json.dumps({"t": float(T[i]), "acc": acc, "gyro": gyro, **fix})


FORCE = {"time": (T * 1e9).astype(int) + EPOCH * 10**9, "x": IMU["ax"], "y": IMU["ay"], "z": IMU["az"]}
TURN = {"time": FORCE["time"], "x": IMU["gx"], "y": IMU["gy"], "z": IMU["gz"]}
PLACE = {"time": FORCE["time"][::EVERY], "latitude": FIXES["lat"], "longitude": FIXES["lon"]}
SENSORS = {"Accelerometer": FORCE, "Gyroscope": TURN, "Location": PLACE}
PAIR = {"imu": {"t": T, **IMU}, "gps": {"t": T[::EVERY], **FIXES}}
JOINED = {"t": T, **IMU, **{n: np.repeat(v, EVERY) for n, v in FIXES.items()}}
JSON: dict[str, Callable[[], str]] = {
    "a list for each sensor": lambda: json.dumps({name: records(table) for name, table in SENSORS.items()}),
    "one list of all sensors, numbers as texts": lambda: json.dumps(
        [row for name, table in SENSORS.items() for row in with_kind(name, table)]
    ),
    "columns": lambda: json.dumps({n: {k: c.tolist() for k, c in table.items()} for n, table in PAIR.items()}),
    "columns of pandas": lambda: json.dumps(
        {n: {k: dict(enumerate(c.tolist())) for k, c in table.items()} for n, table in PAIR.items()}
    ),
    "columns of vectors": lambda: json.dumps(
        {
            "imu": {"t": T.tolist(), "acc": SIX[:, :3].tolist(), "gyr": SIX[:, 3:].tolist()},
            "gps": {k: c.tolist() for k, c in PAIR["gps"].items()},
        }
    ),
    "a value on each line": lambda: "\n".join(
        json.dumps({"name": n, "value": float(v[i]), "timestamp": float(T[i])})
        for i in range(N) for n, v in JOINED.items() if n != "t" and (n in IMU or i % EVERY == 0)
    ),
    "lines of nested objects, the last one cut off": lambda: "\n".join([*map(nested, range(N)), '{"t": 40.0, "acc']),
}  # fmt: skip


@pytest.mark.parametrize(("form", "name"), diagonal(JSON, ["log.json", "log.txt"]))
def test_json(tmp_path: Path, form: str, name: str):
    (tmp_path / name).write_text(JSON[form]())
    require_right(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[{"t": 1, "ax": }]', "is not valid JSON"),
        ('{"t": 1}\n{"t" 2}\n{"t": 3}', "is not valid JSON"),
        ('{"title": "a drive"}', "no list of objects"),
        ('{"a": ' * 100_000, "is not valid JSON"),
        ('[{"t": 1, "note": "x"}]', "no IMU samples"),
    ],
)
def test_json_that_is_no_log_is_refused_in_one_line(tmp_path: Path, text: str, said: str):
    (tmp_path / "log.json").write_text(text)
    with pytest.raises(InputError, match=said):
        imported(tmp_path / "log.json")


CHIP = [(f"{a}_{i}", unit) for a, unit in (("a", "m/s2"), ("g", "rad/s")) for i in "xyz"]
NAMES: dict[str, tuple[list[str], list[str], float]] = {  # of t, six axes; t, lat, lon; factor of t
    "openpilot": (
        ["logMonoTime", *(f"accelerometer.acceleration.v[{i}]" for i in range(3)),
         *(f"gyroscope.gyroUncalibrated.v[{i}]" for i in range(3))],
        ["logMonoTime", "latitude", "longitude"], 1e9,
    ),
    "GoPro": (["Milliseconds", "AcclX", "AcclY", "AcclZ", "GyroX", "GyroY", "GyroZ"],
              ["Milliseconds", "Latitude", "Longitude"], 1e3),
    "a chip": (["unit:timestamp[ms]", *(f"bmi160_{n}[{u}]" for n, u in CHIP)],
               ["UnixTimeMillis", "LatitudeDegrees", "LongitudeDegrees"], 1e3),
}  # fmt: skip


@pytest.mark.parametrize("device", NAMES)
def test_names_of_devices(tmp_path: Path, device: str):
    imu, gps, ticks = NAMES[device]
    start = 1_718_000_000 * ticks  # both in one clock
    pl.DataFrame(dict(zip(imu, [start + np.round(T * ticks), *IMU.values()], strict=True))).write_csv(
        tmp_path / "imu.csv"
    )
    rows = [start + np.round(T[::EVERY] * ticks), *FIXES.values()]
    pl.DataFrame(dict(zip(gps, rows, strict=True))).write_csv(tmp_path / "gps.csv")
    require_right(tmp_path)


def typed(said: str, folder: Path) -> None:
    """Run the command that a message states, with this Python."""
    command = re.search(r'python -c "([^"]*)"', said)
    words = (
        [sys.executable, "-c", command[1]]
        if command
        else ["bash", "-c", re.search(r"sed -E .* > new\.csv", said)[0]]
    )
    subprocess.run(words, cwd=folder, check=True)


def of_values(folder: Path) -> None:
    rows = ["time,sensor,axis,value"]
    rows += [
        f"{t},{'acc' if k[0] == 'a' else 'gyro'},{k[1]},{v[i]}"
        for i, t in enumerate(T)
        for k, v in IMU.items()
    ]
    rows += [f"{t},gps,{k},{v[i]}" for i, t in enumerate(T[::EVERY]) for k, v in FIXES.items()]
    (folder / "log.csv").write_text("\n".join(rows))


def of_sensors(folder: Path) -> None:
    rows = ["MessageType,utcTimeMillis,MeasurementX,MeasurementY,MeasurementZ"]
    for i, t in enumerate((np.round(T * 1e3) + 1_718_000_000_000).astype(int)):
        rows += [f"Accel,{t},{','.join(str(IMU[k][i]) for k in ('ax', 'ay', 'az'))}"]
        rows += [f"Gyro,{t},{','.join(str(IMU[k][i]) for k in ('gx', 'gy', 'gz'))}"]
    (folder / "log.csv").write_text("\n".join(rows))
    (folder / "kinds").mkdir()
    fixes = {"t": np.round(T[::EVERY] * 1e3) + 1_718_000_000_000, **FIXES}
    pl.DataFrame(fixes).write_csv(folder / "kinds" / "gps.csv")


def of_a_monitor(folder: Path) -> None:
    last = np.arange(N) // EVERY
    table = {"millis": np.round(T * 1e3).astype(int), **IMU, **{k: v[last] for k, v in FIXES.items()}}
    head, *rows = pl.DataFrame(table).write_csv().split("\n")[:-1]
    (folder / "log.csv").write_text(
        "\n".join([head, *(f"12:00:{t:06.3f} -> {r}" for t, r in zip(T, rows, strict=True))])
    )


@pytest.mark.parametrize(
    ("write_log", "new"), several([(of_values, "new.csv"), (of_sensors, "kinds"), (of_a_monitor, "new.csv")])
)
def test_rows_of_several_kinds_are_refused_and_the_command_helps(tmp_path: Path, write_log, new: str):
    write_log(tmp_path)
    with pytest.raises(InputError) as caught:
        imported(tmp_path / "log.csv")
    typed(str(caught.value), tmp_path)
    require_right(tmp_path / new)


@pytest.mark.parametrize("name", ["$(touch ran)", "`touch ran`", 'a"b', "a'b", "a!b"])
def test_a_command_for_rows_of_several_kinds_runs_nothing_of_a_header(tmp_path: Path, name: str):
    of_sensors(tmp_path)
    log = tmp_path / "log.csv"
    log.write_text(log.read_text().replace("MessageType", name, 1))
    with pytest.raises(InputError) as caught:
        imported(log)
    assert "python -c" not in str(caught.value)


def test_rows_of_several_kinds_below_a_header_name_the_command(tmp_path: Path):
    """A jumper's logger names the columns of each kind at the top; the last of these lines was the header."""
    rows = [row for i, t in enumerate(T) for row in (f"$TIME,{t},{i},2318", f"$IMU,{t},0,0,0,0,0,9.8,25")]
    head = [
        "$FLYS,1",
        "$COL,IMU,time,wx,wy,wz,ax,ay,az,temp",
        "$COL,TIME,time,tow,week",
        "$UNIT,TIME,s,s,",
        "$DATA",
    ]
    (tmp_path / "log.csv").write_text("\n".join([*head, *rows]))
    with pytest.raises(InputError, match=r"rows of several kinds \(IMU, TIME\); .* awk "):
        imported(tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("column", "scale", "lost"),
    [("zaehler", 1 / HZ, "3"), ("uhr", 1.0, "3"), ("stufe", 1e-3, "3"), ("", 0.0, "")],
)
def test_a_gap_of_the_logger_in_times_from_row_numbers_is_named(
    tmp_path: Path, column: str, scale: float, lost: str
):
    """Another clock of the table shows the gap; without one, the import says that a gap can't be seen."""
    clock = {"uhr": np.floor(T), "stufe": np.round(T * 1e3) + 70}.get(column, np.arange(N))
    kept = (T < 20) | (T >= 23)
    imu = {**IMU, **({column: clock} if column else {})}
    write(
        tmp_path,
        {n: v[kept] for n, v in imu.items()},
        clock=lambda t: np.zeros(kept.sum()),
        gps_clock=lambda t: t,
    )
    for whole in (False, True) if column else (False,):
        if whole:
            write(tmp_path, imu, clock=lambda t: 0 * t, gps_clock=lambda t: t)
        notes = " / ".join(imported(tmp_path, maps=[f"imu.t=row/{HZ:g}"]).notes)
        if not column:
            assert "imu: imu.csv: times from row numbers do not show gaps of the logger" in notes
        elif whole:
            assert "row" not in notes
        else:
            assert f"according to column {column}, rows for {lost}" in notes
            (again,) = re.findall('write --map "(.*?)"', notes)
            time = imported(tmp_path, maps=[again]).drive.imu.time
            assert time[-1] - time[0] == pytest.approx(T[-1] - T[0], abs=1.01 * max(scale, 1 / HZ))


def test_a_counter_of_rows_does_not_hide_the_gap_that_another_counter_shows(tmp_path: Path):
    kept = (T < 20) | (T >= 23)
    counters = {"id": np.arange(kept.sum()), "cnt": np.arange(N)[kept]}
    write(
        tmp_path,
        counters | {n: v[kept] for n, v in IMU.items()},
        clock=lambda t: np.zeros(kept.sum()),
        gps_clock=lambda t: t,
    )
    assert "according to column cnt, rows for 3" in " / ".join(
        imported(tmp_path, maps=[f"imu.t=row/{HZ:g}"]).notes
    )


@pytest.mark.parametrize(("every", "clock"), [(7, False), (15, True)])
def test_a_column_with_irregular_steps_is_no_clock(every: int, clock: bool):
    """One step in seven is four times as long, or one in fifteen."""
    values = np.cumsum(np.where(np.arange(300) % every == 0, 4.0, 1.0))
    assert (_gaps_of(values, np.arange(300) / 100) is not None) == clock


@pytest.mark.parametrize(("step", "named"), [(3.6, False), (6.0, True)])
def test_a_step_within_the_noise_of_the_fixes_is_no_gap(step: float, named: bool):
    """Fixes 1 m apart with noise of 0.3 m: steps up to 2.5 m + 6 x 0.3 m are noise."""
    rng = np.random.default_rng(0)
    noise = 0.3 * rng.standard_normal((2, 100))
    noise[:, 40:60] = 0.0  # only the step between fixes 49 and 50 differs there
    x = np.cumsum(np.where(np.arange(100) == 50, step, 1.0)) + noise[0]
    still = Imu(np.arange(100.0), *np.zeros((3, 100)))
    assert bool(gaps_by_distance(Drive("log", still, Gps(np.arange(100.0), x, noise[1])))) == named


def test_rows_without_a_fix_are_no_missing_fixes(tmp_path: Path):
    time = T[::EVERY]
    lost = (time >= 20) & (time < 26)
    fixes = {n: np.where(lost, np.nan, v) for n, v in FIXES.items()}
    write(tmp_path, gps=fixes, gps_clock=lambda t: 0 * t)
    notes = " / ".join(imported(tmp_path, maps=[f"gps.t=row/{1 / (time[1] - time[0]):g}"]).notes)
    assert "since a cell is empty" in notes and "much longer than the distances before and after" not in notes


def test_fixes_that_are_corrected_each_second_are_not_interpolated(tmp_path: Path):
    """Between the corrections the errors are small, but larger than those of rounding."""
    rng, time = np.random.default_rng(0), np.arange(600) / 10
    jumps = np.repeat(rng.normal(0.0, 0.3, 60), 10)
    east = 15.0 * time + jumps + rng.normal(0.0, 0.005, 600)
    rows = np.column_stack([time, 48 + 0 * time + rng.normal(0.0, 4e-8, 600), 8 + east / 74_600])
    np.savetxt(tmp_path / "gps.csv", rows, fmt="%.10f", delimiter=",", header="t,lat,lon", comments="")
    pl.DataFrame({"t": T, **IMU}).write_csv(tmp_path / "imu.csv")
    assert "interpolated" not in " / ".join(imported(tmp_path).notes)


@pytest.mark.parametrize(
    "form", ["/fix/position_covariance[{}]", "position_covariance_{}", ".position_covariance.{}"]
)
def test_covariances_of_messages_in_a_table_are_the_accuracy(tmp_path: Path, form: str):
    count = len(T[::EVERY])
    unknown = np.arange(count) < 5
    variances = {form.format(i): np.where(unknown, 0.0, v) for i, v in ((0, 0.04), (4, 0.09), (8, 0.5))}
    write(tmp_path, gps=FIXES | variances)
    gps = imported(tmp_path).drive.gps
    assert gps.std_x is not None and gps.std_y is not None
    assert gps.std_x[-1] == pytest.approx(0.2) and gps.std_y[-1] == pytest.approx(0.3)


@pytest.mark.parametrize(("begin", "end"), [(20, 20), (20, 26), (31, 33)])
def test_missing_fixes_with_times_from_row_numbers_are_named(tmp_path: Path, begin: float, end: float):
    time = T[::EVERY]
    kept = (time < begin) | (time >= end)
    write(tmp_path, gps={n: v[kept] for n, v in FIXES.items()}, gps_clock=lambda t: 0 * t[kept])
    rate = 1 / (time[1] - time[0])
    notes = " / ".join(imported(tmp_path, maps=[f"gps.t=row/{rate:g}"]).notes)
    assert ("much longer than the distances before and after" in notes) == (end > begin)
    assert "gps: gps.csv: times from row numbers do not show gaps" in notes


@pytest.mark.parametrize(
    ("direction", "speed"),
    several(
        [
            ("Richtung", "Geschwindigkeit"),
            ("rumbo", "velocidad"),
            ("cap", "vitesse"),
            ("direction", "speed"),
            ("Kurs", ""),
        ]
    ),
)
@pytest.mark.parametrize("turned", [False, True])
def test_a_course_in_another_language_needs_no_unit(tmp_path: Path, direction: str, speed: str, turned: bool):
    """Its range shows degrees, and the positions confirm it; a direction of the wind is left out."""
    move = np.gradient(PATH["x"], T) + 1j * np.gradient(PATH["y"], T)
    angle = np.degrees(np.angle(move))[::EVERY]
    values = {direction: (90 - angle + 140 * turned) % 360} | (
        {speed: np.abs(move)[::EVERY]} if speed else {}
    )
    write(tmp_path, gps={**FIXES, **values})
    got = imported(tmp_path)
    assert f"{direction} is read as degrees clockwise from north" in " / ".join(got.notes)
    if turned:
        assert got.drive.gps.course is None
    else:
        assert got.drive.gps.course is not None
        off = np.angle(np.exp(1j * (got.drive.gps.course - np.radians(angle))))
        assert np.median(np.abs(off)) < 0.01


def test_a_direction_in_letters_is_not_read(tmp_path: Path):
    write(tmp_path, gps={**FIXES, "direction": np.array(["N", "NE"] * N)[: N // EVERY]})
    require_right(tmp_path)


SEMICIRCLES = {n: np.round(v * 2**31 / 180) for n, v in FIXES.items()}
BOARDS: dict[str, tuple[Columns, Columns]] = {
    "FIT": (
        {f"calibrated_{s}_{i}[{u}]": v for (n, v), (s, i, u) in zip(
            {n: v / 9.80665 if n[0] == "a" else np.degrees(v) for n, v in IMU.items()}.items(),
            [*(("accel", i, "g") for i in "xyz"), *(("gyro", i, "deg/s") for i in "xyz")], strict=True)},
        {"position_lat[semicircles]": SEMICIRCLES["lat"], "position_long[semicircles]": SEMICIRCLES["lon"]},
    ),
    "Septentrio": (IMU, {f"{n} [rad]": np.radians(v) for n, v in FIXES.items()}),
    "hundredths": ({f"{n} [0.01 {'m/s2' if n[0] == 'a' else 'rad/s'}]": 100 * v for n, v in IMU.items()}, FIXES),
}  # fmt: skip
TICKS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "t": lambda t: t,
    "TOW [0.001 s]": lambda t: np.round(1e3 * t),
    "stamp [10us]": lambda t: np.round(1e5 * t),
    "esp_timer": lambda t: np.round(1e6 * t + 4.28e9) % 2**32,
}


@pytest.mark.parametrize(
    ("layout", "clock"),
    [("FIT", "t"), ("Septentrio", "TOW [0.001 s]"), ("hundredths", "esp_timer"), ("FIT", "stamp [10us]")],
)
def test_units_and_clocks_of_receivers_and_boards(tmp_path: Path, layout: str, clock: str):
    imu, fixes = BOARDS[layout]
    week = {"WNc [w]": 2369} if "TOW" in clock else {}
    for table, time, columns in (("imu", T, imu), ("gps", T[::EVERY], fixes)):
        also = {name: np.full(len(time), value) for name, value in week.items()}
        head = {"cnt": np.arange(len(time)), clock: TICKS[clock](time)}
        pl.DataFrame(head | also | columns).write_csv(tmp_path / f"{table}.csv")
    require_right(tmp_path)


def test_calibrated_columns_are_read_instead_of_raw_ones(tmp_path: Path):
    raw = {f"{n}_raw": np.round(1000 * v) for n, v in IMU.items()}
    write(tmp_path, raw | {f"{n}_cal": v for n, v in IMU.items()})
    require_right(tmp_path)


def test_stamps_of_batches_belong_to_their_last_samples(tmp_path: Path):
    """A program reads ten samples at once, after intervals that vary by milliseconds."""
    last = np.arange(N) // 10 * 10 + 9
    late = np.random.default_rng(0).uniform(0.0, 0.02, N)
    write(tmp_path, clock=lambda t: np.round(last / HZ + late[last], 3), gps_clock=lambda t: t)
    found = imported(tmp_path)
    assert (
        "the stamps are the times of arrival; rows are spread evenly at a constant rate of 20 Hz"
        in " / ".join(found.notes)
    )
    np.testing.assert_allclose(found.drive.imu.time, T, atol=0.005)


def test_a_counter_of_rows_is_not_proposed_as_a_time(tmp_path: Path):
    columns = {"cnt": np.arange(N), "takt": np.round(T * 1e6)}
    for names in (["cnt"], ["cnt", "takt"]):
        pl.DataFrame({n: columns[n] for n in names} | IMU).write_csv(tmp_path / "imu.csv")
        pl.DataFrame({"t": T[::EVERY], **FIXES}).write_csv(tmp_path / "gps.csv")
        with pytest.raises(InputError) as caught:
            imported(tmp_path)
        assert ('specify it with --map "imu.t=takt*1e-6"' in str(caught.value)) == ("takt" in names)
        assert 'compute it from the row number, for example --map "imu.t=row/100"' in str(caught.value)


@pytest.mark.parametrize("every", [3.0, 5.0, 10.0, 10.4])
@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_interpolated_fixes_are_left_out(tmp_path: Path, every: float, noise: float):
    """Loggers of race cars write interpolated positions at the rate of the IMU."""
    rows = np.arange(0.3 * every, N - 1, every)
    rng = np.random.default_rng(0)
    at = {n: np.interp(rows, np.arange(0, N, EVERY), v) for n, v in FIXES.items()}
    at = {n: v + noise / 111e3 * rng.standard_normal(len(v)) for n, v in at.items()}
    places = {n: np.round(np.interp(np.arange(N), rows, v), 8) for n, v in at.items()}
    pl.DataFrame({"t": T, **IMU, **places}).write_csv(tmp_path / "log.csv")
    got = imported(tmp_path / "log.csv")
    left = [note for note in got.notes if "interpolated between fixes" in note]
    assert len(left) == 1
    assert len(got.drive.gps) == pytest.approx(N / every, abs=2)


def test_smooth_fixes_at_a_high_rate_are_kept(tmp_path: Path):
    exact = np.array(enu_to_geodetic(np.column_stack([PATH["x"], PATH["y"], 0 * T]), ORIGIN)).T
    for noise in (0.0, 1e-6):
        moved = exact[:, :2].T if exact.shape[0] == N else exact[:2]
        moved = moved + noise * np.random.default_rng(0).standard_normal(moved.shape)
        pl.DataFrame({"t": T, **IMU, "lat": moved[0], "lon": moved[1]}).write_csv(tmp_path / "log.csv")
        assert len(imported(tmp_path / "log.csv").drive.gps) == N


@pytest.mark.parametrize("form", some(["%Y/%m/%d", "%d.%m.%Y", "%Y-%m-%d"]))
def test_date_and_clock_in_columns_without_names_are_joined(tmp_path: Path, form: str):
    """Solutions of RTK receivers have no header; next to an IMU, --gps names their file."""
    clock = [datetime.datetime.fromtimestamp(EPOCH + t, datetime.UTC) for t in T[::EVERY]]
    rows = zip(clock, *FIXES.values(), strict=True)
    lines = [f"{at:{form} %H:%M:%S.%f} {lat:.9f} {lon:.9f} 500.0 1 12" for at, lat, lon in rows]
    (tmp_path / "solution.llh").write_text("\n".join(lines))
    pl.DataFrame({"unix_time": EPOCH + T, **IMU}).write_csv(tmp_path / "imu.csv")
    with pytest.raises(InputError) as caught:
        imported(tmp_path)
    (gps,) = re.findall(r"--gps (\S+),", str(caught.value))
    seen = inspect_request(Request(tmp_path, gps=Path(gps)))
    assert seen.works and "utc(c1, c2" in (seen.proposal or "")
    maps = [f"{column}={text}" for column, text in seen.settings["maps"].items()]
    require_right(tmp_path, gps=Path(gps), maps=maps)


ALL = ("Accelerometer.csv", "Gyroscope.csv", "Location.csv")
LACKING = {
    ("Gyroscope.csv",): "no table of an accelerometer",
    ("Accelerometer.csv", "Location.csv"): "no table of a gyroscope",
    ("Accelerometer.csv", "Gyroscope.csv"): "no position fixes found",
    ("Location.csv",): "no IMU samples found in Location.csv",
}


def write_phone(folder: Path, names: tuple[str, ...]) -> None:
    for name, letter in zip(ALL[:2], "ag", strict=True):
        if name in names:
            pl.DataFrame({"time": T, **{i: IMU[f"{letter}{i}"] for i in "xyz"}}).write_csv(folder / name)
    if ALL[2] in names:
        pl.DataFrame({"time": T[::EVERY], **FIXES}).write_csv(folder / ALL[2])


@pytest.mark.parametrize("names", LACKING)
def test_the_table_that_is_missing_is_named(tmp_path: Path, names: tuple[str, ...]):
    write_phone(tmp_path, names)
    with pytest.raises(InputError, match=LACKING[names]):
        imported(tmp_path)


@pytest.mark.parametrize("name", ALL)
def test_for_one_table_of_a_log_the_folder_is_named(tmp_path: Path, name: str):
    write_phone(tmp_path, ALL)
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=re.escape(f"specify the folder {tmp_path} as SOURCE")) as caught:
        imported(tmp_path / name)
    assert all((other in str(caught.value)) == (other != "notes.csv") for other in (*ALL, "notes.csv"))
    require_right(tmp_path)


def test_degrees_in_columns_named_north_and_east_lead_to_options_that_work(tmp_path: Path):
    drive = make_drive(duration=60.0)
    imu, gps = drive.imu, drive.gps
    pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}).write_csv(tmp_path / "imu.csv")
    speed = 3.6 * np.hypot(np.gradient(gps.x, gps.time), np.gradient(gps.y, gps.time))
    columns = {"N [°]": 50.0 + gps.y / 111_200, "E [°]": 8.0 + gps.x / 71_500, "Tempo [km/h]": speed}
    pl.DataFrame({"Zeitpunkt [s]": gps.time, **columns}).write_csv(tmp_path / "gps.csv")
    notes = inspect_request(Request(tmp_path)).notes
    maps = [m for note in notes for m in re.findall(r'"(gps\.\w+=[^"]*)"', note)]
    assert sorted(maps) == ["gps.lat=`N [°]`", "gps.lon=`E [°]`", "gps.x=", "gps.y="]
    read = imported(tmp_path, maps=maps).drive
    np.testing.assert_allclose(read.gps.time, gps.time)
    np.testing.assert_allclose(np.ptp(read.gps.x), np.ptp(gps.x), rtol=0.01)


@pytest.mark.parametrize("own_clock", [False, True])
def test_rows_out_of_order_on_a_short_clock_are_sorted(tmp_path: Path, own_clock: bool):
    """A counter of 2^32 nanoseconds wraps every 4.29 s."""
    drive = make_drive(duration=60.0)
    imu, gps = drive.imu, drive.gps
    order, fixes = np.arange(len(imu.time)), np.arange(len(gps.time))
    pair = fixes if own_clock else order
    pair[[20, 21]] = pair[[21, 20]]
    ticks = np.round((imu.time - imu.time[0]) * 1e9).astype(np.int64) % 2**32
    columns = {"t_ns": ticks, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}
    pl.DataFrame({name: values[order] for name, values in columns.items()}).write_csv(tmp_path / "imu.csv")
    table = {"t": gps.time - imu.time[0], "x": gps.x, "y": gps.y}
    pl.DataFrame({name: values[fixes] for name, values in table.items()}).write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path).drive
    assert len(got.imu.time) == len(imu.time) and len(got.gps.time) == len(gps.time)
