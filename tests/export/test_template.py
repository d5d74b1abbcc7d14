"""Templates: filled and omitted parts, and an error for a missing value."""

import re
from dataclasses import replace
from itertools import product

import pytest
from jinja2 import UndefinedError

from exported import export, tuned
from sigmaswarm.exports.c99 import c99
from sigmaswarm.exports.c_emitter import Emitter
from sigmaswarm.exports.c_functions import Function
from sigmaswarm.exports.features import fill
from sigmaswarm.exports.names import DESCRIPTIONS
from sigmaswarm.filters.compiled.measurements import update_fix
from support import quickly


def test_a_placeholder_without_a_value_is_an_error():
    with pytest.raises(UndefinedError, match="'version' is undefined"):
        fill("ins_gps.c.in", {"description": "x"})


@pytest.mark.parametrize("target", DESCRIPTIONS)
@pytest.mark.parametrize(
    ("model", "kind", "everything"),
    quickly(
        product(("planar5", "planar8"), ("ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf"), (True, False)),
        lambda *case: (
            case
            in (
                ("planar5", "ukf", False),
                ("planar8", "adaptive-ukf", True),
                ("planar8", "strong-tracking-ukf", True),
            )
        ),
    ),
)
def test_no_placeholder_and_no_template_syntax_remains(target, model: str, kind: str, everything: bool):
    p = tuned(model, kind, 0.01, everything=everything)
    options = [{}, {"mounting": (0.0, 10.0, 90.0)}, *([{"lanes": 3}] if target == "c99" else [])]
    for text in (text for given in options for text in export(p, target, **given).values()):
        assert re.findall(r"@[A-Z]|\{%|\{\{ ", text) == []
        assert text.endswith("\n")


def test_comments_in_c_contain_no_python():
    p = replace(tuned("planar5", "ukf", 0.01), odometer_noise=0.1)
    assert re.findall(r"`|\b(?:True|False|None)\b", c99(p, 0.01)["ins_gps.c"]) == []


def test_a_row_that_is_kept_between_steps_needs_a_c_text():
    with pytest.raises(TypeError, match="update_fix: row FADING has no C text; add it to "):
        Emitter(Function).add(update_fix, fix_error=0, stores_innovation=0, adaptive=0, note_prior=0)
