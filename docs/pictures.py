"""Draw the pictures of the docs again: `make pictures`.

The picture of the demo is drawn by the demo, the picture of the workbench is a browser's screenshot, and the picture of
the results is drawn from the first table of results.md.
"""

import json
import signal
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from shutil import copyfile

from matplotlib.figure import Figure

import sigmaswarm
from sigmaswarm.importing.mounting import parse_mount

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"
DEMO = {"trajectory.png": "demo-track.png"}
MOUNT = "4,-38,20"
HIDDEN = ".heading, section.card:not(:has(.sketch)), .section:not(:has(.plot)), .q-expansion-item.card"
"""CSS selectors of elements that the picture of the workbench omits."""
METHODS = {"with truth": "#0072b2", "without truth": "#d55e00", "raw fixes": "#009e73"}


def demo(folder: Path) -> None:
    """Run the demo and copy its pictures in `DEMO`."""
    subprocess.run([sys.executable, "-m", "sigmaswarm", "demo", "--out", str(folder)], check=True)
    for made, kept in DEMO.items():
        copyfile(folder / "figures" / made, IMAGES / kept)


def workbench(folder: Path) -> None:
    """Take a screenshot of the workbench's first step, with the log of a rotated IMU and its mounting."""
    sys.path.insert(0, str(DOCS.parent / "tests"))
    from browsing import open_browser

    drive = sigmaswarm.simulate("urban", gps="f9p-rtk", duration=240.0)
    turned = {}
    for names in (("ax", "ay", "az"), ("gx", "gy", "gz")):
        axes = parse_mount(MOUNT).T @ [getattr(drive.imu, name) for name in names]
        turned |= dict(zip(names, axes, strict=True))
    log = sigmaswarm.write_drive(replace(drive, imu=replace(drive.imu, **turned)), folder / "log").resolve()
    (folder / "bench").mkdir()
    choices = {"logs": {str(log): {"mount": MOUNT}}}
    (folder / "bench" / "workbench.json").write_text(json.dumps(choices))
    command = [sys.executable, "-m", "sigmaswarm", "workbench", str(log), "--no-browser", "--out"]
    server = subprocess.Popen([*command, str(folder / "bench")], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        with open_browser() as browser:
            page = browser.new_page(viewport={"width": 1228, "height": 1056})
            page.goto(server.stdout.readline().removeprefix("workbench: ").strip())
            page.get_by_text("Agreement of the IMU with the fixes").wait_for(timeout=120_000)
            page.add_style_tag(content=f"{HIDDEN} {{ display: none }}")
            page.wait_for_timeout(10_000)  # the plots are drawn one after the other
            page.screenshot(path=IMAGES / "workbench.png")
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(30)


def held_out() -> dict[str, dict[str, tuple[float, float]]]:
    """Read position RMSE and 5 s drift, m, by real drive and tuning from the first table of docs/results.md."""
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
    """Draw position RMSE and drift on the real test drives."""
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
        workbench(Path(scratch))
