"""Run of a `LiveFilterBank` over a whole drive."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import merge
from operator import itemgetter
from typing import Any

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.tables import headings_of
from sigmaswarm.filters.bank.live import LiveFilterBank
from sigmaswarm.filters.bank.mixture import Mixture
from sigmaswarm.filters.filter_run import EstimateChunk, Innovations, failure_at
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, require_readable
from sigmaswarm.filters.run import Estimate, estimate_of, whole_pass
from sigmaswarm.geodesy import wrap_angle

AVERAGING_SPAN = 60.0  # s at the end of a drive over which offsets are averaged
LOG_INTERVAL = 1.0  # s
_BATCH_SIZE = 500  # samples per computation of mixtures


@dataclass(frozen=True, eq=False)
class BankLog:
    """Log of a filter bank, with one row per second."""

    names: tuple[str, ...]  # names of the d offsets: see `offsets`
    time: Array  # (k,), s
    weights: Array  # (k, LANES)
    moved: Array  # (k, d), mean offsets from the tuned parameters, in decades or (rear axle) m
    groups: Mapping[str, list[int]]  # indices of the filters in each group

    @property
    def effective(self) -> Array:
        """Effective number of filters in the mixture, (k,); 0 where all filters have failed."""
        squares = np.square(self.weights).sum(axis=1)
        return np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > 0.0)

    @property
    def settled(self) -> Array:
        """Mean offsets from the tuned parameters in the last minute, (d,)."""
        return self.moved[self.time >= self.time[-1] - AVERAGING_SPAN].mean(axis=0)

    @property
    def shares(self) -> dict[str, Array]:
        """Total weight of each group of filters over time, (k,)."""
        return {name: self.weights[:, members].sum(axis=1) for name, members in self.groups.items()}

    def to_frame(self) -> pl.DataFrame:
        """Return a table: t, filter with the largest weight, effective number of filters, offsets, weights."""
        columns = {"t": self.time, "leads": self.weights.argmax(axis=1), "effective": self.effective}
        columns |= {name: self.moved[:, i] for i, name in enumerate(self.names)}
        columns |= {f"weight_{lane}": self.weights[:, lane] for lane in range(self.weights.shape[1])}
        return pl.DataFrame(columns)


class BankRun:
    """Run of a filter bank over a drive, as an iterator of pieces. The log is complete after the last piece.

    ``failure`` is the first time in the pieces so far at which all filters had failed, or None.
    """

    def __init__(
        self,
        drive_pass: FilterPass,
        parameters: FilterParameters,
        *,
        seed: int = 0,
        searches: bool = True,
        recover: bool = False,
        as_recorded: bool = False,
    ) -> None:
        require_readable(drive_pass, KernelArray((parameters,)))
        self._line, self.initial = drive_pass.timeline, drive_pass.initial
        self._model = parameters.kernel
        self.bank = LiveFilterBank(
            parameters,
            drive_pass.initial,
            nominal_interval=self._line.nominal_interval,
            lever_arm=self._line.lever.tolist(),
            seed=seed,
            searches=searches,
            recover=recover,
            as_recorded=as_recorded,
            trust_times=True,
        )
        self.failure: str | None = None
        self._log: list[tuple[float, Array, Array]] = []
        self._innovations: list[tuple[float, ...]] = []

    @property
    def restarts(self) -> list[float]:
        """Times of the bank's resets in the pieces so far, s."""
        return self.bank.bank_restarts

    def __iter__(self) -> Iterator[EstimateChunk]:
        line, bank = self._line, self.bank
        states, weights, lost = [], [], []
        first, logged, n_fixes = 0, -np.inf, 0
        for kind, t, *data in stream(line.drive, FILTERS[self._model].imu):
            if kind != "imu":
                (bank.update if kind == "fix" else bank.update_odometer)(t, *data)
                continue
            bank.predict(t, *data)
            if t <= self.initial.time:
                continue
            if bank.n_fixes != n_fixes:
                n_fixes = bank.n_fixes
                nu, s = bank.innovation
                self._innovations.append((t, *nu.tolist(), s[0, 0], s[0, 1], s[1, 1]))
            if t >= logged + LOG_INTERVAL:
                logged = t
                self._log.append((t, bank.weights, bank.moved))
            state, weight = bank.lanes()
            states.append(state)
            weights.append(weight)
            lost.append(bank.lost)
            if first + len(states) == len(line.imu_time) or len(states) == _BATCH_SIZE:
                yield self._piece(line.imu_time[first : first + len(states)], states, weights, lost)
                first += len(states)
                states, weights, lost = [], [], []

    def _piece(
        self, time: Array, states: list[Array], weights: list[Array], lost: list[bool]
    ) -> EstimateChunk:
        mixed = Mixture.of(np.array(states), np.array(weights), self._model)
        mixed.mean[:, THETA] = wrap_angle(mixed.mean[:, THETA])
        sound = np.isfinite(mixed.mean.sum(axis=1) + mixed.covariance.sum(axis=(1, 2)))
        if self.failure is None and not sound.all():
            self.failure = failure_at(self._line, float(time[np.argmin(sound)]))
        return EstimateChunk(time, mixed.mean, mixed.covariance, sound, np.array(lost))

    @property
    def log(self) -> BankLog:
        time, weights, moved = (np.array(column) for column in zip(*self._log, strict=True))
        return BankLog(self.bank.prior.names, time, weights, moved, self.bank.prior.groups)

    @property
    def innovations(self) -> Innovations:
        """Innovations of the mixture in the pieces so far; of several fixes before an IMU sample, that of the last."""
        rows = np.array(self._innovations).reshape(-1, 6)
        return Innovations(rows[:, 0], rows[:, 1:3], rows[:, [3, 4, 4, 5]].reshape(-1, 2, 2))


