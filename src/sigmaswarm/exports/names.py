"""Names and descriptions of export targets. This module imports no kernels, so that help and workbench are fast."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Literal

Target = Literal["c99", "filterpy", "robot_localization"]
AnyTarget = Literal[Target, "robot-localization"]
"""Targets in the spelling of users (see `target_named`)."""
LIBRARIES = ("libins_gps.so", "libins_gps_float.so")  # C libraries in double and in float


@dataclass(frozen=True, kw_only=True)
class Description:
    """Description of an export target.

    Attributes
    ----------
    title, needs : str
        Name and requirements, for users.
    commands : dict of str to str
        Parts of the shell command that uses the exported files, by file; ``{}`` is the folder of these files.
    lacks : tuple of str
        Options of `tune` that the target does not support.
    tilts : bool
        True if the target supports models with attitude.
    built : tuple of str
        Files that the commands of the exported README.md, and ``--check``, create in the folder. A new export removes
        them, since they contain the earlier filter.
    """

    title: str
    needs: str
    commands: Mapping[str, str]
    lacks: tuple[str, ...] = ()
    tilts: bool = False
    built: tuple[str, ...] = ()


DESCRIPTIONS: dict[Target, Description] = {
    "c99": Description(
        title="C99",
        needs="Needs a C compiler and math.h, but no heap and no other library. The code runs on a microcontroller.",
        commands={
            "ins_gps.c": "cd {} && cc -std=c99 -O2 ins_gps.c ins_gps_align.c replay.c -lm -o replay",
            "replay.csv": " && ./replay < replay.csv > estimate.csv",
        },
        tilts=True,
        built=(*LIBRARIES, "replay", "estimate.csv"),
    ),
    "filterpy": Description(
        title="Python",
        needs="Needs numpy and filterpy (pip install filterpy).",
        commands={"run_filter.py": "python {}/run_filter.py DRIVE estimate.csv"},
        lacks=("fix-error", "heading"),
    ),
    "robot_localization": Description(
        title="ROS robot_localization",
        needs="Needs ROS 2 and robot_localization. Values from a planar filter are only a first configuration.",
        commands={
            "ekf.launch.py": "ros2 launch {}/ekf.launch.py",
            "robot_localization.yaml": (
                "ros2 run robot_localization {node} --ros-args --params-file {}/robot_localization.yaml"
            ),
        },
        lacks=("fix-error",),
    ),
}


def target_named(target: AnyTarget) -> Target:
    """Return a target. The name of the model, robot-localization, is also accepted."""
    return "robot_localization" if target == "robot-localization" else target


def next_command(target: Target, folder: str | Path, texts: Mapping[str, str]) -> str:
    """Return the shell command that uses exported ``texts`` (by file name) in a folder; "" for C without a drive."""
    commands = DESCRIPTIONS[target].commands
    node = "ukf_node" if "\nukf_filter_node:" in texts.get("robot_localization.yaml", "") else "ekf_node"
    if target == "c99" and "replay.csv" not in texts:  # the program would wait for an input
        return ""
    used = "".join(command for file, command in commands.items() if file in texts)
    return used.format(quote(str(folder)), node=node)
