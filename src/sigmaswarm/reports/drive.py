"""Picture of a drive: path, speed, IMU, fixes and their gaps; for a simulated drive, target and achieved values."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.reports.figures import show_time
from sigmaswarm.reports.style import BLUE, GREY, PURPLE, VERMILION

Gaps = list[tuple[float, float]]  # start and end of intervals without fixes, s


def drive_figure(drive: Drive) -> Figure:
    """Draw a drive on a figure of 12 by 9 inches."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    grid = figure.add_gridspec(4, 2, width_ratios=[1, 1.35])
    imu, time = drive.imu, drive.gps.time
    steps = np.diff(time)  # an interval above 2.5 times the median is a gap
    after = np.flatnonzero(steps > 2.5 * np.median(steps)) if len(time) > 2 else []
    gaps: Gaps = [(float(time[i]), float(time[i + 1])) for i in after]
    _draw_path(figure.add_subplot(grid[:3, 0]), drive, gaps)
    _draw_figures(figure.add_subplot(grid[3, 0]), drive)
    top = figure.add_subplot(grid[0, 1])
    panels = [top, *(figure.add_subplot(grid[i, 1], sharex=top) for i in range(1, 4))]
    _draw_speed(panels[0], drive)
    _draw_lines(panels[1], imu.time, {"forward": (imu.ax, BLUE), "left": (imu.ay, VERMILION)})
    panels[1].set_ylabel("specific force\nm/s²")
    rates = {"yaw": (imu.gz, BLUE), "roll": (imu.gx, VERMILION), "pitch": (imu.gy, PURPLE)}
    known = {name: (np.degrees(rate), color) for name, (rate, color) in rates.items() if rate is not None}
    _draw_lines(panels[2], imu.time, known)
    panels[2].set_ylabel("angular rate\ndeg/s")
    _draw_fixes(panels[3], drive, gaps)
    for panel in panels:
        for begin, end in gaps:
            panel.axvspan(begin, end, color=GREY, alpha=0.25, lw=0)
        panel.grid(alpha=0.3)
        panel.tick_params(labelbottom=panel is panels[-1])
    show_time(panels[-1], f"time t, s{' (gray: no fixes)' if gaps else ''}")
    figure.suptitle(f"{drive.name}: {drive.duration:.1f} s, {len(imu)} IMU samples, {len(drive.gps)} fixes")
    return figure


def _draw_path(axes: Axes, drive: Drive, gaps: Gaps) -> None:
    axes.plot(drive.gps.x, drive.gps.y, ".", color=VERMILION, ms=4, label="fixes", zorder=1)
    truth, path = drive.truth, drive.truth or drive.gps
    if truth is not None:
        axes.plot(truth.x, truth.y, color=BLUE, lw=1.5, label="truth", zorder=2)
        for i, (begin, end) in enumerate(gaps):
            inside = (truth.time >= begin) & (truth.time <= end)
            label = "truth, no fixes" if i == 0 else None
            axes.plot(truth.x[inside], truth.y[inside], color="black", lw=3.5, label=label, zorder=3)
    axes.plot(path.x[0], path.y[0], "o", color="black", ms=7, label="start", zorder=4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize="small")


def _draw_speed(axes: Axes, drive: Drive) -> None:
    gps, truth = drive.gps, drive.truth
    dots: dict[str, Any] = {"color": VERMILION, "ms": 3}
    if gps.speed is not None:
        axes.plot(gps.time, gps.speed * 3.6, ".", **dots, label="receiver")
    if truth is not None:
        speed = np.hypot(truth.vx, truth.vy) * 3.6
        axes.plot(truth.time, speed, color=BLUE, lw=1.5, label="truth")
    if gps.speed is None and truth is None:
        steps = np.hypot(np.diff(gps.x), np.diff(gps.y)) / np.diff(gps.time)
        axes.plot(gps.time[1:], steps * 3.6, ".", **dots, label="from fix to fix")
    axes.set_ylabel("speed\nkm/h")
    _legend_above(axes)


def _draw_lines(axes: Axes, when: Array, lines: dict[str, tuple[Array, str]]) -> None:
    for order, (name, (values, color)) in enumerate(lines.items()):
        axes.plot(when, values, color=color, lw=0.8, label=name, zorder=3 - 0.1 * order)
    _legend_above(axes)


def _legend_above(axes: Axes) -> None:
    axes.legend(loc="lower right", bbox_to_anchor=(1, 0.97), ncols=3, frameon=False, fontsize="small")


def _draw_fixes(axes: Axes, drive: Drive, gaps: Gaps) -> None:
    gps, truth = drive.gps, drive.truth
    if truth is None:
        axes.plot(gps.time[1:], np.diff(gps.time), ".", color=VERMILION, ms=3)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("time from fix\nto fix, s")
        return
    # NaN interrupts the line at a gap.
    after_gaps = np.searchsorted(gps.time, [end for _, end in gaps])
    when = np.insert(gps.time, after_gaps, np.nan)
    for values, true, color, name in ((gps.x, truth.x, BLUE, "east"), (gps.y, truth.y, VERMILION, "north")):
        error = values - np.interp(gps.time, truth.time, true)
        axes.plot(when, np.insert(error, after_gaps, np.nan), ".-", color=color, ms=3, lw=0.5, label=name)
    axes.axhline(0, color="black", lw=0.5)
    axes.set_ylabel("error of the\nfixes, m")
    _legend_above(axes)


def _draw_figures(axes: Axes, drive: Drive) -> None:
    axes.axis("off")
    tables: list[Any] = [drive.metadata.get(key) for key in ("target", "achieved")]
    target, achieved = (
        {str(k): v for k, v in table.items() if isinstance(v, int | float)} if isinstance(table, dict) else {}
        for table in tables
    )
    if not achieved:
        return
    names = dict.fromkeys((*target, *achieved))
    cells = [[name, *(f"{d[name]:.3g}" if name in d else "" for d in (target, achieved))] for name in names]
    place = Bbox.from_bounds(0, -0.05, 1, 1.1)
    table = axes.table(cells, colLabels=["", "target", "achieved"], colWidths=[0.56, 0.2, 0.24], bbox=place)
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    for (_, column), cell in table.get_celld().items():
        cell.set_edgecolor("#dddddd")
        cell.set_text_props(ha="left" if column == 0 else "right")
