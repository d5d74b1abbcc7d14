"""Connect to a CARLA server, prepare it for a recording, and restore its settings."""

from __future__ import annotations

import re
import socket
import sys
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from .geometry import Geodesy
from .options import TICK, LostConnection, Options, RecorderError

_KEEP: list[Any] = []
"""Objects of a lost connection. They are kept, since their destructors would wait for the server."""


def reachable(host: str, port: int, seconds: float) -> bool:
    """Return True if a program accepts connections at the port."""
    try:
        socket.create_connection((host, port), seconds).close()
    except OSError:
        return False
    return True


def number_of(version: str) -> str:
    """Return the numbers of a version such as 0.9.14-2-gabc; client and server must have the same numbers."""
    found = re.match(r"\d+\.\d+\.\d+", version)
    return found.group() if found else version


def import_carla() -> Any:
    try:
        return import_module("carla")
    except ImportError as error:
        raise RecorderError(
            f"the CARLA client can't be imported ({error}); run pip install carla==VERSION with the version of the "
            "server: 0.9.14 needs Python 3.8, 0.9.15 needs 3.8 to 3.10, 0.9.16 needs 3.10 to 3.12"
        ) from None


def connect(carla: Any, options: Options) -> Any:
    """Connect to the server; raise RecorderError if the client's version differs, since calls could crash."""
    place = f"{options.host}:{options.port}"
    if not reachable(options.host, options.port, options.timeout):
        raise RecorderError(
            f"no CARLA server at {place}; start one (./CarlaUE4.sh -RenderOffScreen), or specify --host and --port"
        )
    client = carla.Client(options.host, options.port)
    client.set_timeout(options.timeout)
    try:
        server = client.get_server_version()
    except RuntimeError as error:
        raise RecorderError(
            f"the program at {place} does not answer like a CARLA server ({one_line(error)}); "
            "specify the --port of the server, or increase --timeout"
        ) from None
    mine = client.get_client_version()
    if number_of(mine) != number_of(server):
        raise RecorderError(
            f"the server at {place} is CARLA {server}, but the client is {mine}; run pip install "
            f"carla=={number_of(server)}"
        )
    return client


def one_line(error: BaseException) -> str:
    return " ".join(str(error).split())


ROLE = "sigmaswarm"  # role name by which a recorder finds the actors of a recorder that was killed
SUBSTEP = 0.001  # s, step of the physics; with CARLA's default the gyro is wrong
# Settings of the server during a recording.
SETTINGS: dict[str, Any] = {
    "synchronous_mode": True,
    "no_rendering_mode": True,
    "fixed_delta_seconds": TICK,
    "substepping": True,
    "max_substep_delta_time": SUBSTEP,
    "max_substeps": round(TICK / SUBSTEP),
}


def _same(found: Any, wanted: Any) -> bool:
    return found is not None and abs(found - wanted) < 1e-9


