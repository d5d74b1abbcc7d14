"""Access to the workbench, readable files, and the size of uploads."""

import asyncio
import http.client
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import sigmaswarm
from sigmaswarm import InputError
from sigmaswarm.cli.workbench import workbench
from sigmaswarm.workbench.state import MAX_UPLOAD_SIZE, Workbench
from support import make_drive

UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}


def ask(port: int, path: str, method: str = "GET", **headers: str) -> tuple[int, str]:
    """Return status and body of the response."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.putrequest(method, path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read(100_000).decode(errors="replace") if answer.status != 101 else ""
    connection.close()
    return answer.status, body


def test_guard(tmp_path: Path, serve: Any):
    """Without the token, no page, file or socket is served; with the token, no file outside the folder is served."""
    bench = tmp_path / "bench"
    sigmaswarm.write_drive(make_drive(duration=12.0, name="monday"), bench / "drives" / "monday")
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "drive.toml").write_text("secret")
    (bench / "drives" / "stolen").symlink_to(tmp_path / "secret")
    (bench / "drives" / "monday" / "link.csv").symlink_to(tmp_path / "secret" / "drive.toml")
    served = serve(bench)
    port, token = served.port, served.url.rstrip("/").rpartition("/")[2]
    socket = "_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    page = f"/{token}/tune"
    for prefix in ("", "wrong/", f"{token[:-1]}/", f"{token}x/"):
        for path in (
            "",
            "log",
            "download/drives/monday",
            "report/tunings/monday",
            socket,
            "_nicegui/client/x/upload/3",
        ):
            assert ask(port, f"/{prefix}{path}")[0] == 403, (prefix, path)
        assert ask(port, f"/{prefix}{socket}", **UPGRADE)[0] == 403
    assert ask(port, f"/{token}/{socket}&implicit_handshake=true", **UPGRADE)[0] == 101
    assert ask(port, page)[0] == 200
    assert ask(port, page, Host="evil.example")[0] == 403
    assert ask(port, page, Origin="http://evil.example")[0] == 403
    assert ask(port, f"/{token}/{socket}", **UPGRADE, Origin=f"http://127.0.0.1:{port + 1}")[0] == 403
    assert ask(port, f"/{token}/x", "POST", Content_Length=str(MAX_UPLOAD_SIZE + 1))[0] == 413
    for name in ("stolen", "..%2fdrives%2fmonday", "%2e%2e", "..", ".hidden", "none"):
        status, body = ask(port, f"/{token}/download/drives/{name}")
        assert status == 404, name
        assert "secret" not in body.replace(str(tmp_path), "")
    status, packed = ask(port, f"/{token}/download/drives/monday")
    assert status == 200
    assert "drive.toml" in packed
    assert "link.csv" not in packed


def test_a_body_without_a_length_is_bounded(monkeypatch: pytest.MonkeyPatch):
    """An upload in chunks is ended when it is too long."""
    from sigmaswarm.workbench import server

    async def chunk() -> dict[str, Any]:
        return {"type": "http.request", "body": b"1234"}

    async def taken() -> list[str]:
        receive = server.Guard._bounded(chunk)
        return [(await receive())["type"] for _ in range(3)]

    monkeypatch.setattr(server, "MAX_UPLOAD_SIZE", 10)
    with ThreadPoolExecutor(1) as pool:  # this thread may contain an event loop of a browser test
        ended = pool.submit(lambda: asyncio.run(taken())).result()
    assert ended == ["http.request", "http.request", "http.disconnect"]


def test_names_and_sources(tmp_path: Path):
    """Paths outside the folder are rejected, a damaged file of choices is ignored, and a missing log is one line."""
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench" / "workbench.json").write_text("{broken")
    bench = Workbench(tmp_path / "bench")
    for kind, name in (
        ("drives", "../x"),
        ("drives", "/etc"),
        ("drives", ".."),
        ("secrets", "x"),
        ("drives", "a\nb"),
    ):
        with pytest.raises(InputError):
            bench.path(kind, name)
    assert bench.free("drives", "../a b") == "a-b"
    assert bench.sources == []
    (bench.folder / "logs" / "link").symlink_to("/etc")
    bench.choices["log"] = "/etc/hostname"
    assert bench.log is None
    with pytest.raises(InputError, match="does not exist"):
        Workbench(tmp_path / "bench", [tmp_path / "none"])


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch):
    """The error names what to install."""
    monkeypatch.setattr("sigmaswarm.cli.workbench.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'sigmaswarm\[workbench\]'"):
        workbench()
