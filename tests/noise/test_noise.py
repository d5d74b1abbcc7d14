"""The measured noise equals the planted noise, and noise that a log does not show is reported."""

import math
from dataclasses import replace

import allantools
import numpy as np
import pytest
from scipy.signal import lfilter

from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.drives.tables import Imu
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import MODEL_NOISE, baseline
from sigmaswarm.noise import allan_deviation, filter_noise, imu_noise
from sigmaswarm.noise.spectrum import FLICKER, MARKOV_PEAK, NoiseFit, fit, model_parts, spectrum_of
from sigmaswarm.noise.static import find_stretches, step_of
from static_logs import AXES, GRADES, planted, static_log
from support import DRIVES, make_drive, needs_shared, quickly


@pytest.mark.parametrize(("count", "offset"), [(500, 0.0), (4_001, 9.81), (70_000, -200.0)])
def test_the_deviation_is_that_of_allantools(count, offset):
    rng = np.random.default_rng(count)
    values = offset + rng.standard_normal(count) + 0.02 * np.cumsum(rng.standard_normal(count))
    tau, deviation = allan_deviation([values], 0.04)
    known, expected, _, _ = allantools.oadev(values, rate=25.0, data_type="freq", taus=tau)
    np.testing.assert_allclose(known, tau, rtol=1e-12)
    np.testing.assert_allclose(deviation, expected, rtol=1e-9)
    assert len(tau) > 10


def test_stretches_are_pooled_by_their_differences():
    rng = np.random.default_rng(3)
    parts = [5.0 + rng.standard_normal(900), -3.0 + 2 * rng.standard_normal(400)]
    tau, deviation = allan_deviation(parts, 0.1)
    one = [allantools.oadev(p, rate=10.0, data_type="freq", taus=tau[:10]) for p in parts]
    counts = [np.array([len(p) + 1 - 2 * round(t / 0.1) for t in tau[:10]]) for p in parts]
    pooled = sum(n * found[1] ** 2 for n, found in zip(counts, one, strict=True)) / sum(counts)
    np.testing.assert_allclose(deviation[:10], np.sqrt(pooled), rtol=1e-9)


def test_the_model_s_deviation_is_the_integral_of_its_spectrum():
    f = np.geomspace(1e-7, 1e3, 100_000)
    for tau in (0.5, 40.0, 900.0):
        window = 4 * np.sin(np.pi * f * tau) ** 4 / (np.pi * f * tau) ** 2
        for time in (30.0, math.inf):
            parts = model_parts(np.array([tau]), 0.3, 0.02, 0.004, time)
            shapes = 0.3**2 + 0 * f, 0.02**2 / (2 * np.pi * f), 0.004**2 / ((2 * np.pi * f) ** 2 + time**-2)
            for part, density in zip(parts, shapes, strict=True):
                assert part[0] ** 2 == pytest.approx(np.trapezoid(window * density, f), rel=0.01)
    peak = max(model_parts(np.geomspace(10, 1000, 999), 0, 0, math.sqrt(2 / 100), 100.0)[2])
    assert peak**2 == pytest.approx(MARKOV_PEAK, rel=1e-3)
    assert model_parts(np.ones(1), 0, 1.0, 0, math.inf)[1][0] ** 2 == pytest.approx(FLICKER)


def fitted(log: Imu, axis: str) -> NoiseFit:
    interval = float(log.time[1] - log.time[0])
    return fit(spectrum_of([getattr(log, axis)], interval), len(log) * interval)


@pytest.mark.parametrize(
    ("grade", "axis"),
    quickly(
        ((grade, axis) for grade in GRADES for axis in ("ax", "gz")),
        lambda grade, axis: (grade, axis) in {("mpu-6050", "ax"), ("adis16488", "ax"), ("adis16405", "gz")},
    ),
)
def test_a_quarter_of_an_hour_shows_what_was_planted(grade, axis):
    found, known = fitted(static_log(grade, 900.0, 0.02), axis), planted(grade, axis, 0.02)
    assert found.white.value == pytest.approx(known.white, rel=0.05)
    assert found.white.low <= known.white <= found.white.high
    assert found.walk.low <= known.walk <= found.walk.high
    assert found.instability.low == 0


