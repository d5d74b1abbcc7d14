"""Make the site's pictures anew: `make pictures`.

Those of the demo come from the demo itself; those of measured figures from the tables in these pages.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path
from shutil import copyfile

from matplotlib.figure import Figure

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"
DEMO = {
    "evaluation/urban-clear-05-track.png": "demo-track.png",
    "evaluation/comparison.png": "demo-comparison.png",
}
METHODS = {"tuned, truth-pose": "#0072b2", "raw GPS": "#009e73", "manual: defaults": "#e69f00"}


def demo(folder: Path) -> None:
    """Run the demo, and keep some of its pictures."""
    subprocess.run([sys.executable, "-m", "sigmaswarm", "demo", "--out", str(folder)], check=True)
    for made, kept in DEMO.items():
        copyfile(folder / made, IMAGES / kept)


def held_out() -> dict[str, dict[str, tuple[float, float]]]:
    """Of each real drive and method of docs/results.md's first table: position RMSE and 5 s drift, m."""
    found: dict[str, dict[str, tuple[float, float]]] = {}
    text = (DOCS / "results.md").read_text()
    table = text[text.index("| held out | method |") :].partition("\n\n")[0]
    for line in table.splitlines()[2:]:
        drive, method, rmse, _, drift = (cell.strip().strip("*") for cell in line.strip("|").split("|"))
        number = [float(m[0]) if (m := re.match(r"[\d.]+", cell)) else float("nan") for cell in (rmse, drift)]
        found.setdefault(drive, {})[method] = (number[0], number[1])
    return found


def real_drives() -> Figure:
    """Position RMSE and drift on the real drives that were held back."""
    found = held_out()
    figure = Figure(figsize=(9, 0.45 * len(found) + 1.6), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for i, (place, title) in enumerate(
        zip(axes, ("position RMSE, m", "drift over a 5 s outage, m"), strict=True)
    ):
        for k, (method, color) in enumerate(METHODS.items()):
            place.scatter(
                [found[drive].get(method, (float("nan"),) * 2)[i] for drive in found],
                range(len(found)), color=color, marker="osD"[k], s=45, label=method, zorder=3,
            )  # fmt: skip
        place.set_xscale("log")
        place.set_title(title, loc="left")
        place.grid(axis="both", color="0.9")
        place.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(range(len(found)), list(found))
    axes[0].invert_yaxis()
    axes[1].set_xlim(right=1e3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


if __name__ == "__main__":
    real_drives().savefig(IMAGES / "real-drives.png", dpi=110)
    with tempfile.TemporaryDirectory() as scratch:
        demo(Path(scratch) / "demo")
