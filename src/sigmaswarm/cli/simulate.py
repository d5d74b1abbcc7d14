"""`sigmaswarm simulate`."""

from math import inf
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter, validators


def simulate(
    out: Annotated[Path, Parameter(name="OUT")],
    /,
    *,
    runs: int = 6,
    duration: float = 90.0,
    gps_std: float = 1.0,
    seed: Annotated[int, Parameter(validator=validators.Number(gte=0))] = 0,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Make drives to try things on: a car going through a town, in the plane, with noise and biases.

    Examples:

        sigmaswarm simulate drives
        sigmaswarm simulate drives --runs 20 --duration 120 --seed 1

    Parameters
    ----------
    out
        Folder in which the drive folders are made.
    runs
        How many drives.
    duration
        Seconds of each.
    gps_std
        Standard deviation of a fix, m per axis.
    seed
        Decides routes and noise; the same seed gives the same bytes.
    json
        Print what was written for machines.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import print_json, stdout
    from sigmaswarm.errors import InputError

    if runs < 1 or not 30 <= duration < inf or not 0 <= gps_std < inf:
        raise InputError(
            "simulate needs --runs of 1 or more, --duration of 30 s or more, --gps-std of 0 or more"
        )
    written: list[str] = []
    for i in range(runs):
        drive = sigmaswarm.simulate(duration=duration, gps_std=gps_std, seed=seed + i)
        sigmaswarm.write_drive(drive, out / drive.name)
        written.append(str(out / drive.name))
    if json:
        print_json({"drives": written})
    else:
        stdout().print(f"wrote {runs} drive(s) to {out}: {written[0]} ...")
