"""Run one filter over one drive: compiled (`run_filter`), in textbook form (`run_textbook`), or dead reckoning."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from sigmaswarm import notebook
from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepare_drive
from sigmaswarm.errors import InputError, SigmaswarmError
from sigmaswarm.filters import tilted
from sigmaswarm.filters.filter_run import EstimateChunk, FilterRun, Innovations, failure_at, join_chunks
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.filters.textbook.loop import run_steps
from sigmaswarm.geodesy import wrap_angle

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimates of a filter at each IMU sample after its start; each estimate uses all fixes up to its time.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times of the IMU samples after ``initial.time``, s.
    mean : ndarray, shape (n, n_states)
        States of the model in its order: x, y (m), vx, vy (m/s), theta (rad, wrapped to (-pi, pi]); planar8 and
        tilted12 also biases (m/s2, rad/s); tilted12 also roll and pitch (rad). NaN after a failure.
    covariance : ndarray, shape (n, n_states, n_states) or (0,)
        Covariance of ``mean``; empty for dead reckoning.
    initial : InitialState
        The state at which the filter started.
    restarts : tuple of float
        Times of the resets after divergence, s (see `divergence`).
    lost : ndarray of bool, shape (n,) or None
        True if the filter has diverged and no alignment is available for a reset; the position is then the last fix.
        None if divergence is not monitored.
    failure : str or None
        The failure and its time; None if the filter did not fail.
    """

    time: Array
    mean: Array
    covariance: Array
    initial: InitialState
    failure: str | None = None
    restarts: tuple[float, ...] = ()
    lost: NDArray[np.bool_] | None = None

    def columns(self, *, std: bool = False) -> dict[str, Array]:
        """Return the time and the states by name, in the units of ``mean``, each of shape (n,).

        If ``std`` is True, also return standard deviations, named ``std_STATE``, if there is a covariance.
        """
        states = MODELS["tilted12"].names  # begins with the returned states of all other models
        named = {"t": self.time} | dict(zip(states, self.mean.T, strict=False))
        if not std or not self.covariance.size:  # dead reckoning has no covariance
            return named
        deviations = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return named | {
            f"std_{name}": deviation for name, deviation in zip(states, deviations.T, strict=False)
        }

    def to_pandas(self) -> "pd.DataFrame":
        """Return time, states and standard deviations, one row for each time.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        return notebook.to_pandas(self.columns(std=True))

    def _repr_html_(self) -> str:
        columns = self.columns(std=True)
        sound = np.flatnonzero(np.isfinite(self.mean).all(axis=1))
        at, rows = "", []
        if len(sound):
            last = {name: float(values[sound[-1]]) for name, values in columns.items()}
            at = f" at {last['t']:.2f} s"
            rows = [
                (name, value, notebook.number(last.get(f"std_{name}")))
                for name, value in last.items()
                if name != "t" and not name.startswith("std_")
            ]
        restarts = [f"diverged, and was reset, at {t:.1f} s" for t in self.restarts]
        return (
            notebook.table(
                f"Estimates at {len(self.time)} times; last finite state{at}",
                ("", "SI units, rad", "sigma"),
                rows,
            )
            + notebook.html_list("Notes:", [*([self.failure] if self.failure else []), *restarts])
            + notebook.track("Estimate", {"estimate": (self.mean[:, 0], self.mean[:, 1])})
        )


def run_filter(
    drive: Drive | PreparedDrive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    recover: bool = True,
    as_recorded: bool = False,
) -> Estimate:
    """Run the compiled filter over a drive.

    Parameters
    ----------
    drive : Drive or PreparedDrive
        The filter does not use the truth.
    parameters : FilterParameters
    initial : InitialState, optional
        State at which the filter starts; by default `initial_state(drive)`.
    recover : bool
        Reset the filter if it diverges (see `divergence`). Filters are not reset during tuning.
    as_recorded : bool
        Run without preprocessing: use stale fixes, and treat gaps in the IMU as ordinary steps. A `PreparedDrive` has
        its own setting.

    Returns
    -------
    Estimate
        ``failure`` is set if the covariance was not positive definite or a state was not finite.

    Raises
    ------
    AlignmentError
        If ``initial`` is not given and cannot be computed from the drive.
    """
    drive_pass = whole_pass(drive, initial, as_recorded=as_recorded)
    return estimate_of(FilterRun(drive_pass, parameters, recover=recover), recover=recover)


def run_innovations(
    drive: Drive | PreparedDrive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    as_recorded: bool = False,
) -> Innovations:
    """Compute the innovations of the compiled filter over a drive. The parameters are those of `run_filter`.

    Innovations after a failure are NaN or meaningless; `run_filter` reports the failure.
    """
    drive_pass = whole_pass(drive, initial, as_recorded=as_recorded)
    return FilterRun(drive_pass, parameters).finished().innovations


def whole_pass(
    drive: Drive | PreparedDrive, initial: InitialState | None = None, *, as_recorded: bool = False
) -> FilterPass:
    """Prepare a whole drive for filters, without `Targets`. Raises `InputError` if no IMU sample follows the start."""
    ready = prepare_drive(drive, initial, as_recorded=as_recorded)
    timeline = ready.timeline()
    if not len(timeline.imu_time):
        name, start = ready.drive.name, ready.initial.time
        raise InputError(
            f"{name}: no IMU sample after the start of the filter at {start:g} s; use an earlier start"
        )
    return FilterPass(timeline, ready.initial, Targets.none(timeline))


class Run(Protocol):
    """Run of one filter over a drive, as an iterator of pieces; attributes are those of `FilterRun`."""

    @property
    def initial(self) -> InitialState: ...

    @property
    def restarts(self) -> Sequence[float]: ...

    @property
    def failure(self) -> str | None: ...

    def __iter__(self) -> Iterator[EstimateChunk]: ...


def estimate_of(run: Run, *, recover: bool) -> Estimate:
    """Join all pieces of a run. ``recover`` is True if the run monitors divergence."""
    whole = join_chunks(run)
    lost = whole.lost if recover else None
    return Estimate(
        whole.time, whole.mean, whole.covariance, run.initial, run.failure, tuple(run.restarts), lost
    )


def estimates_of(run: Run) -> Iterator[Estimate]:
    """Yield the estimates of a run by piece. Raises `SigmaswarmError` if the filter fails."""
    reported = 0
    for piece in run:
        if run.failure:
            raise SigmaswarmError(run.failure)
        restarts = tuple(run.restarts[reported:])
        reported = len(run.restarts)
        yield Estimate(
            piece.time, piece.mean, piece.covariance, run.initial, restarts=restarts, lost=piece.lost
        )


def run_textbook(
    drive: Drive | PreparedDrive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    heading_first: bool = True,
) -> Estimate:
    """Run the textbook filter over a drive, about 100 times slower than `run_filter`.

    Parameters
    ----------
    drive, parameters, initial
        See `run_filter`.
    heading_first : bool
        Compute the Cholesky factor of P with theta as the first state, like the compiled filter. If False, keep the
        order of the states, like FilterPy.

    Returns
    -------
    Estimate
        ``failure`` is set if the filter failed.
    """
    drive_pass = whole_pass(drive, initial)
    line = drive_pass.timeline
    car = TextbookCar(line, parameters, drive_pass.initial, heading_first=heading_first)
    rows = np.where(line.sampled, np.cumsum(line.sampled) - 1, -1)
    run = run_steps(car, rows.tolist(), n_rows=len(line.imu_time))
    run.mean[:, THETA] = wrap_angle(run.mean[:, THETA])
    failure = failure_at(line, line.end[run.failed]) if run.failed >= 0 else None
    covariance = tilted.as_angles(run.mean, run.covariance) if car.model.tilts else run.covariance
    n = parameters.n_states
    return Estimate(line.imu_time, run.mean[:, :n], covariance[:, :n, :n], drive_pass.initial, failure)


def run_imu_only(drive: Drive | PreparedDrive, *, initial: InitialState | None = None) -> Estimate:
    """Run dead reckoning: integrate the IMU from a filter's initial state by the process of `models.planar5`."""
    ready = prepare_drive(drive, initial)
    line, initial = ready.timeline(), ready.initial
    x, y, vx, vy, theta = initial.mean
    heading = theta + np.cumsum(line.gz * line.dt)
    before = np.concatenate([[theta], heading[:-1]])
    a = (line.ax + 1j * line.ay) * np.exp(1j * before)  # m/s2, east + i north
    v = vx + 1j * vy + np.cumsum(a * line.dt)
    v_before = np.concatenate([[vx + 1j * vy], v[:-1]])
    p = x + 1j * y + np.cumsum(v_before * line.dt + a * line.dt**2 / 2)
    del a, before, v_before
    states = (p.real, p.imag, v.real, v.imag, wrap_angle(heading))
    mean = np.column_stack([state[line.sampled] for state in states])
    return Estimate(line.imu_time, mean, np.empty(0), initial)
