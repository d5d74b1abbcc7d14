"""Pages and web server of the workbench, for this machine only; all addresses contain a secret token."""

import hmac
import io
import logging
import secrets
import socket
import warnings
import webbrowser
import zipfile
from collections.abc import Awaitable, Callable, MutableMapping
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

import uvicorn
from fastapi import FastAPI, Response
from fastapi.responses import HTMLResponse, PlainTextResponse
from nicegui import app, ui

import sigmaswarm
from sigmaswarm import InputError, SigmaswarmWarning
from sigmaswarm.workbench.check_page import CheckPage
from sigmaswarm.workbench.elements import Page, box, text
from sigmaswarm.workbench.evaluate_page import EvaluatePage
from sigmaswarm.workbench.export_page import ExportPage
from sigmaswarm.workbench.log_page import LogPage
from sigmaswarm.workbench.state import MAX_UPLOAD_SIZE, TOO_LARGE, Workbench, attempt
from sigmaswarm.workbench.tune_page import TunePage
from sigmaswarm.workbench.tuning_runs import TuningRuns

STEPS = {
    "log": ("Log", "content and import"),
    "check": ("Check", "faults, repairs, cuts"),
    "tune": ("Tune", "search for parameters"),
    "evaluate": ("Evaluate", "errors on drives that the tuning did not use"),
    "export": ("Export", "C, ROS, Python, trajectories"),
}
FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="7" fill="#0072b2"/>'
    '<path d="M6 24 L13 12 L19 19 L26 7" fill="none" stroke="#fff" stroke-width="3.2" stroke-linecap="round" '
    'stroke-linejoin="round"/></svg>'
)


class Frame:
    """Pages of the steps; all tabs share one page per step."""

    def __init__(self, bench: Workbench) -> None:
        self.bench, self.runs = bench, TuningRuns(bench)
        self.pages: dict[str, Page] = {
            "log": LogPage(bench),
            "check": CheckPage(bench),
            "tune": TunePage(bench, self.runs),
            "evaluate": EvaluatePage(bench),
            "export": ExportPage(bench),
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
        with box("page"):
            with box("heading"):
                text("h1", f"{title}: {about}")
                ui.label(str(self.bench.folder)).classes("soft path")
            self.pages[step].show()

    def _report(self, kind: str, name: str) -> Response:
        page, wrong = attempt(self._page_of, kind, name)
        return PlainTextResponse(wrong, 404) if page is None else HTMLResponse(page)

    def _page_of(self, kind: str, name: str) -> str:
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


HOST = "127.0.0.1"
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Scope]]
Send = Callable[[Scope], Awaitable[None]]


class Guard:
    """Refuse requests without the token, with another host or origin, or of more than `MAX_UPLOAD_SIZE` bytes."""

    def __init__(self, app: Any, token: str, port: int) -> None:
        self.app, self.prefix, self.hosts = app, f"/{token}/", {f"{HOST}:{port}", f"localhost:{port}"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = {key: value.decode("latin-1") for key, value in scope["headers"]}
        origin = headers.get(b"origin", "").removeprefix("http://")
        known = hmac.compare_digest(f"{scope['path']}/"[: len(self.prefix)].encode(), self.prefix.encode())
        code, remedy = 0, ""
        if not known or headers.get(b"host") not in self.hosts or (origin and origin not in self.hosts):
            code, remedy = 403, "open the whole address that sigmaswarm workbench printed"
        elif int(headers.get(b"content-length", "0") or 0) > MAX_UPLOAD_SIZE:
            code, remedy = 413, f"the upload is {TOO_LARGE}"
        if code:
            await PlainTextResponse(f"{code}: {remedy}", code)(scope, receive, send)
        else:
            await self.app(scope, self._bounded(receive), self._with_headers(send))

    @staticmethod
    def _bounded(receive: Receive) -> Receive:
        """Disconnect after `MAX_UPLOAD_SIZE` bytes, since the header may state a wrong length."""
        size = 0

        async def counted() -> Scope:
            nonlocal size
            message = await receive()
            size += len(message.get("body", b""))
            return {"type": "http.disconnect"} if size > MAX_UPLOAD_SIZE else message

        return counted

    @staticmethod
    def _with_headers(send: Send) -> Send:
        """Add headers that keep the token out of referrers and prevent other sites from embedding the page."""

        async def sent(message: Scope) -> None:
            if message["type"] == "http.response.start":
                more = [(b"referrer-policy", b"no-referrer"), (b"x-content-type-options", b"nosniff")]
                message["headers"] = [*message["headers"], *more, (b"x-frame-options", b"SAMEORIGIN")]
            await send(message)

        return sent


def serve(folder: Path, logs: list[Path], *, port: int = 0, browse: bool = True) -> None:
    bench = Workbench(folder, logs)
    warnings.simplefilter("ignore", SigmaswarmWarning)  # the page shows notes and findings
    logging.getLogger("nicegui").setLevel(logging.ERROR)  # NiceGUI warns if the machine is busy
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((HOST, port))
        listening.listen()
    except OSError as error:
        raise InputError(
            f"--port {port}: {error.strerror or error}; omit --port, or specify another port"
        ) from None
    token, port = secrets.token_urlsafe(24), listening.getsockname()[1]
    app, frame = FastAPI(docs_url=None, redoc_url=None, openapi_url=None), Frame(bench)
    frame.register()
    ui.run_with(
        app,
        mount_path=f"/{token}",
        title="sigmaswarm workbench",
        favicon=FAVICON,
        language="en-US",
        reconnect_timeout=30.0,
        tailwind=False,
        show_welcome_message=False,
    )
    address = f"http://{HOST}:{port}/{token}/"
    print(f"workbench: {address}\nfolder:    {bench.folder}", flush=True)
    print("stop with Ctrl+C; all results are saved", flush=True)
    if browse:
        webbrowser.open(address)
    config = uvicorn.Config(Guard(app, token, port), log_level="error", ws_max_size=16_000_000)
    config.timeout_graceful_shutdown = 2
    try:
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        frame.runs.stop_all()