@pytest.mark.long
@pytest.mark.parametrize("grade", GRADES)
def test_twenty_hours_show_what_was_planted(grade):
    inside = []
    for seed in range(20):
        log = static_log(grade, 3600.0, seed=seed)
        for axis in ("ax", "gz"):
            found, known = fitted(log, axis), planted(grade, axis)
            assert found.white.value == pytest.approx(known.white, rel=0.05)
            inside += [found.white.low <= known.white <= found.white.high]
            inside += [found.walk.low <= known.walk <= found.walk.high, found.instability.low == 0]
    assert np.mean(inside) >= 0.93


def flicker(rng: np.random.Generator, count: int) -> np.ndarray:
    """Flicker noise of coefficient 1 (Kasdin 1995): white noise, summed by half."""
    steps = np.arange(1, 2 * count)
    response = np.concatenate([[1.0], np.cumprod((steps - 0.5) / steps)])
    size = 4 * count
    white = np.fft.rfft(rng.standard_normal(2 * count), size)
    return np.fft.irfft(white * np.fft.rfft(response, size), size)[count : 2 * count]


def mixed(white: float, instability: float, walk: float, time: float, seed: int) -> NoiseFit:
    """What is found of an hour at 10 Hz."""
    rng, count, interval = np.random.default_rng(seed), 36_000, 0.1
    values = white / math.sqrt(interval) * rng.standard_normal(count) + instability * flicker(rng, count)
    shocks = walk * math.sqrt(interval) * rng.standard_normal(count)
    values += lfilter([1.0], [1.0, -math.exp(-interval / time)], shocks)
    return fit(spectrum_of([values], interval), count * interval)


MIXTURES = {
    "white": (3e-3, 0.0, 0.0, math.inf),
    "flicker": (3e-3, 1e-3, 0.0, math.inf),
    "walk": (3e-3, 0.0, 1e-4, math.inf),
    "all": (3e-3, 1e-3, 1e-4, math.inf),
    "returns": (3e-3, 0.0, 3e-4, 100.0),
}


def covered(name: str, seeds: range) -> np.ndarray:
    """Which intervals contain the planted white noise, instability and walk, shape (seeds, 3)."""
    known = MIXTURES[name]
    found = [mixed(*known, seed) for seed in seeds]
    intervals = [(f.white, f.instability, f.walk) for f in found]
    return np.array([[i.low <= k <= i.high for i, k in zip(f, known, strict=False)] for f in intervals])


@pytest.mark.parametrize("name", ["flicker", "returns"])
def test_intervals_contain_what_was_planted(name):
    assert covered(name, range(2)).sum() >= 5


@pytest.mark.long
@pytest.mark.parametrize("name", MIXTURES)
def test_intervals_of_95_percent_cover(name):
    assert covered(name, range(100)).mean(0).min() >= 0.90


def test_what_a_log_shows_has_an_interval_above_zero():
    found = mixed(1e-3, 0.0, 1e-3, math.inf, 0)
    assert 0.5e-3 < found.walk.low < 1e-3 < found.walk.high < 2e-3
    assert math.isinf(found.time)
    assert found.white.high / found.white.low < 1.1  # 3600 frequencies


def test_a_drive_uses_its_standstills_and_says_what_they_show():
    drive = stop_and_go()
    noise = imu_noise(drive)
    assert [start for start, _ in noise.stretches] == pytest.approx([1.0, 61.0], abs=2.0)
    assert all(15 <= length <= 20 for _, length in noise.stretches)
    gz = next(a for a in noise.axes if a.axis == "gz")
    assert gz.white.low <= 1e-4 <= gz.white.high
    assert gz.walk.low == 0
    said = " ".join(noise.remarks)
    assert "2 standstills" in said
    assert "use the upper ends" in said


