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
for option in fields(Options):
    if isinstance(option.default, tuple):
        kind, name = tuple[str, ...], option.name[:-1]
    else:
        kind, name = type(option.default), option.name
    RECORDER[name] = FieldInfo(annotation=kind, default=option.default, description=option.metadata["help"])


@options_of(RECORDER, omitted=("out",))
def record_carla(*, out: Path, **options: Any) -> None:
    """Record drives with known truth from a CARLA server.

    A Tesla Model 3 drives each of the paper's five maneuvers in each of the paper's five environments, by default 20
    times.

    For a server of CARLA 0.9.16, first run `pip install carla==0.9.16`. For an older server, write the recorder into
    one file with `python -m sigmaswarm_carla.pack carla_recorder.pyz`, and run this file with the Python installation
    that contains the client of the server (docs/carla.md).

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
    # The CARLA client can crash. It runs in a separate process, so that this process can report the crash.
    process = subprocess.Popen([sys.executable, "-m", "sigmaswarm_carla", *arguments])
    while True:
        try:
            code = process.wait()
            break
        except KeyboardInterrupt:
            continue  # the recorder also receives the signal, and restores the server's settings before it ends
    if code < 0:
        raise SigmaswarmError(
            f"the CARLA client was killed by signal {-code}; complete drives are in {out}; continue "
            "with --resume"
        )
    sys.exit(code)
