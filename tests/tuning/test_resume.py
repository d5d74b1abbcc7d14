"""Interrupted tunings: resumed, they end with the same bits, or an error states why they can't be resumed."""

import json
import os
import random
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from processes import COMMAND, Process
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import InputError, TuningStopped
from sigmaswarm.files import write_atomically
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS
from sigmaswarm.scoring.batch import Scores
from sigmaswarm.tuning.objectives import OBJECTIVES, Objective
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.search import Progress
from sigmaswarm.tuning.store import load_checkpoint, save_checkpoint, saved_history, saved_options
from sigmaswarm.tuning.tune import tune
from support import file_contents, make_drive, quickly

pytestmark = pytest.mark.usefixtures("undiagnosed")

DRIVES = [make_drive(duration=20.0, seed=s, name=f"d{s}") for s in range(2)]
OPTIONS = {
    "model": "planar5",
    "objective": "truth-rmse",
    "optimizer": "pso",
    "particles": 5,
    "generations": 6,
    "trials": 2,
    "seed": 3,
}
GENERATIONS = 50


class Interruption(Exception):
    """Stands for the end of the process."""


def interrupted(drives: list[Drive], out: Path, at: int, *, resume: bool = False, **options) -> None:
    """Tune until ``at`` generations are finished."""

    def stop(progress: Progress) -> None:
        if progress.done >= at:
            raise Interruption

    with pytest.raises(Interruption):
        tune(drives, out=out, resume=resume, progress=stop, **options)


def test_the_callback_stops_a_tuning(tmp_path: Path):
    """The error names the command to resume, and the saved files are sufficient to resume without the options."""
    seen: list[Progress] = []

    def stop(progress: Progress) -> bool:
        seen.append(progress)
        return progress.done < 3

    with pytest.raises(TuningStopped, match="3 of 12 generations"):
        tune(DRIVES, out=tmp_path, progress=stop, **OPTIONS)
    assert [p.done for p in seen] == [1, 2, 3]
    options, data = saved_options(tmp_path)
    assert [one["name"] for one in data] == [drive.name for drive in DRIVES]
    assert saved_history(tmp_path) == {0: [p.best_cost for p in seen]}
    finished = tune(DRIVES, out=tmp_path, resume=True, **options)
    assert finished.cost == tune(DRIVES, **OPTIONS).cost
    history = saved_history(tmp_path)
    assert [len(best) for best in history.values()] == [6, 6]
    assert history[0][2] == seen[-1].best_cost
    alone = tune(DRIVES, **OPTIONS | {"generations": 3, "trials": 1})
    assert seen[-1].parameters == alone.parameters


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("whole")
    tune(DRIVES, out=folder, **OPTIONS)
    return file_contents(folder)


def test_a_finished_tuning_leaves_these_files(uninterrupted: dict[str, bytes]):
    assert sorted(uninterrupted) == [
        "config.json",
        "seen.npz",
        "trial-000/history.npz",
        "trial-000/result.json",
        "trial-001/history.npz",
        "trial-001/result.json",
        "tuning.toml",
    ]


@pytest.mark.parametrize(
    "generation",
    quickly([(n,) for n in (1, 2, 5, 6, 7, 11, 12)], lambda generation: generation in (1, 6, 7)),
)
def test_a_resumed_tuning_ends_in_the_same_bytes(tmp_path: Path, uninterrupted, generation: int):
    out = tmp_path / "out"
    interrupted(DRIVES, out, generation, **OPTIONS)
    assert not (out / "tuning.toml").exists()
    tune(DRIVES, out=out, resume=True, **OPTIONS)
    assert file_contents(out) == uninterrupted


def test_interrupting_after_every_generation_gives_the_same_bytes(tmp_path: Path, uninterrupted):
    out = tmp_path / "out"
    for generation in range(1, 13):
        interrupted(DRIVES, out, generation, resume=generation > 1, **OPTIONS)
    told: list[Progress] = []
    tune(DRIVES, out=out, resume=True, progress=told.append, **OPTIONS)
    assert told == []  # all generations were finished
    assert file_contents(out) == uninterrupted


