"""Measure the workbench in a browser: opening a log, drawing and zooming the plots of each step; memory of the server.

    python benchmarks/workbench_pages.py --minutes 10
    python benchmarks/workbench_pages.py --minutes 60

The log is a simulated drive with all axes at 100 Hz. Prints wall times, followed by the processor times of the server
and of the browser process of the page; the sum of these two is about the wall time on an idle machine. Needs Chromium.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import sigmaswarm

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from browsing import open_browser

DRAWN = """() => { const all = [...document.querySelectorAll('.js-plotly-plot')];
  return all.length > 0 && all.every(p => p.querySelector('.main-svg .trace, .main-svg .scatterlayer')) }"""
WATCH = """p => { const before = p.data[0].x; p.seen = null;
  p.on('plotly_afterplot', () => { if (p.data[0].x !== before) p.seen = true }) }"""


def processes(pid: int) -> list[int]:
    """Return a process and its running descendants."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:  # it has ended
        return []
    return [pid, *(one for child in children for one in processes(int(child)))]


def processor_time(pid: int) -> float:
    """Return user plus system time, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory(pid: int, which: str) -> float:
    """Return the memory of a process, MB; ``which``: VmRSS (now) or VmHWM (peak)."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(which))


class Clock:
    """Clock that prints the times of steps."""

    def __init__(self, server: int) -> None:
        self.server = server

    def measure(self, what: str, act: Callable[[], Any]) -> None:
        begin, start = self._now(), time.perf_counter()
        act()
        passed = time.perf_counter() - start
        server, page = (b - a for a, b in zip(begin, self._now(), strict=True))
        print(f"{what:34} {passed:6.2f} s   server {server:5.2f} s   page {page:5.2f} s", flush=True)

    def _now(self) -> tuple[float, float]:
        """Return the processor times of the server and of the browser process of the page, s."""
        own = [
            p for p in processes(os.getpid()) if b"--type=renderer" in Path(f"/proc/{p}/cmdline").read_bytes()
        ]
        return processor_time(self.server), sum(map(processor_time, own))


def settle(page: Any) -> None:
    """Wait until all data are read and all plots are drawn."""
    page.wait_for_function("!document.querySelector('.message.wait')", polling=100)
    page.wait_for_function(DRAWN, polling=100)


def zoom(page: Any, clock: Clock) -> None:
    """Zoom each plot over time by dragging over its middle third; wait until the detail is drawn."""
    for plot in page.locator(".js-plotly-plot").all():
        label = plot.evaluate("p => (p.closest('[aria-label]') || p).ariaLabel || ''")
        if (
            "time" not in plot.locator(".xtitle").text_content()
            or plot.evaluate("p => p.layout.dragmode") != "zoom"
        ):
            continue
        plot.scroll_into_view_if_needed()
        box = plot.locator(".nsewdrag").first.bounding_box()
        plot.evaluate(WATCH)
        page.mouse.move(box["x"] + box["width"] / 3, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.mouse.move(box["x"] + 2 * box["width"] / 3, box["y"] + box["height"] / 2, steps=4)
        handle = plot.element_handle()

        def released(handle: Any = handle) -> None:
            page.mouse.up()
            page.wait_for_function("p => p.seen", arg=handle)

        clock.measure(f"  zoom: {label.partition(':')[0]}", released)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    minutes = parser.parse_args().minutes
    with tempfile.TemporaryDirectory() as scratch, open_browser() as browser:
        log = Path(scratch) / "log"
        sigmaswarm.write_drive(sigmaswarm.simulate("urban", gps="white-1m", duration=60 * minutes), log)
        command = [sys.executable, "-m", "sigmaswarm", "workbench", str(log), "--no-browser", "--out"]
        server = subprocess.Popen([*command, f"{scratch}/bench"], stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        url = server.stdout.readline().removeprefix("workbench: ").strip()
        clock, page = Clock(server.pid), browser.new_page()
        page.set_default_timeout(120_000)

        def opened(step: str) -> None:
            page.goto(url + step)
            page.wait_for_selector(".page")
            page.wait_for_timeout(300)
            settle(page)

        try:
            page.goto(f"{url}judge")  # loads the files of NiceGUI
            clock.measure("log: read, looked at and drawn", lambda: opened("log"))
            for _ in range(2):
                clock.measure("log: drawn again", lambda: opened("log"))
            zoom(page, clock)
            page.get_by_role("button", name="Make the drive").click()
            page.get_by_role("link", name="Next: check the drive").wait_for()
            clock.measure("check: read, checked and drawn", lambda: opened("check"))
            clock.measure("check: drawn again", lambda: opened("check"))
            zoom(page, clock)
            now, most = memory(server.pid, "VmRSS"), memory(server.pid, "VmHWM")
            print(f"memory of the server: {now:.0f} MB now, {most:.0f} MB at most")
        finally:
            server.send_signal(signal.SIGINT)
            server.wait(30)


if __name__ == "__main__":
    main()
