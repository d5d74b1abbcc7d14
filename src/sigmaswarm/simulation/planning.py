"""Plan a path in the plane and a speed over time from the legs of a route.

The curvature of a leg changes linearly: straight line, arc or clothoid.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached

SPACING = 0.1  # m, between points of a path
DRIVER_STEP = 0.01  # s, between steps of the driver
RUN_OUT = 60.0  # m, straight road after the last leg, for the driver's preview and for longer stops
# Amplitudes of the driver's sway about the ideal line and speed: sqrt(2) times the RMS of the sway
SWAY_OFFSET = 0.10  # m
SWAY_SPEED = 0.006  # relative to the ideal speed


@dataclass(frozen=True)
class Leg:
    """Part of a route, with the limits for its driver."""

    length: float  # m
    speed: float  # m/s, limit
    acceleration: float = 2.5  # m/s2, limit of the plan
    braking: float = 2.5  # m/s2, positive
    curvature: float = 0.0  # 1/m, at the beginning; positive to the left
    curvature_end: float = 0.0  # 1/m
    lateral: float = 3.0  # m/s2, limit of the plan in a bend
    wait: float = 0.0  # s, standstill at the end; 0 for none
    ease: float = 1.0  # s, time in which accelerations build up and fade
    # s/m, relative decrease of the acceleration per m/s, since drivers accelerate less at high speed
    fading: float = 0.02


@dataclass(frozen=True)
class Sway:
    """Deviations of a human driver from the ideal line and speed: sums of three sine waves along the path."""

    phases: Array  # (2, 3) rad
    wavelengths: Array  # (3,) m

    def waves(self, distance: Array, row: int) -> Array:
        return np.sin(2 * np.pi * distance / self.wavelengths[:, None] + self.phases[row][:, None]) / np.sqrt(
            3
        )


def draw_sway(rng: np.random.Generator) -> Sway:
    return Sway(rng.uniform(0, 2 * np.pi, (2, 3)), rng.uniform([110, 150, 200], [150, 200, 260]))


def build_path(legs: Sequence[Leg], heading: float, sway: Sway) -> Array:
    """Return the path, shape (n, 4): east m, north m, heading rad, curvature 1/m, every `SPACING` m.

    The path begins at the origin. The integration uses trapezoids for the curvature and midpoints for the heading.
    """
    ends = np.cumsum([0.0, *(leg.length for leg in legs), RUN_OUT])
    distance = np.arange(0.0, ends[-1], SPACING)
    curvature = np.zeros(len(distance))
    for leg, start, end in zip(legs, ends[:-2], ends[1:-1], strict=True):
        on = (distance >= start) & (distance < end)
        curvature[on] = (
            leg.curvature + (leg.curvature_end - leg.curvature) * (distance[on] - start) / leg.length
        )
    # An offset A sin(k s) adds its second derivative to the curvature.
    wave_numbers = 2 * np.pi / sway.wavelengths
    curvature -= SWAY_OFFSET * wave_numbers**2 @ sway.waves(distance, 0)
    turned = np.cumsum((curvature[1:] + curvature[:-1]) / 2) * SPACING
    yaw = heading + np.concatenate([[0.0], turned])
    middle = (yaw[1:] + yaw[:-1]) / 2
    east = np.concatenate([[0.0], np.cumsum(np.cos(middle))]) * SPACING
    north = np.concatenate([[0.0], np.cumsum(np.sin(middle))]) * SPACING
    return np.column_stack([east, north, yaw, curvature])


@cached(nogil=True, error_model="numpy")
def _reachable(squared: Array, gain: Array, fading: Array, loss: Array) -> None:
    """Reduce squared speeds (n,), m2/s2, in place until acceleration and braking can follow them.

    ``gain`` and ``loss`` (n,) are the largest increase and decrease between neighboring points, m2/s2. For ``fading``
    see `Leg`.
    """
    for i in range(1, len(squared)):
        rest = max(1.0 - fading[i - 1] * np.sqrt(squared[i - 1]), 0.1)
        squared[i] = min(squared[i], squared[i - 1] + gain[i - 1] * rest)
    for i in range(len(squared) - 2, -1, -1):
        squared[i] = min(squared[i], squared[i + 1] + loss[i])


def plan_speed(legs: Sequence[Leg], sway: Sway, stand: float | None) -> Array:
    """Return the fastest plan within all limits, (m, 3): speed m/s, acceleration m/s2, distance m, every `DRIVER_STEP`.

    The car is first stationary for ``stand`` s; if ``stand`` is None, the car starts at the speed of the first leg.
    """
    ends = np.cumsum([0.0, *(leg.length for leg in legs)])
    distance = np.arange(0.0, ends[-1] + SPACING / 2, SPACING)
    leg_of = np.minimum(np.searchsorted(ends, distance, side="right") - 1, len(legs) - 1)

    def of_legs(name: str) -> Array:
        return np.array([getattr(leg, name) for leg in legs])[leg_of]

    part = (distance - ends[leg_of]) / of_legs("length")
    curvature = of_legs("curvature") + (of_legs("curvature_end") - of_legs("curvature")) * part
    limit = np.minimum(of_legs("speed"), np.sqrt(of_legs("lateral") / np.maximum(np.abs(curvature), 1e-6)))
    squared = (limit * (1 + SWAY_SPEED * sway.waves(distance, 1).sum(axis=0))) ** 2
    waits = np.zeros(len(distance))
    for leg, end in zip(legs, ends[1:], strict=True):
        if leg.wait > 0:
            stop = min(round(end / SPACING), len(distance) - 1)
            squared[stop], waits[stop] = 0.0, leg.wait
    if stand is not None:
        squared[0], waits[0] = 0.0, stand
    _reachable(
        squared, 2 * SPACING * of_legs("acceleration"), of_legs("fading"), 2 * SPACING * of_legs("braking")
    )
    return _in_time(distance, np.sqrt(squared), waits, of_legs("ease"))


def _in_time(distance: Array, speed: Array, waits: Array, ease: Array) -> Array:
    """Sample the speed along the path every `DRIVER_STEP` s, and smooth it by a moving average."""
    step = 2 * np.diff(distance) / (speed[1:] + speed[:-1])  # exact for constant acceleration
    arrival = np.concatenate([[0.0], np.cumsum(step + waits[:-1])])
    times = np.column_stack([arrival, arrival + waits]).ravel()
    looks = np.arange(0.0, times[-1], DRIVER_STEP)
    planned = np.interp(looks, times, np.repeat(speed, 2))
    # The legs set the width of the average. The small width of a hard leg also applies 1 s before and after the leg.
    width = minimum_filter1d(np.interp(looks, times, np.repeat(ease, 2)), round(2.0 / DRIVER_STEP))
    half = uniform_filter1d(width, round(0.5 / DRIVER_STEP), mode="nearest") / 2
    far = np.concatenate([[looks[0] - 2], looks, [looks[-1] + 2]])
    flat = np.concatenate([[planned[0]], planned, [planned[-1]]])
    covered = cumulative_trapezoid(flat, far, initial=0)
    eased = (np.interp(looks + half, far, covered) - np.interp(looks - half, far, covered)) / (2 * half)
    travelled = np.concatenate([[0.0], np.cumsum((eased[1:] + eased[:-1]) / 2) * DRIVER_STEP])
    return np.column_stack([eased, np.gradient(eased, DRIVER_STEP), travelled])
