"""Read damaged results: ``python -m fuzzing.records --inputs 5000 --seed 1``.

One or two files of a tuning, an interrupted tuning, an evaluation, a comparison or a study are damaged: their bytes, a
value in JSON or TOML, an array of an archive. Every command that reads the folder must then give a result, or one line.
"""

import argparse
import io
import json
import random
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fuzzing.check import (
    CHARACTERS,
    MEGABYTES,
    SECONDS,
    Finding,
    copied,
    keep,
    limited,
    memory_limit,
    peak_megabytes,
    repeat,
    signature,
)
from fuzzing.mutations import LARGEST, Draw, broken_bytes, broken_json
from sigmaswarm import FilterParameters, Tuning, evaluate, tune
from sigmaswarm.errors import SigmaswarmError
from sigmaswarm.experiments.compare import compare
from sigmaswarm.experiments.study.config import StudyConfig
from sigmaswarm.experiments.study.study import run_study
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.learned.fitting import n_weights
from sigmaswarm.learned.folder import LearnedNetwork, LearnedRecord, load_learned
from sigmaswarm.learned.outage_lstm import new_network
from sigmaswarm.reports.compare import save_comparison
from sigmaswarm.reports.evaluation import save_evaluation
from sigmaswarm.reports.page import page
from sigmaswarm.reports.read import read_report
from sigmaswarm.reports.study_charts import save_study
from support import make_drive

DRIVE = make_drive(duration=20.0, imu_rate=50.0)
SMALL: dict[str, Any] = {"model": "planar5", "objective": "truth-rmse", "particles": 4, "generations": 3}
SMALL_STUDY = StudyConfig(
    maneuvers=("turns",), environments=("clear",), runs=2, trials=2, particles=4, generations=2
)


class _Killed(Exception):
    """Ends a tuning after its second generation."""


def _tuning(folder: Path) -> None:
    tune(DRIVE, out=folder, trials=2, **SMALL)


def _interrupted(folder: Path) -> None:
    def stop(progress: Any) -> None:
        if progress.done == 5:
            raise _Killed

    try:
        tune(DRIVE, out=folder, trials=2, progress=stop, **SMALL)
    except _Killed:
        return
    raise AssertionError("it was not interrupted")


def _evaluation(folder: Path) -> None:
    _tuning(folder / "tuned")
    save_evaluation(evaluate(DRIVE, Tuning.load(folder / "tuned").parameters), folder / "e", folder / "tuned")


COMPARED: dict[str, Any] = {"optimizers": ("pso", "de"), "seeds": 2}


def _comparison(folder: Path) -> None:
    save_comparison(compare(DRIVE, out=folder, **COMPARED, **SMALL), folder)


def _study(folder: Path) -> None:
    save_study(run_study(SMALL_STUDY, folder, workers=1), folder)


def record_network(folder: Path) -> None:
    """Write the record and the weights of a network that is not trained."""
    rng = np.random.default_rng(1)
    windows, moved = rng.normal(size=(20, 40, 4)), rng.normal(9.0, 1.0, (20, 2))
    weights = new_network(rng, ("ax", "gz"), 4.0, 3, windows, moved).weights
    network = {"units": 3, "window": 4.0, "learning_rate": 0.1, "axes": ["ax", "gz"], "inflation": 1.0}
    network["numbers"] = n_weights(weights)
    training = {"seed": 1, "search": 1, "driven_s": 1.0, "epochs": 1, "loss_before": 1.0, "loss": 1.0}
    record = {"kind": "outage-lstm", "network": network, "training": training | {"held_back": "a"}}
    LearnedNetwork(LearnedRecord.model_validate(record), weights).save(folder)


def _network(folder: Path) -> None:
    tune(DRIVE, out=folder, **SMALL)
    record_network(folder)


def _use_network(folder: Path) -> None:
    if learned := load_learned(folder):
        for _ in learned.run(whole_pass(DRIVE), FilterParameters.load(folder)):
            pass


FOLDERS: dict[str, tuple[Callable[[Path], object], tuple[Callable[[Path], object], ...]]] = {
    "tuning": (
        _tuning,
        (
            Tuning.load,
            lambda f: page(read_report(f)),
            lambda f: tune(DRIVE, out=f, trials=2, resume=True, **SMALL),
        ),
    ),
    "interrupted": (_interrupted, (lambda f: tune(DRIVE, out=f, trials=2, resume=True, **SMALL),)),
    "evaluation": (_evaluation, (lambda f: page(read_report(f / "e")),)),
    "network": (_network, (_use_network,)),
    "comparison": (_comparison, (lambda f: compare(DRIVE, out=f, resume=True, **COMPARED, **SMALL),)),
    "study": (
        _study,
        (lambda f: page(read_report(f)), lambda f: run_study(SMALL_STUDY, f, resume=True, workers=1)),
    ),
}
"""What makes each folder, and what reads it."""


