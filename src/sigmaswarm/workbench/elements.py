"""Base class of the pages, which runs work in the background, and elements of pages."""

import asyncio
import json
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from nicegui import background_tasks, run, ui

from sigmaswarm.workbench.state import Workbench, attempt

T = TypeVar("T")
REQUEST_DELAY = 0.1  # s until a request starts, if no new request replaces it


class Page:
    """The page of a step, which all tabs share.

    ``waiting`` is the work in progress, ``wrong`` the message of the last error.
    """

    def __init__(self, bench: Workbench) -> None:
        self.bench = bench
        self.waiting = self.wrong = ""
        self._latest = 0

    @ui.refreshable_method
    def show(self) -> None:
        self.content()

    def content(self) -> None:
        """Create the content of the page."""

    def refresh(self) -> None:
        self.show.refresh()

    def start(
        self, waiting: str, work: Callable[..., T], *arguments: Any, then: Callable[[T | None], Any]
    ) -> None:
        """Run ``work`` in a thread that continues after the tab is closed. Only the latest request's result is used.

        ``then`` receives the result, or None after an error. After an error, ``wrong`` contains the message.
        """
        self.waiting, self._latest = waiting, self._latest + 1
        background_tasks.create(self._work(self._latest, work, arguments, then))

    async def _work(self, number: int, work: Callable[..., T], arguments: Any, then: Any) -> None:
        await asyncio.sleep(REQUEST_DELAY)
        if number != self._latest:
            return
        result, wrong = await run.io_bound(attempt, work, *arguments) or (None, "")
        if number == self._latest:
            self.waiting, self.wrong = "", wrong
            then(result)

    def messages(self) -> None:
        message(self.waiting, "wait")
        message(self.wrong, "bad")


def text(tag: str, content: str, classes: str = "") -> None:
    with ui.element(tag).classes(classes):
        ui.label(content)


def message(content: str, kind: str) -> None:
    """Show a message, which screen readers also announce. ``kind`` is bad, good, or wait (with a spinner)."""
    if content:
        with box(f"message {kind}").props('role="status"'):
            if kind == "wait":
                ui.spinner(size="1.3em").props('aria-hidden="true"')
            ui.label(content)


def command(line: str) -> None:
    with box("command"):
        text("pre", line)
        copy = ui.button("Copy as command", icon="content_copy").props("outline no-caps")
        quoted = json.dumps(line).replace("<", "\\u003c")
        copy.on("click", js_handler=f"() => navigator.clipboard.writeText({quoted})")
        copy.on("click", lambda: ui.notify("copied", position="bottom"))


@contextmanager
def card(kind: str = ""):
    with ui.element("section").classes(f"card {kind}") as element:
        yield element


def box(classes: str = "") -> ui.element:
    return ui.element("div").classes(classes)


def line(classes: str = "") -> ui.element:
    return box(f"line {classes}")


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], classes: str = "") -> None:
    """Create a table that scrolls sideways. With the class "stacks", a narrow page stacks the cells of a row."""
    scrolled = box("wide").props('tabindex="0" role="region" aria-label="table"')
    with scrolled, ui.element("table").classes(f"plain {classes}"):
        with ui.element("thead"), ui.element("tr"):
            for head in heads:
                with ui.element("th").props('scope="col"'):
                    ui.label(head)
        with ui.element("tbody"):
            for row in rows:
                with ui.element("tr"):
                    for head, cell in zip(heads, row, strict=True):
                        with ui.element("td") as made:
                            made.props["data-head"] = head
                            ui.label(cell)


def select(label: str, options: Any, value: Any, choose: Callable[[Any], Any], **more: Any) -> ui.select:
    """Create a dropdown. ``choose`` receives the new value. Nothing is selected if no option has the given value.

    With ``multiple``, ``choose`` is called when the user closes the list.
    """
    known, several = isinstance(value, list) or value in options, more.get("multiple", False)
    made = ui.select(options, label=label, value=value if known else None, **more).classes("grow")
    opened, chosen = False, made.value

    def open_list(now: bool) -> None:
        nonlocal opened
        opened = now
        changed()

    def changed() -> None:
        nonlocal chosen
        if not opened and made.value != chosen:
            chosen = made.value
            choose(chosen)

    made.on_value_change(changed)
    if several:
        made.on("popup-show", partial(open_list, now=True)).on("popup-hide", partial(open_list, now=False))
    return made


def button(label: str, on_click: Callable[[], Any], icon: str = "", *, main: bool = False) -> ui.button:
    made = ui.button(label, on_click=on_click, icon=icon or None)
    return made.props("unelevated" if main else "outline")


def link(label: str, href: str, *, download: bool = False) -> None:
    with ui.element("a").props(f'href="{href}"' + (" download" if download else "")).classes("plain"):
        ui.label(label)


def number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.10g}" if abs(value) >= 1e6 else f"{value:.5g}"
