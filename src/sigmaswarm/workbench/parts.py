"""Common elements of several steps."""

import json
from collections.abc import Callable, Coroutine
from contextlib import contextmanager
from typing import Any, TypeVar

from nicegui import background_tasks, run, ui

from sigmaswarm.workbench.state import attempt

T = TypeVar("T")


def start(work: Coroutine[Any, Any, None]) -> None:
    """Run work in the background; it continues if the tab is closed."""
    background_tasks.create(work)


async def aside(work: Callable[..., T], *arguments: Any, **options: Any) -> tuple[T | None, str]:
    """Run a function on a thread; return its result, or None and the message of its error."""
    return await run.io_bound(attempt, work, *arguments, **options) or (None, "")


def text(tag: str, content: str, classes: str = "") -> None:
    """Show a heading or a paragraph."""
    with ui.element(tag).classes(classes):
        ui.label(content)


def message(content: str, kind: str) -> None:
    """Show a sentence: bad, good, or wait with a spinner. Screen readers announce it."""
    if content:
        with ui.element("div").classes(f"message {kind}").props('role="status"'):
            if kind == "wait":
                ui.spinner(size="1.3em").props('aria-hidden="true"')
            ui.label(content)


def command(line: str) -> None:
    """Show a command with a button that copies it."""
    with ui.element("div").classes("command"):
        with ui.element("pre"):
            ui.label(line)
        copy = ui.button("Copy as command", icon="content_copy").props("outline no-caps")
        quoted = json.dumps(line).replace("<", "\\u003c")
        copy.on("click", js_handler=f"() => navigator.clipboard.writeText({quoted})")
        copy.on("click", lambda: ui.notify("copied", position="bottom"))


@contextmanager
def card(kind: str = ""):
    """A framed part of the page."""
    with ui.element("section").classes(f"card {kind}") as element:
        yield element


def table(heads: list[str], rows: list[list[str]]) -> None:
    """Show a plain table."""
    scrolled = ui.element("div").classes("wide").props('tabindex="0" role="region" aria-label="table"')
    with scrolled, ui.element("table").classes("plain"):
        with ui.element("thead"), ui.element("tr"):
            for head in heads:
                with ui.element("th").props('scope="col"'):
                    ui.label(head)
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    for cell in row:
                        with ui.element("td"):
                            ui.label(cell)


def button(label: str, on_click: Callable[[], Any], icon: str = "", *, main: bool = False) -> ui.button:
    """A button; ``main`` marks the next step."""
    made = ui.button(label, on_click=on_click, icon=icon or None)
    return made.props("unelevated" if main else "outline")


def link(label: str, href: str, *, download: bool = False) -> None:
    """A link within the workbench."""
    with ui.element("a").props(f'href="{href}"' + (" download" if download else "")).classes("plain"):
        ui.label(label)


def number(value: float | None) -> str:
    """A number for people."""
    if value is None:
        return ""
    return f"{value:.10g}" if abs(value) >= 1e6 else f"{value:.5g}"
