"""The world of the stand-in: settings, weather, actors and ticks, and the replies to the client's calls."""

import random
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from standin import wire
from standin.car import Car
from standin.geodesy import to_geolocation
from standin.town import write_town

ORIGIN = (49.0, 8.0)
"""Latitude and longitude of the map's origin, deg."""
MAPS: dict[str, dict[str, Any]] = {"Grid": {}, "Village": {"tail": 150.0}}
"""Towns and their parameters."""
DEFAULTS = [False, False, [False], True, 0.01, 10, 0.0, False, 3000.0, 2000.0, True]
"""EpisodeSettings of a new server."""
GARBAGE = 2
"""Number of first inertial samples that are wrong (carla-simulator/carla#8970)."""

FAULTS = {
    "say_version": "version that the server reports",
    "ignore_settings": "the step of a synchronous mode is ignored",
    "ignore_physics": "the car's physics are ignored",
    "mirror_gnss": "fixes are mirrored at the map's x axis",
    "fail_spawn": "number of failing spawns of a car",
    "stuck": "number of cars that ignore the throttle",
    "astray": "number of cars that ignore the steering wheel",
    "grip": "friction of the stock tires, 0.85 by default",
    "deaf": "number of first samples of each sensor that are not sent",
    "silent": "a sensor, and the number of its first sample that is no longer sent",
    "late": "a sensor, the number of the delayed sample, and the delay in s",
    "drop_frame": "number of the tick cue (after the car's spawn) at which two frames pass",
    "hang_up": "number of the tick cue at which all connections are closed",
    "die": "number of the tick cue at which the server ends",
    "always": "the previous three faults are repeated for each car",
}

_CAR = "vehicle.tesla.model3"
_SENSORS = {
    "sensor.other.imu": [
        f"noise_{kind}_{axis}"
        for kind in ("accel_stddev", "gyro_stddev", "gyro_bias")
        for axis in ("x", "y", "z")
    ],
    "sensor.other.gnss": [
        f"noise_{axis}_{kind}" for axis in ("lat", "lon", "alt") for kind in ("bias", "stddev")
    ],
}


@dataclass
class Actor:
    """An actor that the client has spawned."""

    number: int
    blueprint: str
    attributes: dict[str, str]
    record: list[Any]
    parent: int = 0
    car: Car | None = None
    samples: int = 0
    noise: random.Random = field(default_factory=random.Random)

    def deviation(self, name: str) -> float:
        return float(self.attributes.get(name, 0.0))


