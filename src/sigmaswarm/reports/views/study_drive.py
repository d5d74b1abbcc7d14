"""The charts of one drive of a study: its sharpest turn, errors over time, and NIS."""

import numpy as np

from sigmaswarm.experiments.study.config import MAIN
from sigmaswarm.reports.style import CHARCOAL, LOOKS, MIST, ORANGE, STUDY_LOOKS
from sigmaswarm.reports.views.charts import Axis, Band, Chart, Curve, Look, Points, Rule, Values
from sigmaswarm.scoring.consistency import GATE_95
from sigmaswarm.scoring.tracks import CLOSE_UP, NIS, Picture

DRAWN: dict[str, tuple[str, Look]] = {
    "ukf-defaults": ("UKF, manual: defaults", Look(ORANGE, 1.0, "dash")),
    f"paper-{MAIN}": ("PSO-UKF (paper: against the GPS)", STUDY_LOOKS[f"paper-{MAIN}"]),
    f"honest-{MAIN}": ("PSO-UKF (honest: against truth)", STUDY_LOOKS[f"honest-{MAIN}"]),
}
"""Labels and looks of the drawn filters, by series."""


def trajectory_chart(picture: Picture) -> Chart:
    """Draw truth, GPS, manual and tuned filters at the sharpest turn (the paper's Fig. 3)."""
    named = {"raw_gps": ("GPS", LOOKS["raw_gps"]), **DRAWN, "truth": ("truth", LOOKS["truth"])}
    (x, y), half = picture.turn, CLOSE_UP / 2
    return Chart(
        f"{picture.whole.name}: the sharpest turn",
        tuple(
            Curve(picture.close[series]["x"], picture.close[series]["y"], look, name)
            for series, (name, look) in named.items()
        ),
        Axis("east, m", range=(x - half, x + half)),
        Axis("north, m", range=(y - half, y + half)),
        equal=True,
    )


def error_charts(picture: Picture) -> tuple[Chart, ...]:
    """Draw position and heading error over time with the filter's 3 sigma: two charts a filter."""
    charts: list[Chart] = []
    for series, (name, look) in DRAWN.items():
        columns = picture.whole.series[series]
        time, far, sigma = columns["time"], columns["position_error"], columns["heading_3sigma"]
        radius = Band(time, np.zeros(len(time)), columns["position_3sigma"], Look(MIST))
        band = Band(time, -sigma, sigma, Look(MIST))
        reach, turned = _reach(far), _reach(columns["heading_error"])
        position, heading = (
            Axis("position, m", range=(0.0, reach)),
            Axis("heading, deg", range=(-turned, turned)),
        )
        x = Axis("time, s" if series == list(DRAWN)[-1] else "")
        title = "" if charts else f"{picture.whole.name}: errors and 3 sigma"
        charts.append(Chart(name, (radius, Curve(time, far, look)), x, position))
        charts.append(Chart(title, (band, Curve(time, columns["heading_error"], look)), x, heading))
    return tuple(charts)


def _reach(error: Values) -> float:
    """Return the end of a scale that the error sets, not the band."""
    known = np.abs(np.asarray(error))
    known = known[np.isfinite(known)]
    return 1.5 * float(known.max(initial=0.0)) + 1e-3 if len(known) else 1.5


def nis_charts(picture: Picture) -> tuple[Chart, ...]:
    """Draw the NIS of each filter over time; 95% of a consistent filter's lie below the gate."""
    charts: list[Chart] = []
    for series, (name, look) in DRAWN.items():
        columns = picture.whole.series.get(series + NIS)
        if columns is None:  # it failed
            continue
        nis = columns["nis"]
        inside = float(np.mean(nis < GATE_95))
        charts.append(
            Chart(
                f"{name}\nmean {np.mean(nis):.2f}, {inside:.0%} inside the 95% gate",
                (
                    Points(columns["time"], nis, Look(look.color, 0.0, "none", "dot", 3.0)),
                    Rule("y", GATE_95, Look(CHARCOAL, 1.0, "dash")),
                ),
                Axis("time, s"),
                Axis("NIS (consistent: mean 2)", "log"),
            )
        )
    return tuple(charts)
