"""Make the site's pictures anew: `make pictures`.

Those of the demo come from the demo itself; those of measured figures from the tables in these pages.
"""

import subprocess
import sys
import tempfile
from pathlib import Path
from shutil import copyfile

from matplotlib.figure import Figure

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"
DEMO = {"trajectory.png": "demo-track.png"}
METHODS = {"with truth": "#0072b2", "without truth": "#d55e00", "raw fixes": "#009e73"}


def demo(folder: Path) -> None:
    """Run the demo, and keep some of its pictures."""
    subprocess.run([sys.executable, "-m", "sigmaswarm", "demo", "--out", str(folder)], check=True)
    for made, kept in DEMO.items():
        copyfile(folder / "figures" / made, IMAGES / kept)


def held_out() -> dict[str, dict[str, tuple[float, float]]]:
    """Position RMSE and 5 s drift, m, by real drive and tuning: the first table of docs/results.md."""
    found: dict[str, dict[str, tuple[float, float]]] = {}
    text = (DOCS / "results.md").read_text()
    table = text[text.index("| tested on | filter |") :].partition("\n\n")[0]
    for line in table.splitlines()[2:]:
        drive, _, raw, rmse, _, drift, *_ = (cell.strip() for cell in line.strip("|").split("|"))
        if not drive.startswith("simulated"):
            pairs = zip(rmse.split("; "), drift.split("; "), strict=True)
            tuned = [(float(error), float(drifted)) for error, drifted in pairs]
            found[drive] = {
                "with truth": tuned[0],
                "without truth": tuned[1],
                "raw fixes": (float(raw), float("nan")),
            }
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
                [found[drive][method][i] for drive in found],
                range(len(found)), color=color, marker="osD"[k], s=45, label=method, zorder=3,
            )  # fmt: skip
        place.set_xlim(left=0)
        place.set_title(title, loc="left")
        place.grid(axis="both", color="0.9")
        place.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(range(len(found)), list(found))
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


if __name__ == "__main__":
    real_drives().savefig(IMAGES / "real-drives.png", dpi=110)
    with tempfile.TemporaryDirectory() as scratch:
        demo(Path(scratch) / "demo")
