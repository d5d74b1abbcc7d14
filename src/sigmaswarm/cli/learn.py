"""`sigmaswarm learn`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

import sigmaswarm
from sigmaswarm.cli.common import print_result, read_drives, require_result_folder, require_tuning
from sigmaswarm.cli.options import FIELDS, Seed
from sigmaswarm.cli.terminal import progress_bar
from sigmaswarm.filters.names import NetworkName

if TYPE_CHECKING:
    from sigmaswarm.learned.folder import LearnedRecord


@dataclass(frozen=True, kw_only=True)
class LearnOptions:
    """Options of `sigmaswarm learn`.

    Attributes
    ----------
    out
        Folder for learned.toml, weights.npz and the filter. Without --resume, the folder must not contain a network.
    validation
        Drives for early stopping and calibration, not for training; by default a part of the training drives.
    search
        Number of additional sets of settings (hidden units, window, learning rate) to try; the best network is kept.
    seed
        Seed of all random numbers. The same seed gives the same result.
    resume
        Continue an interrupted training. The result is the same as without the interruption.
    json
        Print learned.toml as JSON.
    """

    out: Path
    validation: list[str] | None = None
    search: Seed = 0
    seed: Seed = 0
    resume: bool = False
    json: bool = False


def learn(
    network: Annotated[NetworkName, Parameter(name="NETWORK", help="Name of the network.")],
    tuning: Annotated[Path, Parameter(name="TUNING", help="A tuning.toml, or the folder that contains it.")],
    drives: Annotated[
        list[str], Parameter(name="DRIVE", help="Drive folders to train on, or folders of drive folders.")
    ],
    /,
    *,
    options: Annotated[LearnOptions, FIELDS],
) -> None:
    """Train a network that assists a tuned filter.

    outage-lstm predicts the displacement of the vehicle in outages. noise-gru scales Q and R depending on the latest
    innovations, and needs a filter with the model planar5 or planar8. OUT also contains the filter, so `sigmaswarm run`
    and `evaluate` accept OUT in place of a tuning. Only training needs `pip install 'sigmaswarm[learned]'`.

    Without --validation, the last quarter of each drive is held out. For outage-lstm with three or more drives, the
    last third of the drives is held out instead.

    For example:

        sigmaswarm learn outage-lstm tuned drives/training --out learned
        sigmaswarm learn outage-lstm tuned drives/training --out learned --validation drives/monday --search 8
        sigmaswarm learn noise-gru tuned drives/training --out learned --seed 1
        sigmaswarm learn noise-gru tuned drives/training --out learned --resume
    """
    require_result_folder(options.out, [tuning], "network", "config.json")
    record = _learn(network, tuning, drives, options)
    print_result(options.json, record.model_dump(mode="json"), *_summary(record, options.out))


def _learn(network: NetworkName, tuning: Path, drives: list[str], options: LearnOptions) -> "LearnedRecord":
    from sigmaswarm.filters.parameters import filter_file
    from sigmaswarm.learned.learn import LearnConfig
    from sigmaswarm.learned.learn import learn as train

    require_tuning(
        tuning, f"pass a tuning first, as in sigmaswarm learn {network} TUNING {quote(str(tuning))}"
    )
    parameters = sigmaswarm.FilterParameters.load(tuning)
    read, held_back = read_drives(drives), read_drives(options.validation or [])
    counted = "epochs at most, loss {task.fields[loss]}, remaining"
    with progress_bar("learning", counted, "smoothing the drives", loss="-") as show:
        learned = train(
            LearnConfig(network, parameters, read, held_back, options.search, options.seed),
            options.out,
            tuning=filter_file(tuning),
            resume=options.resume,
            progress=lambda now: show(now.done, now.total, loss=f"{now.loss:.3f}"),
        )
    return learned.record


def _summary(record: "LearnedRecord", out: Path) -> Iterator[str]:
    net, training = record.network, record.training
    yield (
        f"{record.kind}: {net.numbers} weights, {net.units} units, window {net.window:.3g} s, trained on "
        f"{training.driven_s / 60:.1f} minutes of driving in {training.epochs} epochs"
    )
    yield f"loss on {training.held_back}: {training.loss:.4f}, before training {training.loss_before:.4f}"
    if record.kind == "outage-lstm":
        yield (
            f"calibration: factor {net.inflation:.3g} on the predicted variances"
            if net.inflation
            else "note: the network increases the likelihood of hidden fixes by less than the standard error of the "
            "increase, so the filter does not use the network"
        )
    yield f"learned:  {out / 'learned.toml'}, {out / 'weights.npz'}"
    yield f"next: sigmaswarm evaluate {quote(str(out))} HELD_OUT_DRIVE..."
