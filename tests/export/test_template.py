"""Templates: what is filled in, what is left out, and that nothing is forgotten."""

import re
from dataclasses import replace
from itertools import product

import pytest
from jinja2 import UndefinedError

from exported import tuned
from sigmaswarm.exports.c99 import c99
from sigmaswarm.exports.c_emitter import Emitter
from sigmaswarm.exports.features import fill
from sigmaswarm.exports.lanes import Lanes
from sigmaswarm.exports.targets import TARGETS
from sigmaswarm.filters.compiled.measurements import update_fix
from support import quickly


def test_a_place_without_a_value_is_an_error():
    with pytest.raises(UndefinedError, match="'version' is undefined"):
        fill("ins_gps.c.in", {"description": "x"})


@pytest.mark.parametrize("target", TARGETS)
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
def test_no_place_and_no_part_is_left_over(target, model: str, kind: str, everything: bool):
    p = tuned(model, kind, 0.01, everything=everything)
    texts = [*TARGETS[target](p, 0.01).values(), *TARGETS[target](p, 0.01, False, (0.0, 10.0, 90.0)).values()]
    if target == "c99":
        texts += c99(p, 0.01, lanes=Lanes(3)).values()
    for text in texts:
        assert re.findall(r"@[A-Z]|\{%|\{\{ ", text) == []
        assert text.endswith("\n")


def test_comments_in_c_have_no_python():
    p = replace(tuned("planar5", "ukf", 0.01), odometer_noise=0.1)
    assert re.findall(r"`|\b(?:True|False|None)\b", c99(p, 0.01)["ins_gps.c"]) == []


def test_a_row_that_is_kept_between_steps_must_have_a_c_text():
    with pytest.raises(TypeError, match="update_fix: row FADING has no C text; add it to "):
        Emitter({}).add(update_fix, fix_error=0, stores_innovation=0, adaptive=0, note_prior=0)
