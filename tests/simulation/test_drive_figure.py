import io
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.drives.drive import Drive, Gps, Imu
from sigmaswarm.reports.drive import drive_figure
from sigmaswarm.simulation import simulate
from support import quickly


def rendered(drive):
    page = io.BytesIO()
    figure = drive_figure(drive)
    figure.savefig(page, format="png", dpi=50)
    assert page.getvalue().startswith(b"\x89PNG")
    return figure


def test_a_simulated_drive_shows_outages_and_figures():
    figure = rendered(simulate("outages"))
    labels = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "3415 IMU samples" in figure.get_suptitle() or "IMU samples" in figure.get_suptitle()
    tables = [table for axes in figure.axes for table in axes.tables]
    cells = {cell.get_text().get_text() for table in tables for cell in table.get_celld().values()}
    assert {"target", "achieved", "outage_1_s", "peak_slip_percent"} <= cells
    assert labels == []
    (errors,) = (axes for axes in figure.axes if "error" in axes.get_ylabel())
    for line in errors.lines[:2]:  # the third line is zero
        assert np.isnan(line.get_ydata()).sum() == 2  # a gap at both outages


@pytest.mark.long
@pytest.mark.parametrize("keep", quickly([("no truth",), ("no speed",)], lambda keep: keep == "no speed"))
def test_a_recorded_drive_without_truth_or_speed_is_drawn_too(keep):
    drive = simulate("brake", gps="white-1m" if keep == "no speed" else "ublox-m8")
    rendered(replace(drive, truth=None, metadata={}))


@pytest.mark.parametrize("start", [0.0, 58426.9, 1.6e9])
def test_the_time_axis_shows_the_full_times_of_the_log(start: float):
    time = start + np.arange(100) / 10
    zero = np.zeros(100)
    bare = Drive("bare", Imu(time, zero, zero, zero), Gps(time[::10], zero[::10], zero[::10]))
    axes = rendered(bare).axes[-1]
    low, high = axes.get_xlim()
    labels = [float(label.get_text().replace("\N{MINUS SIGN}", "-")) for label in axes.get_xticklabels()]
    assert low < start < start + 9.8 < high < low + 15
    assert axes.get_xlabel().startswith("time t, s") and all(low - 5 < v < high + 5 for v in labels)
