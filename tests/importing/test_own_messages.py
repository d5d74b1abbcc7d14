"""Bags of messages that an author defined: wrapped numbers, arrays, PX4's, and Protobuf in MCAP."""

import shlex
import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from importing.bags import ROS1, ROS2, Message, Writer2, messages, write_ros
from importing.logs import EPOCH, a_drive, assert_close, imported
from sigmaswarm import import_log
from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.importing.convert import import_drive
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.source import TableChoice
from sigmaswarm.simulation import simulate
from support import quickly, several, some

DRIVE = a_drive(5.0)
IMU, GPS = DRIVE.imu, DRIVE.gps
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
SENSOR = "uint64 timestamp\nfloat32[3] gyro_rad\nfloat32[3] accelerometer_m_s2\n"
FIX = "uint64 timestamp\nfloat64 latitude_deg\nfloat64 longitude_deg\nuint8 fix_type\nfloat32 eph\n"
DEFINED = {
    "own_msgs/msg/Wrapped": "std_msgs/Header header\nstd_msgs/Float64 latitude\nstd_msgs/Float64 longitude\n",
    "own_msgs/msg/Bare": "std_msgs/Float64 latitude\nstd_msgs/Float64 longitude\n",
    "own_msgs/msg/Plain": "int64 time_us\nfloat64 lat\nfloat64 lon\n",
    "own_msgs/msg/Stamped": "float64 stamp\nfloat64 lat\nfloat64 lon\n",
    "own_msgs/msg/Arrays": "std_msgs/Header header\nfloat64[3] accel_m_s2\nfloat64[3] gyro_deg_s\n",
    "own_msgs/msg/Flat": "float64 acc_x_g\nfloat64 acc_y_g\nfloat64 acc_z_g\nfloat64 gx\nfloat64 gy\nfloat64 gz\n",
    "own_msgs/msg/Codes": "float64[3] q\nfloat64 first\nfloat64 second\n",
    "px4_msgs/msg/SensorCombined": SENSOR,
    "px4_msgs/msg/SensorGps": FIX,
}
for store in (ROS1, ROS2):
    for name, text in DEFINED.items():
        store.register(get_types_from_msg(text, name))


def stamp(store: Any, time: float) -> Any:
    ns = round(time * 1e9) + EPOCH * 10**9
    sequence = {"seq": 0} if store is ROS1 else {}
    moment = store.types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=moment, frame_id="", **sequence)


def one(store: Any, kind: str, i: int) -> Any:
    """A message of a kind, of the drive's sample or fix."""
    make = store.types[kind]
    if kind.endswith("Wrapped"):
        number = store.types["std_msgs/msg/Float64"]
        return make(stamp(store, GPS.time[i]), number(GPS.lat[i]), number(GPS.lon[i]))
    if kind.endswith("Plain"):
        return make(round((GPS.time[i] + EPOCH) * 1e6), GPS.lat[i], GPS.lon[i])
    if kind.endswith("Stamped"):
        return make(GPS.time[i] + EPOCH, GPS.lat[i], GPS.lon[i])
    if kind.endswith("SensorGps"):
        return make(round(GPS.time[i] * 1e6), GPS.lat[i], GPS.lon[i], 3, 1.0)
    force, rate = np.array([IMU.ax[i], IMU.ay[i], IMU.az[i]]), np.array([IMU.gx[i], IMU.gy[i], IMU.gz[i]])
    if kind.endswith("Arrays"):
        return make(stamp(store, IMU.time[i]), force, np.degrees(rate))
    if kind.endswith("Flat"):
        return make(*force / 9.80665, *rate)
    down = np.array([1, -1, -1])
    return make(round(IMU.time[i] * 1e6), (rate * down).astype(np.float32), (force * down).astype(np.float32))


def of_kinds(store: Any, imu: str, fix: str) -> Iterator[Message]:
    yield from (("/imu", time, one(store, imu, i)) for i, time in enumerate(IMU.time))
    yield from (("/fix", time, one(store, fix, i)) for i, time in enumerate(GPS.time))