def broken_archive(draw: Draw, data: bytes) -> bytes:
    """An archive with one array left out, added, or of another shape, type or content."""
    with np.load(io.BytesIO(data), allow_pickle=False) as read:
        arrays = {name: read[name] for name in read.files}
    name = draw(st.sampled_from(sorted(arrays)))
    old = arrays.pop(name)
    new = draw(
        st.sampled_from(
            [
                None,
                old[..., None],
                old.ravel()[:-1],
                old.ravel()[:0],
                np.array(3.0),
                np.repeat(old.ravel(), 3),
                old.astype(str),
                old.astype(bytes) if old.dtype.kind != "U" else old,
                np.full(old.shape, np.nan),
                np.full(old.shape, 1e308),
                np.full(old.shape, -1),
                old.astype(complex) if old.dtype.kind in "if" else old,
                np.zeros((10**4, 100)),
            ]
        )
    )
    if new is not None:
        arrays[name if draw(st.integers(0, 5)) else "other"] = new
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def broken_text(draw: Draw, data: bytes) -> bytes:
    """A text with one number, or one whole value or key, in the place of another."""
    if draw(st.booleans()):
        return broken_json(draw, data)
    found = data.split(b"\n")
    at = draw(st.integers(0, len(found) - 1))
    mark = b":" if b":" in found[at] else b"="
    key, _, _ = found[at].partition(mark)
    values = [
        b"1e400",
        b"-1",
        b'"x"',
        b"[]",
        b"{}",
        b"[[0]]",
        b"true",
        b"null",
        b"9" * 4000,
        b'"' + b"x" * 9000 + b'"',
    ]
    comma = b"," if found[at].rstrip().endswith(b",") else b""
    found[at] = draw(
        st.sampled_from([b"", key + mark + b" " + draw(st.sampled_from(values)) + comma, found[at] * 2])
    )
    return b"\n".join(found)


def damage(draw: Draw, folder: Path) -> list[Path]:
    """Damage one or two files, or take the content of another; return them."""
    files = sorted(
        f for f in folder.rglob("*") if f.is_file() and f.suffix in (".toml", ".json", ".npz", ".csv")
    )
    sound = {file: file.read_bytes() for file in files}
    chosen = draw(st.lists(st.sampled_from(files), min_size=1, max_size=2, unique=True))
    for file in chosen:
        data = sound[file]
        how = draw(st.sampled_from(["kind", "kind", "kind", "bytes", "other", "empty", "gone"]))
        if how == "kind" and len(data):
            data = (broken_archive if file.suffix == ".npz" else broken_text)(draw, data)
        elif how == "bytes":
            data = broken_bytes(draw, data)
        elif how == "other":
            data = sound[draw(st.sampled_from(files))]
        elif how == "empty":
            data = b""
        file.write_bytes(data[:LARGEST])
        if how == "gone":
            file.unlink()
    return chosen


def check(folder: Path, read: Callable[[Path], object]) -> bool:
    """Read a damaged folder; whether it gave a result."""
    most = memory_limit()
    with limited(SECONDS), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read(folder)
        except SigmaswarmError as error:
            said = str(error)
            if not said.isprintable() or len(said) > CHARACTERS:
                raise Finding(f"no line: {said[:200]!r}, {len(said)} characters") from None
            if folder.name not in said:
                raise Finding(f"no file: {said[:200]!r}") from None
            return False
    if peak_megabytes() > most:
        raise Finding(f"more than {MEGABYTES} MB")
    return True


def fuzz(number: int, name: str, inputs: int, found: Path | None = None) -> tuple[Counter[str], int]:
    """Damage a folder again and again; return what was found, and how often a result was read nevertheless."""
    make, readers = FOLDERS[name]
    findings: Counter[str] = Counter()
    accepted = 0
    with tempfile.TemporaryDirectory() as place:
        sound = Path(place) / "sound" / name
        sound.parent.mkdir()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            make(sound)

        def one(data: st.DataObject) -> None:
            nonlocal accepted
            read = data.draw(st.sampled_from(readers))
            copy = copied(sound, sound, Path(place) / "in")
            wrong = damage(data.draw, copy)
            try:
                accepted += check(copy, read)
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                kind = f"{signature(error)} ({', '.join(f.name for f in wrong)})"
                findings[kind] += 1
                if found is not None and findings[kind] == 1:
                    keep(found / name / str(len(findings)), copy, kind)

        repeat(one, inputs, number)
    return findings, accepted


def main() -> int:
    parser = argparse.ArgumentParser(prog="fuzzing.records", description=__doc__)
    parser.add_argument("--inputs", type=int, default=1000, help="of each type of folder")
    parser.add_argument("--seed", type=int, default=random.randrange(10**6))
    parser.add_argument("--folder", choices=FOLDERS, help="this one alone")
    parser.add_argument("--found", type=Path, default=Path("fuzz-found"), help="folder for what is found")
    options = parser.parse_args()
    failed = 0
    for name in [options.folder] if options.folder else FOLDERS:
        begin = time.monotonic()
        findings, accepted = fuzz(options.seed, name, options.inputs, options.found)
        failed += len(findings)
        told = {"folder": name, "seed": options.seed, "inputs": options.inputs, "read": accepted}
        print(
            json.dumps(told | {"s": round(time.monotonic() - begin), "peak_mb": round(peak_megabytes())}),
            flush=True,
        )
        for kind, count in findings.most_common():
            print(f"    {count:5} x {kind}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
