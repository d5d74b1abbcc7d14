"""Small files that claim a large content are rejected, with the option that raises the limit."""

import json
import struct
import tracemalloc
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.bags import ROS1
from importing.logs import a_drive, imported
from importing.test_phones import phyphox, zipped
from sigmaswarm.errors import InputError
from sigmaswarm.importing.formats import open_log
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.source import Limits
from support import quickly

mcap = pytest.importorskip("mcap.writer", reason="mcap is not installed")
IMU = a_drive().imu


def write(
    path: Path, sent: list[tuple[str, bytes]], text: bytes = b"{}", encoding: str = "json", **chunks
) -> Path:
    with path.open("wb") as file:
        writer = mcap.Writer(file, **chunks)
        writer.start()
        form = "jsonschema" if encoding == "json" else "ros2msg"
        schema = writer.register_schema("a/msg/T0", form, text)
        channels: dict[str, int] = {}
        for i, (topic, data) in enumerate(sent):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], i, data, i)
        writer.finish()
    return path


def definition(breadth: int, leaf: str) -> bytes:
    """A message of messages of messages, ``breadth`` of each in each, six deep."""
    part = b"\n" + b"=" * 80 + b"\n"
    text = "\n".join(f"a/T1 f{i}" for i in range(breadth)).encode()
    for level in range(1, 6):
        fields = "\n".join(f"a/T{level + 1} f{i}" for i in range(breadth))
        text += part + f"MSG: a/T{level}\n{fields}".encode()
    return text + part + b"MSG: a/T6\n" + "\n".join(f"{leaf} f{i}" for i in range(breadth)).encode()


@pytest.mark.parametrize(
    ("breadth", "leaf"), quickly([(9, "float64[36]"), (60, "string")], lambda breadth, _: breadth == 9)
)
def test_a_definition_of_hundreds_of_millions_of_columns(tmp_path: Path, breadth: int, leaf: str):
    log = write(tmp_path / "log.mcap", [("/imu", bytes(100))] * 10, definition(breadth, leaf), "cdr")
    for use in (imported, lambda path: inspect_request(Request(path))):
        tracemalloc.start()
        with pytest.raises(InputError, match="more than 100000 columns; raise --max-columns"):
            use(log)
        assert tracemalloc.get_traced_memory()[1] < 100e6
        tracemalloc.stop()


def test_a_definition_that_holds_itself(tmp_path: Path):
    text = b"a/B b\n" + b"=" * 80 + b"\nMSG: a/B\na/B b\na/B c\nfloat64 x\n"
    log = write(tmp_path / "log.mcap", [("/imu", bytes(100))] * 10, text, "cdr")
    with pytest.raises(InputError):
        imported(log)


def test_messages_with_more_columns_than_the_limit(tmp_path: Path):
    wide = json.dumps({f"c{i}": i for i in range(300)}).encode()
    log = write(tmp_path / "log.mcap", [("/a", wide), ("/b", wide)])
    assert len(inspect_request(Request(log)).tables) == 2
    for columns in (299, 500):  # one topic beyond it, and both together
        with pytest.raises(InputError, match="columns; raise --max-columns"):
            inspect_request(Request(log, limits=Limits(columns=columns)))


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4"])
def test_a_chunk_that_becomes_gigabytes(tmp_path: Path, compression: str):
    """Both by what its record says and, where that lies, by what the packed data say."""
    sent = [("/x", b'{"a":1,"p":"' + b" " * 1_000_000 + b'"}')] * 4
    kind = mcap.CompressionType[compression]
    log = write(tmp_path / "log.mcap", sent, compression=kind, chunk_size=1 << 30)
    assert log.stat().st_size < 100_000
    limits = Limits(unpacked_mb=3)
    with pytest.raises(
        InputError,
        match=r"needs at least 4 MB in memory at once, but the limit is 3 MB; .* --max-unpacked-mb",
    ):
        inspect_request(Request(log, limits=limits))
    data = log.read_bytes()
    size = next(n for n in range(4_000_000, 4_010_000) if struct.pack("<Q", n) in data[:200])
    log.write_bytes(data.replace(struct.pack("<Q", size), struct.pack("<Q", 4096)))
    with pytest.raises(InputError):
        inspect_request(Request(log, limits=limits))
    log.write_bytes(data)
    assert inspect_request(Request(log)).tables


