"""A run in pieces gives the bits of the whole run, and sums that agree with the recorded estimates."""

import tracemalloc
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from filter_cases import KINDS, OPTIONS, equipped, parameters, two_receivers
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets, run_passes
from sigmaswarm.filters.run import run_filter, run_innovations
from sigmaswarm.scoring.targets import forecast_pass, tracking_pass
from support import make_drive, quickly, timeline_of

EVERY_FILTER = [
    pytest.param(model, kind, option, id=f"{model}-{kind}-{option}")
    for model in ("planar5", "planar8")
    for kind in KINDS
    for option in OPTIONS
]
EVERY_FILTER += [pytest.param("tilted12", kind, "all", id=f"tilted12-{kind}-all") for kind in ("ekf", "ukf")]


forecasts = partial(forecast_pass, seed=0)


@cache
def pass_of(make, of=tracking_pass) -> FilterPass:
    return of(prepare_drive(make()))


def as_bits(recording: FilterRun) -> dict[str, bytes]:
    whole = recording.whole()
    parts = (
        vars(whole) | vars(recording.sums) | {f"fix {k}": v for k, v in vars(recording.innovations).items()}
    )
    return {name: np.ascontiguousarray(column).tobytes() for name, column in parts.items()}


@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(
        (case.values for case in EVERY_FILTER),
        lambda model, kind, option: (
            option == "all" and (model, kind) in (("planar5", "ukf"), ("planar8", "ekf"))
        ),
    ),
)
def test_pieces_of_any_length_give_the_bits_of_the_whole_run(model: str, kind: str, option: str):
    p = parameters(model, kind=kind, **OPTIONS[option])
    for drive_pass, lengths in (
        (pass_of(equipped), (1, -1)),
        (pass_of(two_receivers), (7,)),
        (pass_of(equipped, forecasts), (1000,)),
    ):
        n = len(drive_pass.timeline.imu_time)
        whole = as_bits(FilterRun(drive_pass, p, samples=n))
        for samples in (length % n for length in lengths):
            in_pieces = as_bits(FilterRun(drive_pass, p, samples=samples))
            assert [name for name in whole if whole[name] != in_pieces[name]] == [], samples
        sums = run_passes([drive_pass], [p])
        assert all(np.asarray(column).tobytes() == whole[name] for name, column in vars(sums).items())


@pytest.mark.parametrize("option", OPTIONS)
def test_run_filter_and_run_innovations_join_the_pieces(option: str):
    p, drive = parameters("planar8", **OPTIONS[option]), equipped()
    recording = FilterRun(pass_of(equipped), p, samples=300)
    whole, estimate, said = recording.whole(), run_filter(drive, p), run_innovations(drive, p)
    assert recording.failure is None
    for name in ("time", "mean", "covariance"):
        assert getattr(whole, name).tobytes() == getattr(estimate, name).tobytes()
    for name, column in vars(recording.innovations).items():
        assert column.tobytes() == getattr(said, name).tobytes()


@pytest.mark.parametrize("samples", [1, 7, 100_000])
def test_after_a_failure_all_pieces_are_marked_as_failed(samples: int):
    drive = make_drive(duration=24, seed=2)
    ax = drive.imu.ax.copy()
    ax[2000] = np.nan
    ill = replace(drive, imu=replace(drive.imu, ax=ax))
    start = initial_state(drive)
    line = timeline_of(ill, start.time)
    recording = FilterRun(FilterPass(line, start, Targets.none(line)), parameters("planar5"), samples=samples)
    whole = recording.whole()
    sound = line.imu_time < drive.imu.time[2000]
    assert whole.sound.tolist() == sound.tolist()
    assert np.isfinite(whole.mean).all(axis=1).tolist() == sound.tolist()
    assert np.isfinite(whole.covariance).all(axis=(1, 2)).tolist() == sound.tolist()
    assert f"failed at t = {drive.imu.time[2000]:.3f} s" in str(recording.failure)
    assert recording.sums.failed.all()


