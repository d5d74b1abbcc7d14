"""A drive made ready for filters: its start and its time lines, each made once and kept."""

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.timeline import Timeline, build_timeline


class PreparedDrive:
    """A drive, where a filter starts on it, and its time lines; all that runs filters over a drive shares them.

    Parameters
    ----------
    drive : Drive
    initial : InitialState, optional
        Where to start; by default the drive is aligned when the start is first asked for.
    """

    def __init__(self, drive: Drive, initial: InitialState | None = None) -> None:
        self.drive = drive
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
        return self._given or initial_state(self.drive)

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
        """Let go of the time lines made so far: those of ten hours at 100 Hz take a quarter of a gigabyte each."""
        self._timelines.clear()

    def _built(self, hidden: NDArray[np.bool_], removed: bool) -> Timeline:
        if not hidden.any():
            return build_timeline(self.drive, self.initial.time)
        if removed:
            seen = replace(self.drive, gps=self.drive.gps.select(~hidden))
            return build_timeline(seen, self.initial.time)
        return self.timeline().hiding(hidden)


def prepared(drive: Drive | PreparedDrive, initial: InitialState | None = None) -> PreparedDrive:
    """The drive made ready; itself where it is ready already and no other start is asked for."""
    if isinstance(drive, PreparedDrive):
        return drive if initial is None or initial is drive.initial else PreparedDrive(drive.drive, initial)
    return PreparedDrive(drive, initial)
