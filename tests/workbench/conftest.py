"""A workbench server, and a browser for its pages."""

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from processes import Process
from support import require

require("nicegui", "NiceGUI is not installed (extra workbench)")

SERVER = """
import os, threading, time
timer = threading.Timer(240.0, os._exit, (1,))  # however its test ends
timer.daemon = True
timer.start()
from sigmaswarm.cli import main
if PAUSE:
    from sigmaswarm.tuning.search import TrialRunner
    generation = TrialRunner._generation
    TrialRunner._generation = lambda *given: time.sleep(PAUSE) or generation(*given)
main()
"""
SMALL = {"model": "planar5", "particles": 8, "generations": 4}
"""Options of a tuning that takes one second."""
AT_REST = """document.addEventListener("DOMContentLoaded", () => {
  const style = document.createElement("style");
  style.textContent = "*, ::before, ::after { animation: none !important; transition: none !important; }";
  document.head.append(style);
});"""
"""Without animations: a browser without a graphics card draws the whole page for each frame of a spinner."""


class Served:
    """A server in a separate process; ``pause`` is the time before each generation, s."""

    def __init__(self, folder: Path, *logs: Path, pause: float = 0.0, **choices: Any) -> None:
        folder.mkdir(exist_ok=True)
        self.folder, saved = folder, folder / "workbench.json"
        if not saved.exists():
            saved.write_text(json.dumps({"options": SMALL, **choices}))
        arguments = ["workbench", *logs, "--out", folder, "--no-browser"]
        program = SERVER.replace("PAUSE", str(pause))
        self.process = Process(program, arguments, imports="sigmaswarm.workbench.server")
        self.url = self.process.line().removeprefix("workbench: ").strip()
        self.port = int(self.url.split(":")[2].partition("/")[0])

    def end(self, how: signal.Signals = signal.SIGINT) -> int:
        if self.process.poll() is None:
            self.process.kill(how)
        return self.process.wait(30)


@pytest.fixture
def serve() -> Iterator[Any]:
    """Start servers, which end with the test."""
    served: list[Served] = []

    def start(*arguments: Any, **choices: Any) -> Served:
        served.append(Served(*arguments, **choices))
        return served[-1]

    yield start
    for one in served:
        one.end()


@pytest.fixture
def tab(browser: Any) -> Iterator[Any]:
    """Open tabs; the test fails if a page has an error or sends a request to another host."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    context.set_default_timeout(60_000)
    context.add_init_script(AT_REST)
    wrong: list[str] = []

    def opened(url: str) -> Any:
        page = context.new_page()
        page.on(
            "pageerror", lambda e: wrong.append(str(e)) if "Resize must be passed" not in str(e) else None
        )
        page.on(
            "request",
            lambda r: wrong.append(r.url) if "://127.0.0.1" not in r.url[:24] and ":" in r.url[:6] else None,
        )
        page.goto(url)
        page.wait_for_selector(".page")
        return page

    yield opened
    context.close()
    assert [w for w in wrong if not w.startswith(("data:", "blob:"))] == []
