"""What is said of a filter that loses its way on the drives that it was tuned on."""

from dataclasses import replace

import numpy as np

from sigmaswarm import SigmaswarmError, run_filter, simulate
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.lost import said_of_lost
from sigmaswarm.tuning.problem import car_problem

CONFIG = TuneConfig(model="planar8", kind="ekf", use=("lateral", "gate"), objective="innovation-t")
DRIVE = simulate("urban", run=1, gps="white-1m", duration=150)


def test_a_filter_that_is_lost_where_it_was_tuned_is_not_to_be_used():
    gps = DRIVE.gps
    off = (gps.time >= 60) & (gps.time < 100)
    aside = replace(DRIVE, name="aside", gps=replace(gps, x=gps.x + 120.0 * off, y=gps.y + 160.0 * off))
    problem = car_problem([DRIVE, aside], CONFIG)
    rng, seen = np.random.default_rng(0), set[bool]()
    space = problem.space
    for point in space.low + rng.random((30, len(space.low))) * (space.high - space.low):
        p = problem.parameters(point)
        try:
            lost = {drive.name: run_filter(drive, p).restarts for drive in (DRIVE, aside)}
        except SigmaswarmError:
            continue
        said = [doubt for doubt in problem.doubts(point) if doubt.startswith("DON'T USE IT")]
        assert bool(said) == any(lost.values())
        assert all(
            (f"lost its way on {name} and" in said[0]) == bool(times) for name, times in lost.items() if said
        )
        seen.add(bool(said))
    assert seen == {True, False}


def test_it_names_three_drives_and_counts_the_others():
    assert said_of_lost([("one", []), ("two", [])]) == []
    (said,) = said_of_lost([(f"drive-{i}", [10.25, 31.0][: i % 2 + 1]) for i in range(5)] + [("sound", [])])
    assert "lost its way on drive-0 and started anew once, at t = 10.2 s" in said
    assert "it lost its way on drive-1 and started anew 2 times, at t = 10.2, 31.0 s" in said
    assert "drive-3" not in said
    assert "and on 2 more drives" in said
    assert "sound" not in said
