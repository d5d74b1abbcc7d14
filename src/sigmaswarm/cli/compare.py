"""`sigmaswarm compare`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter, validators


def compare(
    drives: Annotated[list[Path], Parameter(name="DRIVE", consume_multiple=1, negative=())],
    /,
    *,
    out: Path,
    optimizers: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    scales: Annotated[
        list[Literal["log10", "linear"]] | None, Parameter(consume_multiple=1, negative=())
    ] = None,
    seeds: int = 20,
    test: Annotated[list[Path] | None, Parameter(consume_multiple=1, negative=())] = None,
    objective: str = "auto",
    worst: float = 1.0,
    particles: int = 30,
    generations: int = 50,
    model: Literal["planar5", "planar8"] = "planar5",
    kind: Literal["ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf"] = "ukf",
    use: Annotated[
        list[Literal["velocity", "lateral", "standstill", "gate", "latency"]] | None,
        Parameter(consume_multiple=1, negative=()),
    ] = None,
    polish: int = 0,
    racing: Annotated[bool, Parameter(negative=())] = False,
    workers: Annotated[int | None, Parameter(validator=validators.Number(gte=1))] = None,
    resume: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Compare optimizers: the same budget on the same drives, over many seeds.

    OUT gets comparison.md (a table with intervals and paired tests), comparison.csv, runs.csv, curves.csv,
    comparison.png, times.csv and every single tuning. What it says holds for these drives; other seeds would give
    the same within the intervals, other drives need not.

    Examples:

        sigmaswarm compare drives/training --test drives/held-out --out compared
        sigmaswarm compare drives/training --optimizers pso de cma-es --scales log10 linear --out compared
        sigmaswarm compare drives/training --optimizers pso pso:polish=300 pso:racing=true --out compared

    Parameters
    ----------
    drives
        Drive folders to tune on, or folders that hold drive folders.
    out
        Folder for the tables, the figure and all runs.
    optimizers
        pso, ga, ga-pso, de, cma-es, nelder-mead, random, sobol. Settings of one's own follow a colon:
        pso:polish=300 or pso:particles=10,generations=30,trials=5. Particles x generations x trials must be the
        same for all. The others are tested against the first one. By default all but nelder-mead and sobol.
    scales
        log10, linear or both; log10 by default.
    seeds
        Runs of each.
    test
        Held-out drives.
    objective
        As for `sigmaswarm tune`.
    worst
        Share of the drives that counts, the worst ones; by default the mean over all.
    particles
        Evaluations a generation.
    generations
        Generations.
    model
        The filter's process model.
    kind
        Unscented, extended, adaptive (Sage-Husa) or strong tracking.
    use
        What the filter uses beside position fixes.
    polish
        Evaluations of each run that are kept for a Nelder-Mead search from the best point.
    racing
        Drop the worse candidates of a generation before all drives are run.
    workers
        Threads; all cores by default. The result does not depend on it.
    resume
        Go on with a comparison that was interrupted; the result is the same, but for the times.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import progress_bar, read_drives, stdout
    from sigmaswarm.report.compare import comparison_table, save_comparison

    read, held_out = read_drives(drives), read_drives(test or [])
    chosen = {"optimizers": optimizers, "scales": scales}
    with progress_bar("comparing", "tunings, remaining") as show:
        comparison = sigmaswarm.compare(
            read,
            **{name: value for name, value in chosen.items() if value},
            seeds=seeds,
            test=held_out,
            out=out,
            resume=resume,
            workers=workers,
            progress=show,
            objective=objective,
            worst=worst,
            particles=particles,
            generations=generations,
            model=model,
            kind=kind,
            use=tuple(use or ()),
            polish=polish,
            racing=racing,
        )
    written = save_comparison(comparison, out)
    console = stdout()
    console.print(comparison_table(comparison).to_markdown())
    for path in written:
        console.print(f"wrote {path}")
