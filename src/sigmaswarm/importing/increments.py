"""Propose expressions for increments of velocity and angle per sample, such as DeltaVel X (m/s) and delta_angle_z."""

import re
from collections.abc import Sequence

from sigmaswarm.importing.names import read_name, split_words
from sigmaswarm.importing.times import quoted_column
from sigmaswarm.importing.units import in_si

RATE = "SAMPLES_PER_S"  # stands for the rate, Hz, in the expressions
_WORDS = {
    "a": ("speed", r"(?:delta_?|d)v(?:el(?:ocity)?)?_?([xyz])"),
    "g": ("angle", r"(?:delta_?|d)(?:theta|ang(?:le)?|rot(?:ation)?)_?([xyz])"),
}


def increments(names: Sequence[str]) -> dict[str, str]:
    """Return the expressions of the six axes, with `RATE`; {} unless there are increments on all axes."""
    found: dict[str, str] = {}
    for name in names:
        bare = re.sub(r"\s*[\[(][^\[\]()]*[\])]\s*$", "", name)
        plain = "_".join(split_words(bare))
        unit = read_name(name).unit
        for letter, (dimension, words) in _WORDS.items():
            axis = re.fullmatch(rf"(?:.*_)?{words}", plain)
            if axis and (unit is None or unit.dimension == dimension):
                text = quoted_column(name)
                found.setdefault(f"{letter}{axis[1]}", f"{in_si(unit, text) if unit else text}*{RATE}")
    return found if len(found) == 6 else {}
