"""Record all drives, and reconnect if the connection is lost; measure friction by braking."""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import product, starmap
from typing import Any

from .car import Driver, control, edit_physics, place_car, settle
from .drive import Recording, check_fixes, drive, seed_of, state_of
from .files import Journal, describe, keep_incomplete, write_drive
from .options import (
    DRY,
    ENVIRONMENTS,
    GRAVITY,
    RATE,
    TICK,
    Condition,
    FailedRun,
    LostConnection,
    Options,
    RecorderError,
)
from .plans import Leg, Plan, find_path, plan_maneuver, straight
from .server import Session, reachable


class Progress:
    """Progress on stderr: one line that changes on a terminal, otherwise one line per drive."""

    def __init__(self, total: int) -> None:
        self.total, self.done = total, 0
        self._began = self._shown = time.monotonic()
        self._name = ""
        self._live = sys.stderr.isatty()

    def show(self, name: str, t: float) -> None:
        """Show the name of a drive and its recorded time, s."""
        now = time.monotonic()
        if now - self._shown < 0.5 and name == self._name:
            return
        rest = ""
        if self.done:
            minutes = (now - self._began) / self.done * (self.total - self.done) / 60
            rest = f", about {minutes:.0f} min to go" if minutes >= 1 else ", less than a minute to go"
        line = f"drive {self.done + 1} of {self.total}: {name}"
        if self._live:
            print(f"\r\033[K{line}, {t:.0f} s{rest}", end="", file=sys.stderr, flush=True)
        elif name != self._name:
            print(line + rest, file=sys.stderr, flush=True)
        self._shown, self._name = now, name

    def say(self, text: str) -> None:
        self.clear()
        print(text, file=sys.stderr, flush=True)

    def clear(self) -> None:
        if self._live:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def record(options: Options) -> int:
    """Record all missing drives. Return the number of recorded drives.

    Raises
    ------
    RecorderError
        If the recording can't continue. Complete drives are in `options.out`, and an incomplete drive is in the
        subfolder ``incomplete``.
    """
    journal = Journal(options)
    conditions = starmap(Condition, product(options.maneuvers, options.environments, range(options.runs)))
    wanted = [condition for condition in conditions if not (options.out / condition.name).exists()]
    progress = Progress(len(wanted))
    try:
        _record(options, journal, wanted, progress)
    finally:
        progress.clear()
    return progress.done


def _record(options: Options, journal: Journal, wanted: list[Condition], progress: Progress) -> None:
    """Record drives; if the connection is lost, open a new session, at most three times in a row."""
    checked, lost = False, 0
    before: dict[str, Any] = {}
    while wanted or (options.brake_sweep and not journal.friction):
        try:
            with Session(options, before) as session:
                journal.note(server=session.version, map=session.town.name, geodesy=session.geodesy.report())
                if not checked:  # raise RecorderError if the map lacks a route for a drive
                    for maneuver, friction in sorted({(m, ENVIRONMENTS[e].friction) for m, e, _ in wanted}):
                        with session.trouble():
                            plan_maneuver(maneuver, friction, session.town, random.Random(0))
                    checked = True
                if options.brake_sweep and not journal.friction:
                    journal.note(friction=sweep_brakes(session, progress.say))
                while wanted:
                    with session.trouble():
                        record_one(session, journal, progress, wanted[0])
                    del wanted[0]
                    progress.done, lost = progress.done + 1, 0
        except LostConnection as error:
            lost += 1
            complete = f"{progress.done} drives of this call are complete in {options.out}"
            if lost > 3 or not _wait_for(options):
                if reachable(options.host, options.port, 1.0):  # restore the settings
                    with suppress(RecorderError), Session(options, before):
                        pass
                raise RecorderError(
                    f"{error}; {complete}; restart the server and repeat the command with --resume"
                ) from None
            progress.say(f"warning: {error}; the server answers again, and the recording continues")


def _wait_for(options: Options) -> bool:
    """Wait until the server accepts connections again. Return False after `patience` s."""
    end = time.monotonic() + options.patience
    while time.monotonic() < end:
        if reachable(options.host, options.port, 1.0):
            time.sleep(min(1.0, options.patience / 10))
            return True
        time.sleep(0.2)
    return False