def test_resuming_a_finished_tuning_computes_nothing(tmp_path: Path, uninterrupted):
    out = tmp_path / "out"
    tuning = tune(DRIVES, out=out, **OPTIONS)
    again = tune(DRIVES, out=out, resume=True, progress=pytest.fail, **OPTIONS)
    assert again.parameters == tuning.parameters
    assert again.to_dict() == tuning.to_dict()
    assert file_contents(out) == uninterrupted


def test_resume_starts_a_tuning_that_does_not_exist(tmp_path: Path, uninterrupted):
    tune(DRIVES, out=tmp_path / "new" / "out", resume=True, **OPTIONS)
    assert file_contents(tmp_path / "new" / "out") == uninterrupted


def test_patience_is_counted_across_an_interruption(tmp_path: Path):
    options = {"particles": 3, "generations": 40, "seed": 3, "patience": 3}
    whole = tune(DRIVES[:1], out=tmp_path / "whole", **options)
    length = len(whole.trials[0].best)
    assert 4 < length < 40
    interrupted(DRIVES[:1], tmp_path / "cut", length - 1, **options)
    tune(DRIVES[:1], out=tmp_path / "cut", resume=True, **options)
    assert file_contents(tmp_path / "cut") == file_contents(tmp_path / "whole")


def test_failures_are_counted_across_an_interruption(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Within the paper's bounds no filter fails, so the test uses an objective that fails for some scores."""

    def picky(scores: Scores) -> np.ndarray:
        return np.where(scores.position_rmse > 2.0, np.nan, scores.position_rmse)

    monkeypatch.setitem(OBJECTIVES, "picky", Objective("picky", "for this test", picky))
    options = {"particles": 12, "generations": 6, "seed": 3, "objective": "picky"}
    (whole,) = tune(DRIVES, out=tmp_path / "whole", **options).trials
    assert 0 < whole.failures < whole.evaluations
    interrupted(DRIVES, tmp_path / "cut", 3, **options)
    (resumed,) = tune(DRIVES, out=tmp_path / "cut", resume=True, **options).trials
    assert (resumed.failures, resumed.evaluations) == (whole.failures, whole.evaluations)
    assert file_contents(tmp_path / "cut") == file_contents(tmp_path / "whole")


# --- Killed processes --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kills", [2, pytest.param(6, marks=pytest.mark.long)])
def test_a_tuning_killed_several_times_ends_in_the_same_bytes(tmp_path: Path, kills: int):
    """SIGKILL is sent at random times between the first checkpoint and the end."""
    for drive in DRIVES:
        write_drive(drive, tmp_path / "drives" / drive.name)
    options = ["--model", "planar5", "--objective", "truth-rmse"]
    options += ["--generations", str(GENERATIONS), "--particles", "20", "--seed", "8"]
    command = ["tune", str(tmp_path / "drives"), *options]
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    checkpoint = killed / "checkpoint-000.npz"

    uninterrupted = Process(COMMAND, [*command, "--out", whole])
    chance = random.Random(2024)
    saved = [0]  # finished generations after each kill
    for moment in sorted(chance.sample(range(1, GENERATIONS * 8 // 10), kills)):
        run = Process(COMMAND, [*command, "--out", killed, *["--resume"] * (len(saved) > 1)])
        while generations_in(checkpoint) <= max(moment, saved[-1]):
            assert run.poll() is None, "the process ended before it was killed"
            time.sleep(0.005)
        time.sleep(chance.uniform(0.0, 0.01))  # at any time within a generation, also while it is saved
        run.kill()
        assert run.wait() == -signal.SIGKILL
        saved.append(generations_in(checkpoint))
        assert not (killed / "trial-000").exists()
    assert saved == sorted(set(saved))  # each run continued the previous one
    print(f"killed after generations {saved[1:]} of {GENERATIONS}")

    assert Process(COMMAND, [*command, "--out", killed, "--resume"]).wait() == 0
    assert uninterrupted.wait() == 0
    assert {"tuning.toml", "trial-000/result.json", "trial-000/history.npz"} <= set(file_contents(whole))
    assert file_contents(killed) == file_contents(whole)


def generations_in(checkpoint: Path) -> int:
    saved = load_checkpoint(checkpoint)
    return len(saved[0]["best"]) if saved else 0


# --- Folders that can't be resumed -------------------------------------------------------------------------


def refusal(drives, out: Path, **options) -> str:
    before = file_contents(out)
    with pytest.raises(InputError) as caught:
        tune(drives, out=out, **options)
    message = str(caught.value)
    print(message)
    assert "\n" not in message
    assert str(out) in message
    assert file_contents(out) == before  # no file changes
    return message


@pytest.fixture
def started(tmp_path: Path) -> Path:
    interrupted(DRIVES, tmp_path / "out", 3, **OPTIONS)
    return tmp_path / "out"


def test_a_folder_with_results_needs_resume(started: Path):
    assert "already contains an unfinished tuning; add --resume" in refusal(DRIVES, started, **OPTIONS)
    with pytest.raises(InputError, match=r"out: has no finished tuning; add --resume to the command"):
        Tuning.load(started)
    with pytest.raises(InputError, match=r"out: has no finished tuning; add --resume to the command"):
        FilterParameters.load(started)
    (started.parent / "out-2").mkdir()
    for drives, options in ((DRIVES, {**OPTIONS, "seed": 4}), (DRIVES[:1], OPTIONS)):
        said = refusal(drives, started, **options)
        assert "already contains an unfinished tuning; its drives or options differ; choose another" in said
        assert said.endswith(f"folder, for example --out {started}-3")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"particles": 7}, "particles = 5, but this command has particles = 7"),
        ({"seed": 4}, "seed = 3, but this command has seed = 4"),
        ({"generations": 9}, "generations = 6"),
        ({"scale": "linear"}, "scale = log10, but this command has scale = linear"),
        ({"objective": "truth-pose"}, "objective = truth-rmse, but this command has objective = truth-pose"),
        ({"inertia": 0.5}, "inertia = 0.7298, but this command has inertia = 0.5"),
        ({"patience": 5}, "patience = None, but this command has patience = 5"),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_the_error_names_a_different_configuration(started: Path, change: dict, said: str):
    assert said in refusal(DRIVES, started, resume=True, **(OPTIONS | change))


def test_the_error_names_different_drives(started: Path):
    message = refusal(DRIVES[:1], started, resume=True, **OPTIONS)
    assert "drives d0 (" in message
    assert "d1 (" in message
    moved = replace(DRIVES[1], gps=replace(DRIVES[1].gps, x=DRIVES[1].gps.x + 1e-6))
    assert "the drives" in refusal([DRIVES[0], moved], started, resume=True, **OPTIONS)
    assert "the drives" in refusal(DRIVES[::-1], started, resume=True, **OPTIONS)


def test_the_error_names_a_number_of_drive_toml_that_changed(tmp_path: Path):
    interrupted(DRIVES, tmp_path / "out", 8, **OPTIONS)
    stated = [DRIVES[0], replace(DRIVES[1], metadata={**DRIVES[1].metadata, "gps_std_m": 7.0})]
    message = refusal(stated, tmp_path / "out", resume=True, **OPTIONS)
    assert "but this command has drive d1.stated.gps_std_m = 7.0; " in message
    assert "its drives or options differ; choose another" in refusal(stated, tmp_path / "out", **OPTIONS)


CORRUPTIONS = {
    "empty": lambda good: b"",
    "cut-short": lambda good: good[: len(good) // 2],
    "cut-at-the-end": lambda good: good[:-30],
    "text": lambda good: b"this is no checkpoint\n",
    "zip-magic-only": lambda good: b"PK\x03\x04" + b"x" * 100,
    "flipped": lambda good: good[:200] + bytes(b ^ 0xFF for b in good[200:400]) + good[400:],
}


@pytest.mark.parametrize(
    "corruption",
    quickly([(c,) for c in CORRUPTIONS], lambda corruption: corruption in ("cut-short", "flipped")),
)
def test_the_error_names_a_corrupted_checkpoint(started: Path, corruption: str):
    file = started / "checkpoint-000.npz"
    file.write_bytes(CORRUPTIONS[corruption](file.read_bytes()))
    message = refusal(DRIVES, started, resume=True, **OPTIONS)
    assert message.startswith(f"{file}: not a readable checkpoint")
    assert "delete it to redo this trial" in message
    file.unlink()
    tune(DRIVES, out=started, resume=True, **OPTIONS)


def test_the_error_names_a_checkpoint_without_an_array(started: Path):
    file = started / "checkpoint-000.npz"
    arrays, notes = load_checkpoint(file)
    del arrays["first.velocities"]
    save_checkpoint(file, arrays, notes)
    assert "not a readable checkpoint" in refusal(DRIVES, started, resume=True, **OPTIONS)


@pytest.mark.parametrize("content", ["", "{", "[]", "3"])
def test_the_error_names_a_corrupted_configuration(started: Path, content: str):
    (started / "config.json").write_text(content)
    assert "config.json" in refusal(DRIVES, started, resume=True, **OPTIONS)


@pytest.mark.parametrize("file", ["result.json", "history.npz"])
@pytest.mark.parametrize("content", [b"", b"nonsense", None])
def test_the_error_names_a_corrupted_trial(tmp_path: Path, file: str, content: bytes | None):
    out = tmp_path / "out"
    interrupted(DRIVES, out, 8, **OPTIONS)
    broken = out / "trial-000" / file
    broken.unlink() if content is None else broken.write_bytes(content)
    message = refusal(DRIVES, out, resume=True, **OPTIONS)
    assert str(out / "trial-000") in message


# --- Writing -----------------------------------------------------------------------------------------------


def test_a_file_is_replaced_atomically(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "a.txt"
    write_atomically(file, b"first")

    def crash(_: int) -> None:
        raise OSError("power cut")

    monkeypatch.setattr(os, "fsync", crash)
    with pytest.raises(InputError, match="power cut"):
        write_atomically(file, b"second, and longer")
    assert file.read_bytes() == b"first"


def test_a_crash_while_saving_keeps_the_last_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "c.npz"
    save_checkpoint(file, {"a": np.arange(3)}, {"n": 1})

    def crash(_: int) -> None:
        raise OSError("power cut")

    monkeypatch.setattr(os, "fsync", crash)
    with pytest.raises(InputError, match="power cut"):
        save_checkpoint(file, {"a": np.arange(9)}, {"n": 2})
    arrays, notes = load_checkpoint(file)
    assert arrays["a"].tolist() == [0, 1, 2]
    assert notes == {"n": 1}
    assert load_checkpoint(tmp_path / "none.npz") is None


def test_a_checkpoint_keeps_a_generator_s_big_numbers(tmp_path: Path):
    state = np.random.default_rng(5).bit_generator.state
    save_checkpoint(tmp_path / "c.npz", {"x": np.array([np.inf, np.nan, 1e-320])}, {"rng": state})
    arrays, notes = load_checkpoint(tmp_path / "c.npz")
    assert notes["rng"] == state
    assert arrays["x"].tobytes() == np.array([np.inf, np.nan, 1e-320]).tobytes()


def test_the_configuration_contains_the_options(started: Path):
    config = json.loads((started / "config.json").read_text())
    assert OPTIONS.items() <= config.items()
    assert [d["name"] for d in config["data"]] == ["d0", "d1"]


def test_a_search_from_a_start_is_resumed_with_the_same_bits(tmp_path: Path):
    options = {**OPTIONS, "trials": 1, "start": replace(DEFAULTS, nominal_interval=0.01)}
    tune(DRIVES, out=tmp_path / "whole", **options)
    interrupted(DRIVES, tmp_path / "killed", 2, **options)
    tune(DRIVES, out=tmp_path / "killed", resume=True, **options)
    assert file_contents(tmp_path / "killed") == file_contents(tmp_path / "whole")


def test_a_run_without_entries_of_later_versions_is_resumed(tmp_path: Path):
    interrupted(DRIVES, tmp_path / "run", 2, **OPTIONS)
    file = tmp_path / "run" / "config.json"
    config = json.loads(file.read_text())
    assert config.pop("center")
    for drive in config["data"]:
        drive["slow"] = True  # as another version could write it
        del drive["stated"]
    file.write_text(json.dumps(config))
    assert tune(DRIVES, out=tmp_path / "run", resume=True, **OPTIONS).cost > 0
