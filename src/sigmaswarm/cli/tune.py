"""`sigmaswarm tune`."""

from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter, validators


def tune(
    drives: Annotated[list[Path], Parameter(name="DRIVE", consume_multiple=True, negative=())],
    /,
    *,
    out: Path,
    validation: Annotated[list[Path] | None, Parameter(consume_multiple=True, negative=())] = None,
    objective: str = "auto",
    worst: float = 1.0,
    scale: Literal["log10", "linear"] = "log10",
    particles: int = 30,
    generations: int = 50,
    trials: int = 1,
    seed: int = 0,
    model: Literal["planar5", "planar8"] = "planar5",
    kind: Literal["ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf"] = "ukf",
    use: Annotated[
        list[Literal["velocity", "lateral", "standstill", "gate", "latency"]] | None,
        Parameter(consume_multiple=True, negative=()),
    ] = None,
    optimizer: Literal["pso", "ga", "ga-pso", "de", "cma-es", "nelder-mead", "random", "sobol"] = "pso",
    polish: int = 0,
    inertia: float | None = None,
    zero_velocity_at_bounds: Annotated[bool, Parameter(negative=())] = False,
    patience: int | None = None,
    workers: Annotated[int | None, Parameter(validator=validators.Number(gte=1))] = None,
    resume: Annotated[bool, Parameter(negative=())] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Tune a filter on drives, and keep it in OUT/tuning.toml.

    Put the drives first, then the options. Truth is not needed: without truth.csv the filter is tuned to forecast
    the fixes. Keep some drives back, and see with `sigmaswarm evaluate` what the tuning is worth on them.

    Examples:

        sigmaswarm tune drives/monday drives/tuesday --out tuned
        sigmaswarm tune drives/training --out tuned --objective truth-pose --trials 5
        sigmaswarm tune drives/training --out tuned --validation drives/monday --objective innovation-nll
        sigmaswarm tune drives/training --out tuned --model planar8 --use lateral standstill gate
        sigmaswarm tune drives/training --out tuned --resume

    Parameters
    ----------
    drives
        Drive folders to tune on, or folders that hold drive folders.
    out
        Folder for tuning.toml, the convergence history and figures.
    validation
        Drives held back from the search, to see what the result is worth on others.
    objective
        truth-rmse: position error. truth-pose: position, heading and outage drift together.
        innovation-nll: how likely each fix is before it is absorbed; needs no truth, and makes the filter
        honest about its errors. outage-rmse: forecasts of hidden fixes; needs no truth. nis, nees: consistency,
        to be added to others. gps-rmse: the paper's, which rewards copying the GPS. Sums like
        "truth-pose + 0.2 nees" are objectives, too. auto: truth-rmse with truth, else innovation-nll.
    worst
        Share of the drives that counts, the worst ones; by default the mean over all.
    scale
        How variances are searched; linear is the paper's way.
    particles
        Size of the swarm.
    generations
        Moves of the swarm, the first placement included.
    trials
        Independent runs; the best one is kept, all are reported.
    seed
        Decides everything that is left to chance.
    model
        The filter's process model: planar5 is the paper's, planar8 also estimates the IMU's biases.
    kind
        Unscented, extended, adaptive (Sage-Husa) or strong tracking.
    use
        What the filter uses beside position fixes; its parameters are tuned with the rest. velocity: the
        receiver's speed and course. lateral: a car does not slide sideways. standstill: it stands still when
        it stands. gate: turn outlying fixes away. latency: fixes may be older than they say.
    optimizer
        pso: particle swarm. ga: genetic algorithm. ga-pso: both in turn. de: differential evolution. cma-es:
        covariance matrix adaptation. nelder-mead, random, sobol: to compare with.
    polish
        How many of the particles x generations evaluations a Nelder-Mead search from the best point may have.
    inertia
        The swarm's w; 0.7298 by default.
    zero_velocity_at_bounds
        Stop particles in the coordinates in which they hit the box.
    patience
        End a trial after that many generations without progress; by default never.
    workers
        Threads; all cores by default. The result does not depend on it.
    resume
        Go on with a tuning that was interrupted; the result is the same as without the interruption.
    json
        Print the result for machines.
    """
    from concurrent.futures import ThreadPoolExecutor

    import sigmaswarm
    from sigmaswarm.cli.common import print_json, read_drives, stdout, tuning_progress
    from sigmaswarm.report.figures import save_tuning_figures

    config: dict[str, Any] = {
        "objective": objective,
        "worst": worst,
        "scale": scale,
        "particles": particles,
        "generations": generations,
        "trials": trials,
        "seed": seed,
        "model": model,
        "kind": kind,
        "use": tuple(use or ()),
        "optimizer": optimizer,
        "polish": polish,
        "zero_velocity_at_bounds": zero_velocity_at_bounds,
        "patience": patience,
    }
    if inertia is not None:
        config["inertia"] = inertia
    read = read_drives(drives)
    held_back = read_drives(validation or [])
    with ThreadPoolExecutor(workers) as pool, tuning_progress("tuning") as progress:
        tuning = sigmaswarm.tune(
            read, validation=held_back, out=out, resume=resume, executor=pool, progress=progress, **config
        )
    pictures = save_tuning_figures(tuning, read, out)
    if json:
        print_json(tuning.to_dict())
        return
    console = stdout()
    console.print(f"cost {tuning.cost:.4f} ({tuning.config.objective}) on {len(read)} drive(s)")
    if tuning.validation:
        gap = tuning.validation.gap
        gap = f"errors {abs(gap):.1%} {'larger' if gap >= 0 else 'smaller'}" if isfinite(gap) else "failed"
        console.print(f"cost {tuning.validation.cost:.4f} on {len(held_back)} validation drive(s): {gap}")
    for remark in tuning.remarks:
        console.print(f"note: {remark}")
    console.print(f"filter:   {out / 'tuning.toml'}")
    console.print(f"pictures: {', '.join(str(p) for p in pictures)}")
    console.print(f"next:     sigmaswarm evaluate {out} HELD_OUT_DRIVE...")