PAIRS = [("own_msgs/msg/Arrays", "own_msgs/msg/Wrapped"), ("own_msgs/msg/Flat", "own_msgs/msg/Plain"),
         ("own_msgs/msg/Arrays", "own_msgs/msg/Stamped"),
         ("px4_msgs/msg/SensorCombined", "px4_msgs/msg/SensorGps")]  # fmt: skip


@pytest.mark.parametrize("kind", some(["ros1", "sqlite3", "mcap"]))
@pytest.mark.parametrize("pair", some(PAIRS))
def test_numbers_are_known_by_their_names(tmp_path: Path, kind: str, pair: tuple[str, str]):
    path = tmp_path / ("log.bag" if kind == "ros1" else "bag")
    got = imported(write_ros(path, of_kinds(ROS1 if kind == "ros1" else ROS2, *pair), kind)).drive
    assert_close(got.imu, IMU, "ax ay az gx gy gz", 1e-5)
    assert_close(got.gps, GPS, "lat lon", 1e-9)
    np.testing.assert_allclose(got.imu.time - got.imu.time[0], IMU.time - IMU.time[0], atol=2e-6)
    np.testing.assert_allclose(got.gps.time[0] - got.imu.time[0], GPS.time[0] - IMU.time[0], atol=2e-6)


@pytest.mark.parametrize("kind", some(["Wrapped", "Bare"]))
def test_receive_times_are_told(tmp_path: Path, kind: str):
    """The header is not set, or the message has none."""
    zero = ROS1.types["std_msgs/msg/Header"](
        stamp=ROS1.types["builtin_interfaces/msg/Time"](0, 0), frame_id="", seq=0
    )
    number = ROS1.types["std_msgs/msg/Float64"]
    make = ROS1.types[f"own_msgs/msg/{kind}"]

    def sent() -> Iterator[Message]:
        yield from (("/imu", time, one(ROS1, "own_msgs/msg/Arrays", i)) for i, time in enumerate(IMU.time))
        for i, time in enumerate(GPS.time):
            place = number(GPS.lat[i]), number(GPS.lon[i])
            yield "/fix", time, make(*(zero, *place) if kind == "Wrapped" else place)

    notes = imported(write_ros(tmp_path / "log.bag", sent(), "ros1")).notes
    why = {"Wrapped": "the header stamps are not set", "Bare": "the messages have no header"}[kind]
    assert f"/fix: {why}, so receive times are used" in notes
    assert not any("/imu: " in note and "receive times are used" in note for note in notes)


def test_an_axis_that_points_down_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(globals(), "IMU", rotate_imu(IMU, np.diag([1.0, -1.0, -1.0])))
    notes = imported(write_ros(tmp_path / "bag", of_kinds(ROS2, *PAIRS[0]))).assumed
    assert any("accel_m_s2[2] is negative, so the z axis points down" in note for note in notes)


