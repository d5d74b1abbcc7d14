"""Content of the drive.toml of a recorded drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .drive import Recording, Row, Sensors
from .geometry import wrap
from .options import BRAKE_GAIN, ENVIRONMENTS, GPS_EVERY, KMH, RATE, TICK, Condition
from .plans import Plan
from .routes import SPACING
from .server import SUBSTEP, Session
from .vehicle import CAR, Physics


def describe(
    session: Session,
    recording: Recording,
    plan: Plan,
    physics: Physics,
    sensors: Sensors,
    condition: Condition,
) -> dict[str, Any]:
    """Return the content of drive.toml, under the names that `sigmaswarm simulate` uses."""
    o, where = session.options, ENVIRONMENTS[condition.environment]
    began = next((row.t for row in recording.rows if _passed(row, plan)), 0.0)
    noise = {
        "accel_noise_density": o.accel_noise / math.sqrt(RATE),
        "gyro_noise_density": o.gyro_noise / math.sqrt(RATE),
        "gps_std_m": o.gps_noise,
    }
    x, y, z = sensors.bias
    return {
        "frame": "enu",
        "source": f"CARLA {session.version}",
        "vehicle": CAR,
        **{key: value for key, value in noise.items() if value > 0},
        "carla": {
            "map": session.town.name,
            "first_frame": recording.first_frame,
            "tire_friction": physics.tire_friction,
            "brake_gain": BRAKE_GAIN,
            "substep_s": SUBSTEP,
            "imu_seed": sensors.seeds["imu"],
            "gnss_seed": sensors.seeds["gnss"],
            "velocity_against_positions_ms": velocity_check(recording.rows),
        },
        "imu_noise": {"grade": "carla", "gyro_bias": [-x, y, -z]},  # axial
        "gps_noise": {"grade": "carla", "white_std_m": o.gps_noise},
        "imu_place": {"ahead_of_rear_axle_m": round(physics.ahead, 4)},
        "scenario": {
            "maneuver": condition.maneuver,
            "environment": condition.environment,
            "physics": where.physics,
            "friction": where.friction,
            "seed": o.seed,
            "run": condition.run,
            "imu_rate_hz": float(RATE),
            "gps_rate_hz": RATE / GPS_EVERY,
            "outages": [[round(began + at, 3), round(began + at + long, 3)] for at, long in plan.outages],
        },
        "target": plan.target,
        "achieved": achieved(condition.maneuver, recording, began),
    }


def _passed(row: Row, plan: Plan) -> bool:
    """Check if the car has reached the beginning of its maneuver."""
    path = plan.path
    i = min(round(plan.start / SPACING), len(path.x) - 1)
    dx, dy = row.place[0] - path.x[i], row.place[1] - path.y[i]
    return abs(dx) + abs(dy) < 20.0 and dx * math.cos(path.heading[i]) + dy * math.sin(path.heading[i]) >= 0


def velocity_check(rows: Sequence[Row]) -> float:
    """Return the RMS difference between velocities and central differences of positions, m/s.

    It is large if CARLA gives the velocity of the center of mass but the position of the car's origin.
    """
    total = 0.0
    for a, b, c in zip(rows, rows[1:], rows[2:]):
        total += sum(((c.place[i] - a.place[i]) / (c.t - a.t) - b.velocity[i]) ** 2 for i in (0, 1))
    return round(math.sqrt(total / max(len(rows) - 2, 1)), 6)


def achieved(maneuver: str, recording: Recording, began: float) -> dict[str, float]:
    """Return the achieved values under the names of the plan's ``target``."""
    rows = recording.rows
    own = [row for row in rows if row.t >= began]
    speeds = [row.speed for row in rows]
    if maneuver == "cruise":
        mean = sum(row.speed for row in own) / len(own)
        figures = {"distance_m": _length(own), "speed_kmh": mean / KMH}
    elif maneuver == "turns":
        yaw = [0.0]
        for a, b in zip(own, own[1:]):
            yaw.append(yaw[-1] + wrap(b.heading - a.heading))
        extreme = max(yaw, key=abs)
        right, left = sorted((math.degrees(extreme), math.degrees(yaw[-1] - extreme)))
        tenths = zip(own, own[RATE // 10 :])
        lateral = max(abs(wrap(b.heading - a.heading)) * 10 * a.speed for a, b in tenths)
        figures = {"left_deg": left, "right_deg": right, "peak_lateral_ms2": lateral}
    elif maneuver == "outages":
        times = [fix[0] for fix in recording.fixes]
        gaps = sorted(zip(times, times[1:]), key=lambda pair: pair[0] - pair[1])[:2]
        figures = {f"outage_{i + 1}_s": b - a for i, (a, b) in enumerate(sorted(gaps))}
    else:
        fast = (60 if maneuver == "accelerate" else 50) * KMH
        took = _time_to(fast, speeds if maneuver == "accelerate" else speeds[::-1])
        figures = {"speed_kmh": min(max(speeds), fast) / KMH, "time_s": took}
    figures.update(total_distance_m=_length(rows), top_speed_kmh=max(speeds) / KMH)
    return {key: round(value, 4) for key, value in figures.items() if math.isfinite(value)}


def _length(rows: Sequence[Row]) -> float:
    return sum(math.hypot(b.place[0] - a.place[0], b.place[1] - a.place[1]) for a, b in zip(rows, rows[1:]))


def _time_to(fast: float, speeds: Sequence[float]) -> float:
    """Return the shortest time, s, from standstill to the speed `fast`, m/s; inf if it is never reached."""
    best, stood = math.inf, None
    for i, speed in enumerate(speeds):
        if speed <= 0.1:
            stood = i
        elif speed >= fast and stood is not None:
            best, stood = min(best, (i - stood) * TICK), None
    return best
