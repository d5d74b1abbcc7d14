"""Header and navigation of the five pages, and the routes of reports and downloads."""

import io
import zipfile
from functools import partial
from importlib.resources import files
from urllib.parse import quote

from fastapi import Response
from fastapi.responses import HTMLResponse, PlainTextResponse
from nicegui import app, ui

import sigmaswarm
from sigmaswarm.workbench.check_page import CheckPage
from sigmaswarm.workbench.judge_page import JudgePage
from sigmaswarm.workbench.log_page import LogPage
from sigmaswarm.workbench.parts import Page, text
from sigmaswarm.workbench.runs import Runs
from sigmaswarm.workbench.state import Workbench, attempt
from sigmaswarm.workbench.take_page import TakePage
from sigmaswarm.workbench.tune_page import TunePage

STEPS = {
    "log": ("Log", "its content"),
    "check": ("Check", "faults, repairs, cuts"),
    "tune": ("Tune", "search the parameters"),
    "judge": ("Judge", "on drives that the tuning did not use"),
    "take": ("Take away", "C, ROS, Python, tracks"),
}
FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="7" fill="#0072b2"/>'
    '<path d="M6 24 L13 12 L19 19 L26 7" fill="none" stroke="#fff" stroke-width="3.2" stroke-linecap="round" '
    'stroke-linejoin="round"/></svg>'
)


class Frame:
    """Pages of the steps. All tabs share one page per step."""

    def __init__(self, bench: Workbench) -> None:
        self.bench, self.runs = bench, Runs(bench)
        self.pages: dict[str, Page] = {
            "log": LogPage(bench),
            "check": CheckPage(bench),
            "tune": TunePage(bench, self.runs),
            "judge": JudgePage(bench),
            "take": TakePage(bench),
        }

    def register(self) -> None:
        own = files("sigmaswarm.workbench")
        ui.add_css(own.joinpath("style.css").read_text(), shared=True)
        ui.add_head_html(f"<script>{own.joinpath('page.js').read_text()}</script>", shared=True)
        ui.page("/")(lambda: self._show(self._first()))
        for step in STEPS:
            ui.page(f"/{step}")(partial(self._show, step))
        app.get("/report/{kind}/{name}")(self._report)
        app.get("/download/{kind}/{name}")(self._download)

    def _first(self) -> str:
        """Return the last step with content."""
        if self.bench.log or not self.bench.drives:
            return "log"
        return "tune" if self.bench.finished or self.bench.unfinished else "check"

    def _show(self, step: str) -> None:
        title, about = STEPS[step]
        ui.page_title(f"{title} - sigmaswarm workbench")
        ui.colors(
            primary="#005f96", secondary="#4d4d4d", accent="#0072b2", positive="#00664d", negative="#a33c00"
        )
        with ui.header().classes("top"):
            ui.html(FAVICON.replace("<svg ", '<svg class="logo" aria-hidden="true" '), sanitize=False)
            ui.label("sigmaswarm workbench").classes("brand")
            with ui.element("nav").props('aria-label="Steps"'):
                for number, (key, (name, _)) in enumerate(STEPS.items(), 1):
                    link = ui.element("a").props(f'href="{key}"')
                    link.props('aria-current="page"' if key == step else "")
                    with link:
                        ui.label(str(number)).classes("number")
                        ui.label(name)
        with ui.element("div").classes("page"):
            with ui.element("div").classes("heading"):
                text("h1", f"{title}: {about}")
                ui.label(str(self.bench.folder)).classes("soft path")
            self.pages[step].show()

    def _report(self, kind: str, name: str) -> Response:
        page, wrong = attempt(self._page_of, kind, name)
        return PlainTextResponse(wrong, 404) if page is None else HTMLResponse(page)

    def _page_of(self, kind: str, name: str) -> str:
        """Return the page of a result, as `sigmaswarm report` writes it. Write a missing page first."""
        folder = self.bench.path(kind, name)
        file = folder / "page.html"
        if file.is_file() and not file.is_symlink():
            return file.read_text(encoding="utf-8")
        return sigmaswarm.report(folder, file)

    def _download(self, kind: str, name: str) -> Response:
        path, wrong = attempt(self.bench.path, kind, name)
        if path is None or not path.is_dir():
            return PlainTextResponse(wrong or f"no {kind} {name}", 404)
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(path.rglob("*")):
                if file.is_file() and not file.is_symlink() and path in file.resolve().parents:
                    archive.write(file, f"{name}/{file.relative_to(path)}")
        heads = {"content-disposition": f"attachment; filename*=UTF-8''{quote(name)}.zip"}
        return Response(packed.getvalue(), media_type="application/zip", headers=heads)
