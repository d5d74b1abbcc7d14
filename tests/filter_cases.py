"""Filters of every type with every option, and a drive with data for each of them."""

from dataclasses import replace
from functools import cache

import numpy as np

from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from support import make_drive

KINDS = ("ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf")
OPTIONS = {
    "plain": {},
    "velocity": {"velocity_noise": 0.1},
    "lateral": {"lateral_noise": 0.05, "rear_axle": 1.2, "tire_slip": 0.004},
    "gate": {"gate": 2.0},
    "latency": {"latency": 0.1},
    "all": {"velocity_noise": 0.1, "lateral_noise": 0.05, "rear_axle": -0.7, "tire_slip": 0.01, "gate": 6.0,
            "latency": 0.05, "standstill_noise": 1e-3},
}  # fmt: skip

WEIGHED = {
    "accuracy": {"accuracy_scale": 0.4},
    "robust": {"robust_dof": 4.0},
    "both": {**OPTIONS["all"], "gate": None, "accuracy_scale": 0.4, "robust_dof": 2.0},
}
"""Options that weight fixes; not every filter type supports them."""
WEIGHED_CASES = [(kind, option) for kind in ("ukf", "ekf") for option in WEIGHED]
WEIGHED_CASES += [("strong-tracking-ukf", "accuracy"), ("fuzzy-ukf", "accuracy")]


def stands_for_all(model: str, kind: str, option: str) -> bool:
    """Select the quick tests: every filter with all options together, and two filters with each single option."""
    return option == "all" or (model, kind) in (("planar5", "ukf"), ("planar8", "ekf"))


def parameters(model: str, **more) -> FilterParameters:
    more = {"kind": MODELS[model].filter_types[0], **more}
    if more.get("kind") == "strong-tracking-ukf":
        more = {"forgetting": 0.5, **more}  # otherwise it has no effect on a drive that fits the model
    if more.get("kind") == "fuzzy-ukf":
        more = {"forgetting": 0.7, "fuzzy_gains": (5.0, 20.0), **more}
    q = (1e-4, 2e-4, 1e-3, 2e-3, 1e-6, 1e-8, 2e-8, 1e-10, 1e-7, 2e-7, 1e-11, 2e-11)[
        : len(MODELS[model].states)
    ]
    return FilterParameters(0.5, 2.0, 1.0, q, (0.25, 0.36), model, **more)


@cache
def equipped(duration: float = 24.0) -> Drive:
    """Return the drive with speed and course in the fixes, and an antenna beside and above the IMU."""
    drive = make_drive(duration=duration, gps_std=0.5, jitter=0.3, seed=5)
    truth, t = drive.truth, drive.gps.time
    assert truth is not None
    speed = np.interp(t, truth.time, np.hypot(truth.vx, truth.vy))
    course = np.interp(t, truth.time, np.unwrap(np.arctan2(truth.vy, truth.vx)))
    gps = replace(drive.gps, speed=speed, course=course)
    return replace(drive, gps=gps, metadata={"gps_lever_arm_m": [1.0, 0.5, 1.2]})


@cache
def straying() -> Drive:
    """Return the drive with stated accuracies, a burst of outliers, and a jump after 14 s that makes a filter reset."""
    drive, rng = equipped(), np.random.default_rng(2)
    gps, n = drive.gps, len(drive.gps)
    x, late = gps.x.copy(), gps.time > gps.time[0] + 14.0
    x[40:43] += 15.0
    x[late] += 40.0
    std_x, std_y = rng.uniform(0.2, 2.0, (2, n))
    return replace(drive, gps=replace(gps, x=x, std_x=std_x, std_y=std_y))


@cache
def two_receivers() -> Drive:
    """Return the drive with a second receiver with the same clock; some fixes coincide with IMU samples."""
    drive, rng = equipped(), np.random.default_rng(1)
    gps, imu = drive.gps, drive.imu.time
    assert gps.speed is not None
    assert gps.course is not None
    time = np.where(np.arange(len(gps)) % 2, gps.time, imu[np.searchsorted(imu, gps.time)])
    again = np.repeat(np.arange(len(gps)), 2)
    moved = rng.normal(0.0, 0.5, (2, len(again)))
    more = {"speed": gps.speed[again], "course": gps.course[again]}
    return replace(drive, gps=Gps(time[again], gps.x[again] + moved[0], gps.y[again] + moved[1], **more))


@cache
def rough() -> Drive:
    """Return the drive with stale fixes, one of which is repeated again later, and two gaps in its IMU."""
    drive = equipped()
    gps, imu = drive.gps, drive.imu
    frozen = (gps.time > 12.0) & (gps.time < 13.1)
    held = int(np.flatnonzero(frozen)[0]) - 1
    x, y = np.where(frozen, gps.x[held], gps.x), np.where(frozen, gps.y[held], gps.y)
    silent = ((imu.time > 9.0) & (imu.time < 10.3)) | ((imu.time > 12.4) & (imu.time < 12.5))
    return replace(drive, gps=replace(gps, x=x, y=y), imu=imu.select(~silent))
