"""`sigmaswarm study`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from sigmaswarm.cli.common import cluster_at, print_json, require_result_folder, say
from sigmaswarm.cli.options import AT_LEAST_0, FIELDS, Count
from sigmaswarm.cli.terminal import progress_bar

if TYPE_CHECKING:
    from sigmaswarm.experiments.study.config import StudyConfig
    from sigmaswarm.experiments.study.study import Study


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of `sigmaswarm study`; None stands for the value of the configuration.

    Attributes
    ----------
    out
        Folder for study.toml, results.json, scores.csv, tables, figures and the tunings of all trials.
    config
        A study.toml whose values the other options override; by default the paper's study.
    quick
        Run a small study: 50 drives and 3 trials, in about half a minute.
    drives
        Folders or URLs of your own drives with truth, instead of simulated ones.
    trials
        Number of repetitions, each with another split and swarm; 20 by default.
    runs
        Number of simulated drives of each maneuver in each environment; 20 by default.
    particles
        Size of the swarm; 30 by default.
    generations
        Generations of the swarm, including the initial one; 50 by default.
    seed
        Seed of drives, splits and swarms; 0 by default.
    per_condition
        Tune one filter for each condition instead of one filter for all.
    racing
        Evaluate worse candidates on few drives, which takes a fifth of the time; --no-racing: on all, as in the paper.
    rivals
        Also compare a fuzzy filter, Bayesian optimization and networks, and test with other sensors and another car.
    learn_minutes
        With --rivals: minutes of training data for each network; 20 by default.
    elsewhere
        With --rivals: drives with truth from other sensors or another car. Without --drives and --elsewhere
        they are simulated.
    workers
        Number of processes (Linux) or threads, one per core by default; with --cluster, of simultaneous tuning runs.
    cluster
        Dask cluster: tcp://host:8786, a scheduler file, or local:4 (four processes).
    resume
        Continue an interrupted study. The result is the same.
    json
        Print results.json.
    """

    out: Path
    config: Path | None = None
    quick: bool = False
    drives: list[str] | None = None
    trials: Count = None
    runs: Count = None
    particles: Count = None
    generations: Count = None
    seed: Annotated[int | None, AT_LEAST_0] = None
    per_condition: bool = False
    racing: Annotated[bool | None, Parameter(negative="--no-racing")] = None
    rivals: bool = False
    learn_minutes: Annotated[float | None, Parameter(validator=validators.Number(gte=2))] = None
    elsewhere: list[str] | None = None
    workers: Count = None
    cluster: str | None = None
    resume: bool = False
    json: bool = False


def study(*, options: Annotated[StudyOptions, FIELDS]) -> None:
    """Run the paper's experiment.

    Each trial tunes on a different 70% of the simulated drives and evaluates all methods on the other drives. The
    methods are:

    - IMU only and raw GPS;
    - three filters with manual parameters: EKF, adaptive UKF, UKF;
    - the paper's PSO-UKF;
    - three filters tuned with the same budget: EKF, adaptive UKF, planar8;
    - the default filter of `tune`.

    Filters are tuned under two protocols. "paper": cost against the GPS, linear search. "honest": cost against truth,
    logarithmic search. The tables also list the values in the paper. Racing is on by default with 96 training drives or
    more. The result does not depend on the number of workers.

    In each trial, --rivals also tunes a fuzzy UKF, tunes a UKF by Bayesian optimization (at most 100 evaluations), and
    trains outage-lstm and noise-gru for planar8. It adds the drift after 15, 30 and 60 s, drives with other sensors and
    another car, and learning curves. It needs `pip install 'sigmaswarm[learned,bo]'`.

    For example:

        sigmaswarm study --out study
        sigmaswarm study --out study --resume
        sigmaswarm study --out quick --quick
        sigmaswarm study --out whole --no-racing
        sigmaswarm study --out mine --drives drives --trials 10
        sigmaswarm study --out rivals --rivals --runs 4 --trials 5
    """
    from sigmaswarm.experiments.study.study import run_study
    from sigmaswarm.reports.folders import save_page
    from sigmaswarm.reports.study_charts import save_study

    require_result_folder(options.out, [], "study", "study.toml")
    out, config = options.out, _config(options)
    counted = "generations and epochs, remaining" if config.rivals else "generations, remaining"
    with cluster_at(options.cluster) as client, progress_bar("study", counted) as show:
        done = run_study(
            config,
            out,
            resume=options.resume,
            workers=options.workers,
            cluster=client,
            progress=lambda now: show(now.done, now.total),
        )
    save_study(done, out)
    page = save_page(out)
    if options.json:
        print_json(done.results.content())
    else:
        _print(done, out, page)


def _config(options: StudyOptions) -> "StudyConfig":
    """Return the configuration of the file, the resumed study or the paper, changed by the options."""
    from sigmaswarm.experiments.study.config import QUICK, read_config

    of_the_run = ("out", "config", "quick", "workers", "cluster", "resume", "json")
    changes = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in vars(options).items()
        if name not in of_the_run and value is not None and (value is not False or name == "racing")
    }
    started = options.out / "study.toml"
    file = options.config or (started if options.resume and started.exists() else None)
    return read_config(file, **(QUICK if options.quick else {}) | changes)


def _print(done: "Study", out: Path, page: Path) -> None:
    from sigmaswarm.experiments.study.config import BY_DEFAULT
    from sigmaswarm.experiments.study.design import tuning_name
    from sigmaswarm.reports.study_tables import UNPRINTED, objectives_compared, runtime_table, study_tables

    tables = [table for name, table in study_tables(done.results).items() if not name.startswith(UNPRINTED)]
    say(*(f"{t.to_markdown()}\n" for t in (*tables, runtime_table(done.results, done.record.live))))
    name = tuning_name("honest", BY_DEFAULT, done.design.group_of(0))
    say(
        f"{objectives_compared(done.results)}\n",
        f"results: {out / 'results.json'}, {out / 'scores.csv'}",
        f"tables:  {out / 'tables'}",
        f"figures: {out / 'figures'}",
        f"page:    {page}",
        f"next:    sigmaswarm evaluate {out / 'best' / name}.toml DRIVE...",
    )
