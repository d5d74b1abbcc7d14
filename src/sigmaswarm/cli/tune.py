"""`sigmaswarm tune`."""

from collections.abc import Sequence
from math import isfinite
from os.path import relpath
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Unpack

from cyclopts import Parameter, validators

from sigmaswarm.cli.options import takes
from sigmaswarm.tuning.options import DEFAULTS, TuneOptions

if TYPE_CHECKING:
    from sigmaswarm import Drive

MOST_LOOKED_AT = 20
"""Other tunings beside a new one, the newest first, to name one to compare with."""


@takes(TuneOptions, DEFAULTS)
def tune(
    drives: Annotated[list[str], Parameter(name="DRIVE", consume_multiple=1, negative=())],
    /,
    *,
    out: Path,
    validation: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    paper: Annotated[bool, Parameter(negative=())] = False,
    workers: Annotated[int | None, Parameter(validator=validators.Number(gte=1))] = None,
    cluster: str | None = None,
    resume: Annotated[bool, Parameter(negative=())] = False,
    trust_log: Annotated[bool, Parameter(negative=())] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
    **options: Unpack[TuneOptions],
) -> None:
    """Tune a filter on drives, and keep it in OUT/tuning.toml.

    Put the drives first, then the options. Truth is not needed: without truth.csv the filter is tuned to forecast
    the fixes. Without --model and --use the filter is what suits all the drives, by what their logs have; the command
    says what that is. Keep some drives back, and see with `sigmaswarm evaluate` what the tuning is worth on them.

    Examples:

        sigmaswarm tune drives/monday drives/tuesday --out tuned
        sigmaswarm tune drives/training --out tuned --model planar8 --use lateral standstill gate
        sigmaswarm tune drives/training --out tuned --validation drives/monday --trials 5
        sigmaswarm tune drives/training --out tuned --model planar5 --objective innovation-nll
        sigmaswarm tune drives/training --out tuned --racing
        sigmaswarm tune drives/training --out tuned --paper
        sigmaswarm tune drives/training --out tuned --resume
        sigmaswarm tune s3://fleet/training --out tuned --cluster tcp://scheduler:8786

    Parameters
    ----------
    drives
        Drive folders to tune on, or folders that hold drive folders; or URLs of such.
    out
        Folder for tuning.toml, the convergence history and figures.
    validation
        Drives held back from the search, to see what the result is worth on others.
    paper
        The paper's setting: pso, 30 x 50, linear, gps-rmse, planar5, ukf. Options that contradict it are refused.
    workers
        Threads; all cores by default. The result does not depend on it.
    cluster
        A Dask cluster whose workers read the drives, hold them and do the work: tcp://host:8786, a scheduler file, or
        local:4 for so many processes of this machine. Nor does the result depend on it.
    resume
        Go on with a tuning that was interrupted; the result is the same as without the interruption.
    trust_log
        Don't ask the doctor whether something is seriously wrong with the drives.
    json
        Print the result for machines.
    """
    from concurrent.futures import ThreadPoolExecutor
    from functools import partial

    import sigmaswarm
    from sigmaswarm.cli.common import (
        cluster_at,
        print_json,
        print_remarks,
        read_datasets,
        stdout,
        tuning_progress,
    )
    from sigmaswarm.drives.sensors import sensors_of
    from sigmaswarm.scoring.jobs import cores
    from sigmaswarm.scoring.remarks import said_of_first_look
    from sigmaswarm.scoring.tracks import first_look
    from sigmaswarm.tuning.defaults import with_filter
    from sigmaswarm.wording import counted

    with cluster_at(cluster) as client:
        read, held_back = read_datasets(
            drives, validation or [], cluster=client, trusted=trust_log, gaps=True
        )
        everywhere = [*read.map(sensors_of), *held_back.map(sensors_of)]
        chosen = "" if paper else with_filter({**options}, everywhere)[1]
        with ThreadPoolExecutor(workers or cores()) as pool, tuning_progress("tuning") as progress:
            tuning = sigmaswarm.tune(
                read,
                validation=held_back,
                out=out,
                resume=resume,
                paper=paper,
                executor=pool,
                progress=progress,
                **options,
            )
        shown = partial(
            first_look, parameters=tuning.parameters, as_recorded=tuning.config.model_dump()["as_recorded"]
        )
        (look,) = read.subset([0]).map(shown)
        (part,) = read.subset([0]).map(_is_part)
    from sigmaswarm.reports.tuning import save_tuning_figures  # what draws takes memory beside a long drive

    pictures = save_tuning_figures(tuning, look.picture, out)
    if json:
        print_json(tuning.to_dict())
        return
    console = stdout()
    if chosen:  # only now, for a mistake is to be told in one line
        console.print(f"model:    {chosen}")
    margin = (
        f"; {tuning.trials[tuning.best_trial].cost:.4f} before the margin" if tuning.raised_by != 1.0 else ""
    )
    console.print(
        f"cost {tuning.cost:.4f} ({tuning.config.objective}{margin}) on {counted(len(read), 'drive')}"
    )
    if tuning.config.racing:
        share = tuning.steps / tuning.full_steps
        console.print(f"racing: {tuning.steps} filter steps, {share:.0%} of those without it")
    if tuning.validation:
        gap = tuning.validation.gap
        gap = f"errors {abs(gap):.1%} {'larger' if gap >= 0 else 'smaller'}" if isfinite(gap) else "failed"
        console.print(
            f"cost {tuning.validation.cost:.4f} on {counted(len(held_back), 'validation drive')}: {gap}"
        )
    if position := said_of_first_look(look):
        console.print(f"position: {position}")
    print_remarks(tuning.remarks)
    console.print(f"filter:   {out / 'tuning.toml'}")
    console.print(f"pictures: {', '.join(str(p) for p in pictures)}")
    alone = len(read) == 1 and not len(held_back)
    lines = _next(out, drives[0], everywhere[0].name, part=part) if alone else [_usual_next(out)]
    for line in [*lines, *_compare(lines[0], out, [one["sha256"] for one in tuning.data])]:
        console.print(line)


