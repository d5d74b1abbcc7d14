"""Logs that begin at standstill, without fixes or with placeholders: units are judged by rows of the whole log."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import imported
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.importing import guess
from support import quickly, some

HZ, STANDS, DRIVES = 50, 300, 150
T = np.arange((STANDS + DRIVES) * HZ) / HZ
MOVES = T >= STANDS
RATE = np.where(MOVES, 0.4 * np.sin(0.1 * (T - STANDS)), 0.0)
COURSE = 0.5 + np.cumsum(RATE) / HZ
SPEED = np.where(MOVES, 12.0, 0.0)
X, Y = (np.cumsum(SPEED * f(COURSE)) / HZ for f in (np.cos, np.sin))
LAT, LON, ALT = enu_to_geodetic(np.column_stack([X, Y, 0 * X]), (-33.9, 18.4, 100.0)).T
FIX = (np.arange(len(T)) % HZ == 0) & (T > STANDS - 20)
NOISE = np.random.default_rng(1).normal(0, 0.01, (6, len(T)))
IMU = {"t": T, "ax": NOISE[0], "ay": SPEED * RATE + NOISE[1], "az": 9.80665 + NOISE[2],
       "gx": NOISE[3] / 5, "gy": NOISE[4] / 5, "gz": RATE + NOISE[5] / 5}  # fmt: skip
RATES, FORCES = ("gx", "gy", "gz"), ("ax", "ay", "az")
Columns = dict[str, np.ndarray | pl.Series]


def at_fixes(values: np.ndarray, otherwise: object = None) -> pl.Series:
    """A column with values in the rows of fixes, and something else in the other rows."""
    return pl.Series([v if f else otherwise for v, f in zip(values.tolist(), FIX.tolist(), strict=True)])


def scaled(factor: float, names: tuple[str, ...]) -> Columns:
    return IMU | {n: IMU[n] * factor for n in names}


def not_begun(value: float, names: tuple[str, ...], columns: Columns = IMU) -> Columns:
    """Samples with a placeholder in the first 42 s."""
    return columns | {n: np.where(T < 42, value, columns[n]) for n in names}


PLACES: Columns = {"lat": at_fixes(LAT), "lon": at_fixes(LON)}
LETTERS: Columns = {
    "lat": at_fixes(np.abs(LAT)),
    "lat_dir": at_fixes(np.full(len(T), "S")),
    "lon": at_fixes(LON),
    "lon_dir": at_fixes(np.full(len(T), "E")),
}
DDMM: Columns = {
    n: at_fixes(np.sign(v) * (np.floor(abs(v)) * 100 + abs(v) % 1 * 60))
    for n, v in (("lat", LAT), ("lon", LON))
}
CASES: dict[str, Callable[[], Columns]] = {
    "SI units": lambda: IMU | PLACES,
    "deg/s": lambda: scaled(180 / np.pi, RATES) | PLACES,
    "g": lambda: scaled(1 / 9.80665, FORCES) | PLACES,
    "g, at first 0": lambda: not_begun(0.0, FORCES, scaled(1 / 9.80665, FORCES)) | PLACES,
    "g, at first -999": lambda: not_begun(-999.0, FORCES, scaled(1 / 9.80665, FORCES)) | PLACES,
    "1e-7 degrees": lambda: IMU | {"lat": at_fixes(np.round(LAT * 1e7), 0.0),
                                   "lon": at_fixes(np.round(LON * 1e7), 0.0)},
    "letters": lambda: IMU | LETTERS,
    "ddmm": lambda: IMU | DDMM,
    "dms": lambda: IMU | {"lat": at_fixes(np.char.add(np.char.mod("%.9f", -LAT), "°S")),
                          "lon": at_fixes(np.char.add(np.char.mod("%.9f", LON), "°E"))},
    "zeros without a fix": lambda: IMU | {"lat": at_fixes(LAT, 0.0), "lon": at_fixes(LON, 0.0)},
    "an altitude in mm": lambda: IMU | PLACES | {"alt": at_fixes(1e3 * ALT)},
}  # fmt: skip


@pytest.mark.parametrize(
    ("case", "kind"),
    quickly(
        [*((case, "csv") for case in CASES), ("deg/s", "parquet"), ("letters", "parquet")],
        lambda case, kind: kind == "csv" and [*CASES].index(case) % 4 == 0,
    ),
)
def test_a_log_that_begins_at_standstill_without_fixes(tmp_path: Path, case: str, kind: str):
    table = pl.DataFrame(CASES[case]())
    table.write_csv(tmp_path / "log.csv") if kind == "csv" else table.write_parquet(tmp_path / "log.parquet")
    got = imported(tmp_path / f"log.{kind}").drive
    driving = got.imu.time >= 60.0
    for name in ("ax", "az", "gz"):
        np.testing.assert_allclose(getattr(got.imu, name)[driving], IMU[name][T >= 60.0], atol=1e-6)
    np.testing.assert_allclose(got.gps.lat[-100:], LAT[FIX][-100:], atol=1e-7)
    np.testing.assert_allclose(got.gps.lon[-100:], LON[FIX][-100:], atol=1e-7)
    assert got.gps.alt is None


SMALL = {n: 0.2 * v if n != "t" else v for n, v in IMU.items()}
ALIKE: dict[str, Callable[[], tuple[Columns, str]]] = {
    "a phone that is put into its holder": lambda: (
        IMU | {"gz": IMU["gz"] + np.where(T < 0.8, 7.0, 0.0)},
        "gz",
    ),
    "accelerations without gravity, standing": lambda: (IMU | {"az": 0 * T, "ax": 0.3 * IMU["ay"]}, "ax"),
    "a shock at the end": lambda: (IMU | {"ax": IMU["ax"] + np.where(T[-1] - 0.5 < T, 300.0, 0.0)}, "ax"),
    "accelerations without gravity, at first standing": lambda: (
        IMU
        | {
            "az": np.where(T > 30, 1.0 + NOISE[2], NOISE[2] / 10),
            "ax": np.where(MOVES, 0.4 * NOISE[0], 1e-3),
        },
        "az",
    ),
    "slow turns": lambda: (SMALL | {"az": IMU["az"]}, "gz"),
}


@pytest.mark.parametrize("case", some(ALIKE))
def test_rows_of_the_whole_log_change_no_unit(tmp_path: Path, case: str):
    columns, name = ALIKE[case]()
    pl.DataFrame(columns | PLACES).write_csv(tmp_path / "log.csv")
    got = imported(tmp_path / "log.csv").drive
    np.testing.assert_allclose(getattr(got.imu, name), columns[name], atol=1e-9)


@pytest.mark.parametrize("rows", [1, 7999, 8000, 8001, 100_003])
def test_blocks_are_consecutive_and_spread(rows: int):
    got = guess.spread_rows(pl.LazyFrame({"i": np.arange(rows)}))["i"].to_numpy()
    assert len(got) <= min(rows, (guess.BLOCKS + 1) * guess.BLOCK) and got[0] == 0
    if rows <= guess.BLOCKS * guess.BLOCK:
        assert len(got) == rows
    else:
        assert np.mean(np.diff(got) == 1) > 0.99 and got[-1] > 0.9 * rows


def test_numbers_without_a_fix_do_not_change_the_form_of_degrees(tmp_path: Path):
    """MAVLink states unknown coordinates as the largest integer, 214.7483647 degrees."""
    unknown = FIX & (T > STANDS + 120)
    places = {n: at_fixes(np.where(unknown, 214.7483647, v)) for n, v in (("lat", LAT), ("lon", LON))}
    pl.DataFrame(IMU | places).write_csv(tmp_path / "log.csv")
    got = imported(tmp_path / "log.csv")
    assert not any("minutes" in note for note in got.notes)


@pytest.mark.parametrize(
    "case", some(["an accelerometer that fails", "empty cells", "a damaged row", "letters of no fix"])
)
def test_some_odd_rows_do_not_change_how_a_column_is_read(tmp_path: Path, case: str):
    lost, row = FIX & (T > 440) & (T < 444), int(np.flatnonzero(FIX)[-20])
    columns: dict[str, Columns] = {
        "an accelerometer that fails": scaled(1 / 9.80665, FORCES) | PLACES,
        "empty cells": CASES["dms"](),
        "a damaged row": CASES["ddmm"](),
        "letters of no fix": CASES["letters"](),
    }
    table = pl.DataFrame(columns[case])
    change: dict[str, list[pl.Expr]] = {
        "an accelerometer that fails": [
            pl.when(pl.lit(T < 430)).then(pl.col(n)).otherwise(0.0).alias(n) for n in FORCES
        ],
        "empty cells": [
            pl.when(pl.lit(lost)).then(pl.lit("nan")).otherwise(pl.col(n)).alias(n) for n in ("lat", "lon")
        ],
        "a damaged row": [
            pl.when(pl.int_range(pl.len()) == row).then(3399.0).otherwise(pl.col("lat")).alias("lat")
        ],
        "letters of no fix": [
            pl.when(pl.int_range(pl.len()) == row)
            .then(pl.lit("V"))
            .otherwise(pl.col("lat_dir"))
            .alias("lat_dir")
        ],
    }
    table.with_columns(change[case]).write_csv(tmp_path / "log.csv")
    got = imported(tmp_path / "log.csv").drive
    np.testing.assert_allclose(got.gps.lat[:10], LAT[FIX][:10], atol=1e-7)
    np.testing.assert_allclose(got.imu.az[HZ * 60 : HZ * 61], IMU["az"][HZ * 60 : HZ * 61], atol=1e-6)
