"""Consistency: on data drawn from the model of a filter, its errors agree with its covariance.

The start is drawn from the initial covariance; noise with covariance Q is added in each step, and with R to each fix.
Then the normalized estimation error squared (NEES) of n states is chi-square with n degrees of freedom, and the
normalized innovation squared (NIS) with two. Runs and innovations are independent. The standard deviation of the
headings is a few hundredths of a radian, so that rotations are nearly linear.

Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation, Wiley 2001,
section 5.4.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive, Gps, Imu
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters import tilted
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets
from sigmaswarm.geodesy import wrap_angle
from support import quickly, timeline_of

EARLY = 12  # IMU samples after the start, where the initial covariance still has an effect
STATES = {"planar5": 5, "planar8": 8, "tilted12": 12}


def band(freedom: int) -> np.ndarray:
    """Return the 95% interval of a chi-square variable divided by its expectation, ``freedom``."""
    return chi2.ppf([0.025, 0.975], freedom) / freedom


def chance_to_see(off: float, freedom: int) -> float:
    """Return the probability that squared errors that are ``off`` times too large are outside the interval."""
    low, high = band(freedom) / off
    return float(chi2.cdf(low * freedom, freedom) + chi2.sf(high * freedom, freedom))


@cache
def runs_needed(n: int) -> int:
    """Return the number of runs that shows a covariance error of 10%, up or down, with a probability of 95%."""
    return next(k for k in range(100, 5000) if min(chance_to_see(x, k * n) for x in (1.1, 1 / 1.1)) > 0.95)


def model_parameters(model: str, kind: str) -> FilterParameters:
    q = (1e-3, 2e-3, 4e-3, 3e-3, 1e-5, 1e-5, 2e-5, 1e-8, 2e-6, 2e-6, 1e-8, 1e-8)
    return FilterParameters(0.5, 2.0, 0.0, q[: STATES[model]], (0.5, 0.8), model, kind=kind)


def start(n: int) -> InitialState:
    """Return an initial state with a covariance that is not diagonal."""
    rng = np.random.default_rng(5)
    mix = np.eye(n) + 0.2 * rng.standard_normal((n, n))
    covariance = mix @ mix.T
    std = np.array([1.0, 1.5, 0.6, 0.5, 0.02, 0.1, 0.15, 0.003, 0.015, 0.01, 0.003, 0.004])[:n]
    std /= np.sqrt(np.diagonal(covariance))
    mean = np.array([10.0, -20.0, 8.0, 3.0, 3.1, 0.1, -0.1, 0.002, 0.05, -0.03, 0.001, -0.002])[:n]
    return InitialState(mean=mean, covariance=std[:, None] * covariance * std, time=0.0)


@cache
def time_line() -> Timeline:
    """Return 12 s at 10 Hz with 2 fixes per second between samples; the car brakes and its heading crosses pi."""
    rng = np.random.default_rng(1)
    time = np.arange(121) * 0.1
    time[1:-1] += rng.uniform(-0.03, 0.03, 119)
    imu = Imu(
        time=time,
        ax=1.5 * np.sin(time),
        ay=2.0 * np.cos(0.7 * time),
        gz=0.3 * np.cos(0.5 * time),
        az=tilted.GRAVITY + 0.5 * np.sin(2 * time),
        gx=0.02 * np.sin(time),
        gy=0.03 * np.cos(0.8 * time),
    )
    fix_time = np.arange(0.47, 12.0, 0.5)
    gps = Gps(time=fix_time, x=0 * fix_time, y=0 * fix_time)
    drive = Drive("own model", imu, gps, None, metadata={"gps_lever_arm_m": [1.0, 0.5, 0.0]})
    return timeline_of(drive, 0.0)


@cache
def draw(p: FilterParameters, runs: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw true states at the ends of steps (k, runs, n), and fixes (f, runs, 2)."""
    rng, line, initial = np.random.default_rng(seed), time_line(), start(p.n_states)
    s = rng.multivariate_normal(initial.mean, initial.covariance, runs)
    if p.model == "tilted12":
        return draw_tilted(p, runs, rng)
    forward, left = line.lever[:2]
    states, fixes = [], []
    for i, dt in enumerate(line.dt):
        a, b, w = s[:, 5:].T if p.n_states == 8 else np.zeros((3, runs))
        cos, sin = np.cos(s[:, 4]), np.sin(s[:, 4])
        east, north = (
            cos * (line.ax[i] - a) - sin * (line.ay[i] - b),
            sin * (line.ax[i] - a) + cos * (line.ay[i] - b),
        )
        change = np.zeros_like(s)
        change[:, 0], change[:, 1] = s[:, 2] * dt + east * dt**2 / 2, s[:, 3] * dt + north * dt**2 / 2
        change[:, 2], change[:, 3], change[:, 4] = east * dt, north * dt, (line.gz[i] - w) * dt
        s = s + change + rng.standard_normal(s.shape) * np.sqrt(np.array(p.process_noise) * line.q_scale[i])
        if line.updates[i]:
            cos, sin = np.cos(s[:, 4]), np.sin(s[:, 4])
            antenna = s[:, :2] + np.stack([cos * forward - sin * left, sin * forward + cos * left], axis=1)
            fixes.append(antenna + rng.standard_normal((runs, 2)) * np.sqrt(p.measurement_noise))
        states.append(s)
    return np.array(states), np.array(fixes)


