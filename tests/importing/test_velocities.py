"""A stated speed or course that contradicts the positions is omitted; similar columns are not."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import imported
from sigmaswarm.importing.positions import without_wrong_velocity
from sigmaswarm.simulation.scenarios import simulate
from support import some

T = np.arange(0, 60, 0.2)
Columns = dict[str, np.ndarray]


def road(v: float = 10.0, rate: float = 0.2, noise: float = 0.3, t: np.ndarray = T) -> Columns:
    """Fixes of a vehicle that turns left and right, with its speed (m/s) and course (rad)."""
    course, rng = 1.0 + 1.5 * np.sin(rate * t), np.random.default_rng(4)
    east, north = (np.cumsum(v * f(course)) * (t[1] - t[0]) for f in (np.cos, np.sin))
    x, y = (p + noise * rng.standard_normal(len(t)) for p in (east, north))
    return {"t": t, "x": x, "y": y, "speed": np.full(len(t), v), "course": course}


def loaded(folder: Path, fixes: Columns, **options):
    t = np.arange(0, fixes["t"][-1] + 0.01, 0.05)
    flat = dict.fromkeys(("ax", "ay", "gx", "gy", "gz"), 0 * t)
    pl.DataFrame({"t": t, **flat, "az": 0 * t + 9.81}).write_csv(folder / "imu.csv")
    pl.DataFrame(fixes).write_csv(folder / "gps.csv")
    return imported(folder, **options)


def degrees(course: np.ndarray) -> np.ndarray:
    return np.degrees(course) + 360


WRONG: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "mm/s": (lambda c: c | {"speed": c["speed"] * 1e3}, "course=course are left out, since the speed is 1e+03 times"),
    "km/h": (lambda c: c | {"speed": c["speed"] * 3.6}, "left out, since the speed is 3.6"),
    "knots": (lambda c: c | {"speed": c["speed"] * 1.944}, "left out, since the speed is 1.9"),
    "mph": (lambda c: c | {"speed": c["speed"] * 2.237}, "left out, since the speed is 2.2"),
    "mph read as km/h": (lambda c: c | {"speed": c["speed"] / 1.609}, "left out, since the speed is 0.6"),
    "degrees": (
        lambda c: c | {"course [rad]": degrees(c["course"])},
        "course differs from that computed from the positions",
    ),
    "constant": (lambda c: c | {"course": c["course"] * 0 - 2}, "course differs from that computed from the positions"),
    "velocity": (
        lambda c: c | {"vx": 1e3 * np.cos(c["course"]), "vy": 1e3 * np.sin(c["course"])},
        "vx=vx, vy=vy are left out, since ",
    ),
    "a parked vehicle": (
        lambda c: c | {"x": 0 * T + np.random.default_rng(5).normal(0, 1, len(T)), "y": 0 * T, "speed": 0 * T + 3e4},
        "left out, since a median of 3e+04 m/s",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", some(WRONG))
def test_a_speed_or_course_that_the_positions_contradict_is_left_out(tmp_path: Path, case: str):
    change, said = WRONG[case]
    columns = change(road())
    for gone in {"velocity": ("speed", "course"), "degrees": ("course",)}.get(case, ()):
        del columns[gone]
    got = loaded(tmp_path, columns)
    assert got.drive.gps.speed is None and got.drive.gps.course is None
    (note,) = [n for n in got.notes if "left out" in n]
    assert said in note


@pytest.mark.parametrize("rows", [slice(0, 30), slice(None, None, 3), slice(-1, None)])
@pytest.mark.parametrize("name", ["speed", "course"])
@pytest.mark.parametrize("wrong", [True, False])
def test_rows_without_a_speed_or_course_are_not_compared(rows: slice, name: str, wrong: bool):
    fixes, said = road(), list[str]()
    fixes["speed"] *= 3.6 if wrong else 1.0
    fixes[name][rows] = np.nan
    got = without_wrong_velocity(T, {n: c for n, c in fixes.items() if n != "t"}, "gps", {}, said.append)
    assert ("speed" in got, len(said)) == (not wrong, wrong)
    assert not wrong or re.search(r"the speed is 3\.[56]\d* times", said[0])


def test_the_unit_that_the_ratio_shows_is_the_remedy_and_helps(tmp_path: Path):
    fixes = road()
    for name, factor in (("km/h", 3.6), ("knots", 1.94384), ("mm/s", 1e3), ("mph", 2.23694)):
        got = loaded(tmp_path, fixes | {"speed": factor * fixes["speed"]})
        (note,) = [n for n in got.notes if "left out" in n]
        (option,) = [w for w in note.split('"') if w.startswith("gps.speed=")]
        assert name in note
        gps = loaded(tmp_path, fixes | {"speed": factor * fixes["speed"]}, maps=[option]).drive.gps
        np.testing.assert_allclose(gps.speed, fixes["speed"], rtol=1e-4)


def test_feet_per_second_are_named_not_the_near_km_per_hour(tmp_path: Path):
    got = loaded(tmp_path, road(noise=0.01) | {"speed": np.full(len(T), 32.8084)})
    assert any("if it is in ft/s" in note for note in got.notes), got.notes


def held(fixes: Columns, every: int) -> Columns:
    """Positions that are repeated until the next one comes, less than half of the rows."""
    rows = np.arange(len(fixes["t"])) // every * every
    return fixes | {n: fixes[n][rows] for n in ("x", "y")}


def parked(jump: float, wander: float = 0.0) -> Columns:
    """Fixes of a vehicle that stands, with jumps and slow changes."""
    x = (
        jump * (T > 20)
        + 0.5 * jump * (T > 40)
        + wander * np.sin(T / 9)
        + 0.01 * np.random.default_rng(5).standard_normal(len(T))
    )
    return {
        "t": T,
        "x": x,
        "y": 0.01 * np.random.default_rng(5).standard_normal(len(T)),
        "speed": 0 * T + 0.05,
        "course": 0 * T + 2,
    }


def slalom() -> Columns:
    """A robot that mows strips of 5 m at 1.2 m/s."""
    way = 1.2 * T
    strip, along = np.divmod(way, 5.0)
    x, up = 0.6 * strip, strip % 2 == 0
    course = np.where(up, np.pi / 2, -np.pi / 2)
    noise = 0.01 * np.random.default_rng(5).standard_normal((2, len(T)))
    return {"t": T, "x": x + noise[0], "y": np.where(up, along, 5 - along) + noise[1], "speed": 0 * T + 1.2,
            "course": course}  # fmt: skip


def lagging(delay: float) -> Columns:
    fixes = road(rate=0.5)
    return fixes | {"course": 1.0 + 1.5 * np.sin(0.5 * (T - delay))}


def circle(radius: float, v: float) -> Columns:
    angle = v / radius * T
    return {
        "t": T,
        "x": radius * np.sin(angle),
        "y": -radius * np.cos(angle),
        "speed": 0 * T + v,
        "course": (angle + np.pi) % (2 * np.pi) - np.pi,
    }


def stops() -> Columns:
    """A vehicle that stands for most of the time, with courses of the noise there."""
    v = np.where(T > 45, 8.0, 0.0)
    noise = 0.05 * np.random.default_rng(5).standard_normal((2, len(T)))
    course = np.where(T > 45, 0.3, np.random.default_rng(5).uniform(-3, 3, len(T)))
    x, y = np.cumsum(v * np.cos(0.3)) * 0.2, np.cumsum(v * np.sin(0.3)) * 0.2
    return {"t": T, "x": x + noise[0], "y": y + noise[1], "speed": v, "course": course}


def wandering(v: float) -> Columns:
    """A slow robot whose fixes wander by 2 m within 10 s, faster than it drives."""
    t, rng = np.arange(0, 300, 0.2), np.random.default_rng(6)
    wander, phi = np.zeros((2, len(t))), np.exp(-0.2 / 10)
    for k in range(1, len(t)):
        wander[:, k] = phi * wander[:, k - 1] + 2.0 * np.sqrt(1 - phi**2) * rng.standard_normal(2)
    fixes = road(v=v, rate=0.05, noise=0.0, t=t)
    return fixes | {"x": fixes["x"] + wander[0], "y": fixes["y"] + wander[1]}


def in_bursts() -> Columns:
    """Fixes whose times are those of packets: ten fixes in 0.1 s of each second."""
    t = np.arange(0, 60, 0.1)
    return road(t=t) | {"t": np.floor(t) + 0.1 * (t % 1)}


def reverse() -> Columns:
    """A vehicle that drives backwards, with a negative speed and the course of its nose."""
    fixes = road()
    return fixes | {"speed": -fixes["speed"], "course": np.angle(-np.exp(1j * fixes["course"]))}


RIGHT: dict[str, Callable[[], Columns]] = {
    "a usual road": road,
    "in reverse": reverse,
    "fixes that wander faster than a robot": lambda: wandering(0.6),
    "fixes that wander as fast as a robot": lambda: wandering(1.5),
    "times of packets": in_bursts,
    "1 Hz": lambda: road(t=np.arange(0, 60, 1.0)),
    "fast": lambda: road(v=70.0),
    "a receiver with much noise": lambda: road(noise=6.0),
    "a slow robot with noise": lambda: road(v=1.2, noise=2.0),
    "strips": slalom,
    "a small circle": lambda: circle(4.0, 6.0),
    "a skid pad": lambda: circle(20.0, 15.0),
    "a late course": lambda: lagging(1.0),
    "held positions": lambda: held(road(), 3),
    "jumps of a parked vehicle": lambda: parked(12.0),
    "slow changes of a parked vehicle": lambda: parked(0.0, 8.0),
    "mostly standing": stops,
    "one fix in 10 s": lambda: road(rate=0.02, t=np.arange(0, 600, 10.0)),
    "speed rounded to m/s": lambda: road(v=1.4, noise=0.01) | {"speed": 0 * T + 1.0},
}


@pytest.mark.parametrize("case", some(RIGHT, 3))
def test_a_right_speed_and_course_stay(tmp_path: Path, case: str):
    got = loaded(tmp_path, RIGHT[case]())
    assert got.drive.gps.speed is not None and got.drive.gps.course is not None, got.notes


def test_the_velocity_of_a_truth_that_its_positions_contradict_is_replaced(tmp_path: Path):
    fixes = road(noise=0.0)
    vx, vy = (fixes["speed"] * f(fixes["course"]) for f in (np.cos, np.sin))
    places = {"t": T, "x": fixes["x"], "y": fixes["y"]}
    for scale in (1.0, 1e3):
        pl.DataFrame({**places, "vx": vx * scale, "vy": vy * scale}).write_csv(tmp_path / "truth.csv")
        got = loaded(tmp_path, places)
        assert got.drive.truth is not None
        np.testing.assert_allclose(got.drive.truth.vx[5:-5], vx[5:-5], atol=1.0)
        assert any("vx=vx, vy=vy are left out, since the speed is 1e+03 times" in n for n in got.notes) == (
            scale > 1
        )


@pytest.mark.parametrize("factor", [1.0, 3.6, 1 / 1.609])
def test_a_short_drive_with_stops_shows_the_unit_of_the_speed(tmp_path: Path, factor: float):
    """Slow parts are many rows, but a short way."""
    kept = 0
    for run in range(5):
        drive = simulate("urban", run=run, duration=40.0, imu_rate=50.0, gps="white-1m")
        gps, truth = drive.gps, drive.truth
        speed = np.interp(gps.time, truth.time, np.hypot(truth.vx, truth.vy))
        folder = tmp_path / str(run)
        folder.mkdir()
        fixes = {"t": gps.time, "x": gps.x, "y": gps.y, "speed": factor * speed}
        kept += loaded(folder, fixes).drive.gps.speed is not None
    assert kept == 5 if factor == 1.0 else kept <= 1