def test_an_lz4_chunk_that_does_not_say_its_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    import lz4.frame as lz4

    silent = partial(lz4.compress, store_size=False)
    monkeypatch.setattr(mcap.lz4.frame, "compress", lambda data, **_: silent(data))
    sent = [("/x", b'{"a":1,"p":"' + b" " * 1_000_000 + b'"}')] * 4
    log = write(tmp_path / "log.mcap", sent, compression=mcap.CompressionType.LZ4, chunk_size=1 << 30)
    data = log.read_bytes()
    size = next(n for n in range(4_000_000, 4_010_000) if struct.pack("<Q", n) in data[:200])
    log.write_bytes(data.replace(struct.pack("<Q", size), struct.pack("<Q", 4096)))
    with pytest.raises(InputError, match="needs at least 3 MB in memory at once, but the limit is 3"):
        inspect_request(Request(log, limits=Limits(unpacked_mb=3)))
    log.write_bytes(data)
    assert inspect_request(Request(log)).tables


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_a_ros_bag_whose_chunks_become_gigabytes(tmp_path: Path, compression: str):
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    writer = rosbag1.Writer(tmp_path / "log.bag")
    writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    text = ROS1.types["std_msgs/msg/String"]
    with writer:
        connection = writer.add_connection("/x", "std_msgs/msg/String", typestore=ROS1)
        imu = writer.add_connection("/n", "std_msgs/msg/Float64", typestore=ROS1)
        for i in range(4):
            writer.write(connection, i, ROS1.serialize_ros1(text(" " * 1_000_000), "std_msgs/msg/String"))
            number = ROS1.types["std_msgs/msg/Float64"](float(i))
            writer.write(imu, i, ROS1.serialize_ros1(number, "std_msgs/msg/Float64"))
    assert (tmp_path / "log.bag").stat().st_size < 100_000

    def read(limits: Limits) -> int:
        with open_log(tmp_path / "log.bag", None, limits) as source:
            return sum(len(rows) for _, rows, _ in source.batches({"/n": ["data"]}))

    with pytest.raises(InputError, match="in memory at once, but the limit is"):
        read(Limits(unpacked_mb=0))
    assert read(Limits(unpacked_mb=8)) == 4


def test_a_parquet_of_more_rows_than_the_limit(tmp_path: Path):
    rows = 20_000
    frame = pl.DataFrame({"t": np.arange(rows) * 0.01}).with_columns(
        ax=0.0, ay=0.0, gz=0.0, x=pl.col("t"), y=0.0
    )
    frame.write_parquet(tmp_path / "log.parquet")
    frame.write_csv(tmp_path / "log.csv")
    for name in ("log.parquet", "log.csv"):
        with pytest.raises(
            InputError, match=r"contains more than 10000 rows; split the log, or raise --max-rows"
        ):
            imported(tmp_path / name, limits=Limits(rows=10_000))
        assert len(imported(tmp_path / name).drive.imu) == rows


def test_a_parquet_of_billions_of_rows_is_refused_by_its_own_words(tmp_path: Path):
    pl.select(t=pl.repeat(0, 60_000_000, dtype=pl.Int8)).with_columns(ax=pl.col("t")).write_parquet(
        tmp_path / "log.parquet"
    )
    assert (tmp_path / "log.parquet").stat().st_size < 1_000_000
    for use in (imported, lambda path: inspect_request(Request(path))):
        with pytest.raises(InputError, match="more than 10000000 rows"):
            use(tmp_path / "log.parquet")


def test_a_zip_whose_tables_become_gigabytes(tmp_path: Path):
    folder = phyphox(tmp_path / "export")
    log = zipped(folder)
    size = sum((folder / f"{n}.csv").stat().st_size for n in ("Accelerometer", "Gyroscope", "Location"))
    assert len(imported(log, limits=Limits(unpacked_mb=size // 1_000_000 + 1)).drive.imu) == len(IMU)
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("Accelerometer", "Gyroscope", "Location"):
            archive.writestr(f"{name}.csv", "a,b\n" + "0,0\n" * 500_000)
    with pytest.raises(
        InputError,
        match="needs at least 6 MB in memory at once, but the limit is 5 MB; raise --max-unpacked-mb",
    ):
        imported(tmp_path / "bomb.zip", limits=Limits(unpacked_mb=5))