def stop_and_go(turning: float = 0.3) -> Drive:
    """Stands for 20 s, drives for 40 s, stands for 20 s."""
    log, rng = static_log("adis16488", 80.0), np.random.default_rng(0)
    log = replace(log, az=None, gx=None, gy=None)
    t = log.time
    driving = (t >= 20) & (t < 60)
    ax = log.ax + driving * np.sin(2 * np.pi * t / 10) * 2
    gz = 1e-3 * rng.standard_normal(len(t)) + driving * turning
    time = t[::20]
    x = np.interp(time, [20, 60], [0, 400])
    gps = Gps(time, x + 0.5 * rng.standard_normal(len(x)), 0.5 * rng.standard_normal(len(x)))
    return Drive("stop-and-go", replace(log, ax=ax, gz=gz), gps)


def test_fixes_that_move_are_no_standstill():
    """A smooth cruise is as calm as a standstill."""
    log = static_log("adis16488", 60.0)
    gps = Gps(log.time[::100], 20 * log.time[::100], 0 * log.time[::100])
    with pytest.raises(InputError, match="moves"):
        find_stretches(log, gps)
    assert find_stretches(log).parts == (slice(0, len(log)),)


def test_each_fault_of_a_log_gets_a_remark():
    log = static_log("mpu-6050", 60.0)
    faulty = replace(
        log,
        ax=np.round(log.ax / 0.06) * 0.06,
        ay=0 * log.ay,
        az=np.minimum(log.az, np.median(log.az)) / 9.80665,
        gx=np.where(log.gx > np.mean(log.gx), 0.05, 0.0),
        gy=log.gy + 0.02 * np.sin(2 * np.pi * 21 * log.time),
    )
    noise = imu_noise(faulty)
    assert [a.axis for a in noise.axes] == ["ax", "gy", "gz"]
    for expected in (
        "the accelerometer measures ",
        "ax is quantized in steps of 0.06",
        "ay left out, constant at 0",
        "az left out, saturated: ",
        "gx left out, quantized in steps of 0.05",
        "the model does not fit the Allan deviation (gy: ",
    ):
        assert [remark for remark in noise.remarks if remark.startswith(expected)], (expected, noise.remarks)
    assert not [remark for remark in noise.remarks if "gz" in remark]


@pytest.mark.parametrize("grade", ["mpu-6050", "adis16405"])
def test_a_day_at_rest_is_one_stretch(grade):
    log = static_log(grade, 86_400.0, 0.2)
    (part,) = find_stretches(log).parts
    assert len(log) - 20 <= part.stop - part.start


def test_a_gyro_in_degrees_gets_a_remark():
    log = replace(static_log("mpu-6050", 60.0, 0.05), az=None, gx=None, gy=None)
    assert not [r for r in imu_noise(log).remarks if "unit" in r]
    degrees = replace(log, gz=np.degrees(log.gz - np.mean(log.gz)))
    assert [
        r
        for r in imu_noise(degrees).remarks
        if r.startswith("the noise of gz is as large as that of a gyro in deg/s")
    ]


def test_gaps_part_a_log():
    log = static_log("mpu-6050", 90.0)
    kept = (log.time < 30) | (log.time > 47)
    noise = imu_noise(replace(log.select(kept), az=None, gx=None, gy=None))
    assert [start for start, _ in noise.stretches] == pytest.approx([0.0, 47.0], abs=0.02)
    assert "1 gap in the log" in noise.remarks[0]


def test_a_drift_is_named_and_the_walk_of_a_bias_is_not():
    log = static_log("adis16488", 1200.0, 0.05)
    plain = replace(log, ax=log.ay, az=None, gx=None, gy=None)
    assert not [r for r in imu_noise(plain).remarks if "drifts" in r]
    warm = replace(plain, gz=plain.gz + np.radians(240 / 3600) * plain.time / 3600)
    noise = imu_noise(warm)
    gz = next(a for a in noise.axes if a.axis == "gz")
    assert gz.drift * 3600**2 == pytest.approx(np.radians(240), rel=0.3)
    assert [r for r in noise.remarks if r.startswith("gz drifts by ") and "warm-up" in r]


