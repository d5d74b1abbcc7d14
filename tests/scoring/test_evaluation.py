"""The comparison: every method on the same drives, in a machine-readable format."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sigmaswarm
from sigmaswarm.cli.evaluate import print_evaluation
from sigmaswarm.cli.output import Output
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import baseline
from sigmaswarm.filters.run import run_filter, run_imu_only
from sigmaswarm.scoring.batch import BatchScorer, PassOptions
from sigmaswarm.scoring.evaluation import DriveResult, Evaluation, evaluate
from sigmaswarm.scoring.methods import method_names
from sigmaswarm.scoring.remarks import restarted, worse_than_raw, worse_than_untuned
from sigmaswarm.scoring.score import Score, score_estimate, score_raw_gps
from sigmaswarm.scoring.targets import outage_windows, placements
from support import make_drive

GOOD = FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0))
PLANAR8 = replace(GOOD, model="planar8", process_noise=(*GOOD.process_noise, 1e-9, 1e-9, 1e-9))
BROKEN = replace(GOOD, process_noise=(1.0, 1.0, -5.0, 1.0, 1.0))
METHODS = ["tuned", "untuned", "fixes_alone", "raw_gps", "imu_only"]
NAMES = ["tuned UKF", "baseline", "fixes alone", "raw GPS", "IMU only"]
POSITIONS = ["position_rmse_m", "position_median_m", "position_95_m"]
DRIFTS = {"short_outage_drift_m": 1.0, "outage_drift_m": 5.0, "long_outage_drift_m": 30.0}
MEASURES = [*POSITIONS, "heading_rmse_deg", *DRIFTS]
DRIVES = [make_drive(duration=60.0, seed=s, name=f"drive-{s}") for s in range(2)]
SHORT = [make_drive(duration=20.0, seed=s) for s in range(2)]


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    return evaluate(DRIVES, GOOD)


def test_the_json_contains_all_methods_and_measures(evaluation: Evaluation):
    said = json.loads(json.dumps(evaluation.to_dict(), allow_nan=False))
    assert list(said["drives"]) == ["drive-0", "drive-1"]
    for methods in [*said["drives"].values(), said["mean"]]:
        assert list(methods) == METHODS
        for method, measures in methods.items():
            assert list(measures) == MEASURES
            for measure, value in measures.items():
                missing = method == "raw_gps" and measure not in POSITIONS
                assert (value is None) if missing else (isinstance(value, float) and value > 0), (
                    method,
                    measure,
                )


def test_tables_have_no_drift_of_an_outage_for_imu_only(evaluation: Evaluation):
    """IMU-only uses no fix after the start, so its error at the end of a window accumulates since the start."""
    for blind in (False, True):
        drives = [replace(drive, truth=None) for drive in DRIVES] if blind else DRIVES
        view = (evaluate(drives, GOOD) if blind else evaluation).view
        drifts = {measure.title for name, measure in view.measures.items() if name in DRIFTS}
        for table in (view.mean_table(), view.drive_table()):
            rows = [row for row in table.rows if row[1] == "IMU only"]
            assert bool(rows) != blind, "a row without a value is left out"
            titles = [column.title for column in table.columns]
            assert all((row[titles.index(t)] is None) for row in rows for t in drifts if t in titles)
            assert all(row[titles.index("position RMSE")] > 0 for row in rows)
        assert "IMU only" not in {row[1] for row in view.drift_table().rows}


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"kind": "adaptive-ukf"}, "tuned adaptive UKF"),
        (
            {"model": "planar8", "process_noise": (*GOOD.process_noise, 1e-9, 1e-9, 1e-9)},
            "tuned UKF, planar8",
        ),
    ],
)
def test_the_name_of_the_tuned_filter_states_its_type_and_model(change: dict, name: str):
    names = evaluate(SHORT[0], replace(GOOD, **change)).names
    assert list(names) == METHODS
    assert list(names.values()) == [name, *NAMES[1:]]


def all_ends(drive: Drive, start: InitialState, length: float, seed: int = 0) -> list[np.ndarray]:
    """Return the times at which the outages of each placement end."""
    seeds = placements(drive, start, length=length, seed=seed)
    return [outage_windows(drive, start, length=length, seed=each)[:, 1] for each in seeds]


def drifts_of(drive: Drive, sets: list[FilterParameters], length: float, seed: int = 0) -> np.ndarray:
    """Return RMS drifts (n_sets,) over all outages of all placements, one batch per placement."""
    seeds = placements(drive, initial_state(drive), length=length, seed=seed)
    each = [
        BatchScorer.prepare([drive], PassOptions(outages=True, outage_length=length, outage_seed=s))
        .scores(sets)
        .outage_drift[:, 0]
        for s in seeds
    ]
    counts = [len(ends) for ends in all_ends(drive, initial_state(drive), length, seed)]
    return np.sqrt(np.average(np.square(each), weights=counts, axis=0))


def test_drifts_average_many_placements_and_state_their_number_and_range(evaluation: Evaluation):
    drive, name = DRIVES[0], "drive-0"
    start = initial_state(drive)
    ends = all_ends(drive, start, 5.0)
    assert len(ends) == 8
    assert len({each.tobytes() for each in ends}) == 8
    told = evaluation.record.drifts[name]["outage_drift_m"]
    assert told.outages == sum(map(len, ends))
    for method in ("tuned", "untuned", "imu_only"):
        assert len(told.each[method]) == 8
        low, high = told.drift_range(method) or (np.nan, np.nan)
        assert low < evaluation.value(name, method, "outage_drift_m") < high
    first = BatchScorer.prepare([drive], PassOptions(outages=True)).scores([GOOD]).outage_drift[0, 0]
    assert told.each["tuned"][0] == pytest.approx(first, rel=1e-12)
    said = evaluate(drive, GOOD).record.describe_drift("outage_drift_m")
    low, high = told.drift_range("tuned") or (np.nan, np.nan)
    of = f"The drift is the RMS error over {told.outages} outages in 8 random placements"
    few = ". All outages are on one short stretch; the drift on another stretch may be far larger"
    assert said == f"{of}; for a single placement it is {low:.3g} to {high:.3g} m{few}"
    two = {each: {"outage_drift_m": told.model_copy(update={"outages": 8})} for each in (name, "drive-1")}
    said = evaluation.record.model_copy(update={"drifts": two}).describe_drift("outage_drift_m")
    assert ". All outages are on one short stretch of each drive; the drift" in said
    many = {name: {"outage_drift_m": told.model_copy(update={"outages": 8 * 5})}}
    assert few not in evaluation.record.model_copy(update={"drifts": many}).describe_drift("outage_drift_m")
    long = make_drive(duration=3600.0, imu_rate=10.0, gps_rate=1.0)
    assert len(placements(long, initial_state(long), length=5.0, seed=0)) == 2  # each has 240 outages


@pytest.mark.parametrize("in_an_outage", [True, False])
def test_if_the_tuned_filter_failed_its_drift_is_not_described(
    evaluation: Evaluation, capsys: pytest.CaptureFixture[str], in_an_outage: bool
):
    good = evaluation.drives["drive-1"]
    scores = {**good.scores, "tuned": replace(good.scores["tuned"], failed=True)}
    drifts = dict(good.drifts)
    if in_an_outage:
        told = drifts["outage_drift_m"]
        each = {**told.each, "tuned": [None, *told.each["tuned"][1:]]}
        drifts["outage_drift_m"] = told.model_copy(update={"each": each})
    failed = replace(
        evaluation, drives={**evaluation.drives, "drive-1": replace(good, scores=scores, drifts=drifts)}
    )
    assert bool(failed.record.describe_drift("outage_drift_m")) is not in_an_outage
    print_evaluation(Output(verbose=False), failed)
    assert "The tuned filter failed on drive-1." in capsys.readouterr().out
    print_evaluation(Output(verbose=True), failed)
    said = capsys.readouterr().out
    assert "(failed)" in said
    assert "drift of the tuned filter" not in said


def test_a_filter_of_the_user_is_the_first_row_of_every_table(evaluation: Evaluation):
    own = evaluate(DRIVES, GOOD, against=PLANAR8)
    said, sound = own.to_dict(), evaluation.to_dict()
    assert list(said["mean"]) == ["against", *METHODS]
    assert own.names["against"] == "other UKF, planar8"
    assert own.to_frame()["method"].to_list() == ["other UKF, planar8", *NAMES] * 2
    alone = evaluate(DRIVES, PLANAR8).to_dict()
    for drive in said["drives"]:
        assert said["drives"][drive].pop("against") == pytest.approx(
            alone["drives"][drive]["tuned"], nan_ok=True
        )
    assert said["drives"] == sound["drives"]
    assert list(said["improvement_percent"]) == ["against", "untuned", "fixes_alone"]


def test_each_method_is_scored_by_its_definition(evaluation: Evaluation):
    said = evaluation.to_dict()["drives"]
    for drive in DRIVES:
        start = initial_state(drive)
        sets = [GOOD, baseline(drive, like=GOOD)]
        batch = BatchScorer.prepare([drive]).scores(sets)
        drifts = {measure: drifts_of(drive, sets, length) for measure, length in DRIFTS.items()}
        for i, method in enumerate(METHODS[:2]):
            plain = score_estimate(drive, run_filter(drive, sets[i]))
            assert said[drive.name][method] == {
                "position_rmse_m": batch.position_rmse[i, 0],
                "position_median_m": plain.position_median,
                "position_95_m": plain.position_95,
                "heading_rmse_deg": np.rad2deg(batch.heading_rmse[i, 0]),
                **{measure: pytest.approx(each[i], rel=1e-12) for measure, each in drifts.items()},
            }
        raw = score_raw_gps(drive, start)
        assert [said[drive.name]["raw_gps"][m] for m in POSITIONS] == [
            raw.position_rmse,
            raw.position_median,
            raw.position_95,
        ]
        imu_only = score_estimate(drive, run_imu_only(drive, initial=start))
        assert said[drive.name]["imu_only"]["position_rmse_m"] == imu_only.position_rmse
        assert said[drive.name]["imu_only"]["heading_rmse_deg"] == np.rad2deg(imu_only.heading_rmse)


def test_dead_reckoning_drifts_from_the_start(evaluation: Evaluation):
    drive = DRIVES[0]
    start = initial_state(drive)
    estimate = run_imu_only(drive, initial=start)
    ends = np.concatenate(all_ends(drive, start, 5.0))
    at, true = np.searchsorted(estimate.time, ends), np.searchsorted(drive.truth.time, ends)
    error = np.hypot(estimate.mean[at, 0] - drive.truth.x[true], estimate.mean[at, 1] - drive.truth.y[true])
    said = evaluation.to_dict()["drives"]["drive-0"]["imu_only"]
    assert said["outage_drift_m"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    ends = np.concatenate(all_ends(drive, start, 30.0))
    assert len(ends) == 8
    at, true = np.searchsorted(estimate.time, ends), np.searchsorted(drive.truth.time, ends)
    error = np.hypot(estimate.mean[at, 0] - drive.truth.x[true], estimate.mean[at, 1] - drive.truth.y[true])
    assert said["long_outage_drift_m"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)


def test_a_drive_too_short_for_outages_of_30_s_has_no_such_drift():
    said = evaluate(make_drive(duration=35.0, seed=0, name="short"), GOOD).to_dict()["mean"]["tuned"]
    assert said["long_outage_drift_m"] is None
    assert said["outage_drift_m"] > 0


def test_a_sentence_states_if_the_filter_is_worse_than_the_raw_fixes(evaluation: Evaluation):
    assert worse_than_raw(evaluation.record) == ()
    tuned = Score(position_rmse=3.0, position_median=0.5, position_95=7.25)
    raw = Score(position_rmse=2.0, position_median=1.0, position_95=4.0)
    others = dict.fromkeys(METHODS, Score())
    drives = {
        "town": DriveResult(others | {"tuned": tuned, "raw_gps": raw}),
        "field": DriveResult(others | {"tuned": raw, "raw_gps": tuned}),
        "blind": DriveResult(others),
    }
    assert worse_than_raw(Evaluation(drives).record) == (
        "on town the tuned filter is WORSE than the raw fixes: RMSE 3 m instead of 2 m, 95% 7.25 m instead of 4 m",
        "on field the tuned filter is WORSE than the raw fixes: 50% 1 m instead of 0.5 m",
    )


@pytest.mark.parametrize(
    ("own", "baseline", "words"),
    [
        (2.0, 2.0, "equal within 0.5% to"),
        (2.004, 2.0, "equal within 0.5% to"),
        (1.995, 2.0, "equal within 0.5% to"),
        (1.9, 2.0, "5% lower than"),
        (2.1, 2.0, "5% HIGHER than"),
    ],
)
@pytest.mark.parametrize("measure", ["position_rmse", "outage_drift"])
def test_equal_errors_are_described_as_equal(own: float, baseline: float, words: str, measure: str):
    methods: dict[str, Any] = dict.fromkeys(METHODS, Score())
    methods |= {"tuned": Score(**{measure: own}), "untuned": Score(**{measure: baseline})}
    headline = Evaluation({"town": DriveResult(methods)}).view.result()
    assert f"{words} the baseline ({baseline:.3g} m)" in headline


@pytest.mark.parametrize("name", ["second.toml", "tunings/second.toml", "a b/tuning.toml"])
def test_the_row_of_another_filter_shows_its_path(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path(name).parent.mkdir(exist_ok=True)
    PLANAR8.save(Path(name))
    found = evaluate(DRIVES[:1], GOOD, against=name)
    assert found.names["against"] == f"other UKF, planar8 ({name})"
    assert found.setup.against and found.setup.against.called == f"UKF, planar8 ({name})"
    assert f"the other UKF, planar8 ({name})" in found.view.result()


def worse(evaluation: Evaluation) -> tuple[str, ...]:
    return tuple(worse_than_untuned(evaluation.record, evaluation.measures).values())


def test_a_sentence_states_if_the_baseline_is_better(evaluation: Evaluation):
    (here,) = worse(evaluation)  # `GOOD` is not tuned, and the baseline suits these drives
    assert "the baseline: position RMSE 0.8" in here
    others = dict.fromkeys(METHODS, Score())

    def said(tuned: float, manual: float) -> tuple[str, ...]:
        both = {"untuned": Score(outage_drift=manual), "tuned": Score(outage_drift=tuned)}
        return worse(Evaluation({"town": DriveResult(others | both)}))

    assert said(47.8, 18.5) == (
        "the tuned filter is WORSE than the baseline: 5 s outage drift 47.8 m instead of 18.5 m",
    )
    assert said(18.5, 47.8) == said(18.6, 18.5) == ()
    good = Score(position_rmse=0.5, heading_rmse=np.radians(0.4), outage_drift=2.0, long_outage_drift=7.0)
    sheet = replace(good, position_rmse=1.1, heading_rmse=np.radians(0.3), outage_drift=4.0)
    assert worse(Evaluation({"town": DriveResult(others | {"untuned": sheet, "tuned": good})})) == (
        "the tuned filter is worse than the baseline in 1 of 4 measures: heading error "
        "0.4 deg instead of 0.3 deg",
    )
    assert worse(Evaluation({"town": DriveResult(others | {"fixes_alone": sheet, "tuned": good})})) == (
        "the tuned filter is worse than the filter that uses only the fixes in 1 of 4 measures: heading error "
        "0.4 deg instead of 0.3 deg",
    )
    close = {
        "untuned": replace(sheet, long_outage_drift=6.9),
        "fixes_alone": replace(good, long_outage_drift=8.0),
    }
    sentences = Evaluation({"town": DriveResult(others | {"tuned": good} | close)}).view.warnings()
    assert sentences == (
        "The tuned filter is NOT better than the filter that uses only the fixes in the 5 s outage drift (both "
        "2 m).",
        "The tuned filter is worse than the baseline in 1 of 4 measures: heading error 0.4 deg instead of 0.3 deg.",
    )
    other = {"against": replace(good, outage_drift=3.0, long_outage_drift=1.5)}
    whole = Evaluation(
        {"town": DriveResult(others | {"tuned": good} | other)}, names=method_names(also=["against"])
    )
    assert (
        "The tuned filter is NOT better than the other filter in the 30 s outage drift (7 instead of 1.5 m), heading "
        "error (both 0.4 deg)." in whole.view.sentences()[1:]
    )
    farther = replace(sheet, position_rmse=0.4)
    (here,) = worse(Evaluation({"town": DriveResult(others | {"untuned": farther, "tuned": good})}))
    assert "is WORSE than" in here


@pytest.mark.parametrize("failed", [True, False])
def test_a_failed_filter_is_not_described_as_having_too_few_fixes(failed: bool):
    result = DriveResult({**dict.fromkeys(METHODS, Score()), "tuned": Score(failed=failed)})
    view = Evaluation({"town": result}).view
    assert (
        "The filter had too few fixes to determine its consistency, which needs more than 20."
        in view.verdicts().values()
    ) is not failed
    assert ("The tuned filter failed on town." in view.warnings()) is failed


def test_means_are_over_drives_and_improvements_use_the_means(evaluation: Evaluation):
    said = evaluation.to_dict()
    for method in METHODS[:2]:
        for measure in MEASURES:
            each = [said["drives"][d.name][method][measure] for d in DRIVES]
            assert said["mean"][method][measure] == pytest.approx(sum(each) / 2, rel=1e-12)
    manual, tuned = (said["mean"][m]["position_rmse_m"] for m in ("untuned", "tuned"))
    assert evaluation.improvement() == pytest.approx((manual - tuned) / manual * 100, rel=1e-12)
    assert evaluation.mean("baseline", "position_rmse_m") == manual, "the printed name is accepted, too"
    assert evaluation.improvement("baseline") == evaluation.improvement("untuned")
    assert said["improvement_percent"]["untuned"]["position_rmse_m"] == evaluation.improvement()
    sheet = said["mean"]["untuned"]["heading_rmse_deg"]
    expected = (sheet - said["mean"]["tuned"]["heading_rmse_deg"]) / sheet * 100
    assert evaluation.improvement("untuned", "heading_rmse_deg") == pytest.approx(expected, rel=1e-12)


def test_a_filter_that_diverged_is_named(evaluation: Evaluation):
    assert restarted(evaluation.record) == ()
    assert evaluation.to_dict()["restarts"] == {d.name: {"tuned": [], "untuned": []} for d in DRIVES}
    drive = sigmaswarm.simulate("urban", run=1, gps="white-1m", duration=65, imu_rate=50)
    off = (drive.gps.time > 30) & (drive.gps.time < 55)
    aside = replace(drive, gps=replace(drive.gps, x=drive.gps.x + 300.0 * off))
    gated = replace(GOOD, gate=9.2, process_noise=(1e-6, 1e-6, 1e-4, 1e-4, 1e-8))
    found = evaluate(aside, gated)
    times = run_filter(aside, gated).restarts
    assert times
    assert found.drives[aside.name].restarts["tuned"] == times
    assert found.to_dict()["restarts"][aside.name]["tuned"] == list(times)
    (said,) = restarted(found.record)
    assert said.startswith(f"the tuned filter diverged on {aside.name} and was reset")
    assert f"t = {times[0]:.1f}" in said
    plain = score_estimate(aside, run_filter(aside, gated))  # the score is that of the filter with resets
    rmse = found.value(aside.name, "tuned", "position_rmse_m")
    assert rmse == pytest.approx(plain.position_rmse, rel=1e-3)  # the reset itself is different
    assert found.value(aside.name, "tuned", "position_95_m") == pytest.approx(plain.position_95, rel=1e-9)


def test_improvements_follow_equation_5():
    scores = {m: Score(position_rmse=v) for m, v in zip(METHODS, [1.5, 2.0, 2.5, 3.0, 9.0], strict=True)}
    evaluation = Evaluation({"d": DriveResult(scores)})
    assert evaluation.improvement() == pytest.approx(25.0)
    assert evaluation.improvement("raw_gps") == pytest.approx(50.0)
    assert evaluation.improvement("untuned", "heading_rmse_deg") is None


def test_the_frame_has_a_row_per_drive_and_method(evaluation: Evaluation):
    frame = evaluation.to_frame()
    assert frame.columns == ["drive", "method", *MEASURES]
    assert frame["drive"].to_list() == [d.name for d in DRIVES for _ in METHODS]
    assert frame["method"].to_list() == NAMES * 2, "the names are those that the command prints"
    said = evaluation.to_dict()["drives"]
    for row in frame.iter_rows(named=True):
        assert {m: row[m] for m in MEASURES} == said[row["drive"]][METHODS[NAMES.index(row["method"])]]


def test_print_and_the_notebook_show_the_means_and_each_warning_once(evaluation: Evaluation):
    printed, shown = repr(evaluation), evaluation._repr_html_()
    assert len(printed.splitlines()) <= 15
    assert printed.startswith(evaluation.view.result())
    (warning,) = evaluation.view.warnings()
    assert "WORSE than the baseline" in warning
    for text in (printed, shown):
        assert text.count("WORSE than the baseline") == 1
        assert all(name in text for name in NAMES)
    assert all(drive.name in shown for drive in DRIVES)


def test_without_truth_only_the_drift_is_given():
    said = evaluate(replace(DRIVES[0], truth=None), GOOD).to_dict()
    json.dumps(said, allow_nan=False)
    for method in METHODS:
        scores = said["drives"]["drive-0"][method]
        assert [scores[m] for m in POSITIONS] == [None] * 3
        assert scores["heading_rmse_deg"] is None
        assert (scores["outage_drift_m"] is None) == (method == "raw_gps")
        assert said["mean"][method] == scores
    assert said["improvement_percent"]["untuned"]["position_rmse_m"] is None
    assert said["improvement_percent"]["untuned"]["outage_drift_m"] is not None


def test_two_drives_of_one_name_are_both_kept():
    same = [replace(drive, name="monday") for drive in (*SHORT, SHORT[0])]
    said = evaluate(same, GOOD).to_dict()["drives"]
    assert list(said) == ["monday", "monday (2)", "monday (3)"]
    assert said["monday"] == said["monday (3)"]
    assert said["monday"] != said["monday (2)"]


def test_a_filter_that_fails_has_no_scores_and_does_not_change_others(evaluation: Evaluation):
    broken = evaluate(DRIVES, BROKEN)
    said, sound = broken.to_dict(), evaluation.to_dict()
    json.dumps(said, allow_nan=False)
    assert said["drives"]["drive-0"]["tuned"] == dict.fromkeys(MEASURES)
    assert said["mean"]["tuned"] == dict.fromkeys(MEASURES)
    assert broken.scores["drive-0"]["tuned"].failed
    assert broken.improvement() is None
    for method in METHODS[1:]:
        assert said["drives"]["drive-0"][method] == sound["drives"]["drive-0"][method]
        assert said["mean"][method] == sound["mean"][method]


def test_a_failure_on_one_drive_leaves_no_mean():
    fine = {m: Score(position_rmse=1.0) for m in METHODS}
    failed = fine | {"tuned": Score(failed=True)}
    evaluation = Evaluation({"a": DriveResult(fine), "b": DriveResult(failed)})
    assert evaluation.mean("tuned", "position_rmse_m") is None
    assert evaluation.mean("untuned", "position_rmse_m") == 1.0


@pytest.mark.long
def test_the_options_of_outages_have_an_effect():
    one, other, longer = (
        evaluate(DRIVES[:1], GOOD, **kw).to_dict()["mean"]["untuned"]
        for kw in ({}, {"outage_seed": 3}, {"outage_length": 8.0})
    )
    assert one["outage_drift_m"] not in (other["outage_drift_m"], longer["outage_drift_m"])
    assert one["position_rmse_m"] == other["position_rmse_m"] == longer["position_rmse_m"]
    assert other["outage_drift_m"] == pytest.approx(
        drifts_of(DRIVES[0], [baseline(DRIVES[0], like=GOOD)], 5.0, 3)[0], rel=1e-12
    )


@pytest.mark.long
def test_the_order_and_the_number_of_drives_change_no_bit(evaluation: Evaluation):
    turned = evaluate(DRIVES[::-1], GOOD).to_dict()["drives"]
    assert turned == evaluation.to_dict()["drives"]
    assert sigmaswarm.evaluate(DRIVES[1], GOOD).to_dict()["drives"]["drive-1"] == turned["drive-1"]


def test_an_evaluation_without_drives_is_rejected():
    with pytest.raises(ValueError, match="no drives"):
        evaluate([], GOOD)
