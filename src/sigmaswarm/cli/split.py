"""`sigmaswarm split`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def split(
    drive: Annotated[Path, Parameter(name="DRIVE")],
    /,
    *,
    out: Path,
    train_fraction: float | None = None,
    at: float | None = None,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Split one long drive in time: the first part to tune on, the rest to test on.

    Example:

        sigmaswarm split drives/monday --out parts
        sigmaswarm tune parts/monday-train --out tuned
        sigmaswarm evaluate tuned parts/monday-test

    Parameters
    ----------
    drive
        A drive folder.
    out
        Folder in which the two drive folders are made.
    train_fraction
        Share of the drive's time that goes to the first part; 0.7 by default.
    at
        s on the drive's clock (`t` in its files): split there, as where the doctor saw a pause.
    json
        Print what was written for machines.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import print_json, read_known, stdout

    if at is not None and train_fraction is not None:
        raise sigmaswarm.InputError("give --at or --train-fraction, not both: each says where to split")
    whole = read_known(drive)
    parts = sigmaswarm.split_time(whole, 0.7 if train_fraction is None else train_fraction, at=at)
    for part in parts:
        sigmaswarm.write_drive(part, out / part.name)
    if json:
        print_json({"drives": [str(out / part.name) for part in parts]})
    else:
        for part in parts:
            stdout().print(f"wrote {out / part.name} ({part.duration:.0f} s)")
        stdout().print(f"next: sigmaswarm tune {out / parts[0].name} --out tuned")
        stdout().print(f"then: sigmaswarm evaluate tuned {out / parts[1].name}")
