"""A drive prepared for filters, with the initial state and the timelines, which are computed once."""

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.stale_fixes import STALE, classify_fixes
from sigmaswarm.drives.timeline import Timeline, build_timeline

MAX_CACHED_STEPS = 500_000  # largest number of steps that `forget` keeps: 80 minutes at 100 Hz, 40 MB


class PreparedDrive:
    """A drive with the initial state and the timelines that filters need.

    By default, the alignment finds ``initial``. With ``as_recorded``, for diagnosis and the paper's protocol, stale
    fixes are used, and IMU gaps are ordinary steps.
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
        """Initial state of filters. Raises AlignmentError if the alignment finds none."""
        return self._given or initial_state(self.drive, as_recorded=self.as_recorded)

    @cached_property
    def kinds(self) -> Array:
        """Kind of each fix, (number of fixes,) (see `drives.stale_fixes`).

        With ``as_recorded``, all fixes are `NEW`.
        """
        return np.zeros(len(self.drive.gps)) if self.as_recorded else classify_fixes(self.drive.gps)

    @property
    def stale(self) -> NDArray[np.bool_]:
        """Mask of stale fixes, (number of fixes,)."""
        return self.kinds >= STALE

    def timeline(self, hidden: NDArray[np.bool_] | None = None, *, removed: bool = False) -> Timeline:
        """Return the timeline without updates by hidden fixes. ``hidden`` is a mask, (number of fixes,).

        The timeline is cached. If ``removed`` is True, no step ends at a hidden fix. Otherwise, filters can predict
        hidden fixes, and the timeline shares its arrays with the timeline of all fixes.
        """
        if hidden is None or not hidden.any():
            hidden, removed = np.zeros(len(self.drive.gps), dtype=np.bool_), False
        key = hidden.tobytes(), removed
        if key not in self._timelines:
            if hidden.any() and not removed:
                line = self.timeline().hiding(hidden)
            else:
                seen = replace(self.drive, gps=self.drive.gps.select(~hidden)) if removed else self.drive
                start, kinds = self.initial.time, self.kinds[~hidden]
                like = self.timeline() if removed else None
                line = build_timeline(seen, start, kinds, as_recorded=self.as_recorded, like=like)
            self._timelines[key] = line
        return self._timelines[key]

    def forget(self) -> None:
        """Drop the timelines, each of which needs 0.25 GB for ten hours at 100 Hz.

        A small timeline of all fixes is kept, since the other timelines are derived from it.
        """
        self._timelines = {
            (hidden, removed): line
            for (hidden, removed), line in self._timelines.items()
            if not removed and not any(hidden) and len(line.end) <= MAX_CACHED_STEPS
        }


def prepare_drive(
    drive: Drive | PreparedDrive, initial: InitialState | None = None, *, as_recorded: bool = False
) -> PreparedDrive:
    if isinstance(drive, PreparedDrive):
        if initial is None or initial is drive.initial:
            return drive
        return PreparedDrive(drive.drive, initial, as_recorded=drive.as_recorded)
    return PreparedDrive(drive, initial, as_recorded=as_recorded)
