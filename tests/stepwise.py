"""Compare filters in single steps, for tests/filters/test_parity.py and benchmarks/parity.py.

Far from its optimum, a Kalman filter is chaotic, so whole runs do not agree to 1e-9, but single steps do. In each step
of a drive, both filters start from the same state and, if they are adaptive, from the same adaptation state.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numba
import numpy as np

from oracles.extended import THETA, covariance_error, diagonal, mean_error
from oracles.extended_filters import ExtendedCar
from oracles.filterpy_car import FilterPyCar
from sigmaswarm.drives import events
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive, Odometer
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.timeline import N_STEP, Timeline
from sigmaswarm.filters import packing, starts
from sigmaswarm.filters.compiled import layout, run
from sigmaswarm.filters.compiled.layout import R
from sigmaswarm.filters.compiled.single import single_step, take_step
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.simulation.gps import GPS_GRADES
from sigmaswarm.simulation.scenarios import simulate
from support import DRIVES, make_drive, timeline_of

EPS = np.finfo(float).eps

REAL = "kitti-09-30-0033"
SIMULATED = "simulated"


# --- The steps ---------------------------------------------------------------------------------------------


def steps_with_fixes(
    timeline: Timeline, n_steps: int | None = None
) -> Iterator[tuple[int, np.ndarray | None]]:
    """Yield each step's number and the fix at its end, if there is one."""
    fixes = iter(timeline.fixes)
    for i in range(len(timeline.dt))[:n_steps]:
        yield i, next(fixes) if timeline.updates[i] else None


def wheels_at(timeline: Timeline) -> np.ndarray:
    """Return the odometer's values at the end of each step, (k, 3); zeros without an odometer sample."""
    said = np.zeros((len(timeline.dt), 3))
    found = events.events_of(timeline, {"odometer"})
    said[found.flags & events.ODOMETER > 0] = found.wheels
    return said


def some_steps(timeline: Timeline, sets: Sequence[FilterParameters], n: int) -> set[int]:
    """Choose n steps of each kind, spread over the drive, and the longest step with all updates of the next second."""
    flags = events.events_of(timeline, starts.measured_by(sets[0])).flags
    bits = (events.FIX, events.LATERAL, events.STANDSTILL, events.ODOMETER)
    kinds = [flags == events.IMU, *(flags & bit != 0 for bit in bits)]
    chosen: set[int] = set()
    for kind in kinds:
        steps = np.flatnonzero(kind)
        if len(steps):
            chosen.update(steps[np.linspace(0, len(steps) - 1, n).astype(int)].tolist())
    after = timeline.end - timeline.end[np.argmax(timeline.dt)]
    return chosen | set(
        np.flatnonzero((after >= 0) & (after < 1) & ((after == 0) | timeline.updates)).tolist()
    )


