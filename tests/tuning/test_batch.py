"""`run_batch`: costs and scores of parameter sets by drives, independent of the other sets."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import AlignmentError, InputError
from sigmaswarm.filters.presets import DEFAULTS, PAPER
from sigmaswarm.filters.run import run_filter
from sigmaswarm.scoring.score import score_estimate
from sigmaswarm.tuning.batch import run_batch
from support import make_drive

DRIVES = [make_drive(duration=30.0, seed=s, name=f"d{s}") for s in range(2)]
SETS = [DEFAULTS, PAPER, replace(DEFAULTS, alpha=0.5, process_noise=(1e-3,) * 4 + (1e-6,))]


def test_costs_are_the_mean_score_over_drives():
    result = run_batch(DRIVES, SETS)
    assert result.costs.shape == result.failed.shape == (3,)
    for i, parameters in enumerate(SETS):
        each = [score_estimate(d, run_filter(d, parameters)) for d in DRIVES]
        assert result.costs[i] == pytest.approx(np.mean([s.position_rmse for s in each]), rel=1e-9)
        for j, score in enumerate(each):
            assert result.scores[i][j].position_rmse == pytest.approx(score.position_rmse, rel=1e-9)
            assert result.scores[i][j].heading_rmse == pytest.approx(score.heading_rmse, rel=1e-9)


def test_outages_are_run_only_for_objectives_that_contain_them():
    assert math.isnan(run_batch(DRIVES, SETS).scores[0][0].outage_drift)
    pose = run_batch(DRIVES, SETS, objective="truth-pose")
    for i in range(3):
        terms = [
            s.position_rmse + 0.1 * np.degrees(s.heading_rmse) + 0.1 * s.outage_drift for s in pose.scores[i]
        ]
        assert pose.costs[i] == pytest.approx(np.mean(terms), rel=1e-12)
    moved = run_batch(DRIVES, SETS, objective="truth-pose", outage_seed=5)
    assert moved.scores[0][0].outage_drift != pose.scores[0][0].outage_drift


def test_worst_averages_the_drives_with_the_highest_costs():
    each = [[score.position_rmse for score in row] for row in run_batch(DRIVES, SETS).scores]
    assert run_batch(DRIVES, SETS, worst=0.5).costs.tolist() == pytest.approx([*map(max, each)])


def test_a_failing_set_has_infinite_cost_and_changes_no_other_bit():
    bad = replace(DEFAULTS, process_noise=(1.0, 1.0, 1.0, 1.0, -1e3))
    clean, mixed = run_batch(DRIVES, SETS), run_batch(DRIVES, [SETS[0], bad, *SETS[1:]])
    assert mixed.failed.tolist() == [False, True, False, False]
    assert math.isinf(mixed.costs[1])
    np.testing.assert_array_equal(np.delete(mixed.costs, 1), clean.costs)
    assert mixed.scores[1][0].failed
    assert run_batch(DRIVES, [bad]).costs.tolist() == [np.inf]


def test_nan_in_one_drive_fails_that_drive_only():
    ax = DRIVES[1].imu.ax.copy()
    ax[-50] = np.nan
    broken = replace(DRIVES[1], imu=replace(DRIVES[1].imu, ax=ax))
    result = run_batch([DRIVES[0], broken], SETS)
    assert result.failed.all()
    assert np.isinf(result.costs).all()
    clean = run_batch(DRIVES, SETS)
    for i in range(3):
        assert not result.scores[i][0].failed
        assert result.scores[i][0].position_rmse == clean.scores[i][0].position_rmse
        assert result.scores[i][1].failed


@pytest.mark.parametrize("workers", [1, 3])
def test_the_executor_changes_no_bit(workers: int):
    sets = SETS * 13  # more than one block of lanes
    with ThreadPoolExecutor(workers) as pool:
        threaded = run_batch(DRIVES, sets, executor=pool)
    np.testing.assert_array_equal(threaded.costs, run_batch(DRIVES, sets).costs)
    np.testing.assert_array_equal(threaded.costs, np.tile(run_batch(DRIVES, SETS).costs, 13))


def test_one_drive_needs_no_list():
    np.testing.assert_array_equal(run_batch(DRIVES[0], SETS).costs, run_batch(DRIVES[:1], SETS).costs)


def test_no_sets_give_no_costs():
    assert run_batch(DRIVES, []).costs.shape == (0,)


def test_without_truth_only_the_paper_s_objective_is_possible():
    blind = [DRIVES[0], replace(DRIVES[1], truth=None)]
    for objective in ("truth-rmse", "truth-pose"):
        with pytest.raises(InputError, match=f"d1: has no truth, which the objective {objective} needs"):
            run_batch(blind, SETS, objective=objective)
    assert np.isfinite(run_batch(blind, SETS, objective="gps-rmse").costs).all()


def test_invalid_drives_and_objectives_are_rejected():
    with pytest.raises(InputError, match="no drives"):
        run_batch([], SETS)
    with pytest.raises(InputError, match="'nll'"):
        run_batch(DRIVES, SETS, objective="nll")
    zero = np.zeros(len(DRIVES[0].gps))
    still = replace(DRIVES[0], gps=replace(DRIVES[0].gps, x=zero, y=zero))
    with pytest.raises(AlignmentError, match="d0: the vehicle never travels"):
        run_batch([DRIVES[1], still], SETS)


@pytest.mark.parametrize(
    ("drives", "sets", "executor", "said"),
    [
        (
            "drives/monday",
            [DEFAULTS],
            None,
            r"got a str; run_batch takes Drives; sigmaswarm.read_drive\(path\) reads a Drive",
        ),
        (None, [DEFAULTS, {"alpha": 1.0}], None, "got a dict; run_batch takes FilterParameters"),
        (None, 3, None, "got a int; run_batch takes FilterParameters"),
        (
            None,
            [DEFAULTS],
            2,
            r"executor = 2 is not an executor; use concurrent.futures.ThreadPoolExecutor\(2\)",
        ),
    ],
)
def test_arguments_of_wrong_types_are_rejected(drives: Any, sets: Any, executor: Any, said: str):
    with pytest.raises(InputError, match=said):
        run_batch(make_drive(duration=20) if drives is None else drives, sets, executor=executor)


def test_one_drive_and_one_set_are_a_batch():
    drive = make_drive(duration=20)
    assert run_batch(drive, DEFAULTS).costs.tolist() == run_batch([drive], [DEFAULTS]).costs.tolist()


@pytest.mark.parametrize("interval", [1.0, 1.5, 2.0])
def test_a_drive_without_fixes_after_the_start_is_too_short(interval: float):
    """The error must not report that every filter failed."""
    drive = make_drive(duration=30.0, gps_rate=1 / interval)
    begin = initial_state(drive).time
    short = clip(drive, end=begin + 0.5 * interval)
    with pytest.raises(InputError, match=r"no fix follows the start .* longer drive"):
        run_batch(short, SETS[:1], objective="innovation-nll")
