"""Helpers of the tests: selection of quick test cases, the folder of the real drives, an exact synthetic drive."""

from collections.abc import Callable, Collection, Generator, Iterable
from contextlib import contextmanager
from dataclasses import fields, replace
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sigmaswarm.drives.drive import Drive, Gps, Imu, Truth
from sigmaswarm.drives.outages import hidden_fixes
from sigmaswarm.drives.stale_fixes import classify_fixes
from sigmaswarm.drives.timeline import Timeline, build_timeline
from sigmaswarm.geodesy import enu_to_geodetic, geodetic_to_enu


def quickly(cases: Iterable[tuple[Any, ...]], here: Callable[..., bool]) -> list[Any]:
    """Return cases of a parametrized test; those for which ``quick`` is false are marked `long`."""
    return [pytest.param(*case, marks=() if here(*case) else pytest.mark.long) for case in cases]


def some(cases: Iterable[Any], each: int = 2) -> list[Any]:
    """Return cases of a test with one parameter; all except each n-th case are marked `long`."""
    return [
        pytest.param(case, marks=() if k % each == 0 else pytest.mark.long) for k, case in enumerate(cases)
    ]


def several(cases: Iterable[tuple[Any, ...]], each: int = 2) -> list[Any]:
    """Return cases of a test with several parameters; all except each n-th case are marked `long`."""
    return [
        pytest.param(*case, marks=() if k % each == 0 else pytest.mark.long) for k, case in enumerate(cases)
    ]


def diagonal(*values: Iterable[Any]) -> list[Any]:
    """Return all combinations of the values as cases; those on the diagonals are quick, the others are marked `long`.

    The quick cases contain each value at least once. A value that is a tuple stands for several parameters.
    """
    lists = [list(of) for of in values]
    quick = {tuple(k % len(of) for of in lists) for k in range(max(map(len, lists)))}
    cases: list[Any] = []
    for at in product(*(range(len(of)) for of in lists)):
        case = [of[k] for of, k in zip(lists, at, strict=True)]
        flat = [part for value in case for part in (value if isinstance(value, tuple) else (value,))]
        cases.append(pytest.param(*flat, marks=() if at in quick else pytest.mark.long))
    return cases


def require(module: str, reason: str) -> None:
    """Skip the tests of a file if a module is not installed; unlike `pytest.importorskip`, do not import it."""
    if find_spec(module) is None:
        pytest.skip(reason, allow_module_level=True)


SHARED = Path(__file__).parents[1].parent / "shared"
DRIVES = SHARED / "drives"
needs_shared = pytest.mark.skipif(not DRIVES.is_dir(), reason=f"the real drives are not at {DRIVES}")

GRAVITY = 9.80665


