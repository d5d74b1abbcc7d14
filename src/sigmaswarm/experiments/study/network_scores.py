"""The scores of a study's networks: of the same measures, on the same drives and outages as those of the filters."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from functools import partial

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.design import Design
from sigmaswarm.experiments.study.networks import Taught, Training
from sigmaswarm.scoring.batch import scores_of
from sigmaswarm.scoring.drifts import rms_drift
from sigmaswarm.scoring.score import PieceErrors
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, outage_replay, outage_windows, tracking_replay


def scores_of_networks(
    design: Design,
    each: Sequence[Taught],
    drives: Sequence[Sequence[int]],
    executor: Executor | None = None,
) -> dict[str, Array]:
    """Scores of networks, each on some drives by index, of shape (networks, all drives); NaN on the others."""
    jobs = [(k, i) for k, chosen in enumerate(drives) for i in chosen]
    one = partial(_score, long=design.config.long_outages, seed=design.config.seed)
    told = (executor.map if executor else map)(
        one, [each[k] for k, _ in jobs], [design.prepared[i] for _, i in jobs]
    )
    found: dict[str, Array] = {}
    for at, scores in zip(jobs, told, strict=True):
        for measure, value in scores.items():
            found.setdefault(measure, np.full((len(each), len(design.drives)), np.nan))[at] = value
    return found


def scores_of_curve(
    design: Design, taught: Mapping[Training, Taught], executor: Executor | None = None
) -> dict[Training, tuple[Taught, dict[str, Array]]]:
    """Of the networks of learning curves, on the drives that the first trial held back: shape (all drives,) each."""
    less = {training: found for training, found in taught.items() if training.minutes is not None}
    held_back = [design.split(0)[1]] * len(less)
    scores = scores_of_networks(design, list(less.values()), held_back, executor)
    return {
        training: (found, {measure: values[k] for measure, values in scores.items()})
        for k, (training, found) in enumerate(less.items())
    }


def _score(taught: Taught, ready: PreparedDrive, long: Mapping[str, float], seed: int) -> dict[str, float]:
    """Of one drive, as the filters' are: it never starts anew, and outages are placed once."""
    replay, truth = tracking_replay(ready), ready.drive.truth
    assert truth is not None
    run = taught.learned.run(replay, taught.parameters)
    errors = PieceErrors(truth, ready.initial)
    for piece in run:
        errors.add(piece.time, piece.mean)
    sums = scores_of({"tracking": [replay]}, {"tracking": run.sums})[0, 0]
    found = {
        "position_rmse_m": errors.score.position_rmse,
        "gps_rmse_m": sums.fix_rmse,
        "heading_rmse_deg": float(np.degrees(errors.score.heading_rmse)),
        "nis": sums.mean_nis,
    }
    found = {measure: np.inf if run.failure else value for measure, value in found.items()}
    lengths = {"outage_drift_m": OUTAGE_LENGTH, **long}
    return found | {m: _drift(taught, ready, length, seed) for m, length in lengths.items()}


def _drift(taught: Taught, ready: PreparedDrive, length: float, seed: int) -> float:
    ends = outage_windows(ready.drive, ready.initial, length=length, seed=seed)[:, 1]
    if not len(ends):
        return float("nan")
    run = taught.learned.run(outage_replay(ready, length=length, seed=seed), taught.parameters)
    whole = run.whole()
    return float("inf") if run.failure else rms_drift(ready, whole, ends)
