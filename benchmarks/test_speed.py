"""Compare the speed of sigmaswarm with other programs; `table.py` runs these benchmarks and writes the table.

``extra_info`` of each benchmark contains ``work``, the number of parameter sets times IMU samples (or calls) in a
round, ``ns``, the median time divided by this number, and ``times``, the ratio of the whole job to the measured part.
"""

from dataclasses import replace

import numpy as np
import pytest

import rival_numba
from rival_pyswarms import Course
from rival_pyswarms import tune as tune_with_pyswarms
from sigmaswarm import Gps, clip, initial_state, run_filter, run_textbook, tune
from sigmaswarm.scoring.batch import BatchScorer

PART = 5.0
"""Length (s) of the part of the drive for slow filters."""
GENERATIONS, PARTICLES = 50, 30
PAPERS_FILTER = {"model": "planar5", "objective": "truth-rmse"}

pytestmark = pytest.mark.usefixtures("turn")


@pytest.fixture(scope="session")
def part(drive):
    return Course(drive, PART)


@pytest.fixture(scope="session")
def point(parameter_sets):
    """Return the first parameter set in the form of `rival_pyswarms.py`."""
    p = parameter_sets[0]
    return np.array([p.alpha, p.beta, p.kappa, *np.log10([*p.process_noise, *p.measurement_noise])])


@pytest.fixture(scope="session")
def crowded(drive):
    """Return the drive with a fix at every IMU sample, since kalman-py's filter needs a measurement at every step."""
    # Up to the last fix, since later samples would repeat this fix like a stale fix.
    drive = clip(drive, drive.imu.time[0], drive.gps.time[-1] + 1e-3)
    gps, time = drive.gps, drive.imu.time
    return replace(drive, gps=Gps(time, np.interp(time, gps.time, gps.x), np.interp(time, gps.time, gps.y)))


@pytest.fixture(scope="session")
def replayer(drive, parameter_sets):
    replayer = BatchScorer.prepare([drive])
    replayer.scores(parameter_sets)  # compiles if the cache is empty
    return replayer


@pytest.mark.benchmark(group="filter")
def test_filterpy(measure, drive, part, point, parameter_sets):
    # Both filters do the same work if their errors are nearly equal; their sigma points differ slightly.
    ours = run_filter(drive, parameter_sets[0]).mean[: part.n_samples, :2]
    assert part.rmse(point) == pytest.approx(
        np.sqrt(np.mean(np.sum((ours - part.truth) ** 2, axis=1))), rel=1e-3
    )
    measure(lambda: part.rmse(point), work=part.n_samples, rounds=3)


@pytest.mark.benchmark(group="filter")
def test_textbook(measure, drive, part, parameter_sets):
    short = clip(drive, drive.imu.time[0], part.initial.time + PART)
    initial = initial_state(short)
    samples = int((short.imu.time > initial.time).sum())
    measure(
        lambda: run_textbook(short, parameter_sets[0], initial=initial),
        work=samples,
        rounds=3,
    )


@pytest.mark.benchmark(group="filter")
def test_numba(measure, drive, part, parameter_sets):
    whole = Course(drive)
    rival_numba.check(drive, part, parameter_sets[0], PART)
    measure(lambda: rival_numba.means(whole, parameter_sets[0]), work=whole.n_samples, rounds=3)


@pytest.mark.benchmark(group="filter")
def test_gtsam(measure, drive):
    rival_gtsam = pytest.importorskip("rival_gtsam")
    initial = initial_state(drive)
    short = clip(drive, drive.imu.time[0], initial.time + 6 * PART)
    samples = int((short.imu.time > initial.time).sum())
    found = rival_gtsam.run(short, initial, rival_gtsam.Noise(fix=2.0))
    truth = np.interp(found.time, drive.truth.time, drive.truth.x)
    assert np.sqrt(np.mean((found.x - truth) ** 2)) < 5.0  # the receiver's errors are 2.1 m
    measure(lambda: rival_gtsam.run(short, initial, rival_gtsam.Noise(fix=2.0)), work=samples, rounds=1)


@pytest.mark.benchmark(group="fix at every sample")
def test_kalman_py(measure, crowded, parameter_sets):
    rival_kalman_py = pytest.importorskip("rival_kalman_py")
    rival = rival_kalman_py.Rival(crowded, parameter_sets[0], initial_state(crowded))
    rival_kalman_py.check(rival, crowded, parameter_sets[0], initial_state(crowded))
    measure(rival.means, work=len(rival.steps), rounds=3)


@pytest.mark.benchmark(group="fix at every sample")
def test_batch_crowded(measure, crowded, parameter_sets):
    replayer = BatchScorer.prepare([crowded])
    samples = int((crowded.imu.time > replayer.initial[0].time).sum())
    measure(lambda: replayer.scores(parameter_sets), work=len(parameter_sets) * samples, rounds=5)


@pytest.mark.benchmark(group="filter")
def test_batch(measure, drive, replayer, parameter_sets):
    samples = int((drive.imu.time > replayer.initial[0].time).sum())
    assert not replayer.scores(parameter_sets).failed.any()
    measure(lambda: replayer.scores(parameter_sets), work=len(parameter_sets) * samples, rounds=10)


@pytest.mark.benchmark(group="tuning")
def test_tuning_pyswarms_filterpy(measure, part):
    """Measure one generation over a part of the drive; ``times`` extrapolates to the whole job."""
    measure(
        lambda: tune_with_pyswarms(part, particles=PARTICLES, generations=1),
        work=PARTICLES * part.n_samples,
        rounds=1,
        times=GENERATIONS / part.share,
    )


@pytest.mark.benchmark(group="tuning")
def test_tuning_sigmaswarm(measure, drive, replayer):
    """Measure the whole job: alignment, timeline, 30 x 50 filters over ten minutes, and the optimizer."""
    samples = int((drive.imu.time > replayer.initial[0].time).sum())
    measure(
        lambda: tune(drive, **PAPERS_FILTER, optimizer="pso", particles=PARTICLES, generations=GENERATIONS),
        work=GENERATIONS * PARTICLES * samples,
        rounds=2,
    )
