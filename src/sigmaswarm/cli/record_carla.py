"""`sigmaswarm record-carla`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sigmaswarm_carla.options import Options

_Names = Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())]
_Flag = Annotated[bool, Parameter(negative=())]


def record_carla(
    *,
    out: Path,
    host: str = Options.host,
    port: int = Options.port,
    maneuver: _Names = None,
    environment: _Names = None,
    runs: int = Options.runs,
    seed: int = Options.seed,
    map: str = Options.map,
    accel_noise: float = Options.accel_noise,
    gyro_noise: float = Options.gyro_noise,
    gyro_bias: float = Options.gyro_bias,
    gps_noise: float = Options.gps_noise,
    timeout: float = Options.timeout,
    patience: float = Options.patience,
    brake_sweep: _Flag = False,
    resume: _Flag = False,
) -> None:
    """Record drives with known truth from a CARLA server.

    The maneuvers and weathers are the paper's, the car is a Tesla Model 3.

    By default the paper's 25 conditions, 20 runs of each. Needs `pip install carla==0.9.16` for CARLA 0.9.16;
    for an older server `python -m sigmaswarm_carla.pack carla_recorder.pyz` writes the recorder as one file, to be run
    with the Python of its client (docs/carla.md).

    Examples:

        sigmaswarm record-carla --out drives --maneuver brake --environment clear --runs 1
        sigmaswarm record-carla --out drives --host 192.168.0.7 --map Town06 --brake-sweep

    Parameters
    ----------
    out
        Folder in which the drive folders are made. It must not hold drives yet.
    host, port
        Of the server.
    maneuver
        cruise, turns, accelerate, brake, outages; all by default.
    environment
        clear, night, rain, fog, slippery; all by default. Clear, night and fog share one physics.
    runs
        Drives of each maneuver in each environment.
    seed
        Decides routes, driver and noise.
    map
        Town to load, such as Town06; by default the loaded one.
    accel_noise, gyro_noise
        m/s2 and rad/s, standard deviation of each sample.
    gyro_bias
        rad/s; the constant bias of a run is drawn evenly from +- this.
    gps_noise
        m per axis, of each fix.
    timeout
        Seconds to wait for an answer.
    patience
        Seconds to wait for a server that was lost.
    brake_sweep
        Measure first which tire_friction gives which friction, and use it.
    resume
        Keep the drives that are there and record those that are missing.
    """
    import subprocess
    import sys

    from sigmaswarm.errors import SigmaswarmError

    named = {
        "out": out, "host": host, "port": port, "runs": runs, "seed": seed, "map": map,
        "accel-noise": accel_noise, "gyro-noise": gyro_noise, "gyro-bias": gyro_bias, "gps-noise": gps_noise,
        "timeout": timeout, "patience": patience,
    }  # fmt: skip
    arguments = [f"--{name}={value}" for name, value in named.items()]
    for name, values in (("maneuver", maneuver), ("environment", environment)):
        arguments += [f"--{name}", *values] if values else []
    arguments += [f"--{name}" for name, on in (("brake-sweep", brake_sweep), ("resume", resume)) if on]
    # A separate process: the client may kill it, and this one reports that.
    process = subprocess.Popen([sys.executable, "-m", "sigmaswarm_carla", *arguments])
    while True:
        try:
            code = process.wait()
            break
        except KeyboardInterrupt:
            continue  # the recorder has heard it too, and puts the server in order first
    if code < 0:
        raise SigmaswarmError(
            f"the CARLA client died of signal {-code}; what was recorded is in {out}: go on with --resume"
        )
    sys.exit(code)
