"""`sigmaswarm study`."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter, validators

_Flag = Annotated[bool, Parameter(negative=())]
_Count = Annotated[int | None, Parameter(validator=validators.Number(gte=1))]


def study(
    *,
    out: Path,
    config: Path | None = None,
    quick: _Flag = False,
    drives: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    trials: _Count = None,
    runs: _Count = None,
    particles: _Count = None,
    generations: _Count = None,
    seed: Annotated[int | None, Parameter(validator=validators.Number(gte=0))] = None,
    per_condition: _Flag = False,
    racing: Annotated[bool | None, Parameter(negative="--no-racing")] = None,
    rivals: _Flag = False,
    learn_minutes: Annotated[float | None, Parameter(validator=validators.Number(gte=2))] = None,
    elsewhere: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    workers: _Count = None,
    cluster: str | None = None,
    resume: _Flag = False,
    json: _Flag = False,
) -> None:
    """Run the paper's experiment.

    Each trial tunes on another 70% of the simulated drives and scores all methods on the rest: IMU only, raw GPS,
    manual EKF, adaptive UKF and UKF, PSO-UKF as in the paper, EKF, adaptive UKF and planar8 tuned with the same
    budget, and the default filter of `tune`. There are two protocols. paper: cost against the GPS, linear search.
    honest: cost against truth, logarithmic search.

    Racing is the default with 96 training drives or more. --rivals tunes a fuzzy UKF, and a UKF by Bayesian
    optimization (at most 100 evaluations), and trains outage-lstm and noise-gru for planar8 in each trial. It adds
    drift over 15, 30 and 60 s, data and times, drives of another sensor grade and another car, and learning curves.
    It needs pip install 'sigmaswarm[learned,bo]'.

    The tables stand next to the paper's. A killed study continues with --resume and ends in the same bytes, which do
    not depend on the number of workers.

    Examples:

        sigmaswarm study --out study
        sigmaswarm study --out study --resume
        sigmaswarm study --out quick --quick
        sigmaswarm study --out whole --no-racing
        sigmaswarm study --out mine --drives drives --trials 10
        sigmaswarm study --out rivals --rivals --runs 4 --trials 5

    Parameters
    ----------
    out
        Folder for study.toml, results.json, scores.csv, tables, figures and the tunings of all trials.
    config
        A study.toml to start from; the paper's study by default.
    quick
        Run the study in small: 50 drives and 3 trials, in about half a minute.
    drives
        Folders or URLs of your own drives with truth, instead of simulated ones.
    trials
        Number of repetitions, each with its own split and swarm; 20 by default.
    runs
        Simulated drives of each maneuver in each environment; 20 by default.
    particles
        Size of the swarm; 30 by default.
    generations
        Moves of the swarm, including the first placement; 50 by default.
    seed
        Seed of drives, splits and swarms.
    per_condition
        Tune one filter for each condition instead of one for all.
    racing
        Drop the worse candidates after a few drives: a fifth of the time. --no-racing as in the paper.
    rivals
        Compare with fuzzy rules, Bayesian optimization and two networks, also on other sensors and another car.
    learn_minutes
        With --rivals: minutes of training data for a network; 20 by default.
    elsewhere
        With --rivals: drives with truth from other sensors or another car. Simulated without --drives.
    workers
        Processes on Linux, else threads; all cores by default. With --cluster, tunings at a time.
    cluster
        Dask cluster: tcp://host:8786, a scheduler file, or local:4 for four processes of this machine.
    resume
        Continue an interrupted study.
    json
        Print results.json.
    """
    from sigmaswarm.cli.common import cluster_at, print_json, stdout
    from sigmaswarm.cli.progress import progress_bar
    from sigmaswarm.experiments.study.config import BY_DEFAULT, QUICK, read_config
    from sigmaswarm.experiments.study.study import run_study
    from sigmaswarm.reports.folders import save_page
    from sigmaswarm.reports.study import save_study, study_tables
    from sigmaswarm.reports.study_tables import objectives_compared, runtime_table

    named: dict[str, Any] = {
        "drives": None if drives is None else tuple(drives),
        "trials": trials,
        "runs": runs,
        "particles": particles,
        "generations": generations,
        "seed": seed,
        "per_condition": per_condition or None,
        "racing": racing,
        "rivals": rivals or None,
        "learn_minutes": learn_minutes,
        "elsewhere": None if elsewhere is None else tuple(elsewhere),
    }
    changes = {name: value for name, value in named.items() if value is not None}
    started = out / "study.toml"
    study_config = read_config(
        config or (started if resume and started.exists() else None), **(QUICK if quick else {}) | changes
    )
    counted = "generations and epochs, remaining" if study_config.rivals else "generations, remaining"
    with cluster_at(cluster) as client, progress_bar("study", counted) as show:
        done = run_study(
            study_config,
            out,
            resume=resume,
            workers=workers,
            cluster=client,
            progress=lambda now: show(now.done, now.total),
        )
    save_study(done, out)
    page = save_page(out)
    if json:
        print_json(done.results.content())
        return
    console = stdout()
    tables = study_tables(done.results)
    shown = ("table-", "optimum", "rivals", "elsewhere-", "learning-")
    for table in [
        *(table for name, table in tables.items() if name.startswith(shown)),
        runtime_table(done.results, done.record.live),
    ]:
        console.print(table.to_markdown() + "\n")
    console.print(objectives_compared(done.results) + "\n")
    name, _ = done.best_of("honest", BY_DEFAULT, 0)
    console.print(f"results: {out / 'results.json'}, {out / 'scores.csv'}")
    console.print(f"tables:  {out / 'tables'}")
    console.print(f"figures: {out / 'figures'}")
    console.print(f"page:    {page}")
    console.print(f"next:    sigmaswarm evaluate {out / 'best' / name}.toml DRIVE...")
