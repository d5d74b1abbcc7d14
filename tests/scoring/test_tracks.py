"""The parts of trajectories that are stored for figures."""

from dataclasses import replace

import numpy as np

from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.scoring.tracks import sharpest_turn
from sigmaswarm.simulation.scenarios import simulate


def test_the_sharpest_turn_is_found_although_the_fix_there_is_an_outlier():
    drive = simulate("turns", gps="white-1m", seed=2)
    place = sharpest_turn(PreparedDrive(drive))
    assert drive.truth is not None
    away = np.hypot(drive.truth.x - place[0], drive.truth.y - place[1])
    assert away.min() < 1.5
    x = drive.gps.x.copy()
    x[np.argmin(np.hypot(drive.gps.x - place[0], drive.gps.y - place[1]))] += 60.0
    lying = replace(drive, gps=replace(drive.gps, x=x))
    assert np.hypot(*(sharpest_turn(PreparedDrive(lying)) - place)) < 5.0
