"""Mounting of the IMU in the vehicle: three angles, and a sketch that rotates with them."""

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from sigmaswarm.drives.drive import Array
from sigmaswarm.importing.mounting import parse_mount
from sigmaswarm.workbench.parts import button, card, message, text
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
    def _mount(self) -> str:
        return self.page.bench.log_choices.get("mount", "")

    @ui.refreshable_method
    def show(self) -> None:
        """Show the panel."""
        self.shown = self.page.look is not None, self._mount
        if self.page.look is None:
            return
        rotation, wrong = attempt(parse_mount, self._mount) if self._mount else (np.eye(3), "")
        rotation = np.eye(3) if rotation is None else rotation
        with card():
            text("h2", "Mounting of the IMU in the vehicle")
            message(wrong, "bad")
            with ui.element("div").classes("grid"):
                picture = ui.html(sketch(rotation), sanitize=False)
                with ui.element("div"):
                    sliders = ui.element("div")
                    with ui.element("div").classes("line end"):
                        field = ui.input("As an option: 90, or 0,10,90, or x=-y,y=x", value=self._mount)
                        field.classes("grow").on(
                            "change", lambda: self.page.choose(mount=(field.value or "").strip())
                        )
                        with sliders:
                            self._angles(rotation, picture, field)
                        button("Find it in the log", self.page.find_mounting, "explore")
                    text(
                        "p",
                        "The arrows are the sensor's axes: x forward, y left and z up need no rotation.",
                        "soft",
                    )
                    with ui.expansion("More settings").classes("soft"):
                        self._settings()

    def _angles(self, rotation: Array, picture: ui.html, field: ui.input) -> None:
        """Three sliders, for mouse and arrow keys."""
        angles = _degrees(rotation)
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
            self.page.choose(mount=field.value)

        for number, (name, angle) in enumerate(zip(ANGLES, angles, strict=True)):
            with ui.element("div").classes("line"):
                label = ui.label().style("width: 92px")
                slider = ui.slider(min=-180, max=180, step=1, value=angle).classes("grow")
                slider.props(f'aria-label="{name}, degrees"').on_value_change(moved)
                slider.on("change", partial(rested, number), throttle=SETTLED, leading_events=False)
                label.bind_text_from(slider, "value", lambda value, name=name: f"{name} {value:g}°")
                sliders.append(slider)

    def _settings(self) -> None:
        """Settings for few logs."""
        choices = self.page.bench.log_choices
        offset = ui.number("Added to the times of the fixes, s", value=choices.get("gps_offset_s"), step=0.01)
        offset.on("change", lambda: self.page.choose(gps_offset_s=offset.value or 0.0))
        arm = ui.input(
            "From the IMU to the antenna, m forward,left,up", value=choices.get("gps_lever_arm_m", "")
        )
        arm.on("change", lambda: self.page.choose(gps_lever_arm_m=(arm.value or "").strip()))
        part = ui.number(
            "Recording, where a clock restarts", value=choices.get("part"), min=1, step=1, precision=0
        )
        part.on("change", lambda: self.page.choose(part=int(part.value) if part.value else None))


def _degrees(r: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation, whole degrees."""
    pitch = -math.asin(float(np.clip(r[2, 0], -1, 1)))
    angles = math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])
    roll, pitch, yaw = (float(round(math.degrees(angle))) + 0.0 for angle in angles)
    return roll, pitch, yaw
