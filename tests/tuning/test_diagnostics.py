"""Warnings about a filter that diverges or drifts on its training drives."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sigmaswarm import Drive, SigmaswarmError, evaluate, read_drive, run_filter, simulate, split_time, tune
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.fixes_alone import MotionNoise, fitted_noise
from sigmaswarm.filters.presets import baseline
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.diagnostics import (
    RECHECK_RATIO,
    DriftComparison,
    divergence_warnings,
    drift_table,
    drift_warnings,
    drifts_of,
    larger_drifts,
)
from sigmaswarm.tuning.problem import car_problem
from support import DRIVES, needs_shared

CONFIG = TuneConfig(model="planar8", kind="ekf", use=("lateral", "gate"), objective="innovation-t")


@cache
def town() -> Drive:
    return simulate("urban", run=1, gps="white-1m", duration=150, imu_rate=50.0)


def test_divergence_on_a_training_drive_causes_a_warning():
    gps = town().gps
    off = (gps.time >= 60) & (gps.time < 100)
    aside = replace(town(), name="aside", gps=replace(gps, x=gps.x + 120.0 * off, y=gps.y + 160.0 * off))
    problem = car_problem([town(), aside], CONFIG)
    rng, seen = np.random.default_rng(0), list[bool]()
    space = problem.space
    for point in space.low + rng.random((12, len(space.low))) * (space.high - space.low):
        p = problem.parameters(point)
        try:
            lost = {drive.name: run_filter(drive, p).restarts for drive in (town(), aside)}
        except SigmaswarmError:
            continue
        said = [warning for warning in problem.warnings(point) if "the tuned filter diverged" in warning]
        assert bool(said) == any(lost.values())
        assert all(
            (f"diverged on {name} and" in said[0]) == bool(times) for name, times in lost.items() if said
        )
        seen.append(bool(said))
        if len(seen) >= 3 and set(seen) == {True, False}:
            break
    assert set(seen) == {True, False}


@pytest.mark.long
def test_a_larger_drift_than_the_baseline_causes_a_warning():
    good = tune([town()], model="planar8", kind="ekf", objective="innovation-t", particles=16, generations=12)
    assert not [doubt for doubt in good.warnings if "DO NOT" in doubt]
    found = [drifts_of(PreparedDrive(town()), good.parameters)]
    assert drift_warnings(found) == []
    q = list(good.parameters.process_noise)
    q[4] = 1e-2  # a filter that does not use the gyro; fixes are still predicted
    bad = replace(good.parameters, process_noise=tuple(q), lateral_noise=None, standstill_noise=None)
    (tuned, other) = drifts_of(PreparedDrive(town()), bad)
    assert tuned > found[0][0]
    (said,) = drift_warnings([(100.0, 20.0), (np.nan, np.nan)])
    assert said.startswith("TO DO: DO NOT USE THIS FILTER; ")
    assert (
        "or on more drives. Reason: in outages of 30 s on its training drives, the tuned filter drifts 100 m"
        in said
    )
    assert drift_warnings([(29.0, 20.0)]) == drift_warnings([]) == []
    assert (
        drift_warnings([(20.0, 20.0), (np.nan, np.nan)], RECHECK_RATIO)
        == drift_warnings([], RECHECK_RATIO)
        == []
    )
    assert drift_warnings([(25.0, 20.0)], RECHECK_RATIO)
    assert np.isfinite(drifts_of(PreparedDrive(town()), bad, most=2)).all()
    assert [each.length_s for each in good.forecasts] == [1.0, 5.0, 30.0]
    assert good.fixes_alone == MotionNoise.typical([fitted_noise(PreparedDrive(town()))])
    short = good.forecasts[1]
    measured = drifts_of(PreparedDrive(town()), good.parameters, length=5.0, noise=good.fixes_alone)
    assert (short.tuned_m, short.baseline_m, short.fixes_alone_m) == pytest.approx(measured)
    (lower,) = larger_drifts([replace(short, baseline_m=np.inf, fixes_alone_m=0.9 * short.tuned_m)])
    assert lower.startswith(
        "the tuned filter drifts MORE than the filter that uses only the fixes in outages of 5 s"
    )
    assert not larger_drifts([replace(short, baseline_m=np.inf, fixes_alone_m=1.01 * short.tuned_m)])
    assert (
        "RMS position drift at the end of an outage (a time without fixes), on the training drives:\n"
        f"{drift_table(good.forecasts).to_text()}\n" in repr(good)
    )
    same = evaluate([town()], good)
    assert measured[:2] == pytest.approx([same.mean(m, "outage_drift_m") for m in ("tuned", "untuned")])
    whole = evaluate([town()], bad)
    assert (tuned, other) == pytest.approx(
        [whole.mean(m, "long_outage_drift_m") for m in ("tuned", "untuned")]
    )


def test_a_standing_car_has_no_drift():
    imu, gps = town().imu, town().gps
    still = replace(
        town(),
        imu=replace(imu, ax=0.0 * imu.ax, ay=0.0 * imu.ay, gz=0.0 * imu.gz),
        gps=replace(gps, x=0.0 * gps.x, y=0.0 * gps.y),
    )
    assert np.isnan(drifts_of(PreparedDrive(still), baseline(town()))).all()


@pytest.mark.long
@needs_shared
def test_a_search_that_ended_too_early_causes_a_warning():
    first = split_time(read_drive(DRIVES / "dresden"), 0.7)[0]
    early = tune([first], objective="innovation-t", model="planar8", particles=10, generations=2, seed=2)
    assert [r for r in early.remarks if "DO NOT USE THIS FILTER" in r and "over 30 s without fixes" in r]
    whole = tune([first], objective="innovation-t", model="planar8", seed=0)
    assert not [r for r in whole.remarks if "DO NOT" in r]


def test_the_warning_names_three_drives_and_counts_the_others():
    assert divergence_warnings([("one", []), ("two", [])]) == []
    (said,) = divergence_warnings(
        [(f"drive-{i}", [10.25, 31.0][: i % 2 + 1]) for i in range(5)] + [("sound", [])]
    )
    assert "diverged on drive-0 and was reset once, at t = 10.2 s" in said
    assert "it diverged on drive-1 and was reset 2 times, at t = 10.2, 31.0 s" in said
    assert "drive-3" not in said
    assert "it also diverged on 2 more drives" in said
    assert "sound" not in said


@pytest.mark.parametrize(
    ("tuned", "baseline", "worse"),
    [(2.1, 1.8, True), (1.8, 2.1, False), (2.1001, 2.1, False), (2.1, np.nan, False)],
)
def test_larger_drifts_than_those_of_the_baseline_are_reported_in_one_line(
    tuned: float, baseline: float, worse: bool
):
    others = DriftComparison(1.0, 0.3, 0.5, 0.5), DriftComparison(30.0, 80.0, 79.0, 90.0)
    said = larger_drifts([others[0], DriftComparison(5.0, tuned, baseline, 4.0), others[1]])
    each = "5 s (2.1 m instead of 1.8 m), " if worse else ""
    line = f"the tuned filter drifts MORE than the baseline in outages of {each}30 s (80 m instead of 79 m)"
    assert said == [line]
    assert larger_drifts([others[0]]) == []


def test_the_drifts_are_in_a_table_of_methods_and_lengths():
    table = drift_table([DriftComparison(5.0, 1.0, 2.0, 9.0), DriftComparison(30.0, 7.13, 6.36, 59.4)])
    assert [row.split()[-2:] for row in table.to_text().splitlines()[1:]] == [
        ["1", "7.13"],
        ["2", "6.36"],
        ["9", "59.4"],
    ]
    assert drift_table([], [700.0] * 4).caption.endswith(
        "first 3 training drives, 600 s in the middle of each"
    )
