"""`sigmaswarm compare`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import sigmaswarm
from sigmaswarm.cli.common import cluster_at, print_result, read_datasets, require_result_folder
from sigmaswarm.cli.options import FIELDS, MORE, Cluster, Count, Json, Places, options_of
from sigmaswarm.cli.terminal import progress_bar
from sigmaswarm.tuning.config import DEFERRED_OPTIONS, SEEDS, Scale, TuneConfig

# Options of `tune` that `compare` does not have.
EXCLUDED_OPTIONS = ("seed", "optimizer", "scale", "prior", "inflation")
SHORT_HELP = ("objective", "particles", "generations", "model")


@dataclass(frozen=True)
class CompareOptions:
    """Options of `sigmaswarm compare` that are not fields of its configuration.

    Attributes
    ----------
    optimizers
        Optimizers; statistical tests compare each with the first. Settings follow a colon: pso:polish=300. Default:
        pso, ga, ga-pso, de, cma-es, random.
    scales
        Scales of the search space; log10 by default.
    seeds
        Number of runs for each optimizer and scale, each with a different seed.
    validation
        Held-out drives: the search does not use them, and the tuned filters are also evaluated on them.
    workers
        Number of threads, by default one per core; with --cluster, number of simultaneous tuning runs.
    resume
        Continue an interrupted comparison. Except for the times, the result is the same as without the interruption.
    """

    optimizers: list[str] | None = None
    scales: list[Scale] | None = None
    seeds: int = SEEDS
    validation: list[str] | None = None
    workers: Count = None
    cluster: Annotated[Cluster, MORE] = None
    resume: bool = False
    json: Json = False


@options_of(TuneConfig.model_fields, shown=SHORT_HELP, omitted=EXCLUDED_OPTIONS, by_data=DEFERRED_OPTIONS)
def compare(
    drives: Places,
    /,
    *,
    out: Path,
    options: Annotated[CompareOptions, FIELDS] = CompareOptions(),
    **config: Any,
) -> None:
    """Compare optimizers with the same budget on the same drives.

    Each optimizer tunes the filter with several seeds. The command writes to OUT: comparison.md (a table with intervals
    and paired tests), comparison.csv, runs.csv, curves.csv, comparison.png, times.csv and all tuning runs. The
    intervals describe the spread between seeds on these drives, not the spread between drives.

    For example:

        sigmaswarm compare drives/training --validation drives/held-out --out compared
        sigmaswarm compare drives/training --optimizers pso de cma-es --scales log10 linear --out compared
        sigmaswarm compare drives/training --optimizers pso pso:polish=300 pso:racing=true --out compared

    Parameters
    ----------
    out
        Folder for the tables, the figure and all runs. It must not contain a comparison, except with --resume.
    """
    from sigmaswarm.drives.sensors import log_properties
    from sigmaswarm.reports.compare import comparison_table, save_comparison
    from sigmaswarm.tuning.defaults import default_filter_options

    require_result_folder(out, [], "comparison", "config.json")
    varied = {"optimizers": options.optimizers, "scales": options.scales}
    run: dict[str, Any] = {name: value for name, value in varied.items() if value}
    run |= {"seeds": options.seeds, "out": out, "resume": options.resume, "workers": options.workers}
    with cluster_at(options.cluster) as client:
        read, held_out = read_datasets(drives, options.validation or [], cluster=client)
        sensors = [*read.map(log_properties), *held_out.map(log_properties)]
        chosen = default_filter_options(config, sensors)[1]
        with progress_bar("comparing", "tuning runs, remaining") as show:
            comparison = sigmaswarm.compare(read, validation=held_out, progress=show, **run, **config)
    written = save_comparison(comparison, out)
    content = {"comparison": comparison.frame.to_dicts(), "written": [str(path) for path in written]}
    lines = [*([f"model: {chosen}"] if chosen else []), comparison_table(comparison).to_markdown()]
    print_result(options.json, content, *lines, *(f"wrote {path}" for path in written))
