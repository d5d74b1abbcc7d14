"""Record one drive: IMU and truth of each frame, and a fix every `GPS_EVERY` frames."""

from __future__ import annotations

import math
import queue
import random
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from .car import Driver, Physics, control
from .geometry import axial, heading_of, polar
from .options import GPS_EVERY, RATE, STANDSTILL_TIME, TICK, FailedRun, RecorderError
from .plans import Plan
from .server import Session

DISCARDED_SAMPLES = 3  # first samples of a sensor, which are wrong (carla#8970)
STUCK_TIME = 20.0  # s without 1 m of progress after which the car counts as stuck


class Row(NamedTuple):
    """One tick: time, s; position, m; velocity, m/s; heading, rad; specific force, m/s2; angular rate, rad/s."""

    t: float
    place: tuple[float, float, float]
    velocity: tuple[float, float, float]
    heading: float
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def speed(self) -> float:
        """Horizontal speed, m/s."""
        return math.hypot(*self.velocity[:2])


@dataclass
class Recording:
    """Samples and fixes of a drive, up to the latest frame."""

    name: str
    rows: list[Row] = field(default_factory=list)
    fixes: list[tuple[float, float, float]] = field(default_factory=list)  # s, m east, m north
    first_frame: int = 0


def seed_of(*names: object) -> int:
    """Hash names to a seed from 1 to 2**31 - 1."""
    return zlib.crc32("/".join(str(name) for name in names).encode()) % 2147483647 + 1


class Sensors:
    """IMU and GNSS receiver of the car, read frame by frame."""

    def __init__(self, session: Session, car: Any, name: str, rng: random.Random) -> None:
        o = session.options
        lat, lon = session.geodesy.degrees(o.gps_noise)
        self.bias = [rng.uniform(-o.gyro_bias, o.gyro_bias) for _ in range(3)]
        figures = {f"gyro_bias_{axis}": v for axis, v in zip("xyz", self.bias)}
        for axis in "xyz":
            figures.update({f"accel_stddev_{axis}": o.accel_noise, f"gyro_stddev_{axis}": o.gyro_noise})
        noise = {"imu": figures, "gnss": {"lat_stddev": lat, "lon_stddev": lon}}
        self.seeds = {sensor: seed_of(o.seed, name, sensor) for sensor in noise}
        self._timeout = o.timeout
        self._queues: dict[str, queue.Queue[Any]] = {sensor: queue.Queue() for sensor in noise}
        actors: dict[str, Any] = {}
        for sensor, stated in noise.items():
            attributes = {f"noise_{key}": repr(value) for key, value in stated.items()}
            attributes.update(noise_seed=str(self.seeds[sensor]), sensor_tick="0.0")
            actors[sensor] = session.spawn(
                f"sensor.other.{sensor}", attributes, session.carla.Transform(), car
            )
        for sensor, actor in actors.items():
            actor.listen(self._queues[sensor].put)

    def start(self, tick: Callable[[], int]) -> int:
        """Tick until both sensors send data, skip their first samples, and return the number of the last frame."""
        end, wait = time.monotonic() + self._timeout, 0.05
        while True:
            frame = tick()
            silent = [sensor for sensor in self._queues if self._get(sensor, frame, wait) is None]
            if not silent:
                break
            if time.monotonic() > end:
                raise self._silence(silent[0], frame)
            wait *= 2
        for _ in range(DISCARDED_SAMPLES):
            frame = tick()
            self.read(frame)
        return frame

    def read(self, frame: int) -> list[Any]:
        """Wait for the data that the IMU and the GNSS receiver send for a frame, and return both."""
        found: list[Any] = []
        for sensor in self._queues:
            found.append(self._get(sensor, frame, self._timeout))
            if found[-1] is None:
                raise self._silence(sensor, frame)
        return found

    def _silence(self, sensor: str, frame: int) -> RecorderError:
        return RecorderError(
            f"the sensor {sensor} sent no data for frame {frame} within {self._timeout:g} s; restart the "
            "server, or increase --timeout"
        )

    def _get(self, sensor: str, frame: int, seconds: float) -> Any:
        """Return the data of a frame, or None if it does not arrive in time; discard older data."""
        end = time.monotonic() + seconds
        while True:
            try:
                data = self._queues[sensor].get(timeout=max(end - time.monotonic(), 0.001))
            except queue.Empty:
                return None
            if data.frame == frame:
                return data
            if data.frame > frame:
                raise RecorderError(
                    f"the sensor {sensor} skipped frame {frame} and sent frame {data.frame}; restart the server"
                )


