"""One look for all figures: colors that the color-blind can tell apart, legible in grey, the same bytes each time."""

import warnings
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from sigmaswarm.errors import InputError, visible
from sigmaswarm.files import whole_file
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.evaluation import METHODS, method_names

# Okabe and Ito's palette (2008), and line styles that differ too, so that a grey print stays legible.
LOOKS: dict[str, dict[str, Any]] = {
    "truth": {"color": "#000000", "lw": 1.2, "ls": "-"},
    "tuned": {"color": "#0072B2", "lw": 2.2, "ls": "-"},
    "defaults": {"color": "#E69F00", "lw": 0.8, "ls": "--", "alpha": 0.5},
    "datasheet": {"color": "#CC79A7", "lw": 1.2, "ls": "-."},
    "imu_only": {"color": "#D55E00", "lw": 1.2, "ls": ":"},
    "raw_gps": {"color": "#009E73", "lw": 0, "ls": "none", "marker": ".", "ms": 4, "alpha": 0.7},
}
STUDY_LOOKS: dict[str, dict[str, Any]] = {
    "truth": LOOKS["truth"],
    "honest-pso-ukf": LOOKS["tuned"],
    "paper-pso-ukf": {"color": "#D55E00", "lw": 1.4, "ls": "-."},
    "honest-pso-ekf": {"color": "#56B4E9", "lw": 1.4, "ls": "-"},
    "honest-pso-planar8": {"color": "#332288", "lw": 1.4, "ls": "--"},
    "ukf-datasheet": LOOKS["datasheet"],
    "ukf-defaults": LOOKS["defaults"],
    "imu_only": {"color": "#51585F", "lw": 1.2, "ls": ":"},
    "raw_gps": LOOKS["raw_gps"],
}
"""Of the series in a study's tracks, the first one on top."""
LABELS = {"truth": "truth", **METHODS}


def labels_for(parameters: FilterParameters) -> dict[str, str]:
    """`LABELS`, with the tuned filter's kind."""
    return LABELS | method_names(parameters.kind, parameters.model)


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **kw: object
) -> tuple[Figure, list[Axes]]:
    """A figure of that size in inches, with a list of its axes; no global state of pyplot is touched."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **kw).ravel().tolist()  # pyright: ignore
    for ax in axes:
        ax.grid(True, color="0.9", lw=0.6)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _plain(figure: Figure) -> None:
    """Have titles and legends drawn as they are: names of drives are no formulas, and no commands to a terminal."""
    ticks = [text for ax in figure.axes for axis in (ax.xaxis, ax.yaxis) for text in axis.findobj(Text)]
    for text in figure.findobj(Text):
        if text not in ticks:  # which may have powers
            text.set_parse_math(False)
            text.set_text(visible(text.get_text()))


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG, with nothing in it that changes from one run to the next."""
    _plain(figure)
    with whole_file(path) as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name may have letters that the font lacks
        figure.savefig(file, format="png", dpi=130, metadata={"Software": None})
    return path


def save_both(figure: Figure, stem: Path) -> list[Path]:
    """Write a PNG and an SVG, with no date in either."""
    path = stem.with_name(f"{stem.name}.svg")
    _plain(figure)
    with rc_context({"svg.hashsalt": "sigmaswarm"}), whole_file(path) as file:
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    return [save(figure, stem.with_name(f"{stem.name}.png")), path]


def check_file(path: Path, suffix: str = ".png") -> None:
    """Raise `InputError` where no file of that kind can be written, before any work is done."""
    if path.suffix != suffix:
        raise InputError(f"{path}: can't tell the format; end the name in {suffix}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it first")
