"""`sigmaswarm record-carla`."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

from pydantic.fields import FieldInfo

from sigmaswarm.cli.options import options_of
from sigmaswarm.errors import SigmaswarmError
from sigmaswarm_carla.options import Options

RECORDER: dict[str, FieldInfo] = {}  # options by name; an option that can be repeated has a singular name
for one in fields(Options):
    kind, name = (
        (tuple[str, ...], one.name[:-1]) if isinstance(one.default, tuple) else (type(one.default), one.name)
    )
    RECORDER[name] = FieldInfo(annotation=kind, default=one.default, description=one.metadata["help"])


@options_of(RECORDER, omitted=("out",))
def record_carla(*, out: Path, **options: Any) -> None:
    """Record drives with known truth from a CARLA server.

    The command records the maneuvers and environments of the paper with a Tesla Model 3, by default 20 runs of each of
    the 25 conditions.

    CARLA 0.9.16 needs `pip install carla==0.9.16`. For an older server, write the recorder into one file with `python
    -m sigmaswarm_carla.pack carla_recorder.pyz`, and run this file with the Python of the server's client
    (docs/carla.md).

    For example:

        sigmaswarm record-carla --out drives --maneuver brake --environment clear --runs 1
        sigmaswarm record-carla --out drives --host 192.168.0.7 --map Town06 --brake-sweep

    Parameters
    ----------
    out
        Folder for the drive folders. It must not contain drives, except with --resume.
    """
    arguments = [f"--out={out}"]
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, list):
            arguments += [option, *value]
        elif isinstance(value, bool):
            arguments += [option] * value
        else:
            arguments.append(f"{option}={value}")
    # In a separate process, since the client may end its process; this process then reports the end.
    process = subprocess.Popen([sys.executable, "-m", "sigmaswarm_carla", *arguments])
    while True:
        try:
            code = process.wait()
            break
        except KeyboardInterrupt:
            continue  # the recorder also receives the signal, and first restores the server
    if code < 0:
        raise SigmaswarmError(
            f"the CARLA client was killed by signal {-code}; complete drives are in {out}; continue "
            "with --resume"
        )
    sys.exit(code)
