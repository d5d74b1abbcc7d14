"""`sigmaswarm compare`."""

from pathlib import Path
from typing import Annotated, Any

from sigmaswarm.cli.options import MORE, Cluster, Json, Places, Workers, options_of
from sigmaswarm.tuning.config import DECIDED_LATER, TuneConfig
from sigmaswarm.tuning.options import SEEDS, Scale

APART = ("seed", "optimizer", "scale", "prior", "inflation")
"""Options of the comparison, and those that only guard a tuning's result."""


@options_of(
    TuneConfig, shown=("objective", "particles", "generations", "model"), apart=APART, by_data=DECIDED_LATER
)
def compare(
    drives: Places,
    /,
    *,
    out: Path,
    optimizers: list[str] | None = None,
    scales: list[Scale] | None = None,
    seeds: int = SEEDS,
    validation: list[str] | None = None,
    workers: Workers = None,
    cluster: Annotated[Cluster, MORE] = None,
    resume: bool = False,
    json: Json = False,
    **options: Any,
) -> None:
    """Compare optimizers with the same budget on the same drives.

    OUT gets comparison.md (a table with intervals and paired tests), comparison.csv, runs.csv, curves.csv,
    comparison.png, times.csv and all tunings. The result holds for these drives; other seeds would give the same
    within the intervals, other drives need not.

    Examples:

        sigmaswarm compare drives/training --validation drives/held-out --out compared
        sigmaswarm compare drives/training --optimizers pso de cma-es --scales log10 linear --out compared
        sigmaswarm compare drives/training --optimizers pso pso:polish=300 pso:racing=true --out compared

    Parameters
    ----------
    out
        Folder for the tables, the figure and all runs.
    optimizers
        Names, with settings after a colon, as pso:polish=300; all need the same budget. The first is the reference.
    scales
        log10, linear or both; log10 by default.
    seeds
        Runs of each optimizer.
    validation
        Drives that the search does not see, to measure the results on others.
    workers
        Threads, or with --cluster simultaneous tunings; all cores by default. The result does not depend on it.
    resume
        Continue an interrupted comparison; the result is the same, except for the times.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import cluster_at, print_json, read_datasets, stdout
    from sigmaswarm.cli.progress import progress_bar
    from sigmaswarm.drives.sensors import sensors_of
    from sigmaswarm.reports.compare import comparison_table, save_comparison
    from sigmaswarm.tuning.defaults import with_filter

    chosen = {"optimizers": optimizers, "scales": scales}
    with cluster_at(cluster) as client:
        read, held_out = read_datasets(drives, validation or [], cluster=client)
        said = with_filter(options, [*read.map(sensors_of), *held_out.map(sensors_of)])[1]
        with progress_bar("comparing", "tunings, remaining") as show:
            comparison = sigmaswarm.compare(
                read,
                **{name: value for name, value in chosen.items() if value},  # pyright: ignore[reportArgumentType]
                seeds=seeds,
                validation=held_out,
                out=out,
                resume=resume,
                workers=workers,
                progress=show,
                **options,
            )
    written = save_comparison(comparison, out)
    if json:
        print_json({"comparison": comparison.frame.to_dicts(), "written": [str(path) for path in written]})
        return
    console = stdout()
    if said:
        console.print(f"model: {said}")
    console.print(comparison_table(comparison).to_markdown())
    for path in written:
        console.print(f"wrote {path}")
