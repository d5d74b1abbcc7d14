"""`evaluate --out` computes initial states, timelines and runs of filters only once."""

import sys
from collections import Counter
from pathlib import Path

import pytest

import sigmaswarm
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.drives.timeline import build_timeline
from sigmaswarm.filters.compiled import run
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_imu_only
from sigmaswarm.scoring.targets import outage_pass, placements
from support import make_drive

GOOD = FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0))
DRIVE = make_drive(duration=150.0, seed=1, name="monday")  # longer than a piece of a recording


def count_calls(monkeypatch: pytest.MonkeyPatch, function) -> list[None]:
    """Return a list that grows with each call of a function by a module of the package."""
    calls: list[None] = []

    def counted(*args, **kw):
        calls.append(None)
        return function(*args, **kw)

    for name, module in list(sys.modules.items()):
        if name.startswith("sigmaswarm.") and vars(module).get(function.__name__) is function:
            monkeypatch.setattr(module, function.__name__, counted)
    return calls


@pytest.mark.filterwarnings("ignore::sigmaswarm.errors.SigmaswarmWarning")
def test_an_evaluation_with_pictures_computes_each_thing_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unpainted: None
):
    from sigmaswarm.cli import evaluate as command

    sigmaswarm.write_drive(DRIVE, tmp_path / "monday")
    GOOD.save(tmp_path / "tuning.toml")
    whole = prepare_drive(DRIVE)
    lengths = [
        len(outage_pass(whole, length=length, seed=seed).timeline.dt)
        for length in (1.0, 5.0, 30.0)
        for seed in placements(DRIVE, whole.initial, length=length, seed=0)
    ]
    aligned, lines, reckoned = (
        count_calls(monkeypatch, f) for f in (initial_state, build_timeline, run_imu_only)
    )
    steps: Counter[int] = Counter()  # steps of the kernel by the number of steps of the timeline
    lanes = run.run_lanes

    def counted(model, drive, rows, cursor, stop, *written):
        steps[len(drive[0])] += stop - int(cursor[0])
        return lanes(model, drive, rows, cursor, stop, *written)

    monkeypatch.setattr(run, "run_lanes", counted)
    options = command.EvaluateOptions(out=tmp_path / "out")
    command.evaluate(tmp_path / "tuning.toml", [tmp_path / "monday"], options=options)
    assert (tmp_path / "out" / "monday-error.png").exists()
    assert (tmp_path / "out" / "monday-consistency.png").exists()
    assert (len(aligned), len(reckoned)) == (1, 1)
    assert len(lines) == 1 + len(lengths)  # one for all fixes, and one for each placement of outages
    k = len(whole.timeline().dt)
    assert len(lengths) > 8
    # the tuned filter and the baseline, both with the divergence monitor
    assert steps == {k: 2 * k, **{n: 2 * n * count for n, count in Counter(lengths).items()}}
