"""Standstills: the detector compared with a simple implementation, and with the truth of real drives."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.drives.drive import Drive, Gps, Imu
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.stale_fixes import STALE_MOVING, classify_fixes
from sigmaswarm.drives.standstill import MEANS, detect_standstills, fixes_are_still, is_calm, new_memory
from sigmaswarm.simulation.scenarios import simulate
from support import DRIVES, needs_shared, quickly


class Plain:
    """A detector after the documentation, computed from the first sample on for each sample."""

    def __init__(self, drive: Drive) -> None:
        imu = drive.imu
        self.gps = drive.gps.select(classify_fixes(drive.gps) != STALE_MOVING)
        self.time, self.values = imu.time, np.array([imu.ax, imu.ay, imu.gz])
        self.block = np.floor(imu.time / 0.05)
        self.floor: list[float | None] = [None] * 3
        self.last, self.stop, self.counts_from = -math.inf, np.zeros(2), -math.inf

    def calm(self, k: int) -> bool:
        first = np.searchsorted(self.block, self.block[k] - 20, side="left")
        second = self.values[:, first : k + 1]
        if second.shape[1] < 5 or self.block[first] > self.block[k] - 16:
            return False
        calm, dt = abs(self.values[2, k]) < math.radians(1.5), min(1.0, self.time[k] - self.time[k - 1])
        for c, restless in enumerate(second.std(axis=1)):
            least = self.floor[c]
            if least is None:
                least = restless
            elif restless < least:
                least += (restless - least) * min(1.0, dt / 0.5)
            elif restless < 3.0 * least:
                least *= 1.0 + 0.1 * dt
            self.floor[c] = least
            calm &= restless <= 2.5 * max(least, 1e-6)
        return bool(calm)

    def means(self, k: int) -> np.ndarray:
        """Return the means of ax, ay over 1 s and over 0.25 s."""
        firsts = (np.searchsorted(self.block, self.block[k] - n, side="left") for n in (20, 5))
        return np.concatenate([self.values[:2, first : k + 1].mean(axis=1) for first in firsts])

    def fixes(self, now: float) -> bool:
        seen = (self.gps.time <= now) & (self.gps.time >= now - 3.0)
        t = self.gps.time[seen]
        if len(t) < 3 or t[-1] - t[0] < 1.5 or t[0] - (now - 3.0) > 1.5 * np.diff(t).mean():
            return False
        slopes = [np.polyfit(t - t.mean(), column[seen], 1)[0] for column in (self.gps.x, self.gps.y)]
        return bool(np.hypot(*slopes) < 0.8)

    def stands(self, k: int) -> bool:
        if not self.calm(k) or not self.fixes(self.time[k]):
            return False
        means, since = self.means(k), self.time[k] - self.last
        self.last = self.time[k]
        if since > 3.0:
            before = self.stop if self.last - since >= self.counts_from else np.zeros(2)
            known = min(np.max(np.abs(means[:2] - one)) for one in (np.zeros(2), before)) <= 1.0
            self.counts_from = -math.inf if known else self.last + 1.0
            self.stop = means[:2].copy()
        away = means[2:] - self.stop
        if np.max(np.abs(away)) > 0.12:
            return False
        self.stop = self.stop + min(1.0, since) * away
        return self.last >= self.counts_from


def shaken(drive: Drive, seed: int) -> Drive:
    """Return a drive with jittered sample times and two gaps, one of them within a stop."""
    imu, rng = drive.imu, np.random.default_rng(seed)
    time = imu.time + drive.nominal_interval * rng.uniform(-0.3, 0.3, len(imu))
    gone = ((time > 12.0) & (time < 13.3)) | ((time > 50.9) & (time < 51.15))
    return replace(drive, imu=replace(imu, time=time).select(~gone))


def urban(rate: float) -> Drive:
    return simulate("urban", imu_rate=rate, duration=60.0, seed=4)


@pytest.mark.parametrize("jitter", [False, True], ids=["even", "jitter and gaps"])
@pytest.mark.parametrize(
    "rate", quickly([(10.0,), (50.0,), (100.0,), (200.0,), (1000.0,)], lambda rate: rate == 10)
)
def test_the_detector_follows_its_documentation_at_any_rate(rate: float, jitter: bool):
    drive = shaken(urban(rate), int(rate)) if jitter else urban(rate)
    plain = Plain(drive)
    expected = np.array([plain.stands(k) for k in range(len(drive.imu))])
    found = detect_standstills(drive, classify_fixes(drive.gps))
    assert 0.02 < expected.mean() < 0.6
    # Rounding may decide at a threshold.
    assert np.count_nonzero(found != expected) <= 1e-4 * len(found)


@pytest.mark.parametrize("offset", [0.0, 9.81, 1e4])
def test_the_means_are_accurate(offset: float):
    # Compared with a two-pass computation, also hours after the start of the clock.
    rng = np.random.default_rng(3)
    time = 1.7e9 + np.cumsum(rng.uniform(0.0005, 0.0015, 20_000))
    ax = offset + 0.01 * rng.standard_normal(len(time))
    memory, block = new_memory(), np.floor(time / 0.05)
    for k, t in enumerate(time):
        is_calm(memory, t, ax[k], 0.0, 0.0)
        if k % 997 == 996:
            second = ax[np.searchsorted(block, block[k] - 20) : k + 1]
            quarter = ax[np.searchsorted(block, block[k] - 5) : k + 1]
            scale = 1e-12 * max(1.0, offset)
            assert memory[MEANS, 0] == pytest.approx(second.mean(), abs=scale)
            assert memory[MEANS, 2] == pytest.approx(quarter.mean(), abs=scale)


def test_extreme_times_are_not_calm():
    memory = new_memory()
    for t in (1e308, -1e308, 1e16, math.inf, math.nan):
        assert not is_calm(memory, t, 0.0, 0.0, 0.0)


def stop(ramp: float, slope: float = 0.3) -> Drive:
    """Simulate a car that stands for 15 s, then accelerates with a jerk of ``ramp`` m/s3 to 1 m/s2, with sensor noise.

    ``slope``: part of gravity in ax, m/s2.
    """
    rng, time = np.random.default_rng(0), np.arange(0.0, 25.0, 0.01)
    true = np.clip(ramp * (time - 15.0), 0.0, 1.0)
    way = np.cumsum(np.cumsum(true) * 0.01) * 0.01
    noise = 0.02 * rng.standard_normal((2, len(time)))
    imu = Imu(
        time=time, ax=true + slope + noise[0], ay=-0.2 + noise[1], gz=0.001 * rng.standard_normal(len(time))
    )
    fixes = np.arange(0.1, 25.0, 0.25)
    x = np.interp(fixes, time, way) + 0.3 * rng.standard_normal(len(fixes))
    return Drive("stop", imu, Gps(fixes, x, 0.3 * rng.standard_normal(len(fixes))))


@pytest.mark.parametrize("ramp", [0.2, 0.4, 1.0, 10.0])
def test_a_departure_is_detected_before_the_car_is_fast(ramp: float):
    drive = stop(ramp)
    stands, time = detect_standstills(drive, classify_fixes(drive.gps)), drive.imu.time
    assert stands[(time > 5.0) & (time < 15.0)].mean() > 0.95
    speed = np.cumsum(np.clip(ramp * (time - 15.0), 0.0, 1.0)) * 0.01
    assert speed[stands].max() < 0.3


def test_a_stop_on_a_steep_slope_counts_a_second_later():
    flat, steep = (
        drive.imu.time[np.argmax(detect_standstills(drive, classify_fixes(drive.gps)))]
        for drive in (stop(1.0), stop(1.0, slope=1.2))
    )
    assert steep - flat == pytest.approx(1.0, abs=0.02)


def test_a_steady_departure_after_an_outage_is_not_a_standstill():
    cases = ((4, "white-1m", 95.19), (7, "white-1m", 31.18), (501, "ublox-m8", 16.5))
    for seed, receiver, begin in cases:
        drive, end = simulate("urban", seed=seed, gps=receiver, duration=120.0), begin + 5.0
        left = drive.gps.select((drive.gps.time < begin) | (drive.gps.time > end))
        stands = detect_standstills(replace(drive, gps=left), classify_fixes(left))
        speed = np.interp(drive.imu.time, drive.truth.time, np.hypot(drive.truth.vx, drive.truth.vy))
        assert speed[stands].max() < 0.3


def test_timelines_without_some_fixes_detect_the_same_standstills_as_their_drives():
    ready = PreparedDrive(urban(100.0))
    stop = ready.drive.imu.time[detect_standstills(ready.drive, classify_fixes(ready.drive.gps))][0]
    hidden = (ready.drive.gps.time > stop - 0.5) & (ready.drive.gps.time < stop + 0.3)
    for removed in (False, True):
        line = ready.timeline(hidden, removed=removed)
        assert line.like is ready.timeline()
        np.testing.assert_array_equal(line.stands, detect_standstills(line.drive, line.kinds)[line.sample])
        assert (line.stands.sum() > 0) and line.stands.sum() < ready.timeline().stands.sum()


def test_stale_fixes_of_a_driving_car_are_no_evidence():
    t = np.arange(0.0, 12.0, 0.5)
    fixes = np.column_stack([t, np.minimum(t, 5.0) * 9.0, 0 * t])
    kinds = classify_fixes(Gps(t, fixes[:, 1], fixes[:, 2]))
    assert (kinds[t > 5.0] == STALE_MOVING).all()
    assert not fixes_are_still(fixes, kinds, len(t), 11.9, np.empty(1))
    assert fixes_are_still(fixes, 0 * kinds, len(t), 11.9, np.empty(1))


@needs_shared
@pytest.mark.parametrize("name", ["kitti-09-30-0034", "kitti-09-30-0018", "colorado-1", "kingston-1"])
def test_detected_standstills_are_true_standstills(name: str):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the reader, about gaps
        drive = read_drive(DRIVES / name)
    stands = detect_standstills(drive, classify_fixes(drive.gps))
    assert drive.truth is not None
    speed = np.interp(drive.imu.time, drive.truth.time, np.hypot(drive.truth.vx, drive.truth.vy))
    assert stands.sum() > 90
    assert speed[stands].max() < 0.3
    rest = speed < 0.02
    assert stands[rest].mean() > 0.35
