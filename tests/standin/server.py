"""The stand-in as a process: `python -m standin.server --version 0.9.16`.

It listens on 127.0.0.1 alone, prints its port when it is ready, and ends when its standard input closes, or
after `--life` seconds at the latest. At its end it writes what was true to `--log`, as JSON.
"""

import argparse
import json
import os
import socket
import struct
import sys
import threading
import time
from pathlib import Path
from typing import Any

import msgpack

from standin import wire
from standin.car import Car
from standin.world import World


class Streams:
    """Sensor data on its way: connections by the number of the stream that the client asked for."""

    def __init__(self) -> None:
        self.listener = _listen()
        self.port = self.listener.getsockname()[1]
        self.connections: dict[int, list[socket.socket]] = {}
        threading.Thread(target=self._accept, daemon=True).start()

    def token(self, stream: int) -> bytes:
        return wire.token(stream, self.port)

    def heard(self, stream: int) -> bool:
        return bool(self.connections.get(stream))

    def send(self, stream: int, payload: bytes) -> None:
        for connection in list(self.connections.get(stream, [])):
            try:
                connection.sendall(wire.block(payload))
            except OSError:
                self.connections[stream].remove(connection)

    def hang_up(self) -> None:
        """Close all connections."""
        for connection in [c for listening in self.connections.values() for c in listening]:
            connection.shutdown(socket.SHUT_RDWR)
        self.connections.clear()

    def _accept(self) -> None:
        while True:
            connection, _ = self.listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            (stream,) = struct.unpack("<I", connection.recv(4, socket.MSG_WAITALL))
            self.connections.setdefault(stream, []).append(connection)


def _listen() -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", 0))
    listener.listen()
    return listener


def _serve(connection: socket.socket, world: World, lock: threading.Lock) -> None:
    """Answer one client's calls until it goes."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    unpacker = msgpack.Unpacker(raw=False, strict_map_key=False, unicode_errors="surrogateescape")
    try:
        while data := connection.recv(65536):
            unpacker.feed(data)
            for _, number, name, args in unpacker:
                connection.sendall(_answer(world, lock, number, name, args))
    except OSError:
        return


def _answer(world: World, lock: threading.Lock, number: int, name: str, args: list[Any]) -> bytes:
    if os.environ.get("STANDIN_TRACE"):
        print(name, str(args)[:600], file=sys.stderr, flush=True)
    args = args[1:] if args and isinstance(args[0], list) and args[0] in ([False], [True]) else args
    try:
        with lock:
            return wire.answer(number, world.call(name, args))
    except AttributeError as error:
        print(f"stand-in: {name}: {error}", file=sys.stderr, flush=True)
        return wire.unknown(number, name)


class Server:
    """One stand-in: sockets, threads, and the end."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options, self.lock = options, threading.Lock()
        self.clients: list[socket.socket] = []
        self.world = World(options.version, Streams(), options.faults, self.lose)
        self.listener = _listen()

    def lose(self, how: str) -> None:
        """Lose the connection: `die` with the server itself, or only `hang up`."""
        if how == "die":
            self.end(9)
        for client in self.clients:
            client.shutdown(socket.SHUT_RDWR)
        self.clients.clear()
        self.world.streams.hang_up()

    def end(self, code: int) -> None:
        """End the process, with what was true in the log."""
        world = self.world
        log = {
            "truth": world.truth,
            "settings": world.settings,
            "weather": world.weather,
            "actors": [actor.blueprint for actor in world.actors.values()],
            "calls": world.calls,
            "attributes": world.spawned,
        }
        if self.options.log:
            self.options.log.write_text(json.dumps(log))
        os._exit(code)

    def watch(self) -> None:
        """End when nobody holds our standard input any more."""
        sys.stdin.read()
        with self.lock:
            self.end(0)

    def run_free(self) -> None:
        """Tick by ourselves while no client does."""
        while True:
            time.sleep(0.05)
            with self.lock:
                if not self.world.settings[0]:
                    self.world.advance()

    def accept(self) -> None:
        """Serve whoever comes."""
        while True:
            client, _ = self.listener.accept()
            self.clients.append(client)
            threading.Thread(target=_serve, args=(client, self.world, self.lock), daemon=True).start()


def main() -> None:
    """Serve until standard input closes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--version", default="0.9.16")
    parser.add_argument("--life", type=float, default=120.0, help="s, after which the process ends by itself")
    parser.add_argument("--log", type=Path, help="file for what was true")
    parser.add_argument("--faults", type=json.loads, default={}, help="what goes wrong; see World")
    options = parser.parse_args()
    Car(0.0, 0.0, 0.0).tick(0.01)  # compiles, where no cache is there yet
    server = Server(options)
    for work in (server.watch, server.run_free, server.accept):
        threading.Thread(target=work, daemon=True).start()
    print(server.listener.getsockname()[1], flush=True)
    time.sleep(options.life)
    with server.lock:
        server.end(3)


if __name__ == "__main__":
    main()
