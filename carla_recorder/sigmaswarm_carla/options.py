"""Constants and options of a recording, and the parser of its command line."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

RATE = 100  # Hz, of ticks and IMU
TICK = 1.0 / RATE
GPS_EVERY = 20  # ticks from fix to fix (5 Hz), since CARLA's sensor_tick is not synchronous (carla#3653)
STANDSTILL_TIME = 1.0  # s of standstill at the beginning of a drive
GRAVITY = 9.81  # m/s2
KMH = 1 / 3.6  # m/s
DRY = 0.85  # friction of stock tires, assumed if --brake-sweep was not used
BRAKE_GAIN = 2.0
"""Factor on CARLA's max_brake_torque. Without it, the car stops from 50 km/h in 2.7 s instead of the paper's 2 s."""


class Environment(NamedTuple):
    """Friction between tires and road (sources: sigmaswarm.simulation.environments), and CARLA's weather."""

    friction: float
    physics: str
    weather: dict[str, float]


ENVIRONMENTS = {
    "clear": Environment(DRY, "dry", {"sun_altitude_angle": 60.0}),
    "night": Environment(DRY, "dry", {"sun_altitude_angle": -30.0}),
    "rain": Environment(
        0.65,
        "wet",
        {
            "cloudiness": 90.0,
            "precipitation": 80.0,
            "precipitation_deposits": 60.0,
            "wetness": 80.0,
            "sun_altitude_angle": 45.0,
        },
    ),
    "fog": Environment(DRY, "dry", {"cloudiness": 60.0, "fog_density": 70.0, "sun_altitude_angle": 30.0}),
    "slippery": Environment(0.25, "snow", {"cloudiness": 80.0, "wetness": 30.0, "sun_altitude_angle": 30.0}),
}
MANEUVERS = ("cruise", "turns", "accelerate", "brake", "outages")
NOISE_OPTIONS = ("accel_noise", "gyro_noise", "gyro_bias", "gps_noise")


class RecorderError(Exception):
    """Error that ends the recording; the message states cause and remedy."""


class LostConnection(RecorderError):
    """Error that is raised if the server no longer answers."""


class FailedRun(RecorderError):
    """Failure of one drive, which may succeed on another route."""


class Condition(NamedTuple):
    maneuver: str
    environment: str
    run: int

    @property
    def name(self) -> str:
        return f"{self.maneuver}-{self.environment}-{self.run:02d}"


def _option(default: Any, text: str) -> Any:
    return field(default=default, metadata={"help": text})


@dataclass(frozen=True)
class Options:
    """Options of a recording and of the command line."""

    out: Path = field(
        metadata={"help": "Folder for the drive folders. It must not contain drives, except with --resume."}
    )
    host: str = _option("127.0.0.1", "Host of the CARLA server.")
    port: int = _option(2000, "Port of the CARLA server.")
    maneuvers: tuple[str, ...] = _option(MANEUVERS, f"Maneuvers: {', '.join(MANEUVERS)}; all by default.")
    environments: tuple[str, ...] = _option(
        tuple(ENVIRONMENTS),
        f"Environments: {', '.join(ENVIRONMENTS)}; all by default. Clear, night and fog have the same friction.",
    )
    runs: int = _option(20, "Number of drives of each maneuver in each environment.")
    seed: int = _option(0, "Seed of the routes, the driver and the noise.")
    map: str = _option("", "Town to load, such as Town06; by default the town that the server has loaded.")
    accel_noise: float = _option(0.001, "Standard deviation of each acceleration sample, m/s2.")
    gyro_noise: float = _option(0.001, "Standard deviation of each gyro sample, rad/s.")
    gyro_bias: float = _option(
        0.001, "Largest gyro bias, rad/s; each drive has a constant bias within +- this value."
    )
    gps_noise: float = _option(0.56, "Standard deviation of each fix, m per axis.")
    timeout: float = _option(20.0, "Longest time to wait for an answer to a request, s.")
    patience: float = _option(
        120.0, "Longest time to wait for a new connection after the server has stopped answering, s."
    )
    brake_sweep: bool = _option(
        False,
        "First, brake with several values of CARLA's tire_friction, and measure the resulting frictions.",
    )
    resume: bool = _option(False, "Keep existing drives and record the missing drives.")

    def figures(self) -> dict[str, Any]:
        """Return the options that all drives in one folder must share."""
        return {name: getattr(self, name) for name in ("seed", *NOISE_OPTIONS)}


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="sigmaswarm_carla",
        description="Record drives with known truth from a CARLA server: the maneuvers and environments of the paper, "
        "driven by a Tesla Model 3.",
    )
    for option in fields(Options):
        several = isinstance(option.default, tuple)
        flag = "--" + (option.name[:-1] if several else option.name).replace("_", "-")
        stated = (
            isinstance(option.default, (int, float, str))
            and option.default is not False
            and option.default != ""
        )
        text = f"{option.metadata['help']} Default: {option.default}." if stated else option.metadata["help"]
        about: dict[str, Any] = {"dest": option.name, "help": text}
        if option.name == "out":
            p.add_argument(flag, type=Path, required=True, **about)
        elif isinstance(option.default, bool):
            p.add_argument(flag, action="store_true", **about)
        elif several:
            p.add_argument(flag, nargs="+", default=option.default, metavar="NAME", **about)
        else:
            p.add_argument(flag, type=type(option.default), default=option.default, **about)
    return p


def options_of(arguments: Sequence[str]) -> Options:
    given = vars(parser().parse_args(arguments))
    for key, known in (("maneuvers", MANEUVERS), ("environments", tuple(ENVIRONMENTS))):
        given[key] = tuple(dict.fromkeys(given[key]))
        for name in given[key]:
            if name not in known:
                raise RecorderError(f"no {key[:-1]} is called {name!r}; choose from {', '.join(known)}")
    options = Options(**given)
    if options.runs < 1:
        raise RecorderError(f"--runs is {options.runs}; choose 1 or more")
    for name in NOISE_OPTIONS:
        if not 0 <= getattr(options, name) < math.inf:
            raise RecorderError(f"--{name.replace('_', '-')} is {getattr(options, name)}; choose 0 or more")
    if not (options.timeout > 0 and options.patience >= 0):
        raise RecorderError("--timeout must be above 0 s, and --patience 0 s or more")
    return options
