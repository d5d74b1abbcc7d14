"""Tables in unusual dialects, units, dates and clocks: read correctly or rejected in one line."""

import os
import re
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import imported
from importing.odd_tables import make, verdict
from sigmaswarm.errors import InputError

TABLES = int(os.environ.get("ODD_TABLES", "6000"))


def tally(seeds: range, folder: Path) -> Counter[str]:
    """How many tables were read right and refused; one that is read wrong fails."""
    count: Counter[str] = Counter()
    for seed in seeds:
        case = make(seed, folder / str(seed))
        said, why = verdict(case)
        assert said != "wrong", f"seed {seed}: {why}\n" + "\n".join(case.map_arguments)
        count[said] += 1
    return count


def test_a_sample(tmp_path: Path):
    count = tally(range(10), tmp_path)
    assert count["right"] >= 5, count


@pytest.mark.long
def test_many(tmp_path: Path):
    count = tally(range(30, 30 + TABLES), tmp_path)
    print(count)
    assert count["right"] >= 0.6 * TABLES, count


NAMES = ("t", "ax", "ay", "az", "gx", "gy", "gz")


def named(form: str, separator: str) -> Callable[..., str]:
    """Make rows of cells such as `ax: 0.1`."""
    return lambda t, a, g: separator.join(form.format(n, v) for n, v in zip(NAMES, (t, *a, *g), strict=True))


def vectors(form: str, separator: str) -> Callable[..., str]:
    """Make rows of a time and of two cells of three numbers."""
    return lambda t, *both: ",".join(
        [f"{t:.6f}", *(form.format(separator.join(f"{v:.6f}" for v in one)) for one in both)]
    )


PACKED = {
    "name: value": ("", named("{}:{:.6f}", ", ")),
    "name = value": ("", named("{}={:.6f}", " ")),
    "names after the time": ("", lambda *row: named("{}: {:.6f}", ",")(*row).removeprefix("t: ")),
    "brackets": ("time,acc,gyr", vectors("[{}]", " ")),
    "brackets, commas": ("time,ax,ay,az,gx,gy,gz", vectors("[{}]", ", ")),
    "quoted brackets": ("time,acc,gyr", vectors('"({})"', ", ")),
    "quotes": ("time,acc,gyr", vectors('"{}"', " ")),
    "quotes, semicolons": ("time,linear_acceleration,angular_velocity", vectors('"{}"', ";")),
}


@pytest.mark.parametrize("kind", PACKED)
def test_names_or_several_numbers_in_a_cell_are_answered_with_a_command_that_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
):
    header, row = PACKED[kind]
    time = np.arange(0, 30, 0.05)
    imu = np.random.default_rng(0).normal(0, 1, (6, len(time))) + np.array([0, 0, 9.8, 0, 0, 0])[:, None]
    rows = [row(t, v[:3], v[3:]) for t, v in zip(time, imu.T, strict=True)]
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("\n".join([*filter(None, [header]), *rows]) + "\n")
    with pytest.raises(InputError, match="cells contain") as caught:
        imported(Path("log.csv"))
    command = re.search(r"for example with: (\(echo .*\) > new\.csv)", str(caught.value))[1]
    subprocess.run(["sh", "-c", command], check=True)
    got = pl.read_csv("new.csv")
    np.testing.assert_allclose(got.to_numpy(), np.column_stack([time, imu.T]), atol=1e-6)
    assert len(got.columns) == 7 and got.columns[0] in ("t", "time")


@pytest.mark.parametrize("cell", ['"1,234,567"', '"2024 01 02"', '"0,123"', "10:00:01", '"[1.0, 2.0, 3.0]"'])
def test_single_values_and_columns_that_are_not_needed_are_no_fault(tmp_path: Path, cell: str):
    lines = [f"{0.05 * k:.2f},{np.sin(k):.3f},0.1,9.8,0.01,0.02,0.03,{cell}" for k in range(400)]
    (tmp_path / "imu.csv").write_text("\n".join(["t,ax,ay,az,gx,gy,gz,other", *lines]) + "\n")
    fixes = [f"{k},{3 * k},{0.1 * k * k}" for k in range(20)]
    (tmp_path / "gps.csv").write_text("\n".join(["t,x,y", *fixes]) + "\n")
    assert len(imported(tmp_path).drive.imu) == 400
