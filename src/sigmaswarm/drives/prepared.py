"""A drive made ready for filters: its start and its time lines, each made once and kept."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.frozen import FROZEN, judged
from sigmaswarm.drives.timeline import Timeline, build_timeline, driving_of

SMALL = 500_000
"""Steps of a time line, of somewhat over an hour: 40 megabytes."""


class PreparedDrive:
    """A drive, where a filter starts on it, and its time lines; all that runs filters over a drive shares them.

    Parameters
    ----------
    drive : Drive
    initial : InitialState, optional
        Where to start; by default the drive is aligned when the start is first asked for.
    as_recorded : bool
        Absorb frozen fixes, and cross gaps in the IMU as if they were steps like others: for diagnosis, and for the
        paper's protocol.
    """

    def __init__(
        self, drive: Drive, initial: InitialState | None = None, *, as_recorded: bool = False
    ) -> None:
        self.drive = drive
        self.as_recorded = as_recorded
        self._given = initial
        self._timelines: dict[tuple[bytes, bool], Timeline] = {}

    @cached_property
    def initial(self) -> InitialState:
        """Where filters start.

        Raises
        ------
        AlignmentError
            If the drive never moves far enough.
        """
        return self._given or initial_state(self.drive, as_recorded=self.as_recorded)

    @cached_property
    def kinds(self) -> Array:
        """What each fix is, (number of fixes,): see `drives.frozen`. All are new where they are taken as recorded."""
        return np.zeros(len(self.drive.gps)) if self.as_recorded else judged(self.drive.gps)

    @cached_property
    def _driving(self) -> Array:
        """Of all its time lines."""
        return driving_of(self.drive, as_recorded=self.as_recorded)

    @property
    def frozen(self) -> NDArray[np.bool_]:
        """Which fixes are frozen, (number of fixes,): filters don't take them for positions."""
        return self.kinds >= FROZEN

    def timeline(self, hidden: NDArray[np.bool_] | None = None, *, removed: bool = False) -> Timeline:
        """The steps of a filter that sees all fixes but the hidden ones; the same object each time it is asked.

        Parameters
        ----------
        hidden : ndarray of bool, shape (number of fixes,), optional
            Fixes that a filter does not get to see: none by default.
        removed : bool
            Take the hidden fixes out as if they had never been, so that no step ends at one. Otherwise the steps are
            those of the whole drive, whose arrays all such time lines share, and the fixes are there to be forecast.
        """
        if hidden is None or not hidden.any():
            hidden, removed = np.zeros(len(self.drive.gps), dtype=np.bool_), False
        key = hidden.tobytes(), removed
        if key not in self._timelines:
            self._timelines[key] = self._built(hidden, removed)
        return self._timelines[key]

    def forget(self) -> None:
        """Let go of the time lines made so far: those of ten hours at 100 Hz take a quarter of a gigabyte each.

        That of all fixes stays where it is small, since others are made of it.
        """
        self._timelines = {
            (hidden, removed): line
            for (hidden, removed), line in self._timelines.items()
            if not removed and not any(hidden) and len(line.end) <= SMALL
        }

    def _built(self, hidden: NDArray[np.bool_], removed: bool) -> Timeline:
        if removed:
            return self.timeline().without(hidden)
        if hidden.any():
            return self.timeline().hiding(hidden)
        return build_timeline(
            self.drive,
            self.initial.time,
            as_recorded=self.as_recorded,
            kinds=self.kinds,
            driving=self._driving,
        )


def prepared(
    drive: Drive | PreparedDrive, initial: InitialState | None = None, *, as_recorded: bool = False
) -> PreparedDrive:
    """The drive made ready; itself where it is ready already and no other start is asked for.

    ``as_recorded`` is for a drive that is not ready yet: see `PreparedDrive`.
    """
    if isinstance(drive, PreparedDrive):
        if initial is None or initial is drive.initial:
            return drive
        return PreparedDrive(drive.drive, initial, as_recorded=drive.as_recorded)
    return PreparedDrive(drive, initial, as_recorded=as_recorded)