def _rows(columns: Sequence[Array]) -> Iterator[list[float]]:
    for first in range(0, len(columns[0]), _BATCH_SIZE):
        yield from np.column_stack([column[first : first + _BATCH_SIZE] for column in columns]).tolist()


def stream(drive: Drive, axes: Sequence[str]) -> Iterator[tuple[Any, ...]]:
    """Yield the data of a drive in order of time, up to the last IMU sample.

    The tuples are ("fix", time, position, velocity, std, heading), ("odometer", time, speed) and ("imu", time, sample),
    with the arguments of the methods of `LiveFilter`. A sample contains the IMU's ``axes``. Fixes and odometer readings
    precede a sample with the same time.
    """
    imu, end = drive.imu, drive.imu.time[-1]
    gps, wheels = drive.gps.select(drive.gps.time <= end), drive.odometer
    velocity, std, (heading, variance) = gps.velocity, gps.std, headings_of(gps)
    columns = [gps.time, gps.x, gps.y, heading, np.sqrt(variance)]
    columns += [*(() if velocity is None else velocity), *(() if std is None else std)]
    fixes = (
        (
            *("fix", t, (x, y), None if velocity is None else more[:2]),
            *(None if std is None else more[-2:], (theta, sigma)),
        )
        for t, x, y, theta, sigma, *more in _rows(columns)
    )
    readings = _rows([wheels.time, wheels.speed]) if wheels else ()
    samples = (("imu", t, u) for t, *u in _rows([imu.time, *(getattr(imu, axis) for axis in axes)]))
    return merge(fixes, (("odometer", t, v) for t, v in readings if t <= end), samples, key=itemgetter(1))


def run_bank(
    drive: Drive | PreparedDrive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    seed: int = 0,
    searches: bool = True,
    recover: bool = True,
    as_recorded: bool = False,
) -> Estimate:
    """Run a `LiveFilterBank` over a drive. Return its estimate at each IMU sample.

    Parameters
    ----------
    drive, parameters, initial, recover, as_recorded
        See `run_filter`.
    seed, searches
        See `LiveFilterBank`.

    Raises
    ------
    AlignmentError
        If ``initial`` is not given and cannot be computed from the drive.
    """
    drive_pass = whole_pass(drive, initial, as_recorded=as_recorded)
    run = BankRun(
        drive_pass, parameters, seed=seed, searches=searches, recover=recover, as_recorded=as_recorded
    )
    return estimate_of(run, recover=recover)