def test_sums_of_an_unfinished_recording_are_refused():
    recording = FilterRun(pass_of(equipped), parameters("planar5"), samples=100)
    next(iter(recording))
    with pytest.raises(RuntimeError, match="all pieces"):
        _ = recording.sums
    with pytest.raises(RuntimeError, match="all pieces"):
        _ = recording.innovations


def peak_of_pieces(drive: Drive) -> int:
    """Return the bytes that a recording allocates in addition to its pass."""
    start = initial_state(drive)
    line = timeline_of(drive, start.time)
    drive_pass, p = FilterPass(line, start, Targets.none(line)), parameters("planar8")
    drive_pass.arrays(frozenset())
    for _ in FilterRun(drive_pass, p, samples=500):  # compile, and fill the caches
        pass
    tracemalloc.start()
    for _ in FilterRun(drive_pass, p, samples=500):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_memory_does_not_grow_with_the_drive():
    short, long = (peak_of_pieces(make_drive(duration=duration, gps_rate=1.0)) for duration in (60, 600))
    # Innovations need 40 bytes per fix and the ends of pieces 8 bytes per sample: 72 and 430 kB; estimates need 35 MB.
    assert long < short + 2e6


# --- Recorded values and sums ----------------------------------------------------------------------------------


def residuals(nu: np.ndarray, s: np.ndarray, p: FilterParameters) -> np.ndarray:
    """Return R S^-1 nu of each absorbed fix and nu of each rejected fix, for constant R and S without scaling."""
    left = np.array(
        [np.diag(p.measurement_noise) @ np.linalg.solve(v, n) for n, v in zip(nu, s, strict=True)]
    )
    nis = np.array([n @ np.linalg.solve(v, n) for n, v in zip(nu, s, strict=True)])
    rejected = 0
    for i in range(len(nu)):
        taken = p.gate is None or nis[i] <= p.gate or rejected >= 5
        rejected = 0 if taken else rejected + 1
        left[i] = left[i] if taken else nu[i]
    return left


@pytest.mark.parametrize(("model", "kind", "option"), EVERY_FILTER)
@pytest.mark.parametrize("of", [tracking_pass, forecasts], ids=["tracking", "forecast"])
def test_recorded_values_add_up_to_the_sums(model: str, kind: str, option: str, of):
    p, drive_pass = parameters(model, kind=kind, **OPTIONS[option]), pass_of(equipped, of)
    recording = FilterRun(drive_pass, p, samples=100)
    whole, line, targets = recording.whole(), drive_pass.timeline, drive_pass.targets
    said = recording.innovations
    nu, s = said.innovation, said.covariance
    hidden = line.hides[line.hides | line.updates]
    added = {
        "NIS": said.nis.sum(),
        "LOG_DET": np.log(np.linalg.det(s)).sum(),
        "SQ_FORECAST": (nu[hidden] ** 2).sum(),
    }
    if kind in ("ukf", "ekf"):
        added["SQ_FIX"] = (residuals(nu[~hidden], s[~hidden], p) ** 2).sum()
    if of is tracking_pass:
        weight, x, y, theta, counts, _ = targets.columns
        later = np.searchsorted(targets.end[line.sampled], np.arange(len(weight)), side="right")
        times = np.concatenate([[line.start], whole.time])
        means = np.vstack([drive_pass.initial.mean[:5], whole.mean[:, :5]])
        at = times[later] + weight * np.diff(times)[later]
        east, north = (np.interp(at, times, means[:, i]) for i in (0, 1))
        turn = np.interp(at, times, np.unwrap(means[:, 4])) - theta
        error = np.stack([east - x, north - y], axis=1)
        p2 = whole.covariance[later, :2, :2]
        added["SQ_POSITION"] = (error**2).sum()
        added["SQ_HEADING"] = (counts * np.angle(np.exp(1j * turn)) ** 2).sum()
        added["NEES"] = np.einsum("ti,tij,tj->", error, np.linalg.inv(p2), error)
    for name, total in added.items():
        assert total == pytest.approx(recording.sums[name][0, 0], rel=1e-9, abs=1e-12), name