class CompiledCars:
    """The compiled filter, one per parameter set; ``rows`` (s, N_ROWS) is their complete state.

    A filter whose only state is its estimate runs the kernel of a tuning. That kernel can't be started with an
    adaptation state, so adaptive filters run the kernel of the live filter.
    """

    def __init__(self, timeline: Timeline, initial: InitialState, sets: Sequence[FilterParameters]) -> None:
        assert len(sets) % layout.LANES == 0
        self.line, self.n, self.model = timeline, sets[0].n_states, sets[0].model
        self.kernel = sets[0].kernel
        self.remembers = (
            sets[0].kind in ("adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf")
            or sets[0].robust_dof is not None
        )
        self.parts = [slice(a, a + layout.LANES) for a in range(0, len(sets), layout.LANES)]
        self.rows = np.zeros((len(sets), layout.N_ROWS))
        self.wheels = wheels_at(timeline)
        for part in self.parts:
            start = KernelArray(sets[part]).start([initial], [timeline.nominal_interval])[0]
            self.rows[part, : layout.N_KEPT] = start.T

    def step(self, i: int, happens: int, fix: np.ndarray | None, since: float) -> None:
        self.rows[:, [R.NIS, R.SQ_FIX, R.LOG_DET, R.LOG_TAIL]], self.rows[:, [R.DET, R.TAIL]] = 0.0, 1.0
        if not self.remembers:
            self.rows[:, R.REJECTED] = 0.0
        for part in self.parts:
            (self._live if self.remembers else self._run)(part, i, happens, fix, since)

    def _run(self, part: slice, i: int, happens: int, fix: np.ndarray | None, since: float) -> None:
        t = self.line
        rows = self.rows[part, : layout.N_KEPT].T.copy()
        faced = rows[[R.SIN_COS_VALID, R.COS, R.SIN]]
        rows[layout.SUM_ROWS] = 0.0
        rows[[R.SIN_COS_VALID, R.COS, R.SIN]] = faced
        rows[[R.DET, R.TAIL, R.OK]], rows[R.RECENT] = 1.0, -1.0
        run.run_lanes(
            self.kernel,
            (
                t.steps[i : i + 1].copy(),
                t.sample[i : i + 1].copy(),
                t.driving,
                np.array([happens], dtype=np.uint16),
                np.empty((0, 8)) if fix is None else fix[None].copy(),
                self.wheels[i : i + 1].copy(),
                t.lever,
                run.NO_TARGETS,
                np.zeros(1, dtype=np.int32),
            ),
            rows,
            run.new_cursor(),
            1,
            run.NO_RECORD,
            run.NO_INNOVATIONS,
        )
        self.rows[part, : layout.N_KEPT] = rows.T

    def _live(self, part: slice, i: int, happens: int, fix: np.ndarray | None, since: float) -> None:
        t, z = self.line, np.zeros(8) if fix is None else fix
        u = np.zeros(N_STEP)
        u[: 3 + t.driving.shape[1]] = *t.steps[i], *t.driving[t.sample[i]]
        step = single_step(self.kernel).address
        _take(step, self.rows[part], u, happens, z, self.wheels[i], t.lever, since)

    @property
    def state(self) -> tuple[np.ndarray, np.ndarray]:
        return packing.unpack_states(self.rows[:, layout.state_rows(self.model)].T, self.model)

    @property
    def noise(self) -> np.ndarray:
        """Return the diagonals of Q and R, (s, n + 2)."""
        return self.rows[:, [*range(layout.Q0, layout.Q0 + self.n), R.RX, R.RY]]

    @property
    def sums(self) -> np.ndarray:
        """Return NIS, ln det S and squared residual of the last fix, and the recent size of the innovations, (4, s)."""
        rows = self.rows.T
        log_determinant = rows[R.LOG_DET] + np.log(rows[R.DET])
        return np.array([rows[R.NIS], log_determinant, rows[R.SQ_FIX], rows[R.RECENT]])


@numba.njit
def _take(step: int, rows: np.ndarray, *of: Any) -> None:
    for i in range(len(rows)):
        take_step(step, rows[i], *of)


# --- The compiled filter and the oracle -------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Stepwise:
    """Errors of single steps, each (steps, sets).

    ``shrunk`` is the largest factor by which the fix of a step reduced a variance; 1 without a fix. The relative error
    of a covariance in double precision is then at least about eps x shrunk. ``turn`` is the standard deviation of the
    heading (rad) before the fix; inf if the column has failed. ``absorbed`` (steps,) is true for steps with a fix; only
    those have ``sums``, ``noise`` (the adapted Q and R), ``weight`` and ``recovered`` (the oracle's, of robust
    filters).
    """

    mean: np.ndarray
    covariance: np.ndarray
    shrunk: np.ndarray
    turn: np.ndarray
    absorbed: np.ndarray | None = None
    sums: np.ndarray | None = None
    noise: np.ndarray | None = None
    weight: np.ndarray | None = None
    recovered: np.ndarray | None = None

    @property
    def known(self) -> np.ndarray:
        """True where the heading's uncertainty is below 1 rad; otherwise the antenna's position is unknown."""
        return self.turn < 1.0

    def beyond(self, tolerance: float, margin: float) -> np.ndarray:
        """Return the covariance's error divided by the larger of ``tolerance`` and ``margin`` x rounding error."""
        return self.covariance / np.maximum(tolerance, margin * EPS * self.shrunk)


def shrinkage(prior: np.ndarray, posterior: np.ndarray) -> np.ndarray:
    """Return the largest ratio of P_ii before and after the fix, (...)."""
    return np.max(diagonal(prior) / diagonal(posterior), axis=-1).astype(float)


def heading_std(prior: np.ndarray, sound: np.ndarray) -> np.ndarray:
    return np.where(sound, np.sqrt(prior[:, THETA, THETA]), np.inf).astype(float)


