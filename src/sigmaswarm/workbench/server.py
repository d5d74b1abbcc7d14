"""Web server of the workbench, for this machine only; all addresses contain a secret token."""

import hmac
import logging
import secrets
import socket
import warnings
import webbrowser
from collections.abc import Awaitable, Callable, MutableMapping
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI
from fastapi.responses import PlainTextResponse
from nicegui import ui

from sigmaswarm import InputError, SigmaswarmWarning
from sigmaswarm.workbench.frame import FAVICON, Frame
from sigmaswarm.workbench.state import MOST_UPLOADED, Workbench

HOST = "127.0.0.1"
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Scope]]
Send = Callable[[Scope], Awaitable[None]]


class Guard:
    """Refuse requests without the token, from pages of other hosts, or with a body above `MOST_UPLOADED`."""

    def __init__(self, app: Any, token: str, port: int) -> None:
        self.app, self.prefix, self.hosts = app, f"/{token}/", {f"{HOST}:{port}", f"localhost:{port}"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = {key: value.decode("latin-1") for key, value in scope["headers"]}
        origin = headers.get(b"origin", "").removeprefix("http://")
        known = hmac.compare_digest(f"{scope['path']}/"[: len(self.prefix)].encode(), self.prefix.encode())
        if not known or headers.get(b"host") not in self.hosts or (origin and origin not in self.hosts):
            refusal = PlainTextResponse("403: the address needs the workbench's token", 403)
            await refusal(scope, receive, send)
        elif int(headers.get(b"content-length", "0") or 0) > MOST_UPLOADED:
            refusal = PlainTextResponse(
                "413: the upload is larger than 2 GB; open the log from the command line: sigmaswarm workbench LOG",
                413,
            )
            await refusal(scope, receive, send)
        else:
            await self.app(scope, self._bounded(receive), self._with_headers(send))

    @staticmethod
    def _bounded(receive: Receive) -> Receive:
        """Disconnect after `MOST_UPLOADED` bytes, since a header may state another length."""
        taken = 0

        async def counted() -> Scope:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            return {"type": "http.disconnect"} if taken > MOST_UPLOADED else message

        return counted

    @staticmethod
    def _with_headers(send: Send) -> Send:
        """Keep the token out of referrers, and forbid other sites to embed the page."""

        async def sent(message: Scope) -> None:
            if message["type"] == "http.response.start":
                more = [(b"referrer-policy", b"no-referrer"), (b"x-content-type-options", b"nosniff")]
                message["headers"] = [*message["headers"], *more, (b"x-frame-options", b"SAMEORIGIN")]
            await send(message)

        return sent


def serve(folder: Path, logs: list[Path], *, port: int = 0, browse: bool = True) -> None:
    bench = Workbench(folder, logs)
    warnings.simplefilter("ignore", SigmaswarmWarning)  # the page shows notes and findings
    logging.getLogger("nicegui").setLevel(logging.ERROR)  # NiceGUI would also warn of a busy machine
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
    print(
        f"workbench: {address}\nfolder:    {bench.folder}\nstop with Ctrl+C; all results are saved",
        flush=True,
    )
    if browse:
        webbrowser.open(address)
    config = uvicorn.Config(
        Guard(app, token, port), log_level="error", ws_max_size=16_000_000, timeout_graceful_shutdown=2
    )
    try:
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        frame.runs.stop_all()
