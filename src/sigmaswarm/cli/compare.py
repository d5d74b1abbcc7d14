"""`sigmaswarm compare`."""

from pathlib import Path
from typing import Annotated, Unpack

from cyclopts import Parameter, validators

from sigmaswarm.cli.options import takes
from sigmaswarm.tuning.options import DEFAULTS, SEEDS, CompareOptions, Scale


@takes(CompareOptions, DEFAULTS)
def compare(
    drives: Annotated[list[str], Parameter(name="DRIVE", consume_multiple=1, negative=())],
    /,
    *,
    out: Path,
    optimizers: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    scales: Annotated[list[Scale] | None, Parameter(consume_multiple=1, negative=())] = None,
    seeds: int = SEEDS,
    validation: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    workers: Annotated[int | None, Parameter(validator=validators.Number(gte=1))] = None,
    cluster: str | None = None,
    resume: Annotated[bool, Parameter(negative=())] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
    **options: Unpack[CompareOptions],
) -> None:
    """Compare optimizers: the same budget on the same drives, over many seeds.

    OUT gets comparison.md (a table with intervals and paired tests), comparison.csv, runs.csv, curves.csv,
    comparison.png, times.csv and all tunings. The result holds for these drives; other seeds would give the same
    within the intervals, other drives need not.

    Examples:

        sigmaswarm compare drives/training --validation drives/held-out --out compared
        sigmaswarm compare drives/training --optimizers pso de cma-es --scales log10 linear --out compared
        sigmaswarm compare drives/training --optimizers pso pso:polish=300 pso:racing=true --out compared

    Parameters
    ----------
    drives
        Drive folders to tune on, or folders of drive folders; or their URLs.
    out
        Folder for the tables, the figure and all runs.
    optimizers
        pso, ga, ga-pso, de, cma-es, bo, nelder-mead, random, sobol. Their own settings follow a colon:
        pso:polish=300 or pso:particles=10,generations=30,trials=5. Particles x generations x trials must be the
        same for all. The first is the reference of the tests. By default all but bo, nelder-mead and sobol.
    scales
        log10, linear or both; log10 by default.
    seeds
        Number of runs of each.
    validation
        Held-out drives.
    workers
        Threads; all cores by default. With --cluster, tunings at a time. The result does not depend on it.
    cluster
        A Dask cluster whose workers read the drives and do the work: tcp://host:8786, a scheduler file, or local:4
        for four processes of this machine. The result does not depend on it.
    resume
        Continue an interrupted comparison; the result is the same, but for the times.
    json
        Print the table as JSON.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import cluster_at, held_drives, print_json, progress_bar, stdout
    from sigmaswarm.doctor.suited import equipment
    from sigmaswarm.reports.compare import comparison_table, save_comparison
    from sigmaswarm.tuning.defaults import with_filter

    chosen = {"optimizers": optimizers, "scales": scales}
    with cluster_at(cluster) as client:
        read, held_out = held_drives(drives, validation or [], cluster=client)
        said = with_filter({**options}, [*read.of_each(equipment), *held_out.of_each(equipment)])[1]
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
