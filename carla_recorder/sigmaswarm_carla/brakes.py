"""Measure friction for several values of CARLA's tire_friction, by braking."""

from __future__ import annotations

import random
from collections.abc import Callable

from .drive import seed_of, state_of
from .driver import Driver
from .options import GRAVITY, RATE, TICK, RecorderError
from .plans import Leg, Plan
from .routes import find_path, straight
from .server import Session
from .vehicle import control, edit_physics, place_car, settle

SWEEP = (3.5, 2.0, 1.0, 0.5, 0.25)
"""Values of tire_friction, the same for all wheels. The resulting friction depends on CARLA's road and version."""


def sweep_brakes(session: Session, say: Callable[[str], None]) -> list[list[float]]:
    """Brake hard with each tire_friction. Return pairs of tire_friction and measured friction."""
    found: list[list[float]] = []
    guess = 0.4
    for tire_friction in SWEEP:
        easy = min(0.4 * guess * GRAVITY, 2.5)
        speed = max(min(10.0, 15.0 * easy), 3.0)  # reached within 15 s
        away = 1.2 * speed**2 / 2 / easy + 10.0
        rng = random.Random(seed_of(session.options.seed, "sweep", tire_friction))
        with session.trouble():
            path = find_path(session.town, straight(away + 1.5 * speed**2 / guess / GRAVITY), rng)
            plan = Plan(path, [Leg(away, speed, easy, 20.0)], {})
            measured = _brake(session, plan, tire_friction, rng)
        found.append([tire_friction, round(measured, 4)])
        say(f"tire_friction {tire_friction:g} brakes with {measured:.3f} g")
        guess = max(0.5 * measured, 0.02)
    return found


def _brake(session: Session, plan: Plan, tire_friction: float, rng: random.Random) -> float:
    """Measure the friction: deceleration under full brakes from 90% to 30% of the speed, divided by gravity."""
    car = place_car(session, plan.path)
    settle(session, car)
    physics = edit_physics(session, car, tire_friction)
    driver = Driver(plan, physics.wheelbase, rng)
    state = state_of(session, car, session.tick())
    fast, falling = 0.0, [0.0, 0.0]
    for tick in range(RATE * 120):
        wanted = driver.look(*state.place[:2], state.heading, state.speed)
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
            f"--brake-sweep: the car did not stop with tire_friction {tire_friction:g}; leave out --brake-sweep"
        )
    return 0.6 * fast / ((falling[1] - falling[0]) * TICK) / GRAVITY
