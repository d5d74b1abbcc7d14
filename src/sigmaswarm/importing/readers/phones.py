"""Exports of phones, as folders or zips of CSVs, and the mounting of a phone."""

from collections.abc import Collection
from contextlib import ExitStack
from pathlib import Path

from sigmaswarm.importing.readers.columns import log_of_names
from sigmaswarm.importing.source import Guess, Limits, Log

# A phone's x points right and y to its top edge (Android's SensorEvent): forward is y, left is -x
FLAT_NOTE = (
    "the phone is assumed to lie flat with the screen up and the top edge forward; otherwise add --mount, or "
    "--mount auto"
)
NO_GUESS = Guess({})
# Radius of a circle that contains 68% of normal errors, in standard deviations per axis: sqrt(-2 ln 0.32)
RADIUS_68 = 1.515


def phone_files(path: Path, names: Collection[str], limits: Limits, stack: ExitStack) -> Log:
    return log_of_names(path, names, limits, stack, NO_GUESS)
