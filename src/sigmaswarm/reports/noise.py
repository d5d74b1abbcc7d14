"""Figure of the Allan deviation of an IMU."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.noise.records import DEG_PER_HOUR, MGAL, AxisNoise, Noise
from sigmaswarm.noise.spectrum import model_parts
from sigmaswarm.reports.figures import Chart, curve, figure_of, logarithmic
from sigmaswarm.reports.style import BLACK, BLUE, GREEN, NO_LINE, ORANGE, PURPLE, Look

_SLOPES = (
    ("white noise, slope -1/2", Look(BLUE, 1.2, "--")),
    ("bias instability, slope 0", Look(ORANGE, 1.2, "-.")),
    ("rate random walk, slope +1/2", Look(GREEN, 1.2, ":")),
)


def noise_figure(noise: Noise) -> Figure:
    """Draw the measured Allan deviation, the fitted model and its asymptotes for each axis of an IMU log."""
    charts = [
        Chart(f"{axis.axis}{', drifts' * bool(axis.drift)}", lambda ax, axis=axis: _draw(ax, axis))
        for axis in noise.axes
    ]
    columns = min(len(charts), 3)
    size = (4.2 * columns, 3.4 * -(-len(charts) // columns) + 0.4)
    figure = figure_of(*charts, size=size, columns=columns, legend="below")
    total = sum(length for _, length in noise.stretches)
    figure.suptitle(f"{noise.name}: static for {total:.0f} s, longest stretch {noise.longest:.0f} s")
    return figure


def _draw(ax: Axes, axis: AxisNoise) -> None:
    scale, unit = (DEG_PER_HOUR, "deg/h") if axis.axis[0] == "g" else (MGAL, "mGal")
    measured = scale * axis.deviation
    curve(ax, axis.tau, measured, Look(BLACK, 0, NO_LINE, "o", 3.0), "measured")
    tau = np.geomspace(axis.tau[0], axis.tau[-1], 100)
    white, flicker, walk = (
        scale * part
        for part in model_parts(
            tau, axis.white.value, axis.instability.value, axis.walk.value, axis.correlation_time
        )
    )
    curve(ax, tau, np.sqrt(white**2 + flicker**2 + walk**2), Look(PURPLE, 1.6), "fitted model")
    low, high = 0.3 * float(np.min(measured)), 2 * float(np.max(measured))
    slopes = white, flicker, scale * axis.walk.value * np.sqrt(tau / 3)
    for values, (name, look) in zip(slopes, _SLOPES, strict=True):
        curve(ax, tau, np.where((values >= low) & (values <= high), values, np.nan), look, name)
    logarithmic(ax.xaxis)
    logarithmic(ax.yaxis)
    ax.set(xlabel="averaging time, s", ylabel=f"Allan deviation, {unit}")
    ax.set_ylim(low, high)
    if math.isfinite(axis.correlation_time):
        text = f"bias correlation time {axis.correlation_time:.0f} s"
        ax.text(0.97, 0.95, text, transform=ax.transAxes, ha="right", va="top", fontsize=8)
