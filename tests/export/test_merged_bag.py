"""The messages of a recorded bag merged with the estimate: same bytes, counts and types, and one clock."""

import tracemalloc
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed")
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from exported import tuned
from importing.bags import ROS1, ROS2, messages, write_mcap, write_ros
from importing.logs import EPOCH, a_drive, imported
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.exports.ros import TOPIC
from sigmaswarm.exports.trajectory import time_origin_of, write_estimate
from sigmaswarm.filters.run import Estimate, run_filter
from support import quickly

KINDS = ("sqlite3", "mcap", "sqlite3 file", "mcap file")


def recorded(folder: Path, kind: str) -> Path:
    """Write a bag of the drive, with a vendor's type that only the bag defines."""
    if kind == "cdr":
        return write_mcap(folder / "log.mcap", messages(a_drive(), custom=True))
    store, name = (ROS1, "log.bag") if kind == "ros1" else (ROS2, "bag")
    bag = write_ros(folder / name, messages(a_drive(), store, custom=True), kind.removesuffix(" file"))
    return next(f for f in bag.iterdir() if f.suffix in (".mcap", ".db3")) if kind.endswith("file") else bag


def estimated(drive: Drive) -> Estimate:
    return run_filter(drive, tuned("planar5", "ukf", 0.01, everything=False))


def contents(path: Path) -> list[tuple[str, str, int, bytes]]:
    """Return all messages of a bag in reading order: topic, type, time in ns, bytes."""
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        return [(c.topic, c.msgtype, t, bytes(raw)) for c, t, raw in bag.messages()]


@pytest.mark.parametrize("kind", quickly([(k,) for k in KINDS], lambda k: k == "mcap file"))
def test_the_bag_s_own_messages_are_merged(tmp_path: Path, kind: str):
    source = recorded(tmp_path, kind)
    drive = imported(source).drive
    estimate, out = estimated(drive), tmp_path / "e.ros2"
    write_estimate(estimate, out, time_origin=time_origin_of(drive), merge=source)
    before, after = contents(source), contents(out)
    assert len({topic for topic, *_ in before}) == 5
    originals = [message for message in after if not message[0].startswith("/sigmaswarm/")]
    assert sorted(originals) == sorted(before)
    assert [m[:1] + m[2:] for m in originals if m[0] == "/imu/data"] == [
        m[:1] + m[2:] for m in before if m[0] == "/imu/data"
    ]
    assert all(a[2] <= b[2] for a, b in pairwise(after))
    times = np.array([t for topic, _, t, _ in after if topic == TOPIC])
    np.testing.assert_allclose(times / 1e9 - EPOCH, estimate.time, rtol=0, atol=1e-6)
    imu = {t for topic, _, t, _ in before if topic == "/imu/data"}
    assert set(times.tolist()) <= imu  # equal to the nanosecond


def test_message_types_are_copied(tmp_path: Path):
    source = recorded(tmp_path, "mcap")
    drive = imported(source).drive
    write_estimate(estimated(drive), tmp_path / "e.ros2", time_origin=time_origin_of(drive), merge=source)
    with AnyReader([tmp_path / "e.ros2"]) as bag:  # without another typestore
        packet = next(bag.messages([c for c in bag.connections if c.topic == "/imu/data"]))
        message = bag.deserialize(packet[2], packet[0].msgtype)
        assert (packet[0].msgtype, message.temperature) == ("vendor_msgs/msg/Packet", 20.0)
        assert bag.topics[TOPIC].msgtype == "nav_msgs/msg/Odometry"


@pytest.mark.parametrize(
    ("case", "said"),
    [
        ("nowhere", "no such bag"),
        ("cdr", "is an MCAP file that ROS 2 did not write"),
        ("ros1", r"is a ROS 1 bag.*convert it first: rosbags-convert"),
        ("empty folder", "contains no bag"),
        ("broken", "is cut short or broken"),
        (
            "another time",
            r"covers 17000000\d\d\.\d{3} to .*specify the bag from which the drive was imported",
        ),
        ("itself", "already contains /sigmaswarm/odometry"),
    ],
)
def test_a_bag_that_can_not_be_merged_is_reported_and_nothing_is_written(
    tmp_path: Path, case: str, said: str
):
    bag = recorded(tmp_path, case if case in ("ros1", "cdr") else "mcap")
    drive = a_drive()
    estimate, at = estimated(drive), 0.0 if case == "another time" else float(EPOCH)
    source = {"nowhere": tmp_path / "nowhere.mcap", "empty folder": tmp_path / "empty"}.get(case, bag)
    (tmp_path / "empty").mkdir()
    if case == "broken":
        file = next(bag.glob("*.mcap"))
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    if case == "itself":
        source = tmp_path / "before.ros2"
        write_estimate(estimate, source, time_origin=at, merge=bag)
    with pytest.raises(InputError, match=said):
        write_estimate(estimate, tmp_path / "e.ros2", time_origin=at, merge=source)
    assert not (tmp_path / "e.ros2").exists()


def test_a_bag_with_an_error_in_the_middle_leaves_no_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    bag = recorded(tmp_path, "mcap")
    whole = AnyReader.messages

    def messages_with_an_error(self: AnyReader, *a, **k):
        for n, message in enumerate(whole(self, *a, **k)):
            if n == 100:
                raise ValueError("bad bytes")
            yield message

    monkeypatch.setattr(AnyReader, "messages", messages_with_an_error)
    with pytest.raises(InputError, match=r"bag: is cut short or broken \(bad bytes\)"):
        write_estimate(estimated(a_drive()), tmp_path / "e.ros2", time_origin=float(EPOCH), merge=bag)
    assert not (tmp_path / "e.ros2").exists()


def test_only_a_bag_can_be_the_output(tmp_path: Path):
    with pytest.raises(InputError, match=r"--merge writes a ROS 2 bag; end the name of the output in .ros2"):
        write_estimate(estimated(a_drive()), tmp_path / "e.csv", merge=tmp_path / "bag")


def test_a_large_bag_is_copied_in_parts(tmp_path: Path):
    drive, text = a_drive(), ROS2.types["std_msgs/msg/String"]
    blob = "x" * 100_000
    bag = write_ros(tmp_path / "bag", (("/blob", 0.02 * k, text(blob)) for k in range(600)), "mcap")
    estimate = estimated(drive)
    tracemalloc.start()
    write_estimate(estimate, tmp_path / "e.ros2", time_origin=float(EPOCH), merge=bag)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert sum(file.stat().st_size for file in bag.glob("*.mcap")) > 60e6
    assert most < 20e6
