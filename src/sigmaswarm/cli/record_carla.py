"""`sigmaswarm record-carla`."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sigmaswarm.cli.options import FIELDS
from sigmaswarm.errors import SigmaswarmError
from sigmaswarm_carla.options import Options


@dataclass(frozen=True, kw_only=True)
class RecordCarlaOptions:
    """Options of `sigmaswarm record-carla`, the same as the recorder's.

    Attributes
    ----------
    out
        Folder for the drive folders. It must not contain drives, except with --resume.
    host
        Host of the CARLA server.
    port
        Port of the CARLA server.
    maneuver
        cruise, turns, accelerate, brake, outages; all by default.
    environment
        clear, night, rain, fog, slippery; all by default. Clear, night and fog have the same physics.
    runs
        Number of drives of each maneuver in each environment.
    seed
        Seed of the routes, the driver and the noise.
    map
        Town to load, such as Town06; by default the town that the server has loaded.
    accel_noise
        Standard deviation of each acceleration sample, m/s2.
    gyro_noise
        Standard deviation of each gyro sample, rad/s.
    gyro_bias
        Largest gyro bias, rad/s; each drive has a constant bias within +- this value.
    gps_noise
        Standard deviation of each fix, m per axis.
    timeout
        Longest time to wait for an answer of the server, s.
    patience
        Longest time to wait until a server that stopped answering answers again, s.
    brake_sweep
        First measure the friction for several values of CARLA's tire_friction, and use the result.
    resume
        Keep existing drives and record the missing drives.
    """

    out: Path
    host: str = Options.host
    port: int = Options.port
    maneuver: list[str] | None = None
    environment: list[str] | None = None
    runs: int = Options.runs
    seed: int = Options.seed
    map: str = Options.map
    accel_noise: float = Options.accel_noise
    gyro_noise: float = Options.gyro_noise
    gyro_bias: float = Options.gyro_bias
    gps_noise: float = Options.gps_noise
    timeout: float = Options.timeout
    patience: float = Options.patience
    brake_sweep: bool = False
    resume: bool = False


def record_carla(*, options: Annotated[RecordCarlaOptions, FIELDS]) -> None:
    """Record drives with known truth from a CARLA server.

    The command records the maneuvers and weathers of the paper with a Tesla Model 3, by default 20 runs of each of the
    25 conditions.

    CARLA 0.9.16 needs `pip install carla==0.9.16`. For an older server, write the recorder into one file with `python
    -m sigmaswarm_carla.pack carla_recorder.pyz`, and run this file with the Python of the server's client
    (docs/carla.md).

    For example:

        sigmaswarm record-carla --out drives --maneuver brake --environment clear --runs 1
        sigmaswarm record-carla --out drives --host 192.168.0.7 --map Town06 --brake-sweep
    """
    arguments: list[str] = []
    for name, value in vars(options).items():
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, list):
            arguments += [option, *value]
        elif isinstance(value, bool) or value is None:
            arguments += [option] if value else []
        else:
            arguments.append(f"{option}={value}")
    # In a separate process, since the client may end its process; this process reports that.
    process = subprocess.Popen([sys.executable, "-m", "sigmaswarm_carla", *arguments])
    while True:
        try:
            code = process.wait()
            break
        except KeyboardInterrupt:
            continue  # the recorder also gets the signal; it first restores the server
    if code < 0:
        raise SigmaswarmError(
            f"the CARLA client was killed by signal {-code}; complete drives are in {options.out}; continue "
            "with --resume"
        )
    sys.exit(code)
