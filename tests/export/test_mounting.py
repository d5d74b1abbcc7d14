"""From raw samples of a rotated IMU to an exported filter: import or repair, tune, export."""

import importlib.util
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import sigmaswarm
from exported import OPTIMIZED, STRICT, distance, needs_gcc, tuned
from importing.test_mount_auto import log_of
from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.exports.c99 import replay_events
from sigmaswarm.exports.targets import export_texts
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.importing.mounting import parse_mount
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import Part
from sigmaswarm.tuning.record import TuningRecord
from support import quickly

FEW = {"particles": 4, "generations": 2, "trials": 1, "seed": 1}
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
ANGLES = tuple(Rotation.random(random_state=7).as_euler("xyz", degrees=True).round(3).tolist())
MATRIX = Rotation.from_euler("xyz", ANGLES, degrees=True).as_matrix()
"""The rotation from the IMU's axes to the vehicle's."""


@cache
def raw_drive() -> Drive:
    """Return the samples of an IMU that is rotated in the vehicle."""
    drive = sigmaswarm.simulate("urban", duration=40, gps="white-1m", run=4)
    return replace(drive, imu=rotate_imu(drive.imu, MATRIX.T))


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """Return the log imported with the mounting angles, after writing and reading."""
    folder = tmp_path_factory.mktemp("raw")
    log = log_of(raw_drive(), folder / "log")
    mount = ",".join(map(str, ANGLES))
    drive = sigmaswarm.import_log(log / "imu.csv", gps=log / "fixes.csv", name="monday", mount=mount)
    return sigmaswarm.read_drive(sigmaswarm.write_drive(drive, folder / "monday"))


