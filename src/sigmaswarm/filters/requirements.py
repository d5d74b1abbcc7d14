"""The measurements of a filter, and checks that a drive has the data that the filter requires."""

from collections.abc import Collection
from dataclasses import fields

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import MODELS, NOISE_OF
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters


def measured_by(p: FilterParameters) -> frozenset[str]:
    """Return the names in `MEASURED` of a parameter set's measurements, and "ay" if ay has its own noise."""
    used = {name for name, noise in NOISE_OF.items() if getattr(p, noise) is not None}
    return frozenset(used | ({"ay"} if len(p.imu_noise) > 2 else set()))


def require_odometer(drive: Drive) -> None:
    if drive.odometer is None:
        raise InputError(
            f"{drive.name}: the filter uses the wheel speed (odometer_noise), but the drive has no odometer.csv; "
            "use a filter that was tuned without an odometer"
        )


def require_accuracy(line: Timeline) -> None:
    if not line.states_accuracy:
        raise InputError(
            f"{line.drive.name}: the filter weights each fix by the accuracy that the receiver states "
            "(accuracy_scale), but gps.csv does not contain std_x and std_y for all fixes; use a filter that "
            "was tuned without the option accuracy"
        )


def require_axes(drive: Drive, model: ModelName) -> None:
    require_named_axes(
        drive.name, [f.name for f in fields(drive.imu) if getattr(drive.imu, f.name) is not None], model
    )


def require_named_axes(name: str, axes: Collection[str], model: ModelName) -> None:
    lacking = [axis for axis in MODELS[model].imu if axis not in axes]
    if lacking:
        raise InputError(
            f"{name}: imu.csv has no {', '.join(lacking)}, which {model} needs; "
            "use planar8, which needs only ax, ay and gz"
        )
