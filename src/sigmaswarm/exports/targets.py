"""Export of a filter to a target: check of the filter, texts of the files, and their folder."""

from collections.abc import Mapping
from pathlib import Path

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.mounting import Angles
from sigmaswarm.errors import InputError
from sigmaswarm.exports.c99 import c99, replay_rows
from sigmaswarm.exports.filterpy import filterpy
from sigmaswarm.exports.lanes import Lanes
from sigmaswarm.exports.names import DESCRIPTIONS, Target
from sigmaswarm.exports.robot_localization import robot_localization
from sigmaswarm.files import make_folder, staged_files, write_atomically
from sigmaswarm.filters.models import MODELS, require_driven_by_imu
from sigmaswarm.filters.parameters import FilterParameters, known_interval


def export_texts(
    parameters: FilterParameters,
    target: Target,
    *,
    replay: Drive | None = None,
    as_recorded: bool = False,
    mounting: Angles | None = None,
    imu_axes: Mapping[str, str] | None = None,
    lanes: int = 1,
    seed: int = 0,
) -> dict[str, str]:
    """Return the texts of an exported filter by file name.

    Parameters
    ----------
    parameters : FilterParameters
        Parameters with ``nominal_interval``, as in every tuning.
    target : {"filterpy", "c99", "robot_localization"}
    replay : Drive, optional
        c99: also write this drive as replay.csv, the input of the replay program.
    as_recorded : bool
        filterpy, c99: use stale fixes, and treat IMU gaps as ordinary steps.
    mounting : (float, float, float), optional
        c99, robot_localization: roll, pitch and yaw of the IMU in the vehicle (deg) for raw samples.
    imu_axes : dict of str to str, optional
        c99: expressions from which the import computed the IMU's axes, for the README.
    lanes, seed : int
        c99: number of filters of a bank (as in a `LiveFilterBank` without searches), and seed of their parameters.

    Raises
    ------
    InputError
        If the target is unknown or does not support the model, ``replay`` or ``lanes``; if the parameters do not
        contain the nominal interval; or if a variance of Q is negative or a variance of R is not positive.
    """
    interval = _checked(parameters, target)
    if target != "c99" and replay is not None:
        raise InputError(f"--replay needs --to c99: an export to {target} does not use replay.csv")
    if target != "c99" and lanes != 1:
        raise InputError(f"--lanes needs --to c99: {target} runs only one filter")
    match target:
        case "c99":
            texts = c99(
                parameters,
                interval,
                as_recorded=as_recorded,
                mounting=mounting,
                lanes=Lanes(lanes, seed),
                imu_axes=imu_axes,
            )
        case "filterpy":
            texts = filterpy(parameters, interval, as_recorded=as_recorded)
        case "robot_localization":
            texts = robot_localization(parameters, interval, mounting=mounting)
    if replay is not None:
        texts["replay.csv"] = replay_rows(
            replay, parameters.model, as_recorded=as_recorded, heading=parameters.heading_noise is not None
        )
    return texts


def _checked(parameters: FilterParameters, target: Target) -> float:
    """Check that a target supports a filter. Return the nominal IMU interval of Q, s."""
    if target not in DESCRIPTIONS:
        raise InputError(f"there is no export target {target!r}; choose one of {', '.join(DESCRIPTIONS)}")
    if MODELS[parameters.model].tilts and not DESCRIPTIONS[target].tilts:
        raise InputError(
            f"{target} does not support {parameters.model}; run the filter with `sigmaswarm run` or LiveFilter, "
            "or tune planar8"
        )
    used = {"fix-error": parameters.fix_error, "heading": parameters.heading_noise}
    absent = [option for option in DESCRIPTIONS[target].lacks if used[option] is not None]
    if absent:
        raise InputError(
            f"{target} does not support {absent[0]}; tune without {absent[0]} (--use lateral standstill robust), or "
            "run the filter with LiveFilter"
        )
    if target != "robot_localization":
        require_driven_by_imu(parameters.model, target)
    interval = known_interval(parameters)
    if min(parameters.process_noise) < 0 or min(parameters.measurement_noise) <= 0:
        raise InputError(
            "the filter would fail, since a variance of Q is negative or a variance of R is not positive; correct the "
            "variance in the file, or tune again"
        )
    return interval


def write_texts(texts: Mapping[str, str], folder: str | Path, target: Target) -> list[Path]:
    """Write the files of an export into a folder, which is created if missing.

    An earlier export to the same target is replaced, and the files that were built from it are removed.
    """
    folder = Path(folder)
    with staged_files(folder, f"export to {target}", built=DESCRIPTIONS[target].built) as new:
        for name, text in texts.items():
            make_folder((new / name).parent)
            write_atomically(new / name, text)
    return [folder / name for name in texts]
