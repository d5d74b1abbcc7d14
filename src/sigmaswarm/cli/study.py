"""`sigmaswarm study`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, validators

if TYPE_CHECKING:
    from sigmaswarm.experiments.study.study import Study

_Flag = Annotated[bool, Parameter(negative=())]
_Count = Annotated[int | None, Parameter(validator=validators.Number(gte=1))]


def study(
    *,
    out: Path,
    config: Path | None = None,
    drives: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    trials: _Count = None,
    runs: _Count = None,
    particles: _Count = None,
    generations: _Count = None,
    seed: Annotated[int | None, Parameter(validator=validators.Number(gte=0))] = None,
    per_condition: _Flag = False,
    racing: bool | None = None,
    rivals: _Flag = False,
    learn_minutes: Annotated[float | None, Parameter(validator=validators.Number(gte=2))] = None,
    elsewhere: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    workers: _Count = None,
    cluster: str | None = None,
    resume: _Flag = False,
    json: _Flag = False,
) -> None:
    """Run the paper's whole experiment, and put its tables beside the paper's.

    Simulates the drives, tunes in every trial on another 70% of them, and scores all methods on the rest: IMU only,
    raw GPS, EKF, adaptive UKF and UKF by hand, PSO-UKF as in the paper, with the same budget tuned EKF, adaptive UKF
    and planar8, and what `tune` takes by itself. Two protocols stand side by side. paper: scored against the GPS,
    linear search. honest: scored against truth, logarithmic search.

    Killed at any moment, it goes on with --resume and ends in the same bytes.

    Examples:

        sigmaswarm study --out study
        sigmaswarm study --out study --resume
        sigmaswarm study --out quick --runs 4 --trials 5 --particles 16 --generations 20
        sigmaswarm study --out whole --no-racing
        sigmaswarm study --out mine --drives drives --trials 10
        sigmaswarm study --out rivals --rivals --runs 4 --trials 5

    Parameters
    ----------
    out
        Folder for study.toml, results.json, scores.csv, tables, figures, what `sigmaswarm report` makes a page of,
        and the tunings of all trials.
    config
        A study.toml to start from; the paper's study by default.
    drives
        Your own drive folders, with truth, instead of simulated drives; or URLs of such.
    trials
        Repetitions, each with its own split and swarm; 20 by default.
    runs
        Simulated drives of each maneuver in each environment; 20 by default.
    particles
        Size of the swarm; 30 by default.
    generations
        Moves of the swarm, the first placement included; 50 by default.
    seed
        Decides drives, splits and swarms.
    per_condition
        Tune each condition by itself instead of one filter for all.
    racing
        Drop the worse candidates of a generation after a few drives. By default where each tuning has 96 training
        drives or more, where it takes a fifth of the time; --no-racing tries all on all, as the paper does.
    rivals
        Beside all others tune a UKF whose noises fuzzy rules scale, and a UKF by Bayesian optimization, of at most 100
        evaluations; and train two networks, outage-lstm and noise-gru, beside planar8 in each trial. Drift over 15, 30
        and 60 s, what everything takes, drives of another sensor grade and another car, and learning curves are told,
        too. Needs JAX, Optax and scikit-learn: pip install 'sigmaswarm[learned,bo]'.
    learn_minutes
        Of driving that a network learns from, drawn from the trial's training drives; 20 by default. With --rivals.
    elsewhere
        With --rivals, drives with truth, of other sensors or another car than those of --drives; without --drives they
        are simulated by default.
    workers
        Processes, or threads where none can be forked; all cores by default. With --cluster, tunings side by side. The
        result does not depend on it.
    cluster
        A Dask cluster whose workers make or read the drives, hold them and do the work: tcp://host:8786, a scheduler
        file, or local:4 for so many processes of this machine. Nor does the result depend on it.
    resume
        Go on with a study that was interrupted; what is finished is not done again.
    json
        Print results.json.
    """
    from sigmaswarm.cli.common import cluster_at, print_json, progress_bar, stdout
    from sigmaswarm.experiments.study.config import read_config
    from sigmaswarm.experiments.study.study import run_study
    from sigmaswarm.reports.study import save_study, study_tables

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
    asked = read_config(config or (started if resume and started.exists() else None), **changes)
    counted = "generations and epochs, remaining" if asked.rivals else "generations, remaining"
    with cluster_at(cluster) as client, progress_bar("study", counted) as show:
        done = run_study(
            asked,
            out,
            resume=resume,
            workers=workers,
            cluster=client,
            progress=lambda told: show(told.done, told.total),
        )
    save_study(done, out)
    if json:
        print_json(done.results.content())
        return
    console = stdout()
    for name, table in study_tables(done.results).items():
        if name.startswith(("table-", "rivals", "elsewhere-", "learning-")):
            console.print(table.to_markdown() + "\n")
    _say_where(done, out)


def _say_where(done: "Study", out: Path) -> None:
    from sigmaswarm.cli.common import stdout

    console, (name, _) = stdout(), done.best_of("honest", "pso-ukf", 0)
    console.print(f"results: {out / 'results.json'}, {out / 'scores.csv'}")
    console.print(f"tables:  {out / 'tables'}")
    console.print(f"figures: {out / 'figures'}")
    console.print(f"page:    sigmaswarm report {out}")
    console.print(f"next:    sigmaswarm evaluate {out / 'best' / name}.toml DRIVE...")
