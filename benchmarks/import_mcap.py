"""Measure time and memory of the import of a long MCAP file that contains pictures.

    python benchmarks/import_mcap.py [--hours 2] [--size 1.1] [--folder FOLDER]

Writes a file of ``--size`` GB to a temporary folder: IMU samples at 100 Hz, fixes at 5 Hz, and pictures. Imports the
file with the command line in a separate process, and then removes the folder.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
EPOCH = 1_700_000_000


def header(ns: int, frame: str):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def imu(ns: int, t: float):
    vector, nine = TYPES["geometry_msgs/msg/Vector3"], np.zeros(9)
    return TYPES["sensor_msgs/msg/Imu"](
        header(ns, "imu"),
        TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        nine,
        vector(0.0, 0.0, 0.1 * np.cos(t / 20)),
        nine,
        vector(0.3 * np.sin(t / 20), 1.0 * np.cos(t / 20), 9.8),
        nine,
    )


def fix(ns: int, t: float):
    status = TYPES["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
    place = (50.0 + 1e-3 * np.sin(t / 20), 8.0 + 1e-3 * np.cos(t / 20), 100.0)
    return TYPES["sensor_msgs/msg/NavSatFix"](header(ns, "gps"), status, *place, np.eye(3).ravel(), 2)


def write(path: Path, hours: float, size: float) -> None:
    """Fill the file with pictures at 10 Hz. The chunks are not compressed, since pictures are incompressible."""
    names = {
        "/imu": "sensor_msgs/msg/Imu",
        "/fix": "sensor_msgs/msg/NavSatFix",
        "/camera": "sensor_msgs/msg/Image",
    }
    samples = round(hours * 3600 * 100)
    rest = size * 1e9 - samples * 380
    picture = np.random.default_rng(0).integers(0, 256, max(int(rest / (samples / 10)), 1), dtype=np.uint8)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for topic, name in names.items():
            schema = writer.register_schema(name, "ros2msg", STORE.generate_msgdef(name)[0].encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for k in range(samples):
            ns = EPOCH * 10**9 + k * 10**7
            sent = [("/imu", imu(ns, k / 100))]
            if k % 20 == 7:
                sent.append(("/fix", fix(ns, k / 100)))
            if k % 10 == 3:
                image = (header(ns, "camera"), 1, len(picture), "mono8", 0, len(picture), picture)
                sent.append(("/camera", TYPES["sensor_msgs/msg/Image"](*image)))
            for topic, message in sent:
                data = bytes(STORE.serialize_cdr(message, names[topic]))
                writer.add_message(channels[topic], ns, data, ns)
        writer.finish()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--size", type=float, default=1.1, help="GB")
    parser.add_argument("--folder", type=Path, help="parent of the temporary folder")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        free = shutil.disk_usage(folder).free
        if free < 2.5e9 * options.size:
            sys.exit(f"{folder}: only {free / 1e9:.1f} GB free")
        began = time.perf_counter()
        write(folder / "long.mcap", options.hours, options.size)
        gigabytes = (folder / "long.mcap").stat().st_size / 1e9
        print(f"wrote {gigabytes:.2f} GB, {options.hours:g} h in {time.perf_counter() - began:.0f} s")
        code = "from sigmaswarm.cli import main; main()"
        command = [
            sys.executable,
            "-c",
            code,
            "import",
            str(folder / "long.mcap"),
            "--out",
            str(folder / "drive"),
        ]
        began = time.perf_counter()
        process = subprocess.Popen(command)
        _, status, used = os.wait4(process.pid, 0)
        took = time.perf_counter() - began
        rows = sum(1 for _ in (folder / "drive" / "imu.csv").open()) - 1
        assert status == 0 and re.match(r"t,ax,ay", (folder / "drive" / "imu.csv").read_text()[:20])
        print(f"imported {rows} samples in {took:.0f} s, peak memory {used.ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
