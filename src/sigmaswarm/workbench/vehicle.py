"""A sketch of the vehicle with the axes of the IMU, as SVG."""

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.reports.style import BLUE, GREEN, VERMILION

WIDTH, HEIGHT, SCALE = 340, 240, 46
AZIMUTH, ELEVATION = np.radians(148.0), np.radians(24.0)
"""From where the vehicle is seen: from the front left, above."""
PROFILE = np.array(
    [(-2.1, 0.35), (-2.1, 0.95), (-1.55, 1.0), (-1.1, 1.5), (0.35, 1.5), (1.0, 1.0), (2.0, 0.85), (2.1, 0.35)]
)
"""Side view: m forward and up."""
WINDOWS = np.array([(-1.32, 1.05), (-1.0, 1.4), (0.3, 1.4), (0.8, 1.02)])
HALF, WHEEL = 0.85, 0.34
"""m: half of the width, and the radius of a wheel."""
MOUNTED = np.array([-0.4, 0.0, 1.15])
"""m: where the IMU is drawn."""
NAMES = {0: ("x", VERMILION), 1: ("y", GREEN), 2: ("z", BLUE)}


def sketch(rotation: Array) -> str:
    """Draw the vehicle and the sensor's axes.

    Parameters
    ----------
    rotation : (3, 3)
        From the sensor's axes to the vehicle's, as of ``parse_mount``.
    """
    parts = [*_car(), *_arrow(np.array([2.2, 0.0, 0.6]), np.array([3.3, 0.0, 0.6]), "#51585f", "forward")]
    order = sorted(NAMES, key=lambda axis: float(_depth(rotation[:, axis])))
    parts.append(_box(rotation))
    for axis in order:
        name, color = NAMES[axis]
        parts += _arrow(MOUNTED, MOUNTED + 1.35 * rotation[:, axis], color, name)
    said = ", ".join(f"{name} {_direction(rotation[:, axis])}" for axis, (name, _) in NAMES.items())
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" class="sketch" '
        f'aria-label="The IMU in the vehicle: {said}">{"".join(parts)}</svg>'
    )


def _view() -> Array:
    """Rows: right, up and towards the viewer, in the vehicle's axes."""
    c, s = np.cos(AZIMUTH), np.sin(AZIMUTH)
    towards = np.array([-c * np.cos(ELEVATION), s * np.cos(ELEVATION), np.sin(ELEVATION)])
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


def _depth(direction: Array) -> float:
    return float(_view()[2] @ direction)


def _place(points: Array) -> Array:
    """Pixels (n, 2) of points (n, 3), m."""
    flat = (points - np.array([0.2, 0.0, 0.8])) @ _view()[:2].T
    return np.array([WIDTH / 2, HEIGHT / 2 + 16]) + SCALE * flat * [1.0, -1.0]


def _polygon(points: Array, fill: str, stroke: str = "#51585f") -> str:
    places = " ".join(f"{x:.1f},{y:.1f}" for x, y in _place(points))
    return f'<polygon points="{places}" fill="{fill}" stroke="{stroke}" stroke-width="1" stroke-linejoin="round"/>'


def _side(outline: Array, y: float) -> Array:
    return np.column_stack([outline[:, 0], np.full(len(outline), y), outline[:, 1]])


def _car() -> list[str]:
    """The body from far to near."""
    near = HALF if _depth(np.array([0.0, 1.0, 0.0])) > 0 else -HALF
    left, right = _side(PROFILE, near), _side(PROFILE, -near)
    strips = [np.array([left[i], left[i + 1], right[i + 1], right[i]]) for i in range(len(PROFILE) - 1)]
    strips.sort(key=lambda strip: _depth(strip.mean(axis=0)))
    wheels = [_wheel(x, near) for x in (-1.35, 1.35)]
    body = [_polygon(right, "#eef1f4"), *(_polygon(strip, "#f5f7f9") for strip in strips)]
    return [*body, _polygon(left, "#e3e8ed"), _polygon(_side(WINDOWS, near), "#fff"), *wheels]


def _wheel(x: float, y: float) -> str:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.column_stack([x + WHEEL * np.cos(angle), np.full(24, y), WHEEL + WHEEL * np.sin(angle)])
    return _polygon(rim, "#4d4d4d")


def _box(rotation: Array) -> str:
    """The sensor's housing, seen through the roof."""
    corners = np.array([(0.3, 0.2, 0.0), (-0.3, 0.2, 0.0), (-0.3, -0.2, 0.0), (0.3, -0.2, 0.0)])
    return _polygon(MOUNTED + corners @ rotation.T, "#ffffffcc", "#1c2024")


def _arrow(start: Array, end: Array, color: str, name: str) -> list[str]:
    (x0, y0), (x1, y1) = _place(np.array([start, end]))
    along = np.array([x1 - x0, y1 - y0])
    length = float(np.hypot(*along))
    if length < 8:  # towards the viewer, or away
        return [
            f'<circle cx="{x1:.1f}" cy="{y1:.1f}" r="5" fill="{color}"/>',
            _text(x1 + 9, y1 - 6, color, name),
        ]
    unit = along / length
    across = np.array([-unit[1], unit[0]])
    tip = [(x1, y1), *((np.array([x1, y1]) - 9 * unit + side * 4.5 * across) for side in (1, -1))]
    head = " ".join(f"{x:.1f},{y:.1f}" for x, y in tip)
    x, y = np.array([x1, y1]) + 9 * unit
    line = (
        f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}" stroke-width="3"/>'
    )
    return [line, f'<polygon points="{head}" fill="{color}"/>', _text(float(x), float(y), color, name)]


def _text(x: float, y: float, color: str, name: str) -> str:
    halo = 'stroke="#fff" stroke-width="4" paint-order="stroke"'
    style = f'text-anchor="middle" dominant-baseline="middle" font-size="14" font-weight="700" {halo}'
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" {style}>{name}</text>'


def _direction(axis: Array) -> str:
    """The vehicle's direction that an axis is nearest to, in words."""
    k = int(np.argmax(np.abs(axis)))
    return (("forward", "backward"), ("left", "right"), ("up", "down"))[k][int(axis[k] < 0)]