def drive(
    session: Session,
    recording: Recording,
    plan: Plan,
    car: Any,
    physics: Physics,
    rng: random.Random,
    show: Callable[[float], None],
) -> Sensors:
    """Drive a plan and append the data to `recording`, which after a failure contains the data up to the failure."""
    name, rows = recording.name, recording.rows
    sensors = Sensors(session, car, name, rng)
    driver = Driver(plan, physics.wheelbase, rng)
    car.apply_control(session.carla.VehicleControl(brake=1.0))
    frame = sensors.start(session.tick)
    recording.first_frame = frame + 1
    state, began = state_of(session, car, frame), None
    furthest, since = 0.0, 0.0  # m and s
    while not driver.arrived:
        x, y = state.place[:2]
        control(session, car, physics, driver.step(x, y, state.heading, state.speed))
        frame, now = frame + 1, session.tick()
        if now != frame:
            raise RecorderError(
                f"frame {frame} of {name} is missing: the server jumped from {frame - 1} to {now}; disconnect "
                "other clients"
            )
        t = round((frame - recording.first_frame) * TICK, 6)
        imu, fix = sensors.read(frame)
        force, rate = polar(imu.accelerometer), axial(imu.gyroscope)
        state = state_of(session, car, frame)._replace(t=t, force=force, rate=rate)
        if not all(map(math.isfinite, (*force, *rate))):
            raise FailedRun(f"{name}: a value of the IMU is not finite at t = {t} s")
        rows.append(state)
        if began is None and driver.way >= plan.start:
            began = t
        hidden = began is not None and any(0 <= t - began - at < long for at, long in plan.outages)
        if (frame - recording.first_frame) % GPS_EVERY == 0 and not hidden:
            recording.fixes.append((t, *session.geodesy.place(fix.latitude, fix.longitude)))
            if len(recording.fixes) == STANDSTILL_TIME * RATE / GPS_EVERY:
                check_fixes(recording, session.options.gps_noise)
        if driver.way > furthest + 1.0:
            furthest, since = driver.way, t
        stuck = t - since > STUCK_TIME
        if abs(driver.off) > 4.0 or stuck:
            trouble = "got stuck" if stuck else "left its route"
            raise FailedRun(
                f"{name}: the car {trouble} after {driver.way:.0f} m, at {x:.0f}, {y:.0f} m east and north"
            )
        show(t)
    return sensors


def state_of(session: Session, car: Any, frame: int) -> Row:
    """Return the truth of a frame from the world's snapshot."""
    snapshot = session.world.get_snapshot()
    step, seen = snapshot.timestamp.delta_seconds, snapshot.find(car.id)
    if snapshot.frame != frame:
        raise RecorderError(
            f"the world's snapshot is of frame {snapshot.frame}, not {frame}; disconnect other clients"
        )
    if abs(step - TICK) > 1e-6:
        raise RecorderError(
            f"the server's time step is {step:g} s, not {TICK:g} s; restart the server without other clients"
        )
    if seen is None:
        raise RecorderError(f"the car is missing in frame {frame}; disconnect other clients")
    place = seen.get_transform()
    return Row(0.0, polar(place.location), polar(seen.get_velocity()), heading_of(place.rotation))


def check_fixes(recording: Recording, noise: float) -> None:
    """Raise RecorderError if the fixes are far from the car, since server and client then use different geodesies."""
    places = {row.t: row.place for row in recording.rows}
    errors = sorted(math.hypot(x - places[t][0], y - places[t][1]) for t, x, y in recording.fixes)
    if errors and errors[len(errors) // 2] > 3 * noise + 0.5:
        raise RecorderError(
            f"the fixes of {recording.name} are {errors[len(errors) // 2]:.1f} m from the car: server and client "
            "compute different latitudes and longitudes; use a client and a server of the same build"
        )
