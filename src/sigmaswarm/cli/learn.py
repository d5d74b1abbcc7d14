"""`sigmaswarm learn`."""

from pathlib import Path
from shlex import quote
from typing import Annotated

from cyclopts import Parameter, validators

from sigmaswarm.filters.names import NetworkName


def learn(
    network: Annotated[NetworkName, Parameter(name="NETWORK")],
    tuning: Annotated[Path, Parameter(name="TUNING")],
    drives: Annotated[list[str], Parameter(name="DRIVE", consume_multiple=1, negative=())],
    /,
    *,
    out: Path,
    validation: Annotated[list[str] | None, Parameter(consume_multiple=1, negative=())] = None,
    search: Annotated[int, Parameter(validator=validators.Number(gte=0))] = 0,
    seed: Annotated[int, Parameter(validator=validators.Number(gte=0))] = 0,
    resume: Annotated[bool, Parameter(negative=())] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Train a network that helps a tuned filter.

    outage-lstm forecasts displacements during outages. noise-gru scales Q and R by the latest innovations, and is
    trained through planar5 and planar8. OUT includes the filter: `sigmaswarm run` and `evaluate` read it as a tuning.
    Training needs the extra `learned`; a trained network does not. By default the last quarter of each drive is held
    out; outage-lstm holds out the last third of three drives or more.

    Examples:

        sigmaswarm learn outage-lstm tuned drives/training --out learned
        sigmaswarm learn outage-lstm tuned drives/training --out learned --validation drives/monday --search 8
        sigmaswarm learn noise-gru tuned drives/training --out learned --seed 1
        sigmaswarm learn noise-gru tuned drives/training --out learned --resume

    Parameters
    ----------
    network
        outage-lstm or noise-gru.
    tuning
        A tuning.toml, or its folder.
    drives
        Drive folders to learn from, or folders of drive folders.
    out
        Folder for learned.toml, weights.npz and the filter.
    validation
        Held-out drives for early stopping and calibration; by default a part of the drives.
    search
        Number of further settings (units, window, learning rate) to try.
    seed
        Same seed, same result.
    resume
        Continue an interrupted training; the result is the same as without interruption.
    json
        Print learned.toml as JSON.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import print_json, read_drives, stdout
    from sigmaswarm.cli.progress import progress_bar
    from sigmaswarm.learned.learn import LearnConfig
    from sigmaswarm.learned.learn import learn as train
    from sigmaswarm.tuning.record import FILE

    parameters = sigmaswarm.FilterParameters.load(tuning)
    read, held_back = read_drives(drives), read_drives(validation or [])
    waiting = "getting ready (smoothing the drives)"
    with progress_bar(
        "learning", "epochs at most, loss {task.fields[loss]}, remaining", waiting, loss="-"
    ) as show:
        learned = train(
            LearnConfig(network, parameters, read, held_back, search, seed),
            out,
            tuning=tuning / FILE if tuning.is_dir() else tuning,
            resume=resume,
            progress=lambda now: show(now.done, now.total, loss=f"{now.loss:.3f}"),
        )
    record = learned.record
    if json:
        print_json(record.model_dump(mode="json"))
        return
    console, net, training = stdout(), record.network, record.training
    console.print(
        f"{record.kind}: {net.numbers} numbers, {net.units} units, window {net.window:.3g} s, learned from "
        f"{training.driven_s / 60:.1f} minutes of driving in {training.epochs} epochs"
    )
    console.print(f"loss on {training.held_back}: {training.loss:.4f}, untrained {training.loss_before:.4f}")
    if record.kind == "outage-lstm":
        console.print(
            f"calibration: factor {net.inflation:.3g} of its variances"
            if net.inflation
            else "note: hidden fixes are most likely without the network, so the filter does not use its forecasts"
        )
    console.print(f"learned:  {out / 'learned.toml'}, {out / 'weights.npz'}")
    console.print(f"next:     sigmaswarm evaluate {quote(str(out))} HELD_OUT_DRIVE...")
