"""Drives elsewhere: of other sensors, and of another car, than those that a study tunes and trains on."""

from concurrent.futures import Executor
from typing import Any

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.overlap import landmarks
from sigmaswarm.drives.reader import all_drive_locations, read_drive
from sigmaswarm.experiments.study.config import StudyConfig
from sigmaswarm.experiments.study.design import Design, condition_of, require_apart, require_scored
from sigmaswarm.simulation.conditions import simulate_many

MOST_RUNS = 2
"""Simulated drives of each condition."""
OTHER_IMU = ("mpu-6050", "icm-20602")
"""The first one, or the second where the study has the first."""
HOME_CAR, OTHER_CAR = "model3", "model3-carla"


def designs_elsewhere(home: Design, executor: Executor | None = None) -> dict[str, Design]:
    """Drives elsewhere, by what they are: those that were named, or else simulated ones; no trial trains on any.

    Raises
    ------
    InputError
        If drives can't be read, lack truth, or share parts with the study's.
    """
    c = home.config
    if not c.rivals or (c.drives and not c.elsewhere):
        return {}
    if c.elsewhere:
        drives = [read_drive(place) for place in all_drive_locations(c.elsewhere)]
        own = tuple(drive for drive in home.drives if isinstance(drive, Drive))
        require_apart([landmarks(drive) for drive in (*own, *drives)])
        return {"as given": _apart(drives, c)}
    imu = next(name for name in OTHER_IMU if name != c.imu)
    return {
        f"IMU {imu} for {c.imu}": _simulated(c, executor, imu=imu),
        f"car {OTHER_CAR} for {HOME_CAR}": _simulated(c, executor, vehicle=OTHER_CAR),
    }


def _simulated(config: StudyConfig, executor: Executor | None, **other: str) -> Design:
    """Drives of the study's conditions, on other roads: their seed is the next one."""
    options: dict[str, Any] = {**config.simulated, "seed": config.seed + 1, **other}
    runs = min(config.runs, MOST_RUNS)
    made = simulate_many(config.maneuvers, config.environments, runs, executor=executor, **options)
    return _apart(list(made), config)


def _apart(drives: list[Drive], config: StudyConfig) -> Design:
    require_scored(drives)
    conditions = tuple(map(condition_of, drives))
    strata = tuple("-".join(condition) for condition in conditions)
    return Design(tuple(drives), conditions, strata, config, apart=True)
