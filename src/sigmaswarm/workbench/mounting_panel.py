"""Mounting of the IMU in the vehicle: three angles, and a sketch that rotates with them."""

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from sigmaswarm.drives.drive import Array
from sigmaswarm.importing.mounting import parse_mount
from sigmaswarm.workbench.parts import button, card, line, message, text
from sigmaswarm.workbench.state import attempt
from sigmaswarm.workbench.vehicle import sketch

if TYPE_CHECKING:
    from sigmaswarm.workbench.log_page import LogPage

ANGLES = ("roll", "pitch", "yaw")
SETTLED = 0.6
"""s without a change, after which the log is read again."""


class MountingPanel:
    """The choice of the mounting. The sketch follows at once, the plots after a pause."""

    def __init__(self, page: "LogPage") -> None:
        self.page = page
        self.shown: tuple[bool, str] = False, ""

    @property
    def state(self) -> tuple[bool, str]:
        """The state that the panel depends on: whether a log is open, and its mounting."""
        return self.page.look is not None, self.page.bench.log_choices.get("mount", "")

    @ui.refreshable_method
    def show(self) -> None:
        """Show the panel."""
        self.shown = opened, mount = self.state
        if not opened:
            return
        rotation, wrong = attempt(parse_mount, mount) if mount else (None, "")
        rotation = np.eye(3) if rotation is None else rotation
        with card():
            text("h2", "Mounting of the IMU in the vehicle")
            message(wrong, "bad")
            with ui.element("div").classes("grid"):
                picture = ui.html(sketch(rotation), sanitize=False)
                with ui.element("div"):
                    sliders = ui.element("div")
                    with line("end"):
                        field = ui.input("As an option", value=mount).props(
                            'hint="90, or 0,10,90, or x=-y,y=x"'
                        )
                        field.classes("grow").on("change", lambda: self._choose("mount", field.value))
                        with sliders:
                            self._angles(rotation, picture, field)
                        button("Find it in the log", self.page.find_mounting, "explore")
                    about = "The arrows are the sensor's axes: x forward, y left and z up need no rotation."
                    text("p", about, "soft")
                    with ui.expansion("More settings").classes("soft"):
                        self._settings()

    def _choose(self, key: str, value: object) -> None:
        self.page.choose(**{key: value.strip() if isinstance(value, str) else value})

    def _angles(self, rotation: Array, picture: ui.html, field: ui.input) -> None:
        """Three sliders, for mouse and arrow keys."""
        sliders: list[ui.slider] = []

        def moved() -> None:
            turned = ",".join(f"{slider.value:g}" for slider in sliders)
            picture.set_content(sketch(parse_mount(turned)))

        def rested(changed: int, event: GenericEventArguments) -> None:
            values = [slider.value for slider in sliders]
            values[changed] = float(event.args)  # the slider itself may learn of it later
            turned = ",".join(f"{value:g}" for value in values)
            field.value = "" if turned == "0,0,0" else turned
            self.shown = True, field.value
            self._choose("mount", field.value)

        for number, (name, angle) in enumerate(zip(ANGLES, _degrees(rotation), strict=True)):
            with line():
                label = ui.label().style("width: 92px")
                slider = ui.slider(min=-180, max=180, step=1, value=angle).classes("grow")
                slider.props(f'aria-label="{name}, degrees"').on_value_change(moved)
                slider.on("change", partial(rested, number), throttle=SETTLED, leading_events=False)
                label.bind_text_from(slider, "value", lambda value, name=name: f"{name} {value:g}°")
                sliders.append(slider)

    def _settings(self) -> None:
        """Settings for few logs."""
        chosen = self.page.bench.log_choices.get
        offset = ui.number("Added to the times of the fixes, s", value=chosen("gps_offset_s"), step=0.01)
        arm = ui.input("From the IMU to the antenna, m forward,left,up", value=chosen("gps_lever_arm_m", ""))
        part = ui.number("Recording, where a clock restarts", value=chosen("part"), min=1, precision=0)
        offset.on("change", lambda: self._choose("gps_offset_s", offset.value or 0.0))
        arm.on("change", lambda: self._choose("gps_lever_arm_m", arm.value))
        part.on("change", lambda: self._choose("part", int(part.value) if part.value else None))


def _degrees(r: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation, whole degrees."""
    pitch = -math.asin(float(np.clip(r[2, 0], -1, 1)))
    angles = math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])
    roll, pitch, yaw = (float(round(math.degrees(angle))) + 0.0 for angle in angles)
    return roll, pitch, yaw