ERRORS = {
    "short": (lambda log: log.select(slice(0, 700)), "is 6.99 s long"),
    "few": (lambda log: log.select(slice(0, 20)), "the log has 20 samples, or its times do not increase"),
    "moves": (lambda log: replace(log, gz=0.5 * np.sin(log.time)), "moves, and there is no standstill"),
    "dead": (
        lambda log: Imu(log.time, 0 * log.ax, 0 * log.ax, 0 * log.ax),
        "the noise can't be measured on any axis",
    ),
    "nan": (
        lambda log: replace(log, ay=np.where(log.time < 1, np.nan, log.ay)),
        "ay has values that are not finite numbers",
    ),
    "backwards": (lambda log: replace(log, time=log.time[::-1]), "increasing"),
}


@pytest.mark.parametrize("case", ERRORS)
def test_a_log_without_noise_is_refused(case):
    change, expected = ERRORS[case]
    with pytest.raises(InputError, match=expected):
        imu_noise(change(static_log("mpu-6050", 60.0)))


def test_settings_of_an_import_are_for_logs_of_other_formats(tmp_path):
    write_drive(make_drive(duration=20.0), tmp_path / "drive")
    with pytest.raises(InputError, match="omit the import settings"):
        imu_noise(tmp_path / "drive", time="stamp")
    with pytest.raises(InputError, match="the import has no setting 'tim'"):
        imu_noise(tmp_path, tim="stamp")


def test_step_of_finds_steps_and_none_in_floats():
    rng = np.random.default_rng(0)
    assert step_of(np.round(rng.standard_normal(5000) / 0.25) * 0.25) == pytest.approx(0.25)
    assert step_of(rng.standard_normal(5000)) == 0
    assert step_of(np.zeros(100)) == 0


TUNED = FilterParameters(
    0.1,
    2.0,
    0.0,
    (1e-6, 1e-6, 4e-6, 6e-6, 1e-8, 1e-9, 2e-9, 3e-12),
    (1.0, 1.0),
    "planar8",
    nominal_interval=0.01,
)


def test_a_tuned_q_per_second():
    noise = filter_noise(TUNED)
    found = {a.axis: (a.white.value, a.walk.value) for a in noise.axes}
    assert found["ax"] == pytest.approx((math.sqrt(5e-6 / 0.01), math.sqrt(1e-9 / 0.01)))
    assert found["ay"] == pytest.approx((math.sqrt(5e-6 / 0.01), math.sqrt(2e-9 / 0.01)))
    assert found["gz"] == pytest.approx((1e-3, math.sqrt(3e-12 / 0.01)))
    assert "errors of the filter's model" in noise.remarks[0]
    robot = FilterParameters(
        0.1, 2.0, 0.0, (1e-4,) * 8, (1.0, 1.0), "robot-localization", nominal_interval=0.01, kind="ekf",
        imu_noise=(4e-4, 9e-2),
    )  # fmt: skip
    rate = 1 / 0.01
    assert {a.axis: rate * a.white.value**2 for a in filter_noise(robot).axes} == pytest.approx(
        {"ax": 9e-2, "ay": 9e-2, "gz": 4e-4}
    )
    with pytest.raises(InputError, match="nominal_interval"):
        filter_noise(replace(TUNED, nominal_interval=None))


def test_a_baseline_s_q_is_the_stated_noise():
    """What drive.toml states comes back from the Q of the filter that starts from it, with the noise of the model."""
    stated = {
        "accel_noise_density": 3e-3,
        "gyro_noise_density": 2e-4,
        "accel_bias_walk": 5e-5,
        "gyro_bias_walk": 7e-6,
    }
    drive = replace(make_drive(duration=20.0), metadata=stated)
    found = {a.axis: (a.white.value, a.walk.value) for a in filter_noise(baseline(drive, TUNED)).axes}
    accel, gyro = np.hypot(3e-3, MODEL_NOISE["accel"]), np.hypot(2e-4, MODEL_NOISE["gyro"])
    assert found["ax"] == found["ay"] == pytest.approx((accel, 5e-5))
    assert found["gz"] == pytest.approx((gyro, 7e-6))


@needs_shared
def test_standstills_of_a_real_drive_stand():
    noise = imu_noise(DRIVES / "colorado-1")
    (start, length), *others = noise.stretches
    assert not others
    assert start >= 3.5
    assert start + length <= 37.8
    assert [a.axis for a in noise.axes] == list(AXES)