class Session:
    """A connection to a server, whose settings are those of a recording until the `with` block ends.

    Attributes
    ----------
    world, town : CARLA's world and map
    version : version of the server
    geodesy : conversion of the map's latitudes and longitudes to m
    """

    def __init__(self, options: Options, before: dict[str, Any]) -> None:
        """Connect to the server; `before` keeps its original settings and weather if several sessions are needed."""
        self.options, self._before = options, before
        self.actors: list[Any] = []
        self.carla = import_carla()
        self.client = connect(self.carla, options)
        self.version = str(self.client.get_server_version())

    def __enter__(self) -> Session:
        with self.trouble():
            self._load_map()
            self.world = self.client.get_world()
            self.town = self.world.get_map()
            self.geodesy = Geodesy.probe(self.carla, self.town)
            settings = self.world.get_settings()
            if not self._before:  # after a lost connection, the settings are those of the recording
                self._before.update(settings=self._as_before(settings), weather=self.world.get_weather())
        try:
            with self.trouble():
                self._apply_settings()
                self.tick()  # a world lists its actors only after a tick
                left = [a for a in self.world.get_actors() if a.attributes.get("role_name") == ROLE]
                for actor in sorted(left, key=lambda a: not a.type_id.startswith("sensor")):
                    actor.destroy()
        except BaseException:
            self.restore()
            raise
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        if isinstance(error, LostConnection):
            _KEEP.extend([self, *self.actors])
            return
        trouble = self.restore()
        if trouble and kind is None:
            raise RecorderError(trouble)
        if trouble:
            print(f"warning: {trouble}", file=sys.stderr)

    @contextmanager
    def trouble(self) -> Generator[None, None, None]:
        """Convert the client's errors to LostConnection."""
        try:
            yield
        except RuntimeError as error:
            raise LostConnection(f"the server stopped answering: {one_line(error)}") from None

    def _load_map(self) -> None:
        wanted = self.options.map
        if not wanted:
            return
        names = [str(name) for name in self.client.get_available_maps()]
        if wanted not in [name.split("/")[-1] for name in names]:
            known = ", ".join(sorted(name.split("/")[-1] for name in names))
            raise RecorderError(f"the server has no map {wanted!r}; it has {known}")
        if self.client.get_world().get_map().name.split("/")[-1] != wanted:
            self.client.set_timeout(max(self.options.timeout, 120.0))
            self.client.load_world(wanted)
            self.client.set_timeout(self.options.timeout)

    def _as_before(self, settings: Any) -> Any:
        """Return the settings to restore; if an earlier recorder was killed, return CARLA's defaults."""
        if not all(_same(getattr(settings, name), value) for name, value in SETTINGS.items()):
            return settings
        print(
            "warning: the server has the settings of a recording that was killed; this recording will restore CARLA's "
            "default settings",
            file=sys.stderr,
        )
        return self.carla.WorldSettings()

    def _apply_settings(self) -> None:
        settings = self.world.get_settings()
        for name, value in SETTINGS.items():
            setattr(settings, name, value)
        self.world.apply_settings(settings)
        found = self.world.get_settings()
        for name, value in SETTINGS.items():
            if not _same(getattr(found, name), value):
                raise RecorderError(
                    f"the server has {name} = {getattr(found, name)} instead of {value}; restart the server "
                    "without other clients"
                )

    def tick(self) -> int:
        """Advance by one frame and return its number."""
        return int(self.world.tick(self.options.timeout))

    def spawn(self, blueprint: str, attributes: dict[str, str], transform: Any, parent: Any = None) -> Any:
        """Spawn an actor; `clear` removes it."""
        definition = self.world.get_blueprint_library().find(blueprint)
        for name, value in {"role_name": ROLE, **attributes}.items():
            if definition.has_attribute(name):
                definition.set_attribute(name, value)
        actor = self.world.spawn_actor(definition, transform, attach_to=parent)
        self.actors.append(actor)
        return actor

    def clear(self) -> None:
        """Remove all actors, first the sensors and then the car; otherwise the server may crash."""
        sensors = [a for a in self.actors if a.type_id.startswith("sensor")]
        for sensor in sensors:
            if sensor.is_listening:
                sensor.stop()
        if sensors:
            self.tick()
        for actor in [*sensors, *(a for a in self.actors if a not in sensors)]:
            actor.destroy()
        self.actors.clear()

    def restore(self) -> str:
        """Restore the world. Return a message about failures, or an empty string if there are none."""
        if not reachable(self.options.host, self.options.port, 2.0):
            _KEEP.extend([self, *self.actors])
            return "the server does not answer, so its settings and weather could not be restored"
        failed: list[str] = []
        for what, step in (
            ("actors", self.clear),
            ("weather", lambda: self.world.set_weather(self._before["weather"])),
            ("settings", lambda: self.world.apply_settings(self._before["settings"])),
        ):
            try:
                step()
            except RuntimeError as error:
                failed.append(f"{what} ({one_line(error)})")
        if not failed:
            self._before.clear()
        return f"could not restore the server's {', '.join(failed)}; restart the server" if failed else ""
