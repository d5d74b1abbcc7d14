"""Tuning without preprocessing: its effect on stale fixes and gaps, and the paper's setting."""

from dataclasses import replace

from filter_cases import parameters, rough
from sigmaswarm import evaluate, run_filter, run_innovations
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.config import StudyConfig
from sigmaswarm.experiments.study.design import make_design
from sigmaswarm.tuning.batch import run_batch
from sigmaswarm.tuning.config import PAPER_OPTIONS, TuneConfig
from sigmaswarm.tuning.problem import car_problem


def test_the_option_has_an_effect_on_tune_batch_evaluate_and_run():
    drive, p = rough(), parameters("planar5")
    found = {}
    for as_recorded in (False, True):
        ready = PreparedDrive(drive, as_recorded=as_recorded)
        problem = car_problem([drive], TuneConfig(objective="truth-rmse", as_recorded=as_recorded))
        batch = run_batch(drive, [p], as_recorded=as_recorded)
        evaluated = evaluate(drive, p, as_recorded=as_recorded)
        mean = run_filter(drive, p, as_recorded=as_recorded).mean
        assert mean.tobytes() == run_filter(ready, p).mean.tobytes()
        nis = run_innovations(drive, p, as_recorded=as_recorded).nis
        assert nis.tobytes() == run_innovations(ready, p).nis.tobytes()
        assert batch.scores[0][0].position_rmse == evaluated.mean("tuned", "position_rmse_m")
        assert problem.scorer.scores([p])[0, 0].position_rmse == batch.scores[0][0].position_rmse
        (drive_found,) = evaluated.drives.values()
        assert drive_found.stale_fixes == (0 if as_recorded else 5)
        found[as_recorded] = batch.costs[0], problem.steps[0]
    assert found[True][0] != found[False][0]
    assert found[True][1] == found[False][1] + 5  # the stale fixes add steps


def test_the_score_of_the_fixes_includes_stale_fixes():
    drive = rough()
    with_frozen, without = (evaluate(d, parameters("planar5")) for d in (drive, without_stale(drive)))
    assert with_frozen.mean("raw_gps", "position_rmse_m") != without.mean("raw_gps", "position_rmse_m")
    assert with_frozen.mean("tuned", "position_rmse_m") == without.mean("tuned", "position_rmse_m")


def without_stale(drive):
    return replace(drive, gps=drive.gps.select(~PreparedDrive(drive).stale))


def test_the_papers_protocol_has_no_preprocessing():
    assert PAPER_OPTIONS["as_recorded"] is True
    design = make_design(StudyConfig(maneuvers=("turns",), environments=("clear",), runs=2))
    assert all(design.tune_config(method, protocol).as_recorded for protocol, method in design.config.tuned)
