"""Write recording.json and the folders of drives; compute the content of drive.toml."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .car import CAR, Physics
from .drive import Recording, Row, Sensors
from .geometry import interpolate, wrap
from .options import BRAKE_GAIN, ENVIRONMENTS, GPS_EVERY, KMH, RATE, TICK, Condition, Options, RecorderError
from .plans import SPACING, Plan
from .server import SUBSTEP, Session


class Journal:
    """The file recording.json of an output folder: options, version, geodesy, physics and measured friction."""

    def __init__(self, options: Options) -> None:
        self._file = options.out / "recording.json"
        self._content: dict[str, Any] = {"options": options.figures()}
        existing = sorted(path.parent.name for path in options.out.glob("*/imu.csv"))
        if existing and not options.resume:
            raise RecorderError(
                f"{options.out}: already contains {existing[0]}; choose another folder, or continue with --resume"
            )
        if self._file.exists():
            self._read(options, existing)

    def _read(self, options: Options, existing: Sequence[str]) -> None:
        try:
            saved = json.loads(self._file.read_text(encoding="utf-8"))
            made = dict(saved["options"])
        except (ValueError, KeyError, TypeError):
            raise RecorderError(
                f"{self._file}: is not a file of the recorder; choose another folder"
            ) from None
        for key, value in options.figures().items():
            if existing and made.get(key) != value:
                raise RecorderError(
                    f"{self._file}: the existing drives were recorded with {key} {made.get(key)}, not {value}; "
                    "choose another folder, or use the same options"
                )
        if existing and options.brake_sweep and not saved.get("friction"):
            raise RecorderError(
                f"{self._file}: the existing drives were recorded without --brake-sweep; choose another folder, "
                "or omit --brake-sweep"
            )
        self._content = {**saved, "options": options.figures()}

    @property
    def friction(self) -> list[list[float]]:
        """Pairs of tire_friction and the friction measured with it; empty if --brake-sweep was not used."""
        return self._content.get("friction", [])

    def tire_friction(self, friction: float) -> float | None:
        """Return the tire_friction that results in a measured friction; None if --brake-sweep was not used."""
        if not self.friction:
            return None
        table = sorted((measured, tire) for tire, measured in self.friction)
        return interpolate(table, friction)

    def note(self, **entries: Any) -> None:
        """Save entries; dictionaries are merged with the saved dictionaries."""
        for key, value in entries.items():
            old = self._content.get(key)
            self._content[key] = (
                {**old, **value} if isinstance(old, dict) and isinstance(value, dict) else value
            )
        self._file.parent.mkdir(parents=True, exist_ok=True)
        new = self._file.with_suffix(".new")
        new.write_text(json.dumps(self._content, indent=2) + "\n", encoding="utf-8")
        new.replace(self._file)


def write_drive(folder: Path, recording: Recording, about: dict[str, Any], options: Options) -> None:
    """Write the folder of a drive under a temporary name, and rename it when it is complete."""
    new = folder.parent / f".{folder.name}.new"
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    rows = recording.rows
    _write_csv(new / "imu.csv", "t,ax,ay,az,gx,gy,gz", ((r.t, *r.force, *r.rate) for r in rows))
    std = (options.gps_noise,) * 2 if options.gps_noise > 0 else ()
    header = "t,x,y,std_x,std_y" if std else "t,x,y"
    _write_csv(new / "gps.csv", header, ((*fix, *std) for fix in recording.fixes))
    _write_csv(
        new / "truth.csv",
        "t,x,y,vx,vy,theta",
        ((r.t, *r.place[:2], *r.velocity[:2], r.heading) for r in rows),
    )
    (new / "drive.toml").write_text(toml(about), encoding="utf-8")
    new.rename(folder)


def _write_csv(path: Path, header: str, rows: Any) -> None:
    lines = [header, *(",".join(repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def keep_incomplete(recording: Recording, options: Options) -> None:
    """Save an incomplete drive in the folder ``incomplete``, for the analysis of failures."""
    if not recording.rows:
        return
    parent = options.out / "incomplete"
    number = len(list(parent.glob(f"{recording.name}-*"))) if parent.exists() else 0
    about = {"frame": "enu", "source": "CARLA, incomplete"}
    write_drive(parent / f"{recording.name}-{number}", recording, about, options)


def toml(content: dict[str, Any], table: str = "") -> str:
    """Return a dictionary of scalars, lists and tables as TOML."""
    # JSON's numbers, strings and lists are valid TOML.
    values = ((key, v) for key, v in content.items() if not isinstance(v, dict))
    text = "\n".join(f"{key} = {json.dumps(v, ensure_ascii=False)}" for key, v in values) + "\n"
    for key, value in content.items():
        if isinstance(value, dict):
            name = f"{table}{key}"
            text += f"\n[{name}]\n{toml(dict(value), f'{name}.')}"
    return text


def describe(
    session: Session,
    recording: Recording,
    plan: Plan,
    physics: Physics,
    sensors: Sensors,
    condition: Condition,
) -> dict[str, Any]:
    """Return the content of drive.toml, with the names that simulated drives also have."""
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
    path = plan.path
    i = min(round(plan.start / SPACING), len(path.x) - 1)
    dx, dy = row.place[0] - path.x[i], row.place[1] - path.y[i]
    return abs(dx) + abs(dy) < 20.0 and dx * math.cos(path.heading[i]) + dy * math.sin(path.heading[i]) >= 0


def velocity_check(rows: Sequence[Row]) -> float:
    """Return the RMS difference between velocities and central differences of positions, m/s.

    The result is large if CARLA returns the velocity of the center of mass, but the position of the car's origin.
    """
    total = 0.0
    for a, b, c in zip(rows, rows[1:], rows[2:]):
        total += sum(((c.place[i] - a.place[i]) / (c.t - a.t) - b.velocity[i]) ** 2 for i in (0, 1))
    return round(math.sqrt(total / max(len(rows) - 2, 1)), 6)


def achieved(maneuver: str, recording: Recording, began: float) -> dict[str, float]:
    """Return the achieved values of a maneuver, with the names of the plan's ``target``."""
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
    best, stood = math.inf, None
    for i, speed in enumerate(speeds):
        if speed <= 0.1:
            stood = i
        elif speed >= fast and stood is not None:
            best, stood = min(best, (i - stood) * TICK), None
    return best
