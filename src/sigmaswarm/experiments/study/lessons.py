"""What a network learns from in a trial: some minutes of its training drives, in an order drawn for the trial."""

import zlib
from dataclasses import dataclass

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study.design import Design

LEAST = 21.0
"""s behind a filter's start: `noise-gru` learns in segments of 20 s, and outages of 10 s begin 10 s after the start."""
ALONE = 80.0
"""s behind the start: of such a drive the last quarter can be held back, where there are no others."""
FEWEST = 3
"""Drives of which the last third is held back, to end the training in time and to calibrate."""
FIRST_POINT = 2.0
"""Minutes: where learning curves begin."""


@dataclass(frozen=True, eq=False)
class Lessons:
    """What a network learns from.

    Attributes
    ----------
    shown, held_back : tuple of Drive
        To be trained on, and to end the training in time; of one or two drives, `learn` holds back the ends.
    driven : float
        s behind the starts of filters, over both.
    """

    shown: tuple[Drive, ...]
    held_back: tuple[Drive, ...]
    driven: float


def lessons(design: Design, trial: int, minutes: float) -> Lessons:
    """So many minutes of driving, or all: whole drives, and the beginning of one.

    More minutes hold the drives of fewer. It may be more than was asked for, where a network could not learn else.

    Raises
    ------
    InputError
        If the trial's training drives are too few or too short for a network.
    """
    left, whole, begun, longest = 60.0 * minutes, list[Drive](), list[Drive](), 0.0
    driven = 0.0
    for i in _order(design, trial):
        drive, start = design.prepared[i].drive, design.prepared[i].initial.time
        sound = len(whole) >= FEWEST or longest >= ALONE
        if left <= 0 or (left < LEAST and sound):
            if sound:
                break
            left = 0.0  # one more, whole
        length = _length(design.prepared[i])
        took = min(length, left) if left >= LEAST else length
        (whole if took == length else begun).append(
            drive if took == length else clip(drive, end=start + took)
        )
        longest, driven, left = max(longest, took), driven + took, left - took
    chosen = begun + whole  # what is held back is to be long
    if len(chosen) < FEWEST and longest < ALONE:
        raise InputError(
            f"trial {trial} has too little to train networks on: they take {FEWEST} drives of {LEAST:g} s behind the "
            f"start of a filter, or one of {ALONE:g} s; add drives, or the maneuver urban"
        )
    held_back = len(chosen) // FEWEST
    return Lessons(tuple(chosen[: len(chosen) - held_back]), tuple(chosen[len(chosen) - held_back :]), driven)


def curve_minutes(design: Design) -> list[float]:
    """The minutes of a learning curve in the first trial, twice as many each time; without the last, which is all."""
    all_of_it = lessons(design, 0, design.config.learn_minutes).driven / 60.0
    doubled = FIRST_POINT * 2.0 ** np.arange(12)
    return [float(minutes) for minutes in doubled if minutes < 0.9 * all_of_it]


def _length(ready: PreparedDrive) -> float:
    """s behind the start."""
    return float(ready.drive.imu.time[-1]) - ready.initial.time


def _order(design: Design, trial: int) -> list[int]:
    """Indices of the trial's training drives that are long enough, in an order of its own."""
    key = (trial, zlib.crc32(b"lessons"))
    rng = np.random.default_rng(np.random.SeedSequence(design.config.seed, spawn_key=key))
    order = rng.permutation(design.split(trial)[0]).tolist()
    return [i for i in order if _length(design.prepared[i]) >= LEAST]
