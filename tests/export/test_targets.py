"""Export targets: written files, and rejected filters."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest

from exported import export_filter, tuned
from sigmaswarm.errors import InputError
from sigmaswarm.exports.names import DESCRIPTIONS, Target, next_command
from support import make_drive

P = tuned("planar5", "ukf", 0.01, everything=False)
FILES = {
    "c99": [
        *("ins_gps.h", "ins_gps.c", "ins_gps_align.h", "ins_gps_align.c", "replay.c", "README.md"),
        *("CMakeLists.txt", "library.json", "zephyr/module.yml", "zephyr/CMakeLists.txt", "zephyr/Kconfig"),
        *("ins_gps.py", "ins_gps_shared.c"),
    ],
    "filterpy": ["run_filter.py"],
    "robot_localization": ["robot_localization.yaml"],
}


def test_every_target_is_described():
    assert list(DESCRIPTIONS) == list(get_args(Target)) == list(FILES)


@pytest.mark.parametrize("target", DESCRIPTIONS)
def test_writing_again_gives_the_same_files(tmp_path: Path, target):
    written = export_filter(P, target, tmp_path / "a" / "b")
    assert written == [tmp_path / "a" / "b" / name for name in FILES[target]]
    before = [path.read_bytes() for path in written]
    assert [path.read_bytes() for path in export_filter(P, target, tmp_path / "a" / "b")] == before
    folder = tmp_path / "a" / "b"
    found = [str(path.relative_to(folder)) for path in folder.rglob("[!.]*") if path.is_file()]
    assert sorted(found) == sorted(FILES[target])


def test_a_replay_is_written_with_the_c_library(tmp_path: Path):
    written = export_filter(P, "c99", tmp_path, replay=make_drive(duration=8.0))
    rows = written[-1].read_text().splitlines()
    assert written[-1].name == "replay.csv"
    assert [row.split(",")[0] for row in rows[:2]] == ["start", "imu"]
    assert len(rows) == 1 + 801 + 40


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"nominal_interval": None}, "does not contain the IMU interval .* add nominal_interval"),
        (
            {"process_noise": (1e-3, -1e-3, 1e-3, 1e-3, 1e-3)},
            "a variance of Q is negative or a variance of R is not positive",
        ),
        ({"measurement_noise": (0.0, 1.0)}, "a variance of Q is negative or a variance of R is not positive"),
    ],
)
@pytest.mark.parametrize("target", DESCRIPTIONS)
def test_a_filter_that_can_not_be_exported_is_rejected(tmp_path: Path, target, change: dict, said: str):
    with pytest.raises(InputError, match=said):
        export_filter(replace(P, **change), target, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_wrong_arguments_are_reported(tmp_path: Path):
    with pytest.raises(
        InputError, match="there is no export target 'rust'; choose one of c99, filterpy, robot_loc"
    ):
        export_filter(P, "rust", tmp_path)
    with pytest.raises(InputError, match="--replay needs --to c99"):
        export_filter(P, "filterpy", tmp_path, replay=make_drive(duration=8.0))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file: can't be created as a folder .*; choose another --out"):
        export_filter(P, "c99", tmp_path / "file")


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_the_next_command_runs_the_node_of_the_file(tmp_path: Path, kind: str):
    files = export_filter(tuned("planar5", kind, 0.01, everything=False), "robot_localization", tmp_path)
    texts = {file.name: file.read_text() for file in files}
    assert f"\n{kind}_filter_node:" in texts["robot_localization.yaml"]
    assert f"robot_localization {kind}_node --ros-args" in next_command("robot_localization", "x", texts)
