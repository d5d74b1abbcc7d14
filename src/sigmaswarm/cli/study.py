"""`sigmaswarm study`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from sigmaswarm.cli.common import cluster_at, print_json, say
from sigmaswarm.cli.options import AT_LEAST_0, FIELDS, Count
from sigmaswarm.cli.terminal import progress_bar

if TYPE_CHECKING:
    from sigmaswarm.experiments.study.config import StudyConfig
    from sigmaswarm.experiments.study.study import Study


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of `sigmaswarm study`; for None the configuration's value is used.

    Attributes
    ----------
    out
        Folder for study.toml, results.json, scores.csv, tables, figures and the tunings of all trials.
    config
        A study.toml to start from; the paper's study by default.
    quick
        Run a small study: 50 drives and 3 trials, in about half a minute.
    drives
        Folders or URLs of your own drives with truth, instead of simulated ones.
    trials
        Number of repetitions, each with its own split and swarm; 20 by default.
    runs
        Simulated drives of each maneuver in each environment; 20 by default.
    particles
        Size of the swarm; 30 by default.
    generations
        Generations of the swarm, including the initial one; 50 by default.
    seed
        Seed of drives, splits and swarms.
    per_condition
        Tune one filter for each condition instead of one for all.
    racing
        Evaluate the worse candidates on a few drives only, in a fifth of the time. --no-racing: as in the paper.
    rivals
        Compare with fuzzy rules, Bayesian optimization and two networks, also on other sensors and another car.
    learn_minutes
        With --rivals: minutes of training data for a network; 20 by default.
    elsewhere
        With --rivals: drives with truth from other sensors or another car; without --drives such drives are simulated.
    workers
        Number of processes (on Linux) or threads; all cores by default. With --cluster, number of simultaneous tunings.
    cluster
        Dask cluster: tcp://host:8786, a scheduler file, or local:4 for four processes of this machine.
    resume
        Continue an interrupted study.
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

    Each trial tunes on a different 70% of the simulated drives and scores all methods on the others. The methods are
    IMU only, raw GPS, three filters with manual parameters (EKF, adaptive UKF, UKF), the paper's PSO-UKF, three filters
    tuned with the same budget (EKF, adaptive UKF, planar8) and the default filter of `tune`. Filters are tuned under
    two protocols. paper: cost against the GPS, linear search. honest: cost against truth, logarithmic search.

    Racing is the default with 96 training drives or more. In each trial, --rivals tunes a fuzzy UKF, tunes a UKF by
    Bayesian optimization (at most 100 evaluations), and trains outage-lstm and noise-gru for planar8. The option adds
    drift over 15, 30 and 60 s, drives of another sensor grade and another car, and learning curves. The option needs
    pip install 'sigmaswarm[learned,bo]'.

    The tables also list the paper's values. A killed study continues with --resume; the result is the same for any
    number of workers.

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
    """Change the configuration of a file, of the study that is resumed, or of the paper by the options given."""
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
    from sigmaswarm.reports.study_tables import objectives_compared, runtime_table, study_tables

    shown = ("table-", "optimum", "rivals", "elsewhere-", "learning-")
    tables = [table for name, table in study_tables(done.results).items() if name.startswith(shown)]
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
