"""The filter as a C99 library: one header, one source file, and a program that replays a drive through it."""

import math
from collections.abc import Iterable
from operator import itemgetter

import numpy as np

from sigmaswarm.drives import standstill
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.export.features import features_of, listed, plain, values_of
from sigmaswarm.export.template import fill
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters

FILES = ("ins_gps.h", "ins_gps.c", "ins_gps_align.h", "ins_gps_align.c", "replay.c")


def c99(parameters: FilterParameters, interval: float) -> dict[str, str]:
    """Headers, sources and the replaying program, by file name; ``interval`` (s) is what Q refers to."""
    features = features_of(parameters)
    values = values_of(parameters, interval) | _only_in_c(parameters, interval)
    return {name: fill(f"{name}.in", features, values) for name in FILES}


def replay_rows(drive: Drive) -> str:
    """A drive as the rows that replay.c reads: where a filter starts, then samples and fixes by time.

    Raises
    ------
    AlignmentError
        If the drive never moves far enough for a start.
    """
    initial, imu = initial_state(drive), drive.imu
    start = (initial.time, *drive.lever_arm, *initial.mean, *initial.covariance.ravel())
    events = [(z[0], 0, _row("fix", z)) for z in _fixes(drive.gps)]  # a fix before the sample of its time
    events += [(t, 1, _row("imu", (t, *u))) for t, *u in zip(imu.time, imu.ax, imu.ay, imu.gz, strict=True)]
    return (
        "\n".join([_row("start", start), *(row for *_, row in sorted(events, key=itemgetter(0, 1)))]) + "\n"
    )


def _fixes(gps: Gps) -> list[list[float]]:
    """Time and position (s, m), and the velocity (m/s east and north) where the log has it."""
    columns = [gps.time, gps.x, gps.y]
    if gps.speed is not None and gps.course is not None:
        columns += [gps.speed * np.cos(gps.course), gps.speed * np.sin(gps.course)]
    return np.column_stack(columns).tolist()


def _row(name: str, numbers: Iterable[float]) -> str:
    return ",".join([name, *(repr(float(number)) for number in numbers)])


def _only_in_c(p: FilterParameters, interval: float) -> dict[str, str]:
    n, stands, names = p.n_states, p.standstill_noise is not None, MODELS[p.model].names
    derived: dict[str, float | None] = {
        "GAMMA_SQUARED": p.alpha**2 * (n + p.kappa),
        "SPREAD": p.alpha**2 * (n + p.kappa - 1) + p.beta,
        "CALM_WINDOW": standstill.WINDOW,
        "CALM": standstill.CALM,
        "SETTLES": standstill.SETTLES,
        "RISES": standstill.RISES,
        "TURNING": standstill.TURNING,
        "FIX_WINDOW": standstill.FIX_WINDOW,
        "FIX_SPEED": standstill.FIX_SPEED,
    }
    return plain(derived) | {
        "PROCESS_NOISE": listed(p.process_noise, "R({})"),
        "MEASUREMENT_NOISE": listed(p.measurement_noise, "R({})"),
        "HISTORY": str(max(1, math.ceil(1.0 / interval))),  # as LiveFilter's default
        "FIXES": "64" if stands else "32",
        "WINDOW": str(max(8, math.ceil(1.5 * standstill.WINDOW / interval) + 2)),
        "FIXES_NOTE": ", and those of the last 3 s" if stands else "",
        "CALM_NOTE": ": it learns what calm is" if stands else "",
        "VELOCITY_NOTE": "" if p.velocity_noise is not None else " (this filter does not use it)",
        "GYRO_NOTE": ", and all that the gyro shows is its bias"
        if MODELS[p.model].gyro_bias is not None
        else "",
        "CSV_HEADER": ",".join(["t", *names, *(f"std_{name}" for name in names)]),
    }
