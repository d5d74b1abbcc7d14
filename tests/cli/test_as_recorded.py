"""--as-recorded: a filter is run and evaluated with the setting of its tuning."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import sigmaswarm as library
from filter_cases import rough
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import DriveWarning
from support import quickly


@pytest.mark.parametrize("as_recorded", quickly([(False,), (True,)], lambda as_recorded: as_recorded))
def test_the_command_line_uses_the_setting_of_the_tuning(sigmaswarm, tmp_path: Path, as_recorded: bool):
    folder = write_drive(rough(), tmp_path / "rough")
    options = ["--particles", "4", "--generations", "2", *(["--as-recorded"] if as_recorded else [])]
    assert sigmaswarm("tune", str(folder), "--out", str(tmp_path / "tuned"), *options).code == 0
    table = tomllib.loads((tmp_path / "tuned" / "tuning.toml").read_text())
    assert table["config"]["as_recorded"] is as_recorded
    means = []
    for name, more in (("as tuned", []), ("as recorded", ["--as-recorded"])):
        out = tmp_path / f"{name}.csv"
        assert sigmaswarm("run", str(tmp_path / "tuned"), str(folder), "--out", str(out), *more).code == 0
        means.append(np.loadtxt(out, delimiter=",", skiprows=1))
    same = means[0].tobytes() == means[1].tobytes()
    assert same is as_recorded
    out, tuned = tmp_path / "evaluation", tmp_path / "tuned"
    said = sigmaswarm("evaluate", str(tuned), str(folder), "--verbose", "--out", str(out)).out
    assert ("no filter used 5 of the fixes" in said) is not as_recorded
    assert ("--outage-seed 0 --as-recorded" in library.report(out)) is as_recorded
    with pytest.warns(DriveWarning, match="2 gaps"):
        drive = library.read_drive(folder)
    for given in (tuned, library.Tuning.load(tuned)):  # in Python as well
        assert np.array_equal(library.run(drive, given).columns()["x"], means[0][:, 1])
        found = library.evaluate(drive, given)
        assert found.to_dict() == json.loads((out / "scores.json").read_text())
        assert all(one.record.seen_s for one in found.drives.values())
    stated, other = (
        library.export(tuned, "c99", as_recorded=each) for each in (as_recorded, not as_recorded)
    )
    assert (
        library.export(tuned, "c99") == library.export(library.Tuning.load(tuned), "c99") == stated != other
    )


def test_a_tuning_of_an_older_version_is_reported(sigmaswarm, tmp_path: Path):
    folder = write_drive(rough(), tmp_path / "rough")
    options = ["--particles", "4", "--generations", "2"]
    assert sigmaswarm("tune", str(folder), "--out", str(tmp_path / "tuned"), *options).code == 0
    file = tmp_path / "tuned" / "tuning.toml"
    now, run = (
        file.read_text(),
        ("run", str(file), str(folder), "--out", str(tmp_path / "x.csv"), "--overwrite"),
    )
    assert "was tuned by" not in sigmaswarm(*run).err
    for version in ("0.2.0", "0.1.3"):
        file.write_text(re.sub(r'sigmaswarm = "[^"]*"', f'sigmaswarm = "{version}"', now))
        ended = sigmaswarm(*run)
        assert ended.code == 0
        (line,) = [line for line in ended.err.splitlines() if "was tuned by" in line]
        assert f"tuning.toml: was tuned by sigmaswarm {version}" in line
        assert line.endswith("tune it again")
