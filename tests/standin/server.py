"""The stand-in as a process: `python -m standin.server`.

It listens only on 127.0.0.1 and prints its port. Each line of its standard input is a command in JSON:
`{"version": "0.9.16", "faults": {}}` begins a new world, without the clients of the last one;
`{"log": "FILE"}` writes the truth. It answers each command with a line. It ends when its standard input closes, or
after `--life` seconds at the latest.
"""

import argparse
import contextlib
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
    """Sensor data that are sent: connections by the number of the stream that the client has requested."""

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
            with contextlib.suppress(OSError):  # the client has closed it
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
    """Answer the calls of one client until it disconnects."""
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
    """A stand-in: sockets, threads, and the present world."""

    def __init__(self) -> None:
        self.lock, self.listener, self.streams = threading.Lock(), _listen(), Streams()
        self.clients: list[socket.socket] = []
        self.world = World("0.9.16", self.streams, {}, self.lose)

    def obey(self, order: dict[str, Any]) -> None:
        """Start a new world, or write the log of the present one."""
        if "log" in order:
            Path(order["log"]).write_text(json.dumps(self.world.log()))
            return
        self.lose("hang up")
        self.world = World(order["version"], self.streams, order["faults"], self.lose)

    def lose(self, how: str) -> None:
        """Close the connections (`hang up`), or end the process (`die`)."""
        if how == "die":
            os._exit(9)
        for client in self.clients:
            with contextlib.suppress(OSError):  # the client has closed it
                client.shutdown(socket.SHUT_RDWR)
        self.clients.clear()
        self.streams.hang_up()

    def listen_to_orders(self) -> None:
        """Execute commands until standard input closes."""
        for line in sys.stdin:
            with self.lock:
                self.obey(json.loads(line))
            print("done", flush=True)
        os._exit(0)

    def run_free(self) -> None:
        """Advance the world while no client controls the ticks."""
        while True:
            time.sleep(0.05)
            with self.lock:
                if not self.world.settings[0]:
                    self.world.advance()

    def accept(self) -> None:
        """Accept clients."""
        while True:
            client, _ = self.listener.accept()
            with self.lock:
                self.clients.append(client)
                world = self.world
            threading.Thread(target=_serve, args=(client, world, self.lock), daemon=True).start()


def main() -> None:
    """Serve until standard input closes."""
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "--life", type=float, default=1200.0, help="s, after which the process ends by itself"
    )
    options = parser.parse_args()
    Car(0.0, 0.0, 0.0).tick(0.01)  # compiles if the cache is empty
    server = Server()
    for work in (server.listen_to_orders, server.run_free, server.accept):
        threading.Thread(target=work, daemon=True).start()
    print(server.listener.getsockname()[1], flush=True)
    time.sleep(options.life)
    os._exit(3)


if __name__ == "__main__":
    main()
