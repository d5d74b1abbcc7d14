"""`sigmaswarm study`."""

from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

from sigmaswarm.cli.common import cluster_at, print_json, require_result_folder
from sigmaswarm.cli.options import FIELDS, Cluster, Count, Json, options_of
from sigmaswarm.cli.terminal import print_lines, progress_bar
from sigmaswarm.experiments.study.config import QUICK_STUDY, StudyConfig, read_config

if TYPE_CHECKING:
    from sigmaswarm.experiments.study.study import Study


# Fields of the configuration that are not options.
EXCLUDED_OPTIONS = ("maneuvers", "environments", "imu", "gps", "vibration", "terrain", "train_fraction")


@dataclass(frozen=True)
class StudyOptions:
    """Options of `sigmaswarm study` that are not fields of its configuration.

    Attributes
    ----------
    config
        A study.toml; other options take precedence over its values. Default: the paper's study.
    quick
        Run a small study: 50 drives and 3 trials, in about two minutes.
    workers
        Number of processes (Linux) or threads, by default one per core; with --cluster, number of simultaneous
        tuning runs.
    resume
        Continue an interrupted study. The result is the same as without the interruption.
    """

    config: Path | None = None
    quick: bool = False
    workers: Count = None
    cluster: Cluster = None
    resume: bool = False
    json: Json = False


@options_of(StudyConfig.model_fields, omitted=EXCLUDED_OPTIONS, by_data=("racing",))
def study(*, out: Path, options: Annotated[StudyOptions, FIELDS] = StudyOptions(), **config: Any) -> None:
    """Run the paper's experiment.

    Each trial tunes on a random 70% of the drives and evaluates all methods on the other drives. The methods are:

    - IMU only, raw GPS, and a constant-velocity filter without an IMU;
    - EKF, adaptive UKF and UKF, each with two parameter sets: Q = R = I, and noise from data sheets;
    - the UKF with the paper's optimum, and the paper's PSO-UKF;
    - EKF, adaptive UKF and planar8, each tuned with the budget of the PSO-UKF;
    - the default filter of `tune`.

    PSO-UKF is tuned under two protocols. With the protocol "paper", the cost is the distance from the fixes, and
    variances are searched on a linear scale. With the protocol "honest", the cost is the error against truth, and
    variances are searched on a logarithmic scale. The other filters are tuned only with truth. The tables also list the
    values in the paper. Racing, which evaluates bad candidates on fewer drives, is on by default with 96 training
    drives or more. The result does not depend on the number of workers.

    In each trial, --rivals also tunes a fuzzy UKF, tunes a UKF by Bayesian optimization (at most 100 evaluations), and
    trains outage-lstm and noise-gru for planar8. The option adds the drifts over outages of 15, 30 and 60 s, scores on
    drives with other sensors and with another car, and learning curves. It needs `pip install
    'sigmaswarm[learned,bo]'`.

    For example:

        sigmaswarm study --out study
        sigmaswarm study --out study --resume
        sigmaswarm study --out quick --quick
        sigmaswarm study --out whole --no-racing
        sigmaswarm study --out mine --drives drives --trials 10
        sigmaswarm study --out rivals --rivals --runs 4 --trials 5

    Parameters
    ----------
    out
        Folder for scores, tables, figures and tuning runs of all trials. It must not contain a study, except with
        --resume.
    """
    from sigmaswarm.experiments.study.study import run_study
    from sigmaswarm.reports.read import save_page
    from sigmaswarm.reports.study_charts import save_study

    require_result_folder(out, [], "study", "study.toml")
    started = out / "study.toml"
    file = options.config or (started if options.resume and started.exists() else None)
    design = read_config(file, **(QUICK_STUDY if options.quick else {}) | config)
    counted = "generations and epochs, remaining" if design.rivals else "generations, remaining"
    with cluster_at(options.cluster) as client, progress_bar("study", counted) as show:
        settings: dict[str, Any] = {"resume": options.resume, "workers": options.workers, "cluster": client}
        done = run_study(design, out, progress=lambda now: show(now.done, now.total), **settings)
    save_study(done, out)
    page = save_page(out)
    if options.json:
        print_json(done.results.content())
    else:
        _print(done, out, page)


def _print(done: "Study", out: Path, page: Path) -> None:
    from sigmaswarm.experiments.study.config import DEFAULT_METHOD
    from sigmaswarm.experiments.study.design import tuning_name
    from sigmaswarm.reports.study_tables import (
        FILE_ONLY_TABLES,
        objectives_compared,
        runtime_table,
        study_tables,
    )

    tables = [
        table for name, table in study_tables(done.results).items() if not name.startswith(FILE_ONLY_TABLES)
    ]
    print_lines(*(f"{t.to_markdown()}\n" for t in (*tables, runtime_table(done.results, done.record.live))))
    name = tuning_name("honest", DEFAULT_METHOD, done.design.group_of(0))
    print_lines(
        f"{objectives_compared(done.results)}\n",
        f"results: {out / 'results.json'}, {out / 'scores.csv'}",
        f"tables:  {out / 'tables'}",
        f"figures: {out / 'figures'}",
        f"page:    {page}",
        *_next_steps(own_drives=bool(done.design.config.drives), best=out / "best" / f"{name}.toml"),
    )


def _next_steps(*, own_drives: bool, best: Path) -> list[str]:
    """Suggest the next commands; filters that were tuned on simulated sensors do not suit other sensors."""
    if own_drives:
        return [f"next:    sigmaswarm evaluate {quote(str(best))} DRIVE..."]
    return [
        "next:    sigmaswarm import LOG --show    (a log of your own; these filters were tuned for simulated sensors)",
        "or:      sigmaswarm simulate --out drives",
    ]
