"""Files of estimates: they can be read again, and contain the estimates of the filter."""

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pymap3d
import pytest
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.errors import InputError, SigmaswarmError
from sigmaswarm.exports.trajectory import (
    check_target,
    true_trajectory,
    write_estimate,
    write_fixes,
    write_pieces,
)
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.presets import DEFAULTS
from sigmaswarm.filters.run import Estimate, estimates_of, run_filter, run_imu_only, whole_pass
from support import make_drive

STATES = ["x", "y", "vx", "vy", "theta"]
DRIVE = make_drive(duration=12.0)


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return run_filter(DRIVE, DEFAULTS)


def test_csv_keeps_every_bit(tmp_path: Path, estimate: Estimate):
    write_estimate(estimate, tmp_path / "e.csv")
    frame = pl.read_csv(tmp_path / "e.csv")
    assert frame.columns == ["t", *STATES, *(f"std_{s}" for s in STATES)]
    assert frame["t"].to_numpy().tobytes() == estimate.time.tobytes()
    for i, state in enumerate(STATES):
        np.testing.assert_array_equal(frame[state], estimate.mean[:, i])
        expected = [math.sqrt(c[i][i]) for c in estimate.covariance]
        np.testing.assert_allclose(frame[f"std_{state}"], expected, rtol=1e-15)


def test_tum_contains_time_position_and_quaternion(tmp_path: Path, estimate: Estimate):
    write_estimate(estimate, str(tmp_path / "e.tum"))
    lines = (tmp_path / "e.tum").read_text().splitlines()
    assert len(lines) == len(estimate.time)
    assert all(len(line.split(" ")) == 8 for line in lines)
    t, x, y, z, qx, qy, qz, qw = np.loadtxt(tmp_path / "e.tum").T
    np.testing.assert_allclose(t, estimate.time, atol=1e-9)
    np.testing.assert_allclose(np.column_stack([x, y]), estimate.mean[:, :2], atol=1e-6)
    assert not z.any()
    np.testing.assert_allclose(qx**2 + qy**2 + qz**2 + qw**2, 1.0, atol=1e-8)
    # the quaternion rotates the x axis to the heading
    np.testing.assert_allclose(1 - 2 * (qy**2 + qz**2), np.cos(estimate.mean[:, 4]), atol=1e-8)
    np.testing.assert_allclose(2 * (qx * qy + qz * qw), np.sin(estimate.mean[:, 4]), atol=1e-8)


def test_tum_of_a_quarter_turn(tmp_path: Path):
    one = Estimate(np.array([1.5]), np.array([[1.0, -2.0, 0, 0, math.pi / 2]]), np.eye(5)[None], _anywhere())
    write_estimate(one, tmp_path / "e.tum")
    half = f"{math.sqrt(0.5):.9f}"
    zero = "0.000000000"
    assert (
        tmp_path / "e.tum"
    ).read_text() == f"1.500000000 1.000000 -2.000000 0.000000 {zero} {zero} {half} {half}\n"


def _anywhere() -> InitialState:
    return InitialState(np.zeros(5), np.eye(5), 0.0)


def test_dead_reckoning_is_written_without_standard_deviations(tmp_path: Path):
    estimate = run_imu_only(DRIVE)
    write_estimate(estimate, tmp_path / "e.csv")
    frame = pl.read_csv(tmp_path / "e.csv")
    assert frame.columns == ["t", *STATES]
    np.testing.assert_array_equal(frame["theta"], estimate.mean[:, 4])


def in_pieces(estimate: Estimate, rows: int) -> Iterator[Estimate]:
    for first in range(0, len(estimate.time), rows):
        at = slice(first, first + rows)
        yield replace(
            estimate, time=estimate.time[at], mean=estimate.mean[at], covariance=estimate.covariance[at]
        )


@pytest.mark.parametrize("ending", ["csv", "tum", "kitti", "geojson", "gpx", "kml", "mat"])
def test_pieces_are_written_like_the_whole(tmp_path: Path, estimate: Estimate, ending: str):
    whole, parts = (tmp_path / name / f"e.{ending}" for name in ("whole", "parts"))
    for path in (whole, parts):
        path.parent.mkdir()
    write_estimate(estimate, whole, origin=ORIGIN)
    span = (float(estimate.time[0]), float(estimate.time[-1]))
    write_pieces(in_pieces(estimate, 97), span, parts, origin=ORIGIN)
    head = 128 if ending == "mat" else 0  # the header of MATLAB's files contains the time of writing
    assert parts.read_bytes()[head:] == whole.read_bytes()[head:]


