"""Messages between CARLA's client and server: calls, replies, and streams of sensor data.

Calls are msgpack-RPC as in rpclib. Streams are TCP connections, on which the client sends a number and then receives
blocks of bytes. Layouts follow LibCarla's headers (carla/rpc, carla/sensor, carla/streaming).
"""

import socket
import struct
from typing import Any

import msgpack

GNSS, IMU = 4, 5
"""Sensor numbers in LibCarla's registry, the same in 0.9.14 to 0.9.16."""
WORLD = {"0.9.14": 16, "0.9.15": 16, "0.9.16": 17}

Vector = tuple[float, float, float]


class CallError(Exception):
    """Error that a call returns instead of a value; the client raises it as RuntimeError."""


def answer(number: int, value: Any) -> bytes:
    """Return the reply to call `number`: a value, None, or a `CallError`."""
    if isinstance(value, CallError):
        return msgpack.packb([1, number, None, [[0, [str(value)]]]])
    return msgpack.packb([1, number, None, [[False]] if value is None else [[1, value]]])


def unknown(number: int, name: str) -> bytes:
    """Return the reply to a call that the server does not support."""
    return msgpack.packb([1, number, f"no function {name}", None])


def token(stream: int, port: int) -> bytes:
    """Return the address of a stream: its number, and TCP at 127.0.0.1."""
    return struct.pack("<IHBB", stream, port, 1, 1) + socket.inet_aton("127.0.0.1") + bytes(12)


def block(payload: bytes) -> bytes:
    """Return a block of a stream."""
    return struct.pack("<I", len(payload)) + payload


def header(kind: int, frame: int, elapsed: float) -> bytes:
    """Return the header of a sensor's message; the position, six floats, is zero."""
    return struct.pack("<QQd6f", kind, frame, elapsed, *6 * (0.0,))


def gnss(frame: int, elapsed: float, latitude: float, longitude: float) -> bytes:
    """Return a fix, deg."""
    return header(GNSS, frame, elapsed) + msgpack.packb([latitude, longitude, 0.0])


def imu(frame: int, elapsed: float, force: Vector, rate: Vector) -> bytes:
    """Return an inertial sample in CARLA's axes, m/s2 and rad/s, in single precision."""
    return header(IMU, frame, elapsed) + msgpack.packb([list(force), list(rate), 0.0], use_single_float=True)


def actor_state(number: int, place: Vector, rotation: Vector, velocity: Vector, rate: Vector) -> bytes:
    """Return an actor of a snapshot: m, deg (pitch, yaw, roll), m/s, deg/s; no acceleration, no controls."""
    return struct.pack("<IB15f", number, 1, *place, *rotation, *velocity, *rate, 0.0, 0.0, 0.0) + bytes(54)


def snapshot(
    version: str, episode: int, frame: int, elapsed: float, delta: float, actors: list[bytes]
) -> bytes:
    """Return the state of the world at a frame."""
    body = struct.pack("<Qdf3iI", episode, elapsed, delta, 0, 0, 0, 0)
    return header(WORLD[version], frame, elapsed) + body + b"".join(actors)