@pytest.fixture(scope="module")
def tuning(imported: Drive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tuned")
    sigmaswarm.tune(imported, model="planar5", kind="ekf", use=("lateral",), **FEW, out=folder)
    return folder


def board_of(folder: Path, *flags: str):
    """Build the exported C without warnings; return the exported Python module."""
    sources = [folder / name for name in ("ins_gps.c", "ins_gps_align.c", "ins_gps_shared.c")]
    command = ["gcc", *STRICT, *OPTIMIZED, *flags, "-shared", "-fPIC", *sources, "-lm", "-o"]
    built = subprocess.run([*command, folder / "libins_gps.so"], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    spec = importlib.util.spec_from_file_location("ins_gps", folder / "ins_gps.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def fed_with_raw(folder: Path, raw: Drive, drive: Drive, model: ModelName, *flags: str) -> np.ndarray:
    """Return the estimates (k, n) of the C filter, which rotates the raw samples with its own function."""
    module, axes = board_of(folder, *flags), AXES if model == "tilted12" else ("ax", "ay", "gz")
    samples = np.array([np.zeros(len(raw.imu)) if (v := getattr(raw.imu, n)) is None else v for n in AXES]).T
    (_, (begin, *start)), *others = replay_events(drive, model)
    lever = [*start[:2], start.pop(32) if model == "tilted12" else 0.0]
    board = module.Filter(begin, start[2:7], start[7:32], lever, gyro=start[32:])
    means: list[Sequence[float]] = []
    rows = iter(samples.tolist())
    for name, (time, *z) in others:
        if name == "imu":
            sample = dict(zip(AXES, board.turned(next(rows)), strict=True))
            board.predict(time, [sample[axis] for axis in axes])
            means += [board.mean] if time > begin else []
        else:
            board.update(time, z[:2])
    return np.array(means)


def expected(drive: Drive, parameters: FilterParameters) -> np.ndarray:
    return run_filter(drive, parameters, initial=initial_state(drive), recover=False).mean


def test_the_drive_states_the_rotation_of_the_import(imported: Drive):
    assert imported.mounting == pytest.approx(ANGLES, abs=1e-9)
    again = parse_mount(",".join(map(str, imported.mounting)))  # the printed angles are valid input
    for part in (imported, *sigmaswarm.split(imported)):
        assert part.mounting == imported.mounting
    np.testing.assert_allclose(rotate_imu(raw_drive().imu, again).ay, imported.imu.ay, atol=1e-9)


@needs_gcc
@pytest.mark.parametrize(
    ("flags", "off"),
    quickly([((), 1e-9), (("-DINS_GPS_FLOAT",), 2e-3)], lambda flags, _: not flags),
    ids=["double", "float"],
)
def test_c_accepts_raw_samples(
    imported: Drive, tuning: Path, tmp_path: Path, flags: Sequence[str], off: float
):
    sigmaswarm.export(tuning, "c99", tmp_path)
    means = fed_with_raw(tmp_path, raw_drive(), imported, "planar5", *flags)
    parameters = sigmaswarm.FilterParameters.load(tuning)
    assert distance(means, expected(imported, parameters)) < off
    readme = (tmp_path / "README.md").read_text()
    assert "to `ins_gps_turn_imu()`, as in `on_sample()` below" in readme
    assert "rotate\neach sample in the same way" not in readme
    board = board_of(tmp_path, *flags).Filter(0.0, [0.0] * 5, np.eye(5).ravel().tolist())
    matrix = np.array([board.turned(sample) for sample in np.eye(6).tolist()]).T
    rounding = 1e-7 if flags else 1e-15
    np.testing.assert_allclose(matrix, np.kron(np.eye(2), MATRIX), rtol=0, atol=rounding)


@pytest.mark.long
@needs_gcc
def test_c_accepts_raw_samples_with_attitude(imported: Drive, tmp_path: Path):
    parameters = tuned("tilted12", "ekf", 0.01, everything=False)
    sigmaswarm.export(parameters, "c99", tmp_path, mounting=imported.mounting)
    means = fed_with_raw(tmp_path, raw_drive(), imported, "tilted12")
    assert distance(means, expected(imported, parameters)) < 1e-9


@pytest.mark.long
@needs_gcc
def test_c_accepts_raw_samples_of_three_axes_that_the_doctor_rotated(tmp_path: Path):
    plane = sigmaswarm.simulate("urban", duration=120, gps="white-1m", run=4)
    still = dict.fromkeys(("az", "gx", "gy"))
    raw = replace(plane, imu=replace(plane.imu, ax=-plane.imu.ay, ay=plane.imu.ax, **still))
    mended = sigmaswarm.repair(raw, sigmaswarm.diagnose(raw))
    assert mended.metadata["repaired"] == ["accelerometer-axes"]
    assert mended.mounting == (0.0, 0.0, -90.0)
    parameters = tuned("planar5", "ekf", 0.01, everything=False)
    sigmaswarm.export(parameters, "c99", tmp_path, mounting=mended.mounting)
    assert distance(fed_with_raw(tmp_path, raw, mended, "planar5"), expected(mended, parameters)) < 1e-9


def test_a_tuning_stores_the_mounting_if_its_drives_agree(imported: Drive, tuning: Path, tmp_path: Path):
    found = sigmaswarm.Tuning.load(tuning)
    assert found.mounting == TuningRecord.read(tuning).mounting == pytest.approx(ANGLES, abs=1e-9)
    assert found.data[0]["imu_mounting_deg"] == pytest.approx(imported.mounting)
    texts = sigmaswarm.export(found, "c99")
    assert texts == sigmaswarm.export(tuning, "c99")
    plain = sigmaswarm.export(found.parameters, "c99")
    assert not any("turn_imu" in text or "MOUNTING" in text for text in plain.values())
    assert "rotate\neach sample in the same way" in plain["README.md"]

    def of(*mountings: tuple[float, ...] | None) -> sigmaswarm.Tuning:
        return replace(
            found, data=[{"name": "a", **({"imu_mounting_deg": m} if m else {})} for m in mountings]
        )

    assert of(None, None).mounting is None
    assert of((0.0, 0.0, 88.0), (0.0, 0.0, 92.0)).mounting == (0.0, 0.0, 90.0)
    assert not any("mountings" in remark for remark in of(None, (0.0, 0.0, 2.0)).remarks)
    for differing in (of((0.0, 0.0, 86.0), (0.0, 0.0, 94.0)), of((180.0, 0.0, 0.0), None)):
        assert differing.mounting is None
        assert sum("training drives state different mountings" in remark for remark in differing.remarks) == 1
    sigmaswarm.FilterParameters.load(tuning).save(tmp_path / "filter.toml")
    assert TuningRecord.read(tmp_path / "filter.toml").mounting is None


def test_the_readme_of_the_c_contains_the_expressions_of_the_import(tmp_path: Path):
    """The expressions use several tables, a sum and a rotation, if the drives agree; a repair of units removes them."""
    raw, log = raw_drive(), tmp_path / "log"
    log.mkdir()
    imu = pl.DataFrame({"t": raw.imu.time, **{n: getattr(raw.imu, n) for n in AXES}})
    forces = imu.select("t", "az", fwd=-pl.col("ax"), left=pl.col("ay") / 9.80665)
    forces.write_csv(log / "acc.csv")
    imu.select("t", "gx", "gy", "gz").write_csv(log / "gyro.csv")
    pl.DataFrame({"t": raw.gps.time, "x": raw.gps.x, "y": raw.gps.y}).write_csv(log / "gps.csv")
    parts = (
        Part("acc.csv", {"t": "t", "ax": "-fwd", "ay": "left*9.80665", "az": "az"}),
        Part("gyro.csv", {"t": "t", "gx": "gx", "gy": "gy", "gz": "gz", "+az": "0*gz"}),
    )
    drive = sigmaswarm.import_log(log, recipe=Recipe(roles={"imu": parts}, mount=",".join(map(str, ANGLES))))
    np.testing.assert_allclose(drive.imu.ay, (MATRIX @ [raw.imu.ax, raw.imu.ay, raw.imu.az])[1], atol=1e-9)
    again = sigmaswarm.read_drive(sigmaswarm.write_drive(drive, tmp_path / "monday"))
    sigmaswarm.tune(again, model="planar5", kind="ekf", **FEW, out=tmp_path / "tuned")
    readme = sigmaswarm.export(tmp_path / "tuned", "c99")["README.md"]
    assert readme == sigmaswarm.export(sigmaswarm.Tuning.load(tmp_path / "tuned"), "c99")["README.md"]
    block = readme.partition("from the columns of the log. Compute them in the same way:\n\n```text\n")[2]
    block = block.partition("\n```")[0]
    assert block.split("\n") == [
        "ax = -fwd of acc.csv",
        "ay = left*9.80665 of acc.csv",
        "az = az of acc.csv + 0*gz of gyro.csv",
        *(f"{axis} = {axis} of gyro.csv" for axis in ("gx", "gy", "gz")),
    ]
    found = sigmaswarm.Tuning.load(tmp_path / "tuned")
    level = replace(
        found, data=[{k: v for k, v in one.items() if k != "imu_mounting_deg"} for one in found.data]
    )
    readme = sigmaswarm.export(level, "c99")["README.md"]
    assert block in readme and "were rotated" not in readme  # the expressions are complete
    several = replace(found, data=[*found.data, {**found.data[0], "imu_mounting_deg": [0.0, 0.0, 90.0]}])
    readme = sigmaswarm.export(several, "c99")["README.md"]
    assert "```text" not in readme and "were rotated" in readme
    differing = replace(found, data=[*found.data, {"name": "b", "imu_axes": {"ax": "x"}}])
    assert differing.imu_axes == {} and "```text" not in sigmaswarm.export(differing, "c99")["README.md"]
    degrees = replace(
        again, imu=replace(again.imu, **{n: np.degrees(getattr(again.imu, n)) for n in AXES[3:]})
    )
    mended = sigmaswarm.repair(degrees, sigmaswarm.diagnose(degrees))
    assert "gyro-unit" in mended.metadata["repaired"]
    stated = again.metadata["imu_axes"]
    in_radians = {axis: f"radians({stated[axis]})" for axis in AXES[3:]}
    assert mended.metadata["imu_axes"] == stated | in_radians


def test_the_axes_contain_the_repairs_of_signs_and_units():
    """The expressions lead from the columns of the log to the repaired axes, also after a rotation by the import."""
    sound = sigmaswarm.simulate("urban", duration=90.0, imu_rate=50.0, gps="white-1m")
    sound = replace(sound, truth=None)
    axes = {axis: f"{axis}_of_log" for axis in AXES}
    imu = replace(sound.imu, gz=-sound.imu.gz, **{n: getattr(sound.imu, n) / 9.80665 for n in AXES[:3]})
    wrong = replace(sound, imu=imu, metadata={**sound.metadata, "imu_axes": axes})
    mended = sigmaswarm.repair(wrong, sigmaswarm.diagnose(wrong))
    assert {"gyro-sign", "accelerometer-unit"} <= {*mended.metadata["repaired"]}
    names = {f"{axis}_of_log": getattr(wrong.imu, axis) for axis in AXES}
    for axis, text in mended.metadata["imu_axes"].items():
        np.testing.assert_allclose(
            eval(text, {"radians": np.radians}, names), getattr(mended.imu, axis), rtol=1e-6
        )
    for angles in ((0.0, 0.0, 90.0), ANGLES):
        turned = replace(wrong, metadata={**wrong.metadata, "imu_mounting_deg": [*angles]})
        mended = sigmaswarm.repair(turned, sigmaswarm.diagnose(turned))
        assert mended.mounting is None  # the expressions contain it
        rotated = rotate_imu(wrong.imu, Rotation.from_euler("xyz", angles, degrees=True).as_matrix().T)
        raw = {f"{axis}_of_log": getattr(rotated, axis) for axis in AXES}
        assert {*mended.metadata["imu_axes"]} == {*AXES}
        for axis, text in mended.metadata["imu_axes"].items():
            expected = getattr(mended.imu, axis)
            np.testing.assert_allclose(eval(text, {"radians": np.radians}, raw), expected, atol=1e-5)
    three = replace(sound.imu, az=None, gx=None, gy=None, ax=-sound.imu.ax, ay=-sound.imu.ay)
    names = {axis: axes[axis] for axis in ("ax", "ay", "gz")}
    backward = replace(sound, imu=three, metadata={**sound.metadata, "imu_axes": names})
    mended = sigmaswarm.repair(backward, sigmaswarm.diagnose(backward)).metadata
    assert mended["imu_mounting_deg"] == pytest.approx([0.0, 0.0, 180.0], abs=3.0)
    assert mended.get("imu_axes", names) == names  # the rotation includes the change of signs


@pytest.mark.parametrize("model", ["planar5", "robot-localization"])
def test_ros_rotates_the_imu_by_a_static_transform(model: ModelName):
    parameters = tuned("planar5", "ekf", 0.01)
    if model == "robot-localization":
        parameters = sigmaswarm.FilterParameters(
            1.0, 0.0, 0.0, (0.1,) * 8, (1.0, 1.0), model, kind="ekf", nominal_interval=0.01
        )
    text = "".join(export_texts(parameters, "robot_localization", mounting=ANGLES).values())
    words = text[text.index("static_transform_publisher") :].split()[1:7]
    assert words[::2] == ["--roll", "--pitch", "--yaw"]
    oracle = Rotation.from_euler("xyz", [float(word) for word in words[1::2]]).as_matrix()
    np.testing.assert_allclose(oracle, MATRIX, atol=1e-8)
    assert "static_transform" not in "".join(export_texts(parameters, "robot_localization").values())