def record_one(session: Session, journal: Journal, progress: Progress, condition: Condition) -> None:
    """Record one drive; after a failure, try up to three other routes."""
    options, name, where = session.options, condition.name, ENVIRONMENTS[condition.environment]
    session.world.set_weather(
        session.carla.WeatherParameters(**where.weather)
    )  # no effect on the physics (carla#655)
    for attempt in range(4):
        rng = random.Random(seed_of(options.seed, name, "driver", attempt))
        recording = Recording(name)
        try:
            plan = plan_maneuver(condition.maneuver, where.friction, session.town, rng)
            car = place_car(session, plan.path)
            settle(session, car)
            physics = edit_physics(session, car, journal.tire_friction(where.friction), where.friction / DRY)
            sensors = drive(session, recording, plan, car, physics, rng, lambda t: progress.show(name, t))
            check_fixes(recording, options.gps_noise)
            journal.note(physics={condition.environment: physics.dump})
            about = describe(session, recording, plan, physics, sensors, condition)
            write_drive(options.out / name, recording, about, options)
            session.clear()
            return
        except FailedRun as error:
            keep_incomplete(recording, options)
            session.clear()
            if attempt == 3:
                raise RecorderError(
                    f"{error}; the recorder tried four routes; use another --map, or omit this maneuver"
                ) from None
            progress.say(f"warning: {error}; trying another route")
        except BaseException:
            keep_incomplete(recording, options)
            raise


SWEEP_FRICTIONS = (3.5, 2.0, 1.0, 0.5, 0.25)
"""Values of tire_friction, equal for all wheels. The resulting friction depends on the road and on CARLA's version."""


def sweep_brakes(session: Session, say: Callable[[str], None]) -> list[list[float]]:
    """Brake hard with each value of tire_friction. Return pairs of this value and the measured friction."""
    found: list[list[float]] = []
    guess = 0.4
    for tire_friction in SWEEP_FRICTIONS:
        easy = min(0.4 * guess * GRAVITY, 2.5)
        speed = max(min(10.0, 15.0 * easy), 3.0)  # reached within 15 s
        away = 1.2 * speed**2 / 2 / easy + 10.0
        rng = random.Random(seed_of(session.options.seed, "sweep", tire_friction))
        with session.trouble():
            path = find_path(session.town, straight(away + 1.5 * speed**2 / guess / GRAVITY), rng)
            plan = Plan(path, [Leg(away, speed, easy, 20.0)], {})
            measured = _brake(session, plan, tire_friction, rng)
        found.append([tire_friction, round(measured, 4)])
        say(f"with tire_friction {tire_friction:g}, the car brakes with {measured:.3f} g")
        guess = max(0.5 * measured, 0.02)
    return found


def _brake(session: Session, plan: Plan, tire_friction: float, rng: random.Random) -> float:
    """Brake fully. Return the friction: mean deceleration from 90% to 30% of the initial speed, divided by gravity."""
    car = place_car(session, plan.path)
    settle(session, car)
    physics = edit_physics(session, car, tire_friction)
    driver = Driver(plan, physics.wheelbase, rng)
    state = state_of(session, car, session.tick())
    fast, falling = 0.0, [0.0, 0.0]
    for tick in range(RATE * 120):
        wanted = driver.step(*state.place[:2], state.heading, state.speed)
        if driver.arrived:
            fast = fast or state.speed
            falling = [tick if state.speed > share * fast else at for share, at in zip((0.9, 0.3), falling)]
            if state.speed < 0.2 * fast:
                break
        control(session, car, physics, wanted)
        state = state_of(session, car, session.tick())
    session.clear()
    if not falling[1] > falling[0] > 0:
        raise RecorderError(
            f"--brake-sweep: the car did not stop with tire_friction {tire_friction:g}; omit --brake-sweep"
        )
    return 0.6 * fast / ((falling[1] - falling[0]) * TICK) / GRAVITY