def compiled_against_extended(
    timeline: Timeline,
    initial: InitialState,
    sets: Sequence[FilterParameters],
    steps: set[int] | None = None,
    *,
    until: int | None = None,
) -> Stepwise:
    """Run the compiled filter over the drive; compare some of its steps (default: all) with the oracle."""
    compiled, oracle = CompiledCars(timeline, initial, sets), ExtendedCar(timeline, sets)
    flags = events.events_of(timeline, starts.measured_by(sets[0])).flags
    found: dict[str, list[np.ndarray]] = {field.name: [] for field in fields(Stepwise)}
    since = 0.0
    for i, fix in steps_with_fixes(timeline, until):
        beside = steps is None or i in steps
        if beside:
            restart(oracle, compiled, since)
        since += timeline.q_scale[i]
        compiled.step(i, int(flags[i]), fix, since)
        if beside:
            with np.errstate(all="ignore"):  # of columns that have failed
                oracle.step(i, int(flags[i]), fix, compiled.wheels[i])
                for name, error in errors_of(compiled, oracle, fix is not None).items():
                    found[name].append(error)
        since = 0.0 if fix is not None else since
    return Stepwise(**{name: np.array(errors) for name, errors in found.items()})


def restart(oracle: ExtendedCar, compiled: CompiledCars, since: float) -> None:
    """Set the oracle to the state of the compiled filter."""
    extended, n = np.longdouble, compiled.n
    mean, covariance = compiled.state
    oracle.mean, oracle.covariance = mean.astype(extended), covariance.astype(extended)
    if compiled.remembers:
        noise, recent = compiled.noise.astype(extended), compiled.rows[:, R.RECENT].astype(extended)
        oracle.q, oracle.r = noise[:, :n], noise[:, n:]
        oracle.recent = np.where(recent < 0, np.nan, recent)
        fuzzy = compiled.rows[:, [R.QUICK, R.SLOW, R.TIMES_R, R.TIMES_Q]].T.astype(extended)
        oracle.quick, oracle.slow, oracle.times_r, oracle.times_q = fuzzy
    oracle.rejected = compiled.rows[:, R.REJECTED].astype(int) if compiled.remembers else 0 * oracle.rejected
    oracle.outliers = compiled.rows[:, R.OUTLIERS].astype(int)
    oracle.span = compiled.rows[:, R.SPAN].astype(extended)
    oracle.since = extended(since)


def errors_of(compiled: CompiledCars, oracle: ExtendedCar, absorbed: bool) -> dict[str, np.ndarray]:
    """Return the fields of `Stepwise` for one step, each (s,)."""
    mean, covariance = compiled.state
    errors: dict[str, Any] = {
        "mean": mean_error(mean, oracle.mean),
        "covariance": covariance_error(covariance, oracle.covariance),
        "shrunk": shrinkage(oracle.prior, oracle.covariance),
        "turn": heading_std(oracle.prior, compiled.rows[:, R.OK] == 1.0),
        "absorbed": np.bool_(absorbed),
    }
    if absorbed:
        true = [oracle.nis, oracle.log_determinant, oracle.squared_residual]
        if compiled.remembers:
            true.append(np.where(np.isnan(oracle.recent), -1, oracle.recent))
            decided = (compiled.rows[:, R.REJECTED] == oracle.rejected) | ~np.isfinite(errors["turn"])
            assert decided.all(), "the gates disagree"
            decided = (compiled.rows[:, R.OUTLIERS] == oracle.outliers) | ~np.isfinite(errors["turn"])
            assert decided.all(), "the weights disagree"
        if oracle.kind in ("adaptive-ukf", "fuzzy-ukf"):
            noise = np.concatenate([oracle.q, oracle.r], axis=1)
            errors["noise"] = np.max(np.abs(compiled.noise - noise) / noise, axis=1).astype(float)
        if oracle.robust:
            errors |= {"weight": oracle.weight.astype(float), "recovered": oracle.lost}
        # The rounding error of a residual is that of a position, whatever the size of the residual.
        wrong = np.abs(compiled.sums[: len(true)] - true) / np.maximum(1, np.abs(true))
        errors["sums"] = np.max(wrong, axis=0).astype(float)
    return errors


# --- The textbook filter and FilterPy ----------------------------------------------------------------------


