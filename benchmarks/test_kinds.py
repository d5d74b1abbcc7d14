"""Measure the time of other models and filter types: 32 parameter sets over the same drive as planar5's UKF."""

import numpy as np
import pytest

from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.tuning.space import search_space

pytestmark = [pytest.mark.usefixtures("turn"), pytest.mark.benchmark(group="kinds")]

FILTERS = {
    "planar5 ukf": ("planar5", "ukf", ()),
    "planar5 ekf": ("planar5", "ekf", ()),
    "planar5 adaptive-ukf": ("planar5", "adaptive-ukf", ()),
    "planar5 strong-tracking-ukf": ("planar5", "strong-tracking-ukf", ()),
    "planar5 fuzzy-ukf": ("planar5", "fuzzy-ukf", ()),
    "planar8 ukf": ("planar8", "ukf", ()),
    "planar8 ukf, lateral": ("planar8", "ukf", ("lateral",)),
    "planar8 ukf, lateral and standstill": ("planar8", "ukf", ("lateral", "standstill")),
    "planar8 ukf, lateral, standstill, accuracy and robust": (
        "planar8",
        "ukf",
        ("lateral", "standstill", "accuracy", "robust"),
    ),
    "planar8 ukf, lateral, standstill, accuracy, robust and fix-error": (
        "planar8",
        "ukf",
        ("lateral", "standstill", "accuracy", "robust", "fix-error"),
    ),
}


@pytest.fixture(scope="session")
def replayer(drive):
    return BatchScorer.prepare([drive])


@pytest.mark.parametrize("name", FILTERS)
def test_kind(measure, drive, replayer, name):
    model, kind, use = FILTERS[name]
    space = search_space(model, "log10", drive.nominal_interval, kind=kind, use=use)
    points = np.random.default_rng(0).uniform(space.low, space.high, (32, len(space.names)))
    sets = space.decode(points)
    samples = int((drive.imu.time > replayer.initial[0].time).sum())
    measure(lambda: replayer.scores(sets), work=len(sets) * samples, rounds=5)
