"""A sketch of the vehicle with the axes of the IMU, as SVG."""

from functools import cache
from importlib.resources import files

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.reports.style import BLUE, GREEN, VERMILION

CENTER, SCALE = np.array([170.0, 136.0]), 46
"""Pixels, and pixels per m, of car.svg."""
VIEW = np.array([(-0.530, 0.848, 0.0), (-0.345, -0.216, 0.914), (0.775, 0.484, 0.407)])
"""Rows: right, up and towards the viewer of car.svg, in the vehicle's axes."""
MOUNTED = np.array([-0.4, 0.0, 1.15])
"""m: where the IMU is drawn."""
AXES = (("x", VERMILION), ("y", GREEN), ("z", BLUE))
DIRECTIONS = (("forward", "backward"), ("left", "right"), ("up", "down"))


def sketch(rotation: Array) -> str:
    """Draw the vehicle and the sensor's axes.

    Parameters
    ----------
    rotation : (3, 3)
        From the sensor's axes to the vehicle's, as of ``parse_mount``.
    """
    corners = np.array([(0.3, 0.2, 0.0), (-0.3, 0.2, 0.0), (-0.3, -0.2, 0.0), (0.3, -0.2, 0.0)])
    box = _polygon(_place(MOUNTED + corners @ rotation.T), 'fill="#ffffffcc" stroke="#1c2024"')
    parts = [_arrow(np.array([2.2, 0.0, 0.6]), np.array([3.3, 0.0, 0.6]), "#51585f", "forward"), box]
    for k in np.argsort(VIEW[2] @ rotation):
        name, color = AXES[k]
        parts.append(_arrow(MOUNTED, MOUNTED + 1.35 * rotation[:, k], color, name))
    said = ", ".join(f"{name} {_direction(rotation[:, k])}" for k, (name, _) in enumerate(AXES))
    labeled = _car().replace('aria-label=""', f'aria-label="The IMU in the vehicle: {said}"')
    return labeled.replace("</svg>", "".join([*parts, "</svg>"]))


@cache
def _car() -> str:
    return files("sigmaswarm.workbench").joinpath("car.svg").read_text()


def _place(points: Array) -> Array:
    """Pixels (n, 2) of points (n, 3), m."""
    return CENTER + SCALE * ((points - np.array([0.2, 0.0, 0.8])) @ VIEW[:2].T) * [1.0, -1.0]


def _polygon(places: Array, style: str) -> str:
    return f'<polygon points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in places)}" {style}/>'


def _arrow(start: Array, end: Array, color: str, name: str) -> str:
    first, last = _place(np.array([start, end]))
    length = float(np.hypot(*(last - first)))
    along = (last - first) / length if length >= 8 else np.array([0.7, -0.7])
    across = np.array([-along[1], along[0]])
    head = np.array([last, last - 9 * along + 4.5 * across, last - 9 * along - 4.5 * across])
    if length >= 8:
        (x0, y0), (x1, y1) = first, last
        ends = f'x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}"'
        drawn = f'<line {ends} stroke="{color}" stroke-width="3"/>' + _polygon(head, f'fill="{color}"')
    else:  # towards the viewer, or away
        drawn = f'<circle cx="{last[0]:.1f}" cy="{last[1]:.1f}" r="5" fill="{color}"/>'
    x, y = last + 9 * along
    style = 'text-anchor="middle" dominant-baseline="middle" font-size="14" font-weight="700"'
    halo = 'stroke="#fff" stroke-width="4" paint-order="stroke"'
    return f'{drawn}<text x="{x:.1f}" y="{y:.1f}" fill="{color}" {style} {halo}>{name}</text>'


def _direction(axis: Array) -> str:
    """The vehicle's direction that an axis is nearest to."""
    k = int(np.argmax(np.abs(axis)))
    return DIRECTIONS[k][int(axis[k] < 0)]
