"""`sigmaswarm export`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def export(
    tuning: Annotated[Path, Parameter(name="TUNING")],
    /,
    *,
    to: Literal["filterpy", "c99", "robot_localization"],
    out: Path,
    replay: Path | None = None,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Write a tuned filter for use elsewhere.

    Trajectories are written by `sigmaswarm run`; this writes the filter itself.

    Examples:

        sigmaswarm export tuned --to filterpy --out filter-py
        sigmaswarm export tuned --to c99 --out filter-c --replay drives/friday
        sigmaswarm export tuned --to robot_localization --out filter-ros

    Parameters
    ----------
    tuning
        A tuning.toml, or the folder that holds it.
    to
        filterpy: a script that needs NumPy and FilterPy only. c99: a C library without allocation, and a program
        that replays a drive. robot_localization: parameters to start from; its model is another one.
    out
        Folder to write to; made if missing.
    replay
        c99: a drive to write as the replay program's input.
    json
        Print the written files for machines.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import print_json, read_known, stdout, tuned_as_recorded
    from sigmaswarm.export.targets import export_filter

    parameters = sigmaswarm.FilterParameters.load(tuning)
    drive = read_known(replay) if replay else None
    written = export_filter(parameters, to, out, replay=drive, as_recorded=tuned_as_recorded(tuning))
    if json:
        print_json({"written": [str(path) for path in written]})
        return
    for path in written:
        stdout().print(f"wrote {path}")
    stdout().print(f"next: {_next_step(to, out, replay=replay is not None)}")


def _next_step(to: str, out: Path, *, replay: bool) -> str:
    """How to go on with what was written."""
    if to == "filterpy":
        return f"python {out / 'run_filter.py'} DRIVE estimate.csv"
    if to == "c99":
        build = f"cd {out} && cc -std=c99 -O2 ins_gps.c ins_gps_align.c replay.c -lm -o replay"
        return build + (" && ./replay < replay.csv > estimate.csv" if replay else "")
    file = out / "robot_localization.yaml"
    return f"read what {file} says, then give it to robot_localization with --params-file"