class World:
    """State of the server; the caller holds a lock around every method.

    Parameters
    ----------
    version : str
        Version of the server.
    streams : Streams
        Receiver of the sensor data.
    faults : dict
        Planted faults; see `FAULTS`.
    lose : callable
        Function that closes the connection, "die" or "hang up".
    """

    def __init__(
        self, version: str, streams: Any, faults: dict[str, Any], lose: Callable[[str], None]
    ) -> None:
        assert faults.keys() <= FAULTS.keys()
        self.version, self.streams, self.faults, self.lose = version, streams, faults, lose
        self.settings = list(DEFAULTS)
        self.weather = [10.0] + 13 * [0.0]
        self.actors: dict[int, Actor] = {}
        self.frame, self.elapsed, self.numbers, self.cars = 100, 5.0, 1, 0
        self.map, self.episode = "Grid", 1
        self.truth: list[list[float]] = []
        self.ticks = 0
        """Number of tick cues since the client has spawned a car."""
        self.calls: dict[str, int] = {}
        self.spawned: list[dict[str, str]] = []

    def log(self) -> dict[str, Any]:
        """Return the true values for the tests."""
        return {
            "truth": self.truth,
            "settings": self.settings,
            "weather": self.weather,
            "actors": [actor.blueprint for actor in self.actors.values()],
            "calls": self.calls,
            "attributes": self.spawned,
        }

    # -- calls of a client ------------------------------------------------------------------------

    def call(self, name: str, args: list[Any]) -> Any:
        """Execute a call; raise AttributeError for an unsupported one."""
        self.calls[name] = self.calls.get(name, 0) + 1
        return getattr(self, f"call_{name}")(*args)

    def call_version(self) -> str:
        return self.faults.get("say_version", self.version)

    def call_get_episode_info(self) -> list[Any]:
        return [self.episode, [self.streams.token(1)]]

    def call_get_sensor_token(self, stream: int) -> list[bytes]:
        return [self.streams.token(stream)]

    def call_get_episode_settings(self) -> list[Any]:
        return self.settings

    def call_set_episode_settings(self, settings: list[Any]) -> int:
        if self.faults.get("ignore_settings") and settings[0]:
            settings = [*settings[:2], [True, 0.05], *settings[3:]]
        self.settings = settings
        return self.frame

    def call_query_lights_state(self, client: str) -> list[Any]:
        return []

    def call_get_weather_parameters(self) -> list[Any]:
        return self.weather

    def call_set_weather_parameters(self, weather: list[Any]) -> None:
        self.weather = weather

    def call_get_map_info(self) -> list[Any]:
        return [f"Carla/Maps/{self.map}/{self.map}", []]

    def call_get_map_data(self) -> str:
        return write_town(**MAPS[self.map], origin=ORIGIN)

    def call_get_available_maps(self) -> list[str]:
        return [f"/Game/Carla/Maps/{name}/{name}" for name in MAPS]

    def call_load_new_episode(self, name: str, *_: Any) -> None:
        self.map, self.episode = name, self.episode + 1
        self.actors.clear()

    def call_get_required_files(self, folder: str) -> list[str]:
        return []

    def call_request_file(self, name: str) -> bytes:
        return self.call_get_map_data().encode()

    def call_get_actor_definitions(self) -> list[Any]:
        shift = 1 if self.version == "0.9.16" else 0  # shift of the attribute types

        def attribute(name: str, kind: int, value: str) -> list[Any]:
            return [name, kind + shift, value, [], True, False]

        common = [attribute("role_name", 3, "front")]
        found = [[1, _CAR, "vehicle,tesla,model3", [*common, attribute("number_of_wheels", 1, "4")]]]
        for uid, (sensor, names) in enumerate(_SENSORS.items(), 2):
            own = [attribute(name, 2, "0.0") for name in names]
            seed = [attribute("noise_seed", 1, "0"), attribute("sensor_tick", 2, "0.0")]
            found.append([uid, sensor, sensor.replace(".", ","), [*common, *own, *seed]])
        return found

    def call_spawn_actor(self, description: list[Any], transform: list[Any]) -> Any:
        return self._spawn(description, transform, 0)

    def call_spawn_actor_with_parent(self, description, transform, parent, *_: Any) -> Any:
        return self._spawn(description, transform, parent)

    def _spawn(self, description: list[Any], transform: list[Any], parent: int) -> Any:
        if self.faults.get("fail_spawn", 0) > 0 and parent == 0:
            self.faults["fail_spawn"] -= 1
            return wire.CallError("Spawn failed because of collision at spawn position")
        self.numbers += 1
        number, blueprint = self.numbers, description[1]
        stream = self.streams.token(number) if blueprint.startswith("sensor") else b""
        box = [[0.0, 0.0, 0.75], [2.396, 1.082, 0.744], [0.0, 0.0, 0.0]]
        record = [number, parent, description, box, b"\x0a", stream]
        attributes = {name: value for name, _, value in description[2]}
        actor = Actor(number, blueprint, attributes, record, parent)
        self.spawned.append({"blueprint": blueprint, **attributes})
        actor.noise.seed(int(attributes.get("noise_seed", 0)))
        if blueprint == _CAR:
            (x, y, _), (_, yaw, _) = transform
            self.ticks, self.cars = 0, self.cars + 1
            actor.car = Car(x, y, yaw, self.faults.get("grip", 0.85))
        self.actors[number] = actor
        return record

    def call_destroy_actor(self, number: int) -> bool:
        if any(other.parent == number for other in self.actors.values()):
            raise RuntimeError("a vehicle is destroyed before its sensors: a genuine server would crash")
        return self.actors.pop(number, None) is not None

    def call_get_actors_by_id(self, numbers: list[int]) -> list[Any]:
        return [self.actors[n].record for n in numbers if n in self.actors]

    def call_get_physics_control(self, number: int) -> list[Any]:
        return self._car(number).told_physics()

    def call_apply_physics_control(self, number: int, physics: list[Any]) -> None:
        if not self.faults.get("ignore_physics"):
            self._car(number).physics = physics

    def call_apply_control_to_vehicle(self, number: int, control: list[Any]) -> None:
        if number in self.actors:
            throttle, steer, *rest = control
            throttle = 0.0 if self.cars <= self.faults.get("stuck", 0) else throttle
            steer = 0.1 if self.cars <= self.faults.get("astray", 0) else steer
            self._car(number).control = [throttle, steer, *rest]

    def _car(self, number: int) -> Car:
        car = self.actors[number].car
        assert car is not None
        return car

    # -- time ----------------------------------------------------------------------------------------

    def call_tick_cue(self) -> int:
        self.ticks += 1
        if not self.settings[0]:
            return self.frame
        if self._strikes("drop_frame"):
            self.advance()
        for how in ("die", "hang up"):
            if self._strikes(how.replace(" ", "_")):
                self.lose(how)
        self.advance()
        return self.frame

    def _strikes(self, fault: str) -> bool:
        if self.ticks != self.faults.get(fault):
            return False
        if not self.faults.get("always"):
            del self.faults[fault]
        return True

    def advance(self) -> None:
        """Advance by one frame: move the cars and send sensor data."""
        fixed = self.settings[2]
        seconds = fixed[1] if fixed[0] else 0.05
        self.frame, self.elapsed = self.frame + 1, self.elapsed + seconds
        for actor in self.actors.values():
            if actor.car is not None:
                actor.car.tick(seconds)
                self.truth.append([self.frame, *actor.car.truth(), *sum(actor.car.felt, ())])
        states = [self._state(actor) for actor in self.actors.values()]
        message = wire.snapshot(self.version, self.episode, self.frame, self.elapsed, seconds, states)
        self.streams.send(1, message)
        for actor in self.actors.values():
            if actor.parent and self.streams.heard(actor.number):
                actor.samples += 1
                self._send(actor, self._measure(actor))

    def _send(self, actor: Actor, message: bytes) -> None:
        name = actor.blueprint.split(".")[-1]
        silent, since = self.faults.get("silent", ["", 0])
        late, sample, seconds = self.faults.get("late", ["", 0, 0.0])
        if (name == silent and actor.samples >= since) or actor.samples <= self.faults.get("deaf", 0):
            return
        if name == late and actor.samples == sample:
            threading.Timer(seconds, self.streams.send, (actor.number, message)).start()
        else:
            self.streams.send(actor.number, message)

    def _state(self, actor: Actor) -> bytes:
        car = self.actors.get(actor.parent, actor).car
        nothing = (0.0, 0.0, 0.0)
        return wire.actor_state(actor.number, *(car.seen if car else 4 * (nothing,)))

    def _measure(self, actor: Actor) -> bytes:
        car = self._car(actor.parent)

        def noisy(value: float, name: str, bias: str) -> float:
            return value + actor.deviation(bias) + actor.deviation(name) * actor.noise.gauss(0.0, 1.0)

        if actor.blueprint.endswith("gnss"):
            (x, y, _), *_ = car.seen
            version = "0.9.16" if self.version == "0.9.16" else "0.9.14"
            y = -y if self.faults.get("mirror_gnss") else y
            lat, lon = (float(v) for v in to_geolocation(x, y, *ORIGIN, version))
            lat = noisy(lat, "noise_lat_stddev", "noise_lat_bias")
            lon = noisy(lon, "noise_lon_stddev", "noise_lon_bias")
            return wire.gnss(self.frame, self.elapsed, lat, lon)
        force, rate = car.felt
        axes = ("x", "y", "z")
        force = tuple(noisy(v, f"noise_accel_stddev_{a}", "") for v, a in zip(force, axes, strict=True))
        rate = tuple(
            noisy(v, f"noise_gyro_stddev_{a}", f"noise_gyro_bias_{a}")
            for v, a in zip(rate, axes, strict=True)
        )
        if actor.samples <= GARBAGE:
            force, rate = (1e6, -1e6, 1e6), (50.0, 50.0, 50.0)
        return wire.imu(self.frame, self.elapsed, force, rate)
