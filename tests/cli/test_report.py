"""`sigmaswarm report` on results with values that JSON does not support."""

import json
import re
from pathlib import Path

import pytest


@pytest.mark.parametrize("number", ["NaN", "Infinity"])
def test_scores_with_nan(sigmaswarm, drives: Path, tuned: Path, here: Path, number: str):
    assert sigmaswarm("evaluate", tuned, drives / "urban-clear-00", "--out", "e").code == 0
    setup = here / "e" / "evaluation.json"  # no hashes, as in older versions
    setup.write_text(json.dumps({k: v for k, v in json.loads(setup.read_text()).items() if k != "files"}))
    file = here / "e" / "scores.json"
    good = file.read_text()
    file.write_text(re.sub(r'("position_rmse_m": )[\d.]+', rf"\g<1>{number}", good))
    ended = sigmaswarm("report", "e")
    assert (ended.code, ended.err) == (0, "")
    assert number not in json.dumps(re.findall(r"<td[^>]*>([^<]*)", (here / "e" / "page.html").read_text()))
    file.write_text(re.sub(r'("mean_nis": )[\d.]+', rf"\g<1>{number}", good))
    ended = sigmaswarm("report", "e")
    assert ended.code == 2
    assert ended.err.count("\n") == 1
    assert "e/scores.json: consistency." in ended.err