@contextmanager
def no_pictures() -> Generator[None]:
    """Draw no charts and write empty pictures, in all modules that have imported the drawing functions."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    from sigmaswarm.reports import figures

    def figure_of(*charts: Any, size: Any, columns: Any = None, legend: Any = "inside", **shared: Any) -> Any:
        from matplotlib.figure import Figure  # imported here, since only the code object is used in `figures`

        return Figure()

    def svg(chart: Any) -> str:
        return "<svg></svg>"

    empty = '<svg height="1pt" width="1pt"></svg>'
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(FigureCanvasAgg, "print_png", lambda _, file, **__: file.write(b"a picture"))
        patched.setattr(FigureCanvasSVG, "print_svg", lambda _, file, **__: file.write(empty))
        patched.setattr(figures.figure_of, "__code__", figure_of.__code__)
        patched.setattr(figures.svg, "__code__", svg.__code__)
        yield


@contextmanager
def limited_memory(gigabytes: float = 1.0) -> Generator[None]:
    """Limit the memory that the process can allocate in addition; more is a MemoryError, if the system supports it."""
    resource = pytest.importorskip("resource")
    usual = resource.getrlimit(resource.RLIMIT_AS)
    with Path("/proc/self/statm").open() as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + int(gigabytes * 2**30), usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, usual)


def _motion(time: np.ndarray, phase_x: float, phase_y: float, turn: float):
    """Return position, velocity, acceleration, each (n, 2), of a weaving car: 3.9 to 14.3 m/s, up to 0.42 rad/s.

    A straight cruise plus one sine along and one across it, rotated by ``turn``: every derivative is exact.
    """
    wx, wy = 2 * np.pi / 37, 2 * np.pi / 29
    sx, sy = 24.0, 35.0
    px, py = wx * time + phase_x, wy * time + phase_y
    position = np.stack([8.0 * time + sx * np.sin(px), sy * np.sin(py)], axis=1)
    velocity = np.stack([8.0 + sx * wx * np.cos(px), sy * wy * np.cos(py)], axis=1)
    acceleration = np.stack([-sx * wx**2 * np.sin(px), -sy * wy**2 * np.sin(py)], axis=1)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, s], [-s, c]])  # transposed, since vectors are rows
    return position @ rotation, velocity @ rotation, acceleration @ rotation


def _heading_and_rate(velocity: np.ndarray, acceleration: np.ndarray):
    """Return the course (n,) rad, unwrapped, and its exact rate (n,) rad/s."""
    vx, vy = velocity.T
    ax, ay = acceleration.T
    return np.unwrap(np.arctan2(vy, vx)), (vx * ay - vy * ax) / (vx**2 + vy**2)


def timeline_of(drive: Drive, start: float, *, as_recorded: bool = False) -> Timeline:
    """Build the timeline of all fixes that are not stale, after ``start`` (s)."""
    kinds = np.zeros(len(drive.gps)) if as_recorded else classify_fixes(drive.gps)
    return build_timeline(drive, start, kinds, as_recorded=as_recorded)


def make_drive(
    *,
    duration: float = 60.0,
    imu_rate: float = 100.0,
    gps_rate: float = 5.0,
    gps_std: float = 1.0,
    seed: int = 0,
    name: str = "synthetic",
    jitter: float = 0.0,
    truth: bool = True,
) -> Drive:
    """Simulate a car on a curvy, flat road: exact IMU, fixes with white noise, truth at IMU times.

    Parameters
    ----------
    duration : s, from the first to the last IMU sample
    imu_rate, gps_rate : Hz; fixes fall between IMU samples
    gps_std : m per axis
    seed : of the road and the noise
    jitter : largest time shift of IMU samples and fixes, in IMU intervals (below 0.5)
    truth : whether the drive contains truth
    """
    rng = np.random.default_rng(seed)
    road = (*rng.uniform(-np.pi, np.pi, 2), rng.uniform(-np.pi, np.pi))
    interval = 1 / imu_rate

    time = np.arange(round(duration * imu_rate) + 1) * interval
    time[1:-1] += rng.uniform(-jitter, jitter, len(time) - 2) * interval
    position, velocity, acceleration = _motion(time, *road)
    theta, rate = _heading_and_rate(velocity, acceleration)
    c, s = np.cos(theta), np.sin(theta)
    zero = np.zeros_like(time)
    imu = Imu(
        time=time,
        ax=c * acceleration[:, 0] + s * acceleration[:, 1],
        ay=c * acceleration[:, 1] - s * acceleration[:, 0],
        gz=rate,
        az=zero + GRAVITY,
        gx=zero,
        gy=zero,
    )

    fix_time = np.arange(0.37 * interval + 0.5 / gps_rate, duration, 1 / gps_rate)
    fix_time += rng.uniform(-jitter, jitter, len(fix_time)) * interval
    fix = _motion(fix_time, *road)[0] + gps_std * rng.standard_normal((len(fix_time), 2))
    gps = Gps(time=fix_time, x=fix[:, 0], y=fix[:, 1])

    motion = Truth(time, position[:, 0], position[:, 1], velocity[:, 0], velocity[:, 1], theta)
    return Drive(name, imu, gps, motion if truth else None)


def sparse(drive: Drive, n: int = 4) -> Drive:
    """Return the drive with each n-th IMU sample, so that textbook filters need fewer steps."""
    return replace(drive, imu=drive.imu.select(np.arange(len(drive.imu)) % n == 0))


def hide_fixes(drive: Drive, windows: Any) -> Drive:
    """Remove the fixes of a drive inside windows (k, 2), s."""
    return replace(drive, gps=drive.gps.select(~hidden_fixes(drive.gps.time, windows)))


def assert_same(a: Drive, b: Drive) -> None:
    """Check that two drives are equal bit for bit."""
    assert (a.name, a.frame, a.origin, a.metadata) == (b.name, b.frame, b.origin, b.metadata)
    for one, other in ((a.imu, b.imu), (a.gps, b.gps), (a.truth, b.truth)):
        assert type(one) is type(other)
        for f in fields(one) if one is not None else ():
            left, right = getattr(one, f.name), getattr(other, f.name)
            assert (left is None) == (right is None), f.name
            assert left is None or left.tobytes() == right.tobytes(), f.name


def file_contents(folder: Path, omitted: Collection[str] = ()) -> dict[str, bytes]:
    """Return the content of each file in a folder and its subfolders, by path, except files named in ``omitted``."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name not in omitted)
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def in_degrees(drive: Drive, altitude: bool = True) -> Drive:
    """Return the drive with fixes in WGS-84."""
    origin = (51.05, 13.74, 113.25)
    enu = np.stack([drive.gps.x, drive.gps.y, np.zeros(len(drive.gps))], axis=1)
    lat, lon, alt = enu_to_geodetic(enu, origin).T
    x, y, _ = geodetic_to_enu(lat, lon, alt if altitude else origin[2], origin).T
    gps = replace(drive.gps, x=x, y=y, lat=lat, lon=lon, alt=alt if altitude else None)
    return replace(drive, gps=gps, frame="wgs84", origin=origin)


def drive_variants() -> dict[str, Drive]:
    """Return drives with different sets of columns and metadata."""
    drive = make_drive(duration=10.0, jitter=0.4, seed=3)
    ones = np.ones(len(drive.gps))
    return {
        "plain": drive,
        "no-truth": replace(drive, truth=None),
        "origin": replace(
            drive, origin=(-33.1, 151.0, 4.0), metadata={"licence": "MIT", "arm": {"x": [1, 2.5]}}
        ),
        "few-imu-columns": replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None)),
        "many-gps-columns": replace(
            drive, gps=replace(drive.gps, std_x=1.5 * ones, std_y=ones / 3, speed=7 * ones, course=-ones)
        ),
        "truth-in-doubt": replace(
            drive,
            truth=replace(
                drive.truth, **{k: np.full(len(drive.truth), 1 / 3) for k in ("std_x", "std_y", "std_theta")}
            ),
        ),
        "degrees": in_degrees(drive),
        "degrees-without-altitude": in_degrees(drive, altitude=False),
        "both": replace(in_degrees(drive), frame="enu"),
    }
