"""The steps one by one: faults next to their columns, repairs and their removal, keyboard, contrast."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sigmaswarm
from sigmaswarm.drives.drive import Imu
from support import make_drive
from workbench.conftest import SMALL
from workbench.test_road import DURATION, drop, expect, odd_csv

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")


def wrong_sign(folder: Path) -> Path:
    """Write a drive whose gyro has the wrong sign."""
    drive = make_drive(duration=DURATION, gps_rate=5.0, seed=3, name="monday")
    imu = Imu(drive.imu.time, drive.imu.ax, drive.imu.ay, -drive.imu.gz)
    return sigmaswarm.write_drive(replace(drive, imu=imu), folder / "drives" / "monday")


def contrast_of(page: Any) -> list[str]:
    """Return the violations that an accessibility checker finds."""
    rules = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21aa"]}}
    found = axe.Axe().run(page, options=rules).response["violations"]
    return [f"{v['id']}: {n['html'][:200]}" for v in found for n in v["nodes"]]


def tab_to(page: Any, name: str) -> None:
    """Press Tab until an element with this name has the focus."""
    name_of = "e => e === document.body ? '' : e.getAttribute('aria-label') || e.innerText"
    focused = f"({name_of})(document.activeElement.closest('[role=slider]') || document.activeElement)"
    for _ in range(60):
        page.keyboard.press("Tab")
        if any(line.startswith(name) for line in page.evaluate(focused).split("\n")):
            return
    raise AssertionError(f"Tab does not lead to {name}")


def test_cuts(tmp_path: Path, serve: Any, tab: Any):
    """One click repairs or cuts a copy, another tab reverts it, both tabs show this, and the original stays."""
    original = wrong_sign(tmp_path / "bench")
    before = (original / "imu.csv").read_bytes()
    served = serve(tmp_path / "bench")
    page, other = tab(served.url + "check"), tab(served.url + "check")
    page.get_by_role("button", name="Repair: gyro-sign").click()
    for one in (page, other):
        one.get_by_text("repaired: gyro-sign").wait_for()
    page.get_by_role("heading", name="No serious finding").wait_for()
    checked = original.with_name("monday-checked")
    mended = sigmaswarm.read_drive(checked)
    np.testing.assert_allclose(mended.imu.gz, -sigmaswarm.read_drive(original).imu.gz)
    page.get_by_label("to, s").fill("40")
    page.get_by_role("button", name="Keep only this part").click()
    page.get_by_text("kept only 0 to 40 s").wait_for()
    assert sigmaswarm.read_drive(checked).duration == pytest.approx(40.0, abs=0.1)
    other.get_by_role("button", name="Undo: repaired: gyro-sign").click()
    page.get_by_role("button", name="Repair: gyro-sign").wait_for()
    assert (sigmaswarm.read_drive(checked).imu.gz == sigmaswarm.read_drive(original).imu.gz[:4000]).all()
    page.get_by_role("button", name="Undo: kept").click()
    page.get_by_text("kept only").wait_for(state="hidden")
    assert not checked.exists()
    assert (original / "imu.csv").read_bytes() == before
    page.get_by_label("from, s").fill("20")
    page.get_by_label("to, s").fill("25")
    page.get_by_role("button", name="Remove this part").click()
    page.get_by_text("wrote drives/monday-before and drives/monday-after").wait_for()
    first, last = (sigmaswarm.read_drive(f"{original}-{part}").imu.time for part in ("before", "after"))
    assert first[-1] < 20.0
    assert last[0] >= 25.0
    page.goto(served.url + "tune")
    expect(page.get_by_role("combobox", name="monday", exact=True)).to_have_value("leave it out")
    page.get_by_text("Filter: planar5").wait_for()
    page.bring_to_front()  # a list opens only in the active tab
    page.get_by_role("combobox", name="Measurements").click()
    for name in ("lateral", "robust"):  # the list stays open
        option = page.get_by_role("option", name=name, exact=True)
        option.click()
        expect(option).to_have_attribute("aria-selected", "true")
    page.keyboard.press("Escape")
    page.get_by_text("Filter: planar5 with lateral, robust").wait_for()


def test_broken_log_and_faults(tmp_path: Path, serve: Any, tab: Any):
    """A broken file causes one line; a fault is shown next to the column that it concerns."""
    served = serve(tmp_path / "bench")
    page = tab(served.url)
    broken = tmp_path / "broken.csv"
    broken.write_bytes(b"\x00\xff" * 500)
    page.locator("input[type=file]").first.set_input_files(broken)
    expect(page.locator(".message.bad")).to_contain_text("broken.csv")
    (file,) = odd_csv(tmp_path / "odd")[1:]
    frame = pl.read_csv(file).rename({"vorn": "ax", "seite": "ay", "dreh": "gz"})
    frame = frame.with_columns((pl.col("gz") * 131).round().cast(pl.Int64))
    frame.write_csv(file)
    drop(page, sorted(file.parent.iterdir()))
    row = page.locator(".column-row", has=page.get_by_text("gz", exact=True))
    expect(row.locator(".wrong")).to_contain_text("gz")  # once, although the import reports it, too
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    expect(page.locator(".message.bad")).to_be_in_viewport()
    expect(page.get_by_role("button", name="Make the drive")).to_be_disabled()


def test_keyboard_alone_and_contrast(tmp_path: Path, serve: Any, tab: Any):
    """All five steps work with the keyboard only; the checker finds no violation on any page."""
    drive = make_drive(duration=DURATION, gps_rate=5.0, seed=3, name="monday")
    assert drive.truth is not None
    turned = replace(drive.truth, theta=drive.truth.theta + 8 * np.pi)
    log = sigmaswarm.write_drive(replace(drive, truth=turned), tmp_path / "log")
    sigmaswarm.tune(drive, out=tmp_path / "bench" / "tunings" / "monday", **SMALL)
    served = serve(tmp_path / "bench", log, logs={str(log): {"mount": "0,0,0.5"}})
    page = tab(served.url + "log")
    page.get_by_text(
        "truth: the heading is converted from unwrapped radians"
    ).wait_for()  # a note of the import
    page.get_by_role("button", name="Make the drive").wait_for()
    assert contrast_of(page) == []
    tab_to(page, "yaw, degrees")
    for angle in (1.5, 2.5, 3.5):
        page.keyboard.press("ArrowRight")
        page.get_by_text(f"yaw {angle}°").wait_for()
    expect(page.locator("pre")).to_contain_text("--mount=0,0,3.5")
    tab_to(page, "Make the drive")
    page.keyboard.press("Enter")
    page.get_by_text("wrote drives/log").wait_for()
    tab_to(page, "Next: check the drive")
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="Cut", exact=True).wait_for()
    assert contrast_of(page) == []
    tab_to(page, "to, s")
    page.keyboard.press("Control+A")
    page.keyboard.type("50")
    tab_to(page, "Keep only this part")
    page.keyboard.press("Enter")
    page.get_by_text("kept only 0 to 50 s").wait_for()
    tab_to(page, "Next: tune")
    page.keyboard.press("Enter")
    page.get_by_text("Filter: planar5").wait_for()
    assert contrast_of(page) == []
    tab_to(page, "Start")
    page.keyboard.press("Enter")
    page.get_by_role("cell", name="log", exact=True).wait_for()
    page.set_viewport_size({"width": 390, "height": 844})
    cells = page.locator("table.stacks td").all()
    assert len({cell.bounding_box()["x"] for cell in cells}) == 1  # the cells form one column
    assert contrast_of(page) == []
    page.set_viewport_size({"width": 1280, "height": 900})
    for step, name, do, done in (
        ("evaluate", "Evaluate", "Evaluate this filter", "Next: export the filter"),
        ("export", "Next: export the filter", "Write Python", "wrote 1 file to"),
    ):
        tab_to(page, name)
        page.keyboard.press("Enter")
        page.wait_for_url(f"**/{step}")
        page.get_by_role("combobox", name="Filter").wait_for()
        assert contrast_of(page) == []
        tab_to(page, do)
        page.keyboard.press("Enter")
        page.get_by_text(done).wait_for()
    expect(page.locator("pre")).to_contain_text(f"{tmp_path / 'bench' / 'drives' / 'log'}")


def test_envelope_keeps_all_peaks():
    """An hour at 100 Hz is drawn with a few points per pixel, and no peak is lost."""
    from sigmaswarm.workbench import plots

    time = np.arange(360_000) / 100.0
    values = np.sin(time)
    values[123_456] = 50.0
    t, v = plots.envelope((time, values))
    assert len(t) == len(v) <= 2 * plots.PIXELS
    assert v.max() == 50.0
    assert v.min() == values.min()
    t, v = plots.envelope((time, values), 1234.0, 1235.0)
    assert len(t) == 103
    np.testing.assert_array_equal(v, values[123_399:123_502])
