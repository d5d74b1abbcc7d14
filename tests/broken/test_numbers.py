"""Finite but absurd numbers are rejected with row and column; a live filter reports its failure."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from filter_cases import KINDS, parameters
from fuzzing.live import START, feed, require_sound
from sigmaswarm import Drive, FilterParameters, LiveFilter, LiveFilterBank, read_drive, write_drive
from sigmaswarm.errors import DriveWarning, InputError
from sigmaswarm.filters.compiled.layout import at
from sigmaswarm.filters.compiled.live import is_definite
from support import make_drive, quickly

CELLS = {
    "imu": ("ax", "ay", "gz", "az", "gx", "gy"),
    "gps": ("x", "y", "std_x", "std_y", "speed", "course", "alt"),
    "truth": ("x", "y", "vx", "vy", "theta"),
    "odometer": ("speed",),
}
COLUMNS = [(table, column) for table, columns in CELLS.items() for column in columns]
VALUES = (1e16, -1e16, 1e77, 1e155, -1e200, 1e308)


@pytest.fixture(scope="module")
def tables() -> dict[str, pl.DataFrame]:
    """The tables of a sound drive, with every column that one can have."""
    drive = make_drive(duration=20.0)
    imu, gps, truth = (
        pl.DataFrame({("t" if k == "time" else k): v for k, v in vars(of).items() if v is not None})
        for of in (drive.imu, drive.gps, drive.truth)
    )
    imu = imu.with_columns(az=pl.lit(9.8), gx=pl.lit(0.0), gy=pl.lit(0.0))
    known = {"std_x": 1.0, "std_y": 1.0, "speed": 5.0, "course": 0.1, "alt": 100.0}
    gps = gps.with_columns(**{name: pl.lit(value) for name, value in known.items()})
    return {"imu": imu, "gps": gps, "truth": truth, "odometer": imu.select("t", speed=pl.lit(5.0))}


def spoiled(
    tables: dict[str, pl.DataFrame], table: str, column: str, value: float
) -> dict[str, pl.DataFrame]:
    cell = pl.when(pl.int_range(pl.len()) == 7).then(value).otherwise(pl.col(column)).alias(column)
    return {**tables, table: tables[table].with_columns(cell)}


def require_refused(tables: dict[str, pl.DataFrame], folder: Path, table: str, row: int, fault: str) -> None:
    """Frames and files with a fault in a row are refused; the rows of a file are counted from 1, with its header."""
    with pytest.raises(InputError, match=f"{table}, row {row}, {fault}"):
        Drive.from_frames(**tables)
    (folder / "drive.toml").touch()
    for name, frame in tables.items():
        frame.write_csv(folder / f"{name}.csv")
    with pytest.raises(InputError, match=rf"{table}\.csv, row {row + 2}, {fault}"):
        read_drive(folder)


@pytest.mark.parametrize(
    ("table", "column", "value"),
    quickly(
        [(*column, value) for column in COLUMNS for value in VALUES],
        lambda *case: (COLUMNS.index(case[:2]) + [*map(repr, VALUES)].index(repr(case[2]))) % 2 == 0,
    ),
)
def test_a_cell_is_refused_with_row_and_column(
    table: str, column: str, value: float, tables: dict[str, pl.DataFrame], tmp_path: Path
):
    require_refused(
        spoiled(tables, table, column, value), tmp_path, table, 7, f"column {column}: .* is outside"
    )


@pytest.mark.parametrize("value", [1e16, 1e20, 1e155, 1e200, 1e308])
@pytest.mark.parametrize("table", ["imu", "gps", "truth", "odometer"])
def test_a_time_far_away_is_refused(
    table: str, value: float, tables: dict[str, pl.DataFrame], tmp_path: Path
):
    rows = tables[table].height
    last = pl.when(pl.int_range(pl.len()) == rows - 1).then(value).otherwise("t").alias("t")
    broken = {**tables, table: tables[table].with_columns(last)}
    require_refused(broken, tmp_path, table, rows - 1, "column t: .* too far")


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_a_clock_that_is_set_is_no_absurd_number(
    unit: float, tables: dict[str, pl.DataFrame], tmp_path: Path
):
    """The doctor finds it, and mends it."""
    drive = Drive.from_frames(**{k: v for k, v in tables.items() if k in ("imu", "gps")})
    late = np.arange(len(drive.imu)) > 500
    times = {"imu": (drive.imu.time + 1.7e9 * late) * unit, "gps": (drive.gps.time) * unit}
    moved = replace(
        drive, imu=replace(drive.imu, time=times["imu"]), gps=replace(drive.gps, time=times["gps"])
    )
    folder = write_drive(moved, tmp_path / "d")
    with pytest.warns(DriveWarning):
        assert len(read_drive(folder).imu) == len(drive.imu)


@pytest.mark.parametrize(
    "key", ["gps_std_m", "accel_noise_density", "gps_lever_arm_m", "gps_lever_arm_std_m"]
)
@pytest.mark.parametrize("value", ["1e16", "1e155", "1e300", "inf", "nan"])
def test_a_key_is_refused(key: str, value: str, tmp_path: Path):
    folder = write_drive(make_drive(duration=20.0), tmp_path / "d")
    said = f"[{value}, 0.0]" if "arm" in key else value
    with (folder / "drive.toml").open("a") as file:
        file.write(f"{key} = {said}\n")
    with pytest.raises(InputError, match=rf"drive\.toml: {key}"):
        read_drive(folder)


def packed(covariance: np.ndarray) -> np.ndarray:
    n = len(covariance)
    rows = np.zeros(n * (n + 1) // 2)
    for j in range(n):
        for i in range(j + 1):
            rows[at(i, j) - at(0, 0)] = covariance[i, j]
    return rows


@pytest.mark.parametrize("n", [5, 8, 12])
@pytest.mark.parametrize("seed", range(20))
def test_definiteness_is_that_of_the_eigenvalues(n: int, seed: int):
    rng = np.random.default_rng([n, seed])
    turn, _ = np.linalg.qr(rng.standard_normal((n, n)))
    scale = 10.0 ** rng.uniform(-8, 8, n)
    for least, definite in ((0.1, True), (0.0, True), (-1e-6, False), (-0.5, False)):
        matrix = turn @ np.diag([least, *rng.uniform(0.1, 1.0, n - 1)]) @ turn.T
        scaled = packed(scale[:, np.newaxis] * (matrix + matrix.T) / 2 * scale)
        assert is_definite(scaled, n, np.zeros(len(scaled)), 0) == definite


@pytest.mark.parametrize(
    ("matrix", "definite"),
    [
        (np.zeros((5, 5)), True),
        (np.diag([1.0, 0.0, 1.0, 0.0, 1.0]), True),
        (np.diag([1.0, 1.0, 1.0, 1.0, -1e-30]), False),
        (np.full((5, 5), 1.0), True),
        (np.full((5, 5), np.nan), False),
        (np.full((5, 5), 1e308), True),
        (np.fliplr(np.eye(5)), False),
    ],
)
def test_definiteness_of_special_matrices(matrix: np.ndarray, definite: bool):
    assert is_definite(packed(matrix), 5, np.zeros(15), 0) == definite


@pytest.mark.parametrize(
    ("bank", "seed"),
    quickly(
        product([False, True], range(5)), lambda bank, seed: seed < 2 or (bank and seed != 3)
    ),  # the others are unscented tilted12, whose live filters take long to compile
)
def test_hostile_sequences(bank: bool, seed: int):
    feed(np.random.default_rng([seed, int(bank)]), bank=bank, events=150)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("model", ["planar5", "planar8"])
def test_a_covariance_that_is_lost_is_reported_at_once(kind: str, model: str):
    """Whoever spoils it: at the next reading of the state, and for good at the next check."""
    live = LiveFilter(parameters(model, kind=kind), START, nominal_interval=0.01, recover=False)
    live.predict(100.01, (0.0, 0.0, 0.0))
    assert not live.state.failed
    live._filter_state[at(0, 1)] = 1e3 * live._filter_state[at(0, 0)]
    assert live.state.failed
    for k in range(2, 40):
        live.predict(100 + 0.01 * k, (0.0, 0.0, 0.0))
    assert live.state.failed


def test_noise_far_outside_the_bounds():
    """The shared case: variances of 2 and 322 a step next to 1e-13."""
    noise = (2.0, 322.0, 1e-13, 1e-13, 1e-13, 1e-13, 322.0, 1e-13)
    live = LiveFilter(
        FilterParameters(0.5, 2.0, 0.0, noise, (1.0, 1.0), "planar8", kind="ekf"),
        START,
        nominal_interval=0.01,
    )
    for k in range(1, 600):
        t = 100 + 0.01 * k
        live.predict(t, (0.1, -0.2, 0.3))
        if k % 10 == 0:
            live.update(t, (10 * (t - 100), 0.0))
        require_sound(live.state)


WRONG: list[Any] = [
    None,
    "a",
    10**400,
    [1.0],
    {},
    (1e200, 1.0),
    (np.inf, 1.0),
    (1.0,),
    (1.0, "a"),
    (10**400, 1.0),
]


@pytest.mark.parametrize("wrong", WRONG, ids=lambda v: str(v)[:20])
@pytest.mark.parametrize("kind", [LiveFilter, LiveFilterBank])
def test_what_is_no_number_is_an_input_error(wrong: Any, kind: type[LiveFilter]):
    live = kind(parameters("planar5", accuracy_scale=0.4), START, nominal_interval=0.01)
    with pytest.raises(InputError):
        live.update(100.1, (1.0, 2.0), std=wrong)
    if not isinstance(wrong, tuple):
        for call in (
            lambda: live.predict(wrong, (0.0, 0.0, 0.0)),
            lambda: live.predict(100.1, (0.0, wrong, 0.0)),
            lambda: live.update(100.1, (wrong, 0.0), std=(1.0, 1.0)),
            lambda: live.update_odometer(100.1, wrong),
        ):
            with pytest.raises(InputError):
                call()
    assert not live.state.failed


@pytest.mark.parametrize(
    "wrong",
    [
        *({"nominal_interval": value} for value in (0.0, np.nan, 1e-300)),
        *({"history": value} for value in (np.inf, -1.0, 1e9)),
        {"lag": 1e9},
    ],
    ids=str,
)
def test_a_memory_of_any_size_is_refused(wrong: dict[str, float]):
    with pytest.raises(InputError, match="nominal_interval"):
        LiveFilter(parameters("planar5"), START, **{"nominal_interval": 0.01, **wrong})
