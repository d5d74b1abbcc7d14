"""`sigmaswarm tune`."""

from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter, validators


def default(value: str) -> Parameter:
    """What the help says of an option that is left out: `--paper` must know which ones were given."""
    return Parameter(show_default=lambda _: value)


def tune(
    drives: Annotated[list[Path], Parameter(name="DRIVE", consume_multiple=1, negative=())],
    /,
    *,
    out: Path,
    validation: Annotated[list[Path] | None, Parameter(consume_multiple=1, negative=())] = None,
    objective: Annotated[str | None, default("auto")] = None,
    worst: Annotated[float | None, default("1.0")] = None,
    scale: Annotated[Literal["log10", "linear"] | None, default("log10")] = None,
    particles: Annotated[int | None, default("30")] = None,
    generations: Annotated[int | None, default("50")] = None,
    trials: int = 1,
    seed: int = 0,
    model: Annotated[Literal["planar5", "planar8"] | None, default("planar5")] = None,
    kind: Annotated[
        Literal["ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf"] | None, default("ukf")
    ] = None,
    use: Annotated[
        list[Literal["velocity", "lateral", "standstill", "gate", "latency"]] | None,
        Parameter(consume_multiple=1, negative=()),
    ] = None,
    optimizer: Annotated[
        Literal["pso", "ga", "ga-pso", "de", "cma-es", "nelder-mead", "random", "sobol"] | None,
        default("de"),
    ] = None,
    polish: Annotated[int | None, default("0")] = None,
    racing: Annotated[bool, Parameter(negative=())] = False,
    paper: Annotated[bool, Parameter(negative=())] = False,
    inertia: float | None = None,
    zero_velocity_at_bounds: Annotated[bool, Parameter(negative=())] = False,
    patience: int | None = None,
    workers: Annotated[int | None, Parameter(validator=validators.Number(gte=1))] = None,
    resume: Annotated[bool, Parameter(negative=())] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Tune a filter on drives, and keep it in OUT/tuning.toml.

    Put the drives first, then the options. Truth is not needed: without truth.csv the filter is tuned to forecast
    the fixes, which tells planar5's position but hardly its heading: planar8 with lateral tells both. Keep some
    drives back, and see with `sigmaswarm evaluate` what the tuning is worth on them.

    Examples:

        sigmaswarm tune drives/monday drives/tuesday --out tuned
        sigmaswarm tune drives/training --out tuned --model planar8 --use lateral standstill gate
        sigmaswarm tune drives/training --out tuned --objective truth-pose --trials 5
        sigmaswarm tune drives/training --out tuned --validation drives/monday --objective innovation-nll
        sigmaswarm tune drives/training --out tuned --racing
        sigmaswarm tune drives/training --out tuned --paper
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
    racing
        Try each generation on one drive first, its better half on two, and so on: fewer filter steps, with a part of
        the drives deciding who goes on. With one drive it changes nothing.
    paper
        The paper's setting: pso, 30 x 50, linear, gps-rmse, planar5, ukf. Options that contradict it are refused.
    inertia
        The w of pso; 0.7298 by default.
    zero_velocity_at_bounds
        pso: stop particles in the coordinates in which they hit the box.
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
    from sigmaswarm.scoring.tracks import compared, picture_of

    asked = {
        "objective": objective,
        "worst": worst,
        "scale": scale,
        "particles": particles,
        "generations": generations,
        "trials": trials,
        "seed": seed,
        "model": model,
        "kind": kind,
        "use": tuple(use) if use else None,
        "optimizer": optimizer,
        "polish": polish,
        "racing": racing or None,
        "inertia": inertia,
        "zero_velocity_at_bounds": zero_velocity_at_bounds or None,
        "patience": patience,
    }
    config: dict[str, Any] = {name: value for name, value in asked.items() if value is not None}
    read = read_drives(drives)
    held_back = read_drives(validation or [])
    with ThreadPoolExecutor(workers) as pool, tuning_progress("tuning") as progress:
        tuning = sigmaswarm.tune(
            read,
            validation=held_back,
            out=out,
            resume=resume,
            paper=paper,
            executor=pool,
            progress=progress,
            **config,
        )
    filters = compared(read[0], tuning.parameters)
    pictures = save_tuning_figures(tuning, picture_of(read[0], filters, read[0].name), out)
    if json:
        print_json(tuning.to_dict())
        return
    console = stdout()
    console.print(f"cost {tuning.cost:.4f} ({tuning.config.objective}) on {len(read)} drive(s)")
    if racing:
        share = tuning.steps / tuning.full_steps
        console.print(f"racing: {tuning.steps} filter steps, {share:.0%} of those without it")
    if tuning.validation:
        gap = tuning.validation.gap
        gap = f"errors {abs(gap):.1%} {'larger' if gap >= 0 else 'smaller'}" if isfinite(gap) else "failed"
        console.print(f"cost {tuning.validation.cost:.4f} on {len(held_back)} validation drive(s): {gap}")
    for remark in tuning.remarks:
        console.print(f"note: {remark}")
    console.print(f"filter:   {out / 'tuning.toml'}")
    console.print(f"pictures: {', '.join(str(p) for p in pictures)}")
    console.print(f"next:     sigmaswarm evaluate {out} HELD_OUT_DRIVE...")
