"""ROS 1 and ROS 2 bags and MCAP: all columns of a drive that other libraries wrote are restored."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from importing.bags import ROS1, ROS2, messages, odometry, write_mcap, write_ros
from importing.logs import EPOCH, ORIGIN, a_drive, assert_close, imported
from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import TableChoice
from support import quickly, some

DRIVE = a_drive(5.0)
AT = Recipe(origin=ORIGIN)


def write(folder: Path, kind: str, **options) -> Path:
    """A bag of some kind that contains the drive."""
    if kind in ("cdr", "json"):
        return write_mcap(folder / "log.mcap", messages(DRIVE, **options), kind)
    path = folder / ("log.bag" if kind == "ros1" else "bag")
    return write_ros(path, messages(DRIVE, ROS1 if kind == "ros1" else ROS2, **options), kind)


def assert_same(got) -> None:
    """Every column of the drive, to float rounding (nanosecond stamps; covariances and quaternions computed)."""
    assert_close(got.imu, DRIVE.imu, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.imu, DRIVE.imu, "ax ay az gx gy gz", 0)
    assert_close(got.gps, DRIVE.gps, "lat lon alt", 0)
    assert_close(got.gps, DRIVE.gps, "time std_x std_y speed course", 1e-9)
    assert_close(got.gps, DRIVE.gps, "x y", 5e-9)  # a float's last bit of a degree is 1e-9 m
    assert_close(got.truth, DRIVE.truth, "x y", 0)
    assert_close(got.truth, DRIVE.truth, "time vx vy", 1e-9)
    np.testing.assert_allclose(wrap_angle(got.truth.theta - DRIVE.truth.theta), 0, atol=1e-12)


@pytest.mark.parametrize("kind", some(["ros1", "sqlite3", "mcap", "cdr", "json"]))
def test_round_trip(tmp_path: Path, kind: str):
    got = imported(write(tmp_path, kind), recipe=AT)
    assert_same(got.drive)
    assert got.drive.frame == "wgs84" and got.drive.origin == ORIGIN
    if kind != "json":
        assert any("'imu_link'" in note for note in got.notes)


@pytest.mark.parametrize(
    "kind", quickly([("ros1",), ("sqlite3",), ("mcap",), ("cdr",)], lambda kind: kind in ("ros1", "mcap"))
)
def test_a_vendors_message_that_the_file_defines(tmp_path: Path, kind: str):
    assert_same(imported(write(tmp_path, kind, custom=True), recipe=AT).drive)


def test_storage_file_alone(tmp_path: Path):
    folder = write(tmp_path, "sqlite3")
    assert_same(imported(next(folder.glob("*.db3")), recipe=AT).drive)
    (folder / "metadata.yaml").unlink()
    assert_same(imported(folder, recipe=AT).drive)


def test_a_number_of_messages_that_is_none(tmp_path: Path):
    file = write(tmp_path, "mcap") / "metadata.yaml"
    file.write_text(re.sub(r"(  - message_count: )\d+", r"\1many", file.read_text(), count=1))
    with pytest.raises(InputError, match=r"its metadata.yaml is damaged .*; run `ros2 bag reindex`"):
        imported(file.parent)


def test_stamps_count_and_their_distance_is_told(tmp_path: Path):
    bag = write(tmp_path, "sqlite3", delay=0.25)
    stamped, received = imported(bag), imported(bag, choice=TableChoice(receive_times=True))
    assert any("0.250 s before the receive times" in note for note in stamped.notes)
    step = stamped.drive.imu.time - received.drive.imu.time + stamped.drive.metadata["time_origin_s"]
    np.testing.assert_allclose(step - received.drive.metadata["time_origin_s"], -0.25, atol=1e-8)
    assert not any("receive times" in note for note in received.notes)


def test_unset_stamps(tmp_path: Path):
    got = imported(
        write(tmp_path, "sqlite3", delay=float(EPOCH) + 100.0), choice=TableChoice(receive_times=True)
    )
    assert_close(got.drive.imu, DRIVE.imu, "time", 1e-9)

    def unset():
        for topic, time, message in messages(DRIVE):
            if hasattr(message, "header"):
                message.header.stamp.sec = message.header.stamp.nanosec = 0
            yield topic, time, message

    (tmp_path / "b").mkdir()
    got = imported(write_ros(tmp_path / "b" / "bag", unset()), recipe=AT)
    assert_same(got.drive)
    assert any("not set" in note for note in got.notes)


def test_several_imus_are_chosen_among(tmp_path: Path):
    def doubled():
        for topic, time, message in messages(DRIVE):
            yield topic, time, message
            if topic == "/imu/data" and time > 1.0:
                other = type(message)(**{k: getattr(message, k) for k in message.__dataclass_fields__})
                vector = type(message.linear_acceleration)
                other.linear_acceleration = vector(7.0, 7.0, 7.0)
                yield "/imu/second", time, other

    bag = write_ros(tmp_path / "bag", doubled())
    first = imported(bag, recipe=AT)
    assert_same(first.drive)
    assert any("/imu/data is used for the imu, not /imu/second" in note for note in first.notes)
    second = imported(bag, choice=TableChoice({"imu": "imu/second"}))
    assert np.all(second.drive.imu.ax == 7.0)


@pytest.mark.parametrize("custom", some([False, True]))
def test_an_axis_that_points_down_is_told(tmp_path: Path, custom: bool):
    down = replace(DRIVE, imu=rotate_imu(DRIVE.imu, np.diag([1.0, -1.0, -1.0])))
    bag = write_ros(tmp_path / "bag", messages(down, custom=custom))
    assert any("the z axis points down" in note for note in imported(bag, recipe=AT).assumed)
    got = imported(bag, recipe=replace(AT, mount="x=x,y=-y"))
    assert not any("points down" in note for note in (*got.notes, *got.assumed))
    assert_same(got.drive)
    assert not any("points down" in note for note in imported(write(tmp_path, "ros1", custom=custom)).assumed)


def test_wheel_odometry_is_no_truth_unless_chosen(tmp_path: Path):
    renamed = (("/wheel" if t == "/ground_truth" else t, time, m) for t, time, m in messages(DRIVE))
    bag = write_ros(tmp_path / "bag", renamed)
    got = imported(bag, recipe=AT)
    assert got.drive.truth is None
    assert any("to use /wheel as truth" in note for note in got.notes)
    assert_same(imported(bag, recipe=AT, choice=TableChoice({"truth": "/wheel"})).drive)


def test_commands_are_no_velocity(tmp_path: Path):
    def sent():
        for topic, time, message in messages(DRIVE):
            yield ("/cmd_vel" if topic == "/gps/vel" else topic), time, message

    assert imported(write_ros(tmp_path / "bag", sent())).drive.gps.speed is None


def test_no_fix_and_unknown_covariance_are_left_out(tmp_path: Path):
    def sent():
        for i, (topic, time, message) in enumerate(messages(DRIVE)):
            if topic == "/gps/fix":
                message.position_covariance_type = 0
                if i % 3 == 0:
                    message.status.status = -1
                    message.latitude = float("nan")
            yield topic, time, message

    got = imported(write_ros(tmp_path / "bag", sent()))
    assert got.drive.gps.std_x is None
    assert 0 < len(got.drive.gps) < len(DRIVE.gps)
    assert any("status.status >= 0 is not true" in note for note in got.notes)


def test_fixes_as_poses_in_metres(tmp_path: Path):
    got = imported(write(tmp_path, "sqlite3"), choice=TableChoice({"gps": "/ground_truth"}))
    assert got.drive.frame == "enu"
    last = DRIVE.gps.time  # the receiver's velocity goes with the fixes, while there is one
    both = (DRIVE.truth.time >= last[0]) & (DRIVE.truth.time <= last[-1])
    assert_close(got.drive.gps, DRIVE.truth.select(both), "x y", 0)


def test_fields_are_mapped(tmp_path: Path):
    bag = write(tmp_path, "mcap", custom=True)
    got = imported(bag, maps=["ax=-imu.linear_acceleration.y", "ay=imu.linear_acceleration.x"], recipe=AT)
    np.testing.assert_array_equal(got.drive.imu.ax, -DRIVE.imu.ay)
    np.testing.assert_array_equal(got.drive.imu.ay, DRIVE.imu.ax)


@pytest.mark.parametrize("kind", some(["ros1", "sqlite3", "mcap", "cdr"]))
@pytest.mark.parametrize("damage", ["cut", "empty", "wrong", "no topics"])
def test_broken(tmp_path: Path, kind: str, damage: str):
    if damage == "no topics":
        sent = (m for m in messages(DRIVE) if m[0] == "/rosout_text")
        path = tmp_path / ("log.bag" if kind == "ros1" else "log.mcap" if kind == "cdr" else "bag")
        kept = (
            (t, time, ROS1.types["std_msgs/msg/String"]("x") if kind == "ros1" else m) for t, time, m in sent
        )
        path = write_mcap(path, kept) if kind == "cdr" else write_ros(path, kept, kind)
    else:
        path = write(tmp_path, kind)
        file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
        content = file.read_bytes()
        broken = {"cut": content[: len(content) * 6 // 10], "empty": b"", "wrong": b"not a bag at all" * 99}
        file.write_bytes(broken[damage])
    with pytest.raises(InputError) as caught:
        imported(path)
    said = str(caught.value)
    print(f"{kind}, {damage}: {said}")
    assert path.name in said and "\n" not in said and len(said) < 400


def test_missing_topic(tmp_path: Path):
    with pytest.raises(InputError, match=r"no topic '/imu0' for --imu-topic; choose from"):
        imported(write(tmp_path, "sqlite3"), choice=TableChoice({"imu": "/imu0"}))
    with pytest.raises(InputError, match=r"has no fields with recognized names for ax, ay, gz"):
        imported(tmp_path / "bag", choice=TableChoice({"imu": "/gps/fix"}))


TURNED = (5.0, -10.0, 90.0)
"""Roll, pitch and yaw of the IMU in base_link, deg."""
ARM = (1.5, -0.5, 0.8)
"""From the IMU to the antenna, m, in base_link."""


def static(store, *transforms: tuple[str, str, tuple, tuple[float, float, float]]):
    """A message of static transforms: parent, child, roll, pitch and yaw in deg, translation in m."""
    t, stamp = store.types, {"seq": 0} if store is ROS1 else {}
    made = []
    for parent, child, degrees, at in transforms:
        x, y, z, w = Rotation.from_euler("xyz", degrees, degrees=True).as_quat()
        moment = t["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        header = t["std_msgs/msg/Header"](stamp=moment, frame_id=parent, **stamp)
        translation, rotation = (
            t["geometry_msgs/msg/Vector3"](*at),
            t["geometry_msgs/msg/Quaternion"](x, y, z, w),
        )
        transform = t["geometry_msgs/msg/Transform"](translation, rotation)
        made.append(t["geometry_msgs/msg/TransformStamped"](header, child, transform))
    return "/tf_static", float(DRIVE.imu.time[0]), t["tf2_msgs/msg/TFMessage"](made)


def mounted(kind: str, folder: Path, *more, without: str = "") -> Path:
    """A bag whose IMU is turned and away from the antenna, as its static transforms say."""
    store = ROS1 if kind == "ros1" else ROS2
    turn = Rotation.from_euler("xyz", TURNED, degrees=True).inv()
    force = turn.apply(np.column_stack([DRIVE.imu.ax, DRIVE.imu.ay, DRIVE.imu.az])).T
    rates = turn.apply(np.column_stack([DRIVE.imu.gx, DRIVE.imu.gy, DRIVE.imu.gz])).T
    imu = replace(DRIVE.imu, **dict(zip(("ax", "ay", "az", "gx", "gy", "gz"), (*force, *rates), strict=True)))
    sent = [m for m in messages(replace(DRIVE, imu=imu), store) if not without or without not in m[0]]
    return write_ros(folder / ("log.bag" if kind == "ros1" else "bag"), iter([*sent, *more]), kind)


def plates(store, base: str = "base_link"):
    """The IMU on a plate that is itself turned, and the antenna on a roof: chains of two."""
    return [
        static(store, (base, "plate", (0.0, 0.0, 90.0), (0.2, 0.1, 0.0)), ("plate", "imu_link", *inner())),
        static(
            store,
            (base, "roof", (0.0, 0.0, 0.0), (1.0, 0.0, 1.0)),
            ("/roof", "gps", (3.0, 0, 0), (0.7, -0.4, 0)),
        ),
    ]


def inner() -> tuple[tuple, tuple[float, float, float]]:
    whole = Rotation.from_euler("xyz", TURNED, degrees=True)
    own = Rotation.from_euler("z", 90, degrees=True).inv() * whole
    return tuple(own.as_euler("xyz", degrees=True)), (0.0, 0.0, 0.2)


@pytest.mark.parametrize(
    "kind", quickly([("ros1",), ("sqlite3",), ("mcap",)], lambda kind: kind == "sqlite3")
)
def test_static_transforms_are_the_mounting_and_the_lever_arm(tmp_path: Path, kind: str):
    got = imported(mounted(kind, tmp_path, *plates(ROS1 if kind == "ros1" else ROS2)), recipe=AT)
    assert_close(got.drive.imu, DRIVE.imu, "ax ay az gx gy gz", 1e-6)
    assert got.drive.metadata["gps_lever_arm_m"] == pytest.approx([1.5, -0.5, 0.8])
    assert [float(a) for a in got.recipe.mount.split(",")] == pytest.approx(TURNED, abs=1e-5)
    assert any(
        f"mounting {got.recipe.mount} deg" in note and "imu_link in base_link" in note for note in got.notes
    )
    assert any(
        "lever arm 1.5,-0.5,0.8 m is taken from tf_static, from imu_link to gps" in note for note in got.notes
    )


def test_what_is_stated_comes_before_static_transforms(tmp_path: Path):
    bag = mounted("sqlite3", tmp_path, *plates(ROS2))
    got = imported(bag, recipe=Recipe(origin=ORIGIN, mount="x=y,y=-x", gps_lever_arm_m=(1.0, 2.0, 3.0)))
    assert got.recipe.mount == "x=y,y=-x" and got.drive.metadata["gps_lever_arm_m"] == [1.0, 2.0, 3.0]
    assert not any("tf_static" in note for note in got.notes)


def test_the_root_of_the_transforms_is_the_vehicle_where_none_is_called_so(tmp_path: Path):
    got = imported(mounted("sqlite3", tmp_path, *plates(ROS2, base="chassis")), recipe=AT)
    assert got.drive.metadata["gps_lever_arm_m"] == pytest.approx(ARM)
    assert any("imu_link in chassis" in note for note in got.notes)


@pytest.mark.parametrize(
    "broken", quickly([("ring",), ("zero",), ("no antenna",)], lambda broken: broken != "no antenna")
)
def test_transforms_that_lead_nowhere_place_nothing(tmp_path: Path, broken: str):
    flat = (0.0, 0.0, 0.0)
    ring = [("imu_link", "base_footprint", flat, flat), ("base_footprint", "imu_link", flat, flat)]
    message = static(
        ROS2, *(ring if broken == "ring" else [("base_link", "imu_link", (0.0, 0.0, 90.0), flat)])
    )
    if broken == "zero":
        rotation = message[2].transforms[0].transform.rotation
        rotation.x = rotation.y = rotation.z = rotation.w = 0.0
    got = imported(mounted("sqlite3", tmp_path, message), recipe=AT)
    assert got.recipe.mount == {"ring": "0,0,0", "zero": "", "no antenna": "0,0,90"}[broken]
    assert "gps_lever_arm_m" not in got.drive.metadata
    assert any(
        "does not contain the position of gps; specify it with --lever-arm" in n for n in got.notes
    ) == (broken != "zero")


def test_fixes_of_navsat_transform_are_those_of_the_vehicle(tmp_path: Path):
    sent = []
    for i, time in enumerate(DRIVE.truth.time[::20]):
        t = ROS2.types
        ns = round(float(time) * 1e9) + EPOCH * 10**9
        stamp = t["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        message = odometry(DRIVE, 20 * i, t["std_msgs/msg/Header"](stamp=stamp, frame_id="map"), t)
        message.pose.covariance[[0, 7]] = 4.0
        message.child_frame_id = ""
        sent.append(("/odometry/gps", float(time), message))
    got = imported(mounted("mcap", tmp_path, *plates(ROS2), *sent, without="gps"))
    assert got.drive.gps.x.tolist() == DRIVE.truth.x[::20].tolist()
    assert got.drive.gps.std_x is not None and (got.drive.gps.std_x == 2.0).all()
    assert got.drive.metadata["gps_lever_arm_m"] == pytest.approx([-0.2, -0.1, -0.2])


def test_the_variances_that_the_imu_states_are_kept(tmp_path: Path):
    def stating():
        for topic, time, message in messages(DRIVE):
            if topic == "/imu/data":
                message.angular_velocity_covariance = np.diag([1.0, 1.0, 2e-4]).ravel()
                message.linear_acceleration_covariance = np.diag([0.04, 1.0, 1.0]).ravel()
            yield topic, time, message

    assert imported(write_ros(tmp_path / "a", stating()), recipe=AT).drive.metadata["imu_stated_noise"] == [
        2e-4,
        0.04,
    ]
    unknown = imported(write_ros(tmp_path / "b", messages(DRIVE)), recipe=AT).drive.metadata
    assert "imu_stated_noise" not in unknown
