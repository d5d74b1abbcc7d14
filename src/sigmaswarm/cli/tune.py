"""`sigmaswarm tune`."""

from math import isfinite
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Unpack

from cyclopts import Parameter, validators

from sigmaswarm.cli.options import takes
from sigmaswarm.tuning.options import DEFAULTS, TuneOptions

if TYPE_CHECKING:
    from sigmaswarm import Drive


@takes(TuneOptions, DEFAULTS)
def tune(
    drives: Annotated[list[Path], Parameter(name="DRIVE", consume_multiple=1, negative=())],
    /,
    *,
    out: Path,
    validation: Annotated[list[Path] | None, Parameter(consume_multiple=1, negative=())] = None,
    paper: Annotated[bool, Parameter(negative=())] = False,
    workers: Annotated[int | None, Parameter(validator=validators.Number(gte=1))] = None,
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

    Parameters
    ----------
    drives
        Drive folders to tune on, or folders that hold drive folders.
    out
        Folder for tuning.toml, the convergence history and figures.
    validation
        Drives held back from the search, to see what the result is worth on others.
    paper
        The paper's setting: pso, 30 x 50, linear, gps-rmse, planar5, ukf. Options that contradict it are refused.
    workers
        Threads; all cores by default. The result does not depend on it.
    resume
        Go on with a tuning that was interrupted; the result is the same as without the interruption.
    trust_log
        Don't ask the doctor whether something is seriously wrong with the drives.
    json
        Print the result for machines.
    """
    from concurrent.futures import ThreadPoolExecutor

    import sigmaswarm
    from sigmaswarm.cli.common import print_json, read_drives, stdout, tuning_progress
    from sigmaswarm.drives.prepared import PreparedDrive
    from sigmaswarm.report.tuning import save_tuning_figures
    from sigmaswarm.scoring.tracks import compared, picture_of
    from sigmaswarm.tuning.defaults import with_filter

    read = read_drives(drives, trusted=trust_log, gaps=True)
    held_back = read_drives(validation or [], trusted=trust_log, gaps=True)
    chosen = "" if paper else with_filter({**options}, [*read, *held_back])[1]
    with ThreadPoolExecutor(workers) as pool, tuning_progress("tuning") as progress:
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
    filters = compared(read[0], tuning.parameters)
    first = PreparedDrive(read[0], as_recorded=tuning.config.model_dump()["as_recorded"])
    pictures = save_tuning_figures(tuning, picture_of(first, filters, read[0].name), out)
    if json:
        print_json(tuning.to_dict())
        return
    console = stdout()
    if chosen:  # only now, for a mistake is to be told in one line
        console.print(f"model:    {chosen}")
    console.print(f"cost {tuning.cost:.4f} ({tuning.config.objective}) on {len(read)} drive(s)")
    if tuning.raised_by != 1.0:
        console.print(f"margin: all process noises raised by {tuning.raised_by:.3g}")
    if tuning.config.racing:
        share = tuning.steps / tuning.full_steps
        console.print(f"racing: {tuning.steps} filter steps, {share:.0%} of those without it")
    if tuning.validation:
        gap = tuning.validation.gap
        gap = f"errors {abs(gap):.1%} {'larger' if gap >= 0 else 'smaller'}" if isfinite(gap) else "failed"
        console.print(f"cost {tuning.validation.cost:.4f} on {len(held_back)} validation drive(s): {gap}")
    for remark in tuning.remarks:
        console.print(f"note: {remark}")
    console.print(f"filter:   {out / 'tuning.toml'}")
    console.print(f"pictures: {', '.join(str(p) for p in pictures)}")
    for line in _next(out, drives, read, alone=not held_back):
        console.print(line)


def _next(out: Path, folders: list[Path], drives: "list[Drive]", *, alone: bool) -> list[str]:
    """What to do next: with one log, cut it in two, for of other drives nothing is known yet."""
    from sigmaswarm.drives.reader import drive_folders

    evaluate = f"next:     sigmaswarm evaluate {quote(str(out))}"
    if len(drives) > 1 or not alone:
        return [f"{evaluate} HELD_OUT_DRIVE..."]
    name, (folder,) = drives[0].name, drive_folders(folders[0])  # what was named may hold the drive
    if "cut_from" in drives[0].metadata:
        rest = folder.parent / f"{name.removesuffix('-train')}-test"
        return [f"{evaluate} {quote(str(rest)) if rest.is_dir() else 'HELD_OUT_DRIVE...'}"]
    train, test = (quote(f"parts/{name}-{part}") for part in ("train", "test"))
    return [
        f"{evaluate} HELD_OUT_DRIVE...",
        f"one log?  this filter has seen all of it: sigmaswarm split {quote(str(folder))} --out parts",
        f"          then tune on {train}, and evaluate on {test}",
    ]