def test_a_filter_that_fails_while_it_is_written_leaves_no_file(tmp_path: Path):
    drive = make_drive(duration=150.0, seed=2)  # longer than a piece
    spoiled = drive.imu.gz.copy()
    spoiled[-100:] = np.nan
    replay = whole_pass(replace(drive, imu=replace(drive.imu, gz=spoiled)))
    with pytest.raises(SigmaswarmError, match="the filter failed at t = 149"):
        write_pieces(
            estimates_of(FilterRun(replay, DEFAULTS, recover=True)), (0.0, 150.0), tmp_path / "e.csv"
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["e.xls", "e", "e.CSV", "csv"])
def test_an_unknown_ending_is_rejected(tmp_path: Path, estimate: Estimate, name: str):
    with pytest.raises(InputError, match=rf"{name}: unknown format; end the name in .csv, .mat, .* or .kml"):
        write_estimate(estimate, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_path_that_can_not_be_written_is_rejected(tmp_path: Path, estimate: Estimate):
    with pytest.raises(InputError, match="nowhere: no such folder; create it first"):
        check_target(tmp_path / "nowhere" / "e.csv")
    (tmp_path / "e.csv").mkdir()
    with pytest.raises(InputError, match=r"e.csv.* folder"):
        write_estimate(estimate, tmp_path / "e.csv")


ORIGIN = (49.011, 8.416, 110.0)


def test_kitti_contains_pose_matrices(tmp_path: Path, estimate: Estimate):
    write_estimate(estimate, tmp_path / "e.kitti")
    pose = np.loadtxt(tmp_path / "e.kitti").reshape(-1, 3, 4)
    assert len(pose) == len(estimate.time)
    np.testing.assert_allclose(pose[:, :2, 3], estimate.mean[:, :2], atol=1e-8)
    np.testing.assert_allclose(
        pose[:, :, :3] @ pose[:, :, :3].transpose(0, 2, 1), np.eye(3)[None] + 0 * pose[:, :, :3], atol=1e-8
    )
    np.testing.assert_allclose(np.arctan2(pose[:, 1, 0], pose[:, 0, 0]), estimate.mean[:, 4], atol=1e-8)


def test_the_attitude_of_a_tilted_estimate_is_written(tmp_path: Path):
    mean = np.random.default_rng(0).normal(0.0, 1.0, (40, 12)) * [
        9,
        9,
        5,
        5,
        2,
        1,
        1,
        0.1,
        0.4,
        0.4,
        0.1,
        0.1,
    ]
    estimate = Estimate(np.arange(40.0), mean, np.empty(0), _anywhere())
    theirs = Rotation.from_euler("ZYX", mean[:, [4, 9, 8]])
    write_estimate(estimate, tmp_path / "e.kitti")
    pose = np.loadtxt(tmp_path / "e.kitti").reshape(-1, 3, 4)
    np.testing.assert_allclose(pose[:, :, :3], theirs.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(pose[:, :, 3], np.column_stack([mean[:, :2], 0 * mean[:, 0]]), atol=1e-9)
    write_estimate(estimate, tmp_path / "e.tum")
    quaternion = np.loadtxt(tmp_path / "e.tum")[:, 4:]
    assert (Rotation.from_quat(quaternion) * theirs.inv()).magnitude().max() < 1e-8


def test_matlab_files_contain_names_and_covariances(tmp_path: Path, estimate: Estimate):
    write_estimate(estimate, tmp_path / "e.mat")
    read = loadmat(tmp_path / "e.mat")
    for i, name in enumerate(STATES):
        np.testing.assert_array_equal(read[name], estimate.mean[:, i : i + 1])
    np.testing.assert_array_equal(read["t"][:, 0], estimate.time)
    np.testing.assert_array_equal(read["covariance"], estimate.covariance)


def places(path: Path) -> np.ndarray:
    """Return latitude and longitude, (n, 2), of a file in any format for maps."""
    if path.suffix == ".geojson":
        return np.array(json.loads(path.read_text())["geometry"]["coordinates"])[:, ::-1]
    root = ET.parse(path).getroot()
    if path.suffix == ".gpx":
        points = root.iter("{http://www.topografix.com/GPX/1/1}trkpt")
        return np.array([(float(p.attrib["lat"]), float(p.attrib["lon"])) for p in points])
    (line,) = root.iter("{http://www.opengis.net/kml/2.2}coordinates")
    return np.array([[float(c) for c in p.split(",")] for p in str(line.text).split()])[:, ::-1]


@pytest.mark.parametrize("suffix", [".geojson", ".gpx", ".kml"])
def test_maps_contain_the_track_in_degrees(tmp_path: Path, estimate: Estimate, suffix: str):
    path = tmp_path / f"a & b{suffix}"
    write_estimate(estimate, path, origin=ORIGIN)
    lat, lon, _ = pymap3d.enu2geodetic(estimate.mean[:, 0], estimate.mean[:, 1], 0.0, *ORIGIN)
    np.testing.assert_allclose(places(path), np.column_stack([lat, lon]), rtol=0, atol=1.5e-9)  # 0.1 mm
    with pytest.raises(InputError, match=r"a map needs degrees.*--origin LAT,LON"):
        write_estimate(estimate, path)


WEST = (-16.8, 179.9999, 0.0)


def parts_of(path: Path) -> list[np.ndarray]:
    """Return the positions of each line of a map, (k, 2): latitude and longitude, deg."""
    if path.suffix == ".geojson":
        geometry = json.loads(path.read_text())["geometry"]
        assert geometry["type"] == "MultiLineString"
        return [np.array(line)[:, ::-1] for line in geometry["coordinates"]]
    root = ET.parse(path).getroot()
    if path.suffix == ".gpx":
        gpx = "{http://www.topografix.com/GPX/1/1}"
        return [
            np.array([(float(p.attrib["lat"]), float(p.attrib["lon"])) for p in segment.iter(gpx + "trkpt")])
            for segment in root.iter(gpx + "trkseg")
        ]
    kml = "{http://www.opengis.net/kml/2.2}"
    assert len(list(root.iter(kml + "MultiGeometry"))) == 1
    return [
        np.array([[float(c) for c in p.split(",")] for p in str(line.text).split()])[:, ::-1]
        for line in root.iter(kml + "coordinates")
    ]


def there_and_back() -> Estimate:
    """Return an estimate that goes east for 200 m and back; the antimeridian is 10.65 m east of the origin."""
    x = np.concatenate([np.linspace(-100.0, 100.0, 51), np.linspace(97.0, -99.0, 50)])
    mean = np.zeros((len(x), 5))
    mean[:, 0], mean[:, 1] = x, 0.5 * x
    return Estimate(np.arange(len(x)) * 0.5, mean, np.empty(0), _anywhere())


@pytest.mark.parametrize("suffix", [".geojson", ".gpx", ".kml"])
def test_a_track_is_divided_at_the_antimeridian(tmp_path: Path, suffix: str):
    track = there_and_back()
    write_estimate(track, tmp_path / f"e{suffix}", origin=WEST)
    parts = parts_of(tmp_path / f"e{suffix}")
    assert [np.sign(part[:, 1]).tolist().count(-1.0) == 0 for part in parts] == [True, False, True]
    assert all(len(np.unique(np.sign(part[:, 1]))) == 1 for part in parts)  # no part crosses it
    for one, other in pairwise(parts):  # parts meet at it
        assert np.abs([one[-1, 1], other[0, 1]]).tolist() == pytest.approx([180.0, 180.0], abs=1e-8)
        assert one[-1, 0] == other[0, 0]
    whole = np.concatenate(parts)
    assert whole[:, 1].min() >= -180.0
    assert whole[:, 1].max() <= (180.0 if suffix != ".gpx" else 179.999999999)
    lat, lon, _ = pymap3d.enu2geodetic(track.mean[:, 0], track.mean[:, 1], 0.0, *WEST)
    written = whole[np.abs(np.abs(whole[:, 1]) - 180.0) > 1e-8]
    np.testing.assert_allclose(written, np.column_stack([lat, lon]), rtol=0, atol=1.5e-9)


def test_a_divided_track_has_the_times_of_its_points(tmp_path: Path):
    track = there_and_back()
    write_estimate(track, tmp_path / "e.geojson", origin=WEST)
    feature = json.loads((tmp_path / "e.geojson").read_text())
    lines, times = feature["geometry"]["coordinates"], feature["properties"]["t"]
    assert [len(line) for line in lines] == [len(t) for t in times]
    east = 10.65 / (200.0 / 25.0)  # s after the middle of the way there
    assert times[0][-1] == times[1][0] == pytest.approx(12.5 + east, abs=0.01)
    dated = replace(track, time=track.time + 1395842400.25)
    write_estimate(dated, tmp_path / "e.geojson", origin=WEST)
    stamps = json.loads((tmp_path / "e.geojson").read_text())["properties"]["coordTimes"]
    assert stamps[0][0] == "2014-03-26T14:00:00.250Z"
    assert [len(s) for s in stamps] == [len(t) for t in times]


def test_times_are_written_only_if_the_clock_has_a_date(tmp_path: Path, estimate: Estimate):
    write_estimate(estimate, tmp_path / "e.gpx", origin=ORIGIN)
    assert "<time>" not in (tmp_path / "e.gpx").read_text()
    dated = replace(estimate, time=estimate.time - estimate.time[0] + 1395842400.25)
    write_estimate(dated, tmp_path / "e.gpx", origin=ORIGIN)
    assert "<time>2014-03-26T14:00:00.250Z</time>" in (tmp_path / "e.gpx").read_text()
    write_estimate(dated, tmp_path / "e.geojson", origin=ORIGIN)
    stamps = json.loads((tmp_path / "e.geojson").read_text())["properties"]["coordTimes"]
    assert (len(stamps), stamps[0]) == (len(estimate.time), "2014-03-26T14:00:00.250Z")


def test_truth_is_written_like_an_estimate(tmp_path: Path):
    write_estimate(true_trajectory(DRIVE), tmp_path / "truth.csv")
    frame = pl.read_csv(tmp_path / "truth.csv")
    assert frame.columns == ["t", *STATES]
    np.testing.assert_array_equal(frame["theta"], DRIVE.truth.theta)
    with pytest.raises(InputError, match=r"has no truth\.csv"):
        true_trajectory(replace(DRIVE, truth=None))


def test_a_dated_kml_is_a_track_with_times_under_the_name_of_the_drive(tmp_path: Path):
    """gx:Track of Google has as many times as positions; without dates, the file contains a line."""
    track = there_and_back()
    dated = replace(track, time=track.time + 1395842400.25)
    write_estimate(dated, tmp_path / "e.kml", origin=WEST, name="monday & co")
    root = ET.parse(tmp_path / "e.kml").getroot()
    kml, gx = "{http://www.opengis.net/kml/2.2}", "{http://www.google.com/kml/ext/2.2}"
    (name,) = root.iter(f"{kml}name")
    assert name.text == "monday & co"
    parts = list(root.iter(f"{gx}Track"))
    assert len(parts) == 3  # it crosses the antimeridian
    for part in parts:
        assert len(part.findall(f"{kml}when")) == len(part.findall(f"{gx}coord")) > 1
    assert parts[0].findall(f"{kml}when")[0].text == "2014-03-26T14:00:00.250Z"
    lon, lat, _ = map(float, str(parts[0].findall(f"{gx}coord")[0].text).split())
    expected = pymap3d.enu2geodetic(track.mean[0, 0], track.mean[0, 1], 0.0, *WEST)
    assert (lat, lon) == pytest.approx(expected[:2], abs=1.5e-9)
    write_estimate(track, tmp_path / "e.kml", origin=WEST)
    assert "gx:" not in (tmp_path / "e.kml").read_text()


@pytest.mark.parametrize("suffix", [".csv", ".geojson", ".gpx", ".kml"])
def test_the_fixes_before_the_start_are_written_as_fixes(tmp_path: Path, suffix: str):
    drive = make_drive(duration=20.0)
    count = write_fixes(drive, 5.0, tmp_path / f"f{suffix}", origin=(50.0, 8.0, 100.0))
    assert count == np.count_nonzero(drive.gps.time < 5.0) > 5
    if suffix == ".csv":
        read = pl.read_csv(tmp_path / "f.csv")
        assert read["x"].to_list() == drive.gps.x[:count].tolist()
        assert read["t"].max() < 5.0
    else:
        assert len(places(tmp_path / f"f{suffix}")) == count
        assert f"{drive.name}: fixes before" in (tmp_path / f"f{suffix}").read_text()
    with pytest.raises(
        InputError,
        match=r"f.tum: fixes can't be written in this format; end the name in .csv, .geojson",
    ):
        write_fixes(drive, 5.0, tmp_path / "f.tum")