def textbook_against_filterpy(
    timeline: Timeline,
    initial: InitialState,
    sets: Sequence[FilterParameters],
    steps: set[int] | None = None,
    *,
    theta_first: bool,
    redraw: bool = True,
    until: int | None = None,
) -> Stepwise:
    """Run FilterPy over the drive; compare some of its steps (default: all) with the textbook filter."""
    flags, per_set = events.events_of(timeline, starts.measured_by(sets[0])).flags, []
    for p in sets:
        theirs = FilterPyCar(timeline, p, theta_first=theta_first, redraw=redraw)
        theirs.restart(*starts.start_of(initial, p))
        ours = TextbookCar(timeline, p, initial, heading_first=theta_first, redraw_sigma_points=redraw)
        states = []
        for i, fix in steps_with_fixes(timeline, until):
            beside = steps is None or i in steps
            if beside:
                ours.filter.mean, ours.filter.covariance = theirs.mean.copy(), theirs.covariance.copy()
                ours.step(i)
            theirs.step(i, int(flags[i]), fix)
            if beside:
                found = ours.filter.mean, ours.filter.covariance, theirs.mean, theirs.covariance, theirs.prior
                states.append(found)
        mean, covariance, their_mean, their_covariance, prior = map(np.array, zip(*states, strict=True))
        per_set.append(
            (
                mean_error(mean, their_mean),
                covariance_error(covariance, their_covariance),
                shrinkage(prior, their_covariance),
                heading_std(prior, np.isfinite(their_mean).all(axis=1)),
            )
        )
    return Stepwise(*(np.array(errors).T for errors in zip(*per_set, strict=True)))


# --- The drives --------------------------------------------------------------------------------------------


def with_gap(drive: Drive, start: float, length: float) -> Drive:
    """Remove all samples of both sensors for ``length`` s after ``start``."""
    imu, gps = (s.select(~((s.time > start) & (s.time < start + length))) for s in (drive.imu, drive.gps))
    return replace(drive, imu=imu, gps=gps, name=f"{drive.name} with a gap")


def simulated() -> Drive:
    """Simulate one minute on a curvy road, with jittering clocks and a gap of 1.6 s soon after the start."""
    drive = make_drive(duration=60, jitter=0.3, seed=7)
    return with_gap(drive, initial_state(drive).time + 2.0, 1.6)


def equipped(drive: Drive) -> Drive:
    """Return the drive with an antenna away from the IMU, and fixes with velocities and accuracies."""
    gps = drive.gps
    if gps.speed is None:
        vx, vy = np.gradient(gps.x, gps.time), np.gradient(gps.y, gps.time)
        gps = replace(gps, speed=np.hypot(vx, vy), course=np.arctan2(vy, vx))
    if gps.std_x is None:
        gps = replace(gps, std_x=1 + 0.8 * np.sin(gps.time), std_y=1 + 0.8 * np.cos(gps.time))
    return replace(drive, gps=gps, metadata={**drive.metadata, "gps_lever_arm_m": [1.0, -0.5, 0.3]})


def wheeled(drive: Drive) -> Drive:
    """Return the drive with an 83 Hz odometer that counts pulses, sometimes slips, and reads 2% too high."""
    time = np.arange(drive.imu.time[0], drive.imu.time[-1], 0.012) + 0.0013
    seen = drive.gps if drive.truth is None else drive.truth
    speed = np.hypot(np.gradient(seen.x, seen.time), np.gradient(seen.y, seen.time))
    speed = 1.02 * np.interp(time, seen.time, speed)
    speed = np.where(np.sin(time) > 0.97, 1.3 * speed, speed)
    return replace(drive, odometer=Odometer(time, 0.05 * np.floor(speed / 0.05)))


def real(name: str) -> Drive:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the reader, about gaps
        return read_drive(DRIVES / name)


def on_time_line(drive: Drive) -> tuple[Timeline, InitialState]:
    initial = initial_state(drive)
    return timeline_of(drive, initial.time), initial


def urban(first: float = 7.0, last: float = 22.0) -> Drive:
    """Simulate a city drive: antenna away from the IMU, velocities, jitter, an early gap, a standstill."""
    grade = replace(GPS_GRADES["ublox-m8"], lever_arm=(0.4, -0.3, 1.2), latency=0.08)
    drive = clip(simulate("urban", run=1, duration=60, gps=grade, gps_rate=8, jitter=1e-3), first, last)
    return with_gap(drive, initial_state(drive).time + 1.0, 0.7)


def colorado() -> Drive:
    """Return a real drive with a stop, equipped."""
    return equipped(clip(real("colorado-1"), 186.0, 206.0))


@cache
def ready(name: str) -> tuple[Timeline, InitialState]:
    """Return a drive of this module by its function's name, or a real drive by its name."""
    made = {SIMULATED: simulated, "urban": urban, "colorado": colorado}
    return on_time_line(made[name]() if name in made else real(name))
