"""rosbags reads from a bag the estimates of the filter, converted to the frames of ROS."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from exported import tuned
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.errors import InputError
from sigmaswarm.exports.ros import FIX, INNOVATION, INNOVATION_SIGMA, NIS, NOT_ESTIMATED, SIGMA, TOPIC
from sigmaswarm.exports.trajectory import check_target, true_trajectory, write_estimate
from sigmaswarm.filters.run import Estimate, run_filter, run_innovations
from sigmaswarm.geodesy import geodetic_to_enu
from support import make_drive

DRIVE = make_drive(duration=8.0)


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return run_filter(DRIVE, tuned("planar5", "ukf", 0.01, everything=False))


def test_odometry_is_read_back(tmp_path: Path, estimate: Estimate):
    reader = pytest.importorskip("rosbags.highlevel").AnyReader
    write_estimate(estimate, tmp_path / "e.ros2")
    with reader([tmp_path / "e.ros2"]) as bag:
        assert set(bag.topics) == {TOPIC, SIGMA}
        kept = [c for c in bag.connections if c.topic == TOPIC]
        read = [(t, bag.deserialize(raw, connection.msgtype)) for connection, t, raw in bag.messages(kept)]
    assert len(read) == len(estimate.time)
    for (nanoseconds, m), t, mean, p in zip(
        read, estimate.time, estimate.mean, estimate.covariance, strict=True
    ):
        assert (
            nanoseconds
            == m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
            == pytest.approx(1e9 * t, abs=1)
        )
        pose, twist = m.pose.pose, m.twist.twist.linear
        assert (pose.position.x, pose.position.y) == (mean[0], mean[1])
        assert 2 * np.arctan2(pose.orientation.z, pose.orientation.w) == pytest.approx(mean[4], abs=1e-12)
        # back to the world frame
        assert (twist.x + 1j * twist.y) * np.exp(1j * mean[4]) == pytest.approx(mean[2] + 1j * mean[3])
        np.testing.assert_array_equal(
            m.pose.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])], p[np.ix_([0, 1, 4], [0, 1, 4])]
        )
        assert m.pose.covariance[14] == NOT_ESTIMATED
    assert (m.header.frame_id, m.child_frame_id) == ("map", "base_link")
    rng = np.random.default_rng(0)  # covariance of the velocity in the body frame, from many samples
    drawn = rng.multivariate_normal(mean, 1e-6 * p, 200_000)
    body = (drawn[:, 2] + 1j * drawn[:, 3]) * np.exp(-1j * drawn[:, 4])
    expected = np.cov(body.real, body.imag) * 1e6
    np.testing.assert_allclose(m.twist.covariance.reshape(6, 6)[:2, :2], expected, atol=0.02 * expected.max())


def on_the_road(state: np.ndarray) -> tuple[Rotation, np.ndarray]:
    """Return attitude and velocity (3,) of a tilted state; the velocity is parallel to the road."""
    turned = Rotation.from_euler("ZYX", state[[4, 9, 8]])
    up = turned.apply([0.0, 0.0, 1.0])
    return turned, np.append(state[2:4], -(up[:2] @ state[2:4]) / up[2])


def test_the_twist_of_a_tilted_state_is_parallel_to_the_road(tmp_path: Path):
    reader = pytest.importorskip("rosbags.highlevel").AnyReader
    rng = np.random.default_rng(3)
    mean = rng.normal(0.0, 1.0, (20, 12)) * [9, 9, 8, 8, 2, 1, 1, 0.1, 0.3, 0.3, 0.1, 0.1]
    root = rng.normal(0.0, 0.1, (20, 12, 12))
    estimate = Estimate(
        np.arange(20.0), mean, root @ root.transpose(0, 2, 1), InitialState(mean[0, :5], np.eye(5), 0.0)
    )
    write_estimate(estimate, tmp_path / "e.ros2")
    with reader([tmp_path / "e.ros2"]) as bag:
        kept = [c for c in bag.connections if c.topic == TOPIC]
        read = [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages(kept)]
    for m, state, p in zip(read, mean, estimate.covariance, strict=True):
        turned, velocity = on_the_road(state)
        q, v = m.pose.pose.orientation, m.twist.twist.linear
        assert (Rotation.from_quat([q.x, q.y, q.z, q.w]) * turned.inv()).magnitude() < 1e-12
        np.testing.assert_allclose([v.x, v.y, v.z], turned.inv().apply(velocity), atol=1e-12)
        # x, y, and the rotations about fixed axes, which are roll, pitch and heading
        states, rows = [0, 1, 8, 9, 4], [0, 1, 3, 4, 5]
        pose = m.pose.covariance.reshape(6, 6)
        np.testing.assert_array_equal(pose[np.ix_(rows, rows)], p[np.ix_(states, states)])
        assert pose[2, 2] == NOT_ESTIMATED

        def seen(error: np.ndarray, state: np.ndarray = state) -> np.ndarray:
            turned, velocity = on_the_road(state + error)
            return turned.inv().apply(velocity)[:2]

        jacobian = np.array([(seen(1e-6 * e) - seen(-1e-6 * e)) / 2e-6 for e in np.eye(12)]).T
        twist = m.twist.covariance.reshape(6, 6)
        np.testing.assert_allclose(twist[:2, :2], jacobian @ p @ jacobian.T, rtol=1e-6, atol=1e-7)
        assert twist[2, 2] == NOT_ESTIMATED


def test_errors_of_writing_a_bag_are_reported(
    tmp_path: Path, estimate: Estimate, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "there.ros2").mkdir()
    with pytest.raises(InputError, match="already exists; delete it, or choose another name"):
        check_target(tmp_path / "there.ros2")
    with pytest.raises(InputError, match="a bag can't contain times before 0"):
        write_estimate(replace(estimate, time=estimate.time - 100.0), tmp_path / "e.ros2")
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(InputError, match=r"pip install rosbags$"):
        write_estimate(estimate, tmp_path / "e.ros2")
    assert not (tmp_path / "e.ros2").exists()


def test_truth_can_be_written_to_a_bag(tmp_path: Path):
    reader = pytest.importorskip("rosbags.highlevel").AnyReader
    write_estimate(true_trajectory(DRIVE), tmp_path / "truth.ros2")
    with reader([tmp_path / "truth.ros2"]) as bag:
        assert bag.message_count == 801


def paths_of(config: Any) -> Iterator[str]:
    """Yield the topics and paths that the panels of a layout show."""
    for panel in config["configById"].values():
        yield from (path["value"] for path in panel.get("paths", ()))
        yield from [panel["followTopic"]] if "followTopic" in panel else []


def panels_in(arranged: Any) -> list[str]:
    """Return the panels of a layout's tree in order."""
    if isinstance(arranged, str):
        return [arranged]
    assert arranged["direction"] in ("row", "column") and 0 < arranged["splitPercentage"] < 100
    return panels_in(arranged["first"]) + panels_in(arranged["second"])


