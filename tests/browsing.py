"""Open pages in Chromium."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

CHROMIUM = next(
    (p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None
)
DRAWN = ".scatterlayer path.js-line, .scatterlayer path.point, g[id^=axes] path"


@contextmanager
def open_browser() -> Iterator[object]:
    """Yield a browser; skip the test if Chromium or Playwright is not installed."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: the page is not opened (apt-get install chromium)")
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed (dependency group test)"
    )
    with sync_api.sync_playwright() as playwright:
        sandbox = [] if os.geteuid() else ["--no-sandbox"]  # Chromium's sandbox does not work as root
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=sandbox)
        yield opened
        opened.close()


class Opened:
    """A page in the browser; records its console messages, errors, dialogs and requests."""

    def __init__(self, browser, file: Path, width: int) -> None:
        self.context = browser.new_context(viewport={"width": width, "height": 900})
        self.context.grant_permissions(["clipboard-read", "clipboard-write"])
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.complaints.append(f"{message.type}: {message.text}"))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("dialog", lambda dialog: self.complaints.append(f"dialog: {dialog.message}"))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(file.as_uri())
        self.page.wait_for_selector("body[data-ready]")

    def run(self, script: str):
        return self.page.evaluate(script)

    def settle(self) -> None:
        """Wait until two frames have been drawn."""
        self.run("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def drawn(self) -> list[int]:
        """Return the number of lines, points, bars and boxes of each chart (plotly.js or SVG)."""
        return self.run(
            f"[...document.querySelectorAll('.chart')].map((c) => c.querySelectorAll({DRAWN!r}).length)"
        )

    def width(self) -> float:
        """Return the right end of the page or of its widest chart, px from the left edge."""
        return self.run(
            "Math.max(document.documentElement.scrollWidth, ...[...document.querySelectorAll('.chart svg')]"
            ".map((s) => s.getBoundingClientRect().right))"
        )

    def width_on_paper(self, file: Path) -> float:
        """Print the page to a PDF file; return the width of the widest chart on paper, px."""
        self.page.pdf(path=file, format="A4")
        assert file.read_bytes().startswith(b"%PDF")
        self.page.emulate_media(media="print")
        self.settle()
        return self.run(
            "Math.max(...[...document.querySelectorAll('.chart svg')].map((s) => s.getBoundingClientRect().width))"
        )

    def check_silence(self) -> None:
        """Check that the page logged nothing, and requested no file except itself."""
        assert self.complaints == []
        assert len(self.requests) == 1
        assert self.requests[0].startswith("file:")