def draw_tilted(p: FilterParameters, runs: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw the same for tilted12: the drawn values are errors of the state, which `tilted.plus` adds."""
    line, initial = time_line(), start(p.n_states)
    imu, antenna = line.imu(tilted.AXES), tilted.antenna(line.lever)
    std = np.sqrt(np.array(p.process_noise))
    states, fixes = np.empty((len(line.dt), runs, p.n_states)), np.empty((int(line.updates.sum()), runs, 2))
    for j in range(runs):
        s = tilted.plus(initial.mean, rng.multivariate_normal(0 * initial.mean, initial.covariance))
        seen = iter(fixes[:, j])
        for i, dt in enumerate(line.dt):
            moved = tilted.tilted12(s, dt, imu[i])
            s = tilted.plus(moved, np.sqrt(line.q_scale[i]) * std * rng.standard_normal(len(std)))
            states[i, j] = s
            if line.updates[i]:
                next(seen)[:] = antenna(s) + rng.standard_normal(2) * np.sqrt(p.measurement_noise)
    return states, fixes


@dataclass(frozen=True)
class Consistency:
    """Mean NEES and NIS divided by their expectation, and their degrees of freedom."""

    early: float
    late: float
    nis: float
    nees_freedom: int
    nis_freedom: int

    @property
    def inside(self) -> dict[str, bool]:
        """Whether each mean is inside its 95% interval."""
        nees, nis = band(self.nees_freedom), band(self.nis_freedom)
        values = {"early": (self.early, nees), "late": (self.late, nees), "nis": (self.nis, nis)}
        return {name: bool(low < value < high) for name, (value, (low, high)) in values.items()}


def consistency(
    model: str, kind: str, *, q: float = 1.0, r: float = 1.0, p0: float = 1.0, seed: int = 0
) -> Consistency:
    """Run the compiled filter, with its Q, R and P0 scaled, over data of its unscaled model."""
    right, n = model_parameters(model, kind), STATES[model]
    runs, line, initial = runs_needed(n), time_line(), start(n)
    states, fixes = draw(model_parameters(model, "ekf"), runs, seed=0)  # the same data for all filter types
    truth = states[line.sampled]
    wrong = replace(
        right,
        process_noise=tuple(q * v for v in right.process_noise),
        measurement_noise=tuple(r * v for v in right.measurement_noise),
    )
    initial = replace(initial, covariance=p0 * initial.covariance)
    nees, nis = [], 0.0
    for j in range(runs):
        own = replace(line, fixes=np.hstack([fixes[:, j], np.zeros((len(fixes), 4))]))
        drive_pass = FilterPass(own, initial, Targets.none(own))
        recording = FilterRun(drive_pass, wrong)
        run = recording.whole()
        assert run.sound.all()
        nis += recording.sums["NIS"][0, 0]
        error = run.mean[[EARLY, -1]] - truth[[EARLY, -1], j]
        error[:, 4] = wrap_angle(error[:, 4])
        covariance = run.covariance[[EARLY, -1]]
        nees.append([e @ np.linalg.solve(c, e) for e, c in zip(error, covariance, strict=True)])
    early, late = np.mean(nees, axis=0) / n
    return Consistency(early, late, nis / (2 * fixes[..., 0].size), runs * n, 2 * fixes[..., 0].size)


EVERY_FILTER = [
    (model, kind) for model in STATES for kind in MODELS[model].filter_types if kind in ("ukf", "ekf")
]


@pytest.mark.parametrize(
    ("model", "kind"),
    quickly(EVERY_FILTER, lambda *case: case in (("planar5", "ukf"), ("tilted12", "ekf"))),
)
def test_errors_agree_with_the_covariance(model: str, kind: str):
    found = consistency(model, kind)
    assert all(found.inside.values()), found


OFF = [("q", 1.25), ("q", 0.8), ("r", 1.25), ("r", 0.8), ("p0", 1.25), ("p0", 0.8)]


@pytest.mark.parametrize(
    ("model", "kind", "name", "factor"),
    quickly(
        [(*of, *off) for of in (("planar5", "ukf"), ("planar8", "ekf"), ("tilted12", "ekf")) for off in OFF],
        lambda model, kind, *off: model == ("planar5" if OFF.index((*off,)) % 2 else "planar8"),
    ),
)
def test_noise_that_is_25_percent_wrong_is_detected(model: str, kind: str, name: str, factor: float):
    found = consistency(model, kind, **{name: factor})
    assert not all(found.inside.values()), found


@pytest.mark.parametrize("n", STATES.values())
def test_the_number_of_runs_is_enough_to_detect_ten_percent(n: int):
    runs = runs_needed(n)
    assert 200 < runs < 600
    drawn = np.random.default_rng(0).chisquare(n, (2000, runs)).mean(axis=1) / n
    low, high = band(runs * n)
    assert np.mean((drawn > low) & (drawn < high)) == pytest.approx(0.95, abs=0.02)
    for off in (1.1, 1 / 1.1):
        assert np.mean((drawn * off > low) & (drawn * off < high)) < 0.07