def _is_part(drive: "Drive") -> bool:
    """Whether a drive was cut from another one."""
    return "cut_from" in drive.metadata


def _compare(evaluate: str, out: Path, tuned_on: Sequence[str]) -> list[str]:
    """How to see this tuning beside the newest other one of the same drives, where there is one in the folder above."""
    from sigmaswarm.errors import InputError
    from sigmaswarm.records import load_record
    from sigmaswarm.scoring.records import SCORES_FILE
    from sigmaswarm.tuning.record import FILE, TuningRecord

    files = out.resolve().parent.glob(f"*/{FILE}")  # an evaluation holds a copy of its tuning's
    others = [f for f in files if not f.parent.samefile(out) and not (f.parent / SCORES_FILE).exists()]
    for file in sorted(others, key=lambda file: file.stat().st_mtime, reverse=True)[:MOST_LOOKED_AT]:
        try:
            data = load_record(TuningRecord, file).data
        except InputError:
            continue
        if [one.sha256 for one in data] == [*tuned_on]:
            beside = out.parent / file.parent.name  # as the user writes it, unless OUT is "." or a link
            there = beside.exists() and beside.samefile(file.parent)
            other = beside if there else relpath(file.parent)
            return [f"compare:  {evaluate.removeprefix('next:     ')} --against {quote(str(other))}"]
    return []


def _usual_next(out: Path) -> str:
    return f"next:     sigmaswarm evaluate {quote(str(out))} HELD_OUT_DRIVE..."


def _next(out: Path, given: str, name: str, *, part: bool) -> list[str]:
    """What to do next with one log: cut it in two, for of other drives nothing is known yet."""
    from sigmaswarm.drives.reader import drive_folders
    from sigmaswarm.drives.urls import is_url

    if is_url(given):
        return [_usual_next(out)]
    (folder, *_) = drive_folders(Path(given))  # the path may be that of its parent
    if part:
        rest = folder.parent / f"{name.removesuffix('-train')}-test"
        return [
            f"next:     sigmaswarm evaluate {quote(str(out))} {quote(str(rest))}"
            if rest.is_dir()
            else _usual_next(out)
        ]
    train, test = (quote(f"parts/{name}-{part}") for part in ("train", "test"))
    return [
        _usual_next(out),
        f"one log?  this filter has seen all of it: sigmaswarm split {quote(str(folder))} --out parts",
        f"          then tune on {train}, and evaluate on {test}",
    ]