def test_fixes_innovations_and_sigmas_are_topics_and_the_layout_shows_them(tmp_path: Path):
    reader = pytest.importorskip("rosbags.highlevel").AnyReader
    p, origin = tuned("planar5", "ukf", 0.01, everything=False), (49.0, 8.4, 110.0)
    estimate, found = run_filter(DRIVE, p), run_innovations(DRIVE, p)
    write_estimate(estimate, tmp_path / "e.ros2", origin=origin, innovations=found)
    read: dict[str, list[tuple[int, Any]]] = {}
    with reader([tmp_path / "e.ros2"]) as bag:
        times = []
        for connection, t, raw in bag.messages():
            read.setdefault(connection.topic, []).append((t, bag.deserialize(raw, connection.msgtype)))
            times.append(t)
    assert times == sorted(times)
    assert set(read) == {TOPIC, SIGMA, FIX, INNOVATION, INNOVATION_SIGMA, NIS}
    assert [t for t, _ in read[NIS]] == pytest.approx(1e9 * found.time, abs=1)
    assert [m.data for _, m in read[NIS]] == found.nis.tolist()
    assert [(m.vector.x, m.vector.y) for _, m in read[INNOVATION]] == [
        tuple(nu) for nu in found.innovation.tolist()
    ]
    sigma = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    assert [(m.vector.x, m.vector.y) for _, m in read[INNOVATION_SIGMA]] == [tuple(s) for s in sigma.tolist()]

    rows = np.searchsorted(1e9 * estimate.time, [t - 1 for t, _ in read[SIGMA]])
    assert np.diff(estimate.time[rows]) == pytest.approx(0.1, abs=0.011)
    std = np.sqrt(np.diagonal(estimate.covariance[rows], axis1=1, axis2=2))
    found_std = [(m.vector.x, m.vector.y, m.vector.z) for _, m in read[SIGMA]]
    np.testing.assert_allclose(found_std, std[:, [0, 1, 4]], rtol=1e-12)
    degrees = np.array([(m.latitude, m.longitude, m.altitude) for _, m in read[FIX]])
    back = geodetic_to_enu(*degrees.T, origin)
    np.testing.assert_allclose(back[:, :2], estimate.mean[rows, :2], atol=1e-6)
    fix = read[FIX][-1][1]
    assert (fix.position_covariance_type, fix.status.status) == (3, 0)
    np.testing.assert_array_equal(
        fix.position_covariance.reshape(3, 3)[:2, :2], estimate.covariance[rows[-1], :2, :2]
    )

    config = json.loads((tmp_path / "e.ros2" / "foxglove-layout.json").read_text())
    assert sorted(panels_in(config["layout"])) == sorted(config["configById"])
    assert set(config) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    for path in paths_of(config):
        topic, *fields = path.split(".")
        value = read[topic][0][1]
        for name in fields:
            value = getattr(value, name)
    assert {path.split(".")[0] for path in paths_of(config)} == set(read)


def test_a_layout_contains_only_existing_topics(tmp_path: Path, estimate: Estimate):
    pytest.importorskip("rosbags")
    write_estimate(estimate, tmp_path / "e.ros2")
    config = json.loads((tmp_path / "e.ros2" / "foxglove-layout.json").read_text())
    assert {path.split(".")[0] for path in paths_of(config)} == {TOPIC, SIGMA}
