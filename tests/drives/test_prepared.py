"""A prepared drive: aligned once, each timeline is built once, IMU columns are shared."""

from dataclasses import replace

import numpy as np
import pytest

import sigmaswarm.drives.prepared as module
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.prepared import PreparedDrive, prepare_drive
from support import make_drive, timeline_of

DRIVE = make_drive(duration=20.0, seed=1)
HIDDEN = np.arange(len(DRIVE.gps)) % 3 == 1


def test_start_and_timeline_equal_those_of_the_drive():
    ready = prepare_drive(DRIVE)
    start = initial_state(DRIVE)
    np.testing.assert_array_equal(ready.initial.mean, start.mean)
    line, own = ready.timeline(), timeline_of(DRIVE, start.time)
    for name in ("end", "steps", "updates", "sampled", "fixes", "sample"):
        np.testing.assert_array_equal(getattr(line, name), getattr(own, name))


def test_alignment_and_timelines_are_computed_once(monkeypatch: pytest.MonkeyPatch):
    calls: list[str] = []
    for name in ("initial_state", "build_timeline"):
        own = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda *a, own=own, name=name, **k: calls.append(name) or own(*a, **k)
        )
    ready = prepare_drive(DRIVE)
    assert not calls, "the alignment must wait until the start is needed"
    for _ in range(2):
        assert ready.timeline() is ready.timeline(np.zeros(len(HIDDEN), dtype=bool))
        assert ready.timeline(HIDDEN) is ready.timeline(HIDDEN.copy())
        assert ready.timeline(HIDDEN, removed=True) is ready.timeline(HIDDEN, removed=True)
    assert calls == ["initial_state", *2 * ["build_timeline"]], "one timeline of all fixes, one of the rest"


def test_hidden_fixes_do_not_change_the_steps_and_removed_fixes_do():
    ready = prepare_drive(DRIVE)
    whole, hidden, removed = ready.timeline(), ready.timeline(HIDDEN), ready.timeline(HIDDEN, removed=True)
    for name in ("steps", "driving", "end", "sampled", "sample", "fixes"):
        assert getattr(hidden, name) is getattr(whole, name), name
    usable = (DRIVE.gps.time > whole.start) & (DRIVE.gps.time <= DRIVE.imu.time[-1])
    assert int(hidden.hides.sum()) == int(HIDDEN[usable].sum()) > 0
    np.testing.assert_array_equal(hidden.hides | hidden.updates, whole.updates)
    assert len(hidden.drive.gps) == len(removed.drive.gps) == int((~HIDDEN).sum())
    gone = timeline_of(replace(DRIVE, gps=DRIVE.gps.select(~HIDDEN)), whole.start)
    np.testing.assert_array_equal(removed.steps, gone.steps)
    np.testing.assert_array_equal(removed.driving[removed.sample], gone.driving[gone.sample])
    assert removed.driving is whole.driving
    assert len(removed.dt) < len(whole.dt)


def test_preparing_again_returns_the_same_object_unless_the_start_differs():
    ready = prepare_drive(DRIVE)
    assert prepare_drive(ready) is ready
    assert prepare_drive(ready, ready.initial) is ready
    later = replace(ready.initial, time=ready.initial.time + 2.0)
    assert prepare_drive(ready, later) is not ready
    assert prepare_drive(ready, later).timeline().start == later.time
    assert isinstance(prepare_drive(ready, later), PreparedDrive)