@pytest.mark.parametrize(("pair",), quickly(((pair,) for pair in PAIRS), lambda pair: pair == PAIRS[0]))
def test_definitions_that_the_bag_lacks_are_given(tmp_path: Path, pair: tuple[str, str]):
    """Bags of ROS 2 before Iron bring no definitions along."""
    with Writer2(tmp_path / "bag", version=8) as writer:
        connections = {}
        for topic, time, message in sorted(of_kinds(ROS2, *pair), key=lambda m: m[1]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(
                connections[topic], round(time * 1e9) + EPOCH * 10**9, ROS2.serialize_cdr(message, kind)
            )
    database = sqlite3.connect(next((tmp_path / "bag").glob("*.db3")))
    database.execute("delete from message_definitions")
    database.commit()
    database.close()
    with pytest.raises(InputError, match=r"no IMU samples.* --msg"):
        imported(tmp_path / "bag")
    names = [kind.rpartition("/")[2] + ".msg" for kind in pair]
    said = " ".join(inspect_request(Request(tmp_path / "bag")).notes)
    assert all(f"--msg {name}" in said for name in names)
    package = tmp_path / pair[0].split("/")[0] / "msg"
    package.mkdir(parents=True)
    for kind, name in zip(pair, names, strict=True):
        (package / name).write_text(DEFINED[kind])
    for definitions in ([package / name for name in names], [package.parent]):
        got = imported(tmp_path / "bag", definitions=definitions).drive
        assert_close(got.imu, IMU, "ax ay az gx gy gz", 1e-5)
        assert_close(got.gps, GPS, "lat lon", 1e-9)


def test_a_definition_that_is_none_is_one_line(tmp_path: Path):
    bag = write_ros(tmp_path / "bag", of_kinds(ROS2, *PAIRS[0]), "sqlite3")
    (tmp_path / "Arrays.msg").write_text("float64[[ x\n= y")
    for given in (tmp_path / "Arrays.msg", tmp_path / "missing.msg", tmp_path / "nothing"):
        with pytest.raises(InputError, match="--msg"):
            imported(bag, definitions=[given])


def test_a_topic_without_names_can_be_mapped(tmp_path: Path):
    make = ROS2.types["own_msgs/msg/Codes"]

    def sent() -> Iterator[Message]:
        yield from (m for m in messages(DRIVE, ROS2) if m[0] == "/imu/data")
        yield from (("/codes", t, make(np.zeros(3), GPS.lat[i], GPS.lon[i])) for i, t in enumerate(GPS.time))

    bag = write_ros(tmp_path / "bag", sent(), "sqlite3")
    with pytest.raises(InputError, match=r"/codes .* choose another topic, or map the fields with --map"):
        imported(bag, choice=TableChoice({"gps": "/codes"}))
    got = imported(bag, choice=TableChoice({"gps": "/codes"}), maps=["lat=first", "lon=second"]).drive
    assert_close(got.gps, GPS, "lat lon", 0)


def test_what_is_proposed_for_a_topic_reads_it(tmp_path: Path):
    """Names that only a proposal reads: it works as it is pasted."""
    text = "std_msgs/Header header\nfloat64 rover_latitude\nfloat64 rover_longitude\n"
    ROS2.register(get_types_from_msg(text, "own_msgs/msg/Rover"))
    make = ROS2.types["own_msgs/msg/Rover"]

    def sent() -> Iterator[Message]:
        yield from (m for m in messages(DRIVE, ROS2) if m[0] == "/imu/data")
        zero = ROS2.types["std_msgs/msg/Header"](ROS2.types["builtin_interfaces/msg/Time"](0, 0), "")
        yield from (("/rover", t, make(zero, GPS.lat[i], GPS.lon[i])) for i, t in enumerate(GPS.time))

    bag = write_ros(tmp_path / "bag", sent(), "sqlite3")
    words = shlex.split(inspect_request(Request(bag)).proposal)
    at = words.index("--map")
    choice = TableChoice({words[k].removeprefix("--").split("-")[0]: words[k + 1] for k in range(0, at, 2)})
    got = import_drive(replace(Request(bag), choice=choice, maps=words[at + 1 :]), "pasted").drive
    assert_close(got.gps, GPS, "lat lon", 0)
    assert_close(got.gps, GPS, "time", 1e-6)


@pytest.mark.parametrize("value", some(["abc", "", "1.5e9s"], 3))
def test_a_bag_whose_times_are_text_is_refused(tmp_path: Path, value: str):
    bag = write_ros(tmp_path / "bag", messages(DRIVE, ROS2), "sqlite3")
    database = sqlite3.connect(next(bag.glob("*.db3")))
    database.execute("update messages set timestamp=? where rowid=7", (value,))
    database.commit()
    database.close()
    with pytest.raises(InputError, match="has the receive time"):
        imported(bag)


@pytest.mark.parametrize("stamped", ["header", "timestamp", ""])
def test_protobuf(tmp_path: Path, stamped: str):
    pytest.importorskip("mcap_protobuf", reason="mcap-protobuf-support is not installed")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
    from mcap_protobuf.writer import Writer

    file = descriptor_pb2.FileDescriptorProto(
        name=f"own{stamped}.proto", package=f"own{stamped}", syntax="proto3"
    )
    file.dependency.append("google/protobuf/timestamp.proto")
    double, whole = (
        descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE,
        descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE,
    )

    def define(name: str, fields: dict[str, str]) -> None:
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields.items(), 1):
            about = {"type": whole, "type_name": kind} if kind else {"type": double}
            message.field.add(name=field, number=number, label=1, **about)

    moment = ".google.protobuf.Timestamp"
    head = (
        {"timestamp": moment}
        if stamped == "timestamp"
        else {"header": f".own{stamped}.Header"}
        if stamped
        else {}
    )
    define("Header", {"stamp": moment})
    define("Vector", dict.fromkeys("xyz", ""))
    vector = f".own{stamped}.Vector"
    define("Imu", {**head, "linear_acceleration": vector, "angular_velocity": vector})
    define("Fix", {**head, "latitude": "", "longitude": "", "altitude": ""})
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    make = {
        n: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"own{stamped}.{n}"))
        for n in ("Imu", "Fix")
    }

    def filled(kind: str, time: float) -> Any:
        message = make[kind]()
        ns = round(time * 1e9) + EPOCH * 10**9
        at = message.header.stamp if stamped == "header" else message.timestamp if stamped else None
        if at is not None:
            at.seconds, at.nanos = ns // 10**9, ns % 10**9
        return message

    rows: list[tuple[float, str, Any]] = []
    for i, t in enumerate(IMU.time):
        message = filled("Imu", t)
        for axis in "xyz":
            setattr(message.linear_acceleration, axis, getattr(IMU, f"a{axis}")[i])
            setattr(message.angular_velocity, axis, getattr(IMU, f"g{axis}")[i])
        rows.append((t, "/imu", message))
    for i, t in enumerate(GPS.time):
        message = filled("Fix", t)
        message.latitude, message.longitude, message.altitude = GPS.lat[i], GPS.lon[i], GPS.alt[i]
        rows.append((t, "/fix", message))
    with (tmp_path / "log.mcap").open("wb") as out, Writer(out) as writer:
        for t, topic, message in sorted(rows, key=lambda r: r[:2]):
            late = 0.0 if not stamped else 0.02
            writer.write_message(topic, message, round((t + late) * 1e9) + EPOCH * 10**9)
    got = imported(tmp_path / "log.mcap").drive
    assert_close(got.imu, IMU, "ax ay az gx gy gz", 0)
    assert_close(got.gps, GPS, "lat lon alt", 0)
    np.testing.assert_allclose(got.imu.time, IMU.time, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "number"), several([("mcap", "Float32"), ("ros1", "Float64"), ("sqlite3", "Float64")], 3)
)
def test_arrays_of_numbers_are_recognized_by_their_values(tmp_path: Path, kind: str, number: str):
    drive = simulate("urban", duration=60.0, imu_rate=50.0, run=1, gps="white-1m")
    store = ROS1 if kind == "ros1" else ROS2
    places = np.column_stack([drive.gps.x, drive.gps.y, 0 * drive.gps.x])
    fixes = enu_to_geodetic(places, (50.0, 8.0, 100.0))
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)

    def sent() -> Iterator[Message]:
        for topic, time, rows, form in (
            ("/imu", drive.imu.time, np.column_stack([getattr(drive.imu, n) for n in AXES]), number),
            ("/fix", drive.gps.time, fixes, "Float64"),
        ):
            make, dtype = store.types[f"std_msgs/msg/{form}MultiArray"], np.dtype(form.lower())
            yield from (
                (topic, t, make(layout, row.astype(dtype))) for t, row in zip(time, rows, strict=True)
            )

    bag = write_ros(tmp_path / ("log.bag" if kind == "ros1" else "log"), sent(), kind)
    seen = inspect_request(Request(bag))
    assert seen.works and "signs, axes and units agree" in seen.evidence
    got = import_log(bag, say=[].append, **seen.settings)
    for name in AXES:
        np.testing.assert_allclose(getattr(got.imu, name), getattr(drive.imu, name), atol=1e-5)
    np.testing.assert_allclose(got.gps.x - got.gps.x[0], drive.gps.x - drive.gps.x[0], atol=0.01)
