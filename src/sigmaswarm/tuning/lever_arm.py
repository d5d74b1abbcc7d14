"""Estimate the antenna's lever arm by maximum likelihood from the innovations of a filter.

An innovation nu with covariance S = L L^T is almost linear in the lever arm and the other unknowns. Weighted least
squares on L^-1 nu is therefore a Gauss-Newton step on the likelihood of the fixes (N. K. Gupta, R. K. Mehra, IEEE
Trans. Automatic Control 19, 1974). The derivatives are finite differences between runs of the filter.
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive, as_list
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.sensors import log_properties
from sigmaswarm.drives.suggestion import suggest_filter
from sigmaswarm.errors import InputError
from sigmaswarm.filters.filter_run import FilterRun, Innovations
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets
from sigmaswarm.filters.presets import HALF_A_WHEELBASE, baseline_of
from sigmaswarm.scoring.batch import cores
from sigmaswarm.tuning.config import TuneConfig, validated_config
from sigmaswarm.tuning.defaults import complete_config
from sigmaswarm.tuning.problem import car_problem
from sigmaswarm.tuning.search import TrialRunner

ARM = ("forward", "left")
UNKNOWN_STD, STATED_STD = 2.0, 1.0
"""Prior standard deviations (m): if drive.toml has no lever arm, and if it has one without a standard deviation."""
SCALES = ("scale_ax", "scale_ay", "scale_gz")
ROLLING = 0.1
"""Prior standard deviation of a planar filter's accelerometer scale errors, which include effects of roll and pitch."""
PRIOR_STD = dict.fromkeys(SCALES, 0.03) | {"latency": 0.02, "rear_axle": 1.0, "tire_slip": 0.01}
"""Prior standard deviations of scale errors (no unit), latency (s), rear axle (m) and tire slip (s2/m)."""
STEP = {"forward": 0.1, "left": 0.1, "latency": 0.01, "rear_axle": 0.1, "tire_slip": 1e-3} | dict.fromkeys(
    SCALES, 0.005
)
"""Steps of finite differences: lever arm in m, other unknowns in the units of `PRIOR_STD`."""
DOF = 8.0  # degrees of freedom of Student's t, which reduces the weight of outliers
BLOCK_LENGTH = 20.0  # s, length of a block; fix errors may be correlated within a block
STD_FACTOR = 1.2
"""Factor by which the standard deviations are enlarged, because the noise is fitted to the same fixes, and tire slip is
not exactly linear.

Without this factor, 93% of the errors on 65 simulated drives were within 1.96 standard deviations.
"""
MAX_ROUNDS, STEP_TOLERANCE = 8, 0.005
"""Largest number of Gauss-Newton steps, and the step of the lever arm (m) below which the iteration ends."""
NOISE_SEARCH: dict[str, Any] = {"particles": 32, "generations": 50, "inflation": 0.0, "prior": 0.0}
"""Options for tuning the noise.

Without tuning, the standard deviations of the lever arm are two to six times as large.
"""
Values = dict[str, float]
Whitened = tuple[Array, Array, Array, Array]
"""Arrays of a drive: times (f,), s; L^-1 nu (f, 2); negative derivatives of L^-1 nu (f, 2, k); robust weights (f,)."""


@dataclass(frozen=True)
class LeverArmEstimate:
    """The lever arm of the antenna, estimated from drives.

    Attributes
    ----------
    forward, left : float
        Position of the antenna relative to the IMU, m.
    std : (float, float)
        Standard deviations of forward and left, m.
    stated : (float, float)
        Lever arm in drive.toml, m; zeros if drive.toml contains none.
    within : float
        Required accuracy, m. An axis is observable if 1.96 standard deviations are at most this value.
    """

    forward: float
    left: float
    std: tuple[float, float]
    stated: tuple[float, float]
    within: float

    @property
    def observable(self) -> tuple[bool, bool]:
        """Observability of forward and left.

        True if the axis can be estimated from the turns with the accuracy ``within``.
        """
        forward, left = (1.96 * std <= self.within for std in self.std)
        return forward, left

    def __str__(self) -> str:
        estimated, stated = _placed(self.forward, self.left), _placed(*self.stated)
        axes = [f"{axis} (std {std:.2f} m)" for axis, std in zip(estimated, self.std, strict=True)]
        known = [axis for axis, observable in zip(axes, self.observable, strict=True) if observable]
        unknown = [axis for axis in axes if axis not in known]
        remarks = [f"antenna {' and '.join(known)} of the IMU"] if known else []
        if known and any(self.stated):
            remarks.append(f"drive.toml states {' and '.join(stated)}")
        if unknown:
            times = (1.96 * max(self.std) / self.within) ** 2
            remarks.append(
                f"{' and '.join(unknown)}: the 95% error exceeds {self.within:g} m; for this accuracy the log needs "
                f"{times:.1f} times as many turns"
                + ("; the value in drive.toml is kept" if any(self.stated) else "")
            )
        return "; ".join(remarks)

    def to_dict(self) -> dict[str, Any]:
        """Return the attributes as JSON types."""
        pairs = {name: list(getattr(self, name)) for name in ("std", "stated", "observable")}
        return vars(self) | pairs

    def applied(self, drive: Drive) -> Drive:
        """Return a copy of a drive with the observable axes in ``gps_lever_arm_m``.

        Other axes keep the stated value.
        """
        if not any(self.observable):
            return drive
        repaired = [*drive.metadata.get("repaired", []), "lever-arm"]
        axes = zip((self.forward, self.left), drive.lever_arm, self.observable, strict=True)
        arm = tuple(round(value, 4) if known else float(stated) for value, stated, known in axes)
        stds = zip(self.std, _stated_std(drive), self.observable, strict=True)
        std = [round(float(s if known else p), 4) for s, p, known in stds]
        return _with_arm(drive, arm, repaired=repaired, gps_lever_arm_std_m=std)


def estimate_lever_arm(
    drives: Sequence[Drive] | Drive, parameters: FilterParameters | None = None, *, within: float = 0.15
) -> LeverArmEstimate:
    """Estimate the antenna's lever arm, forward and left, from drives of one vehicle.

    The prior has the mean ``gps_lever_arm_m`` and the standard deviation ``gps_lever_arm_std_m`` of drive.toml. Without
    a stated lever arm, the mean is 0 and the default standard deviation is 2 m; otherwise this default is 1 m. A delay
    of the fixes has a similar effect as ``forward``, so the delay has a prior standard deviation of 0.02 s.

    Parameters
    ----------
    drives : Drive or sequence of Drive
        Drives of one vehicle; their truth is not used.
    parameters : FilterParameters, optional
        The filter that computes the innovations. Default: the default filter for the logs, tuned by likelihood.
    within : float
        Required accuracy, m. An axis is observable if its 95% error is at most this value.

    Returns
    -------
    LeverArmEstimate

    Raises
    ------
    AlignmentError
        If no filter can start on a drive, for example because the vehicle is too slow.
    InputError
        If there are no drives, if the drives state different lever arms or standard deviations, if a filter fails, or
        if ``within`` is not positive and finite.
    """
    read = [replace(drive, truth=None) for drive in as_list(drives)]
    if not read:
        raise InputError("there are no drives; pass at least one")
    if not 0 < within < math.inf:
        raise InputError(f"within = {within:g} m is not positive and finite; specify the required accuracy")
    if len({(*drive.lever_arm, *_stated_std(drive)) for drive in read}) > 1:
        raise InputError(
            "the drives contain different gps_lever_arm_m or gps_lever_arm_std_m; pass drives of one vehicle, or one "
            "drive at a time"
        )
    mean, std = read[0].lever_arm, _stated_std(read[0])
    prior = {name: (float(m), s) for name, m, s in zip(ARM, mean, std, strict=True)}
    if parameters is None:
        suited = suggest_filter(read)
        options: dict[str, Any] = {"model": suited.model, "use": suited.use}
        values, _ = _maximum(read, baseline_of(read[0], options["model"], options["use"]), prior)
        moved = [_with_arm(drive, (values["forward"], values["left"])) for drive in read]
        parameters = _tuned(moved, options)
    else:
        values = {name: float(m) for name, m in zip(ARM, mean, strict=True)}
    values, deviations = _maximum(read, parameters, prior, values)
    return LeverArmEstimate(
        values["forward"], values["left"], deviations, (float(mean[0]), float(mean[1])), within
    )


def _placed(forward: float, left: float) -> tuple[str, str]:
    ahead, aside = "ahead" if forward >= 0 else "behind", "left" if left >= 0 else "right"
    return f"{abs(forward):.2f} m {ahead}", f"{abs(left):.2f} m {aside}"


def _stated_std(drive: Drive) -> tuple[float, float]:
    known = STATED_STD if "gps_lever_arm_m" in drive.metadata and drive.lever_arm.any() else UNKNOWN_STD
    stated = drive.metadata.get("gps_lever_arm_std_m", (known, known))
    return float(stated[0]), float(stated[1])


def _with_arm(drive: Drive, arm: Sequence[float], **metadata: Any) -> Drive:
    changed = {"gps_lever_arm_m": [*map(float, arm), drive.antenna_height], **metadata}
    return replace(drive, metadata={**drive.metadata, **changed})


def _tuned(drives: Sequence[Drive], options: Mapping[str, Any]) -> FilterParameters:
    use = (*options["use"], "slip") if "lateral" in options["use"] else options["use"]
    chosen = {**options, **NOISE_SEARCH, "use": use, "kind": "ekf", "objective": "innovation-t"}
    sensors = [log_properties(drive) for drive in drives]
    problem = car_problem(drives, complete_config(validated_config(TuneConfig, chosen), sensors))
    with ThreadPoolExecutor(cores()) as pool:
        return problem.parameters(TrialRunner(problem, pool).trial(0).point)


def _maximum(
    drives: Sequence[Drive],
    parameters: FilterParameters,
    arm: Mapping[str, tuple[float, float]],
    start: Mapping[str, float] | None = None,
) -> tuple[Values, tuple[float, float]]:
    """Return the values that maximize the posterior density, and the standard deviations of the lever arm, m."""
    prior = {**arm, **_others(parameters)}
    values = {name: mean for name, (mean, _) in prior.items()} | dict(start or {})
    values = {name: getattr(parameters, name, values[name]) for name in prior}
    solution = _step(drives, parameters, values, prior)
    for _ in range(MAX_ROUNDS - 1):
        if np.abs(solution[0][: len(ARM)]).max() < STEP_TOLERANCE:
            break
        values = _moved(values, solution[0])
        solution = _step(drives, parameters, values, prior)
    return _moved(values, solution[0]), _deviations(*solution)


def _moved(values: Values, step: Array) -> Values:
    return {name: value + d for (name, value), d in zip(values.items(), step.tolist(), strict=True)}


def _step(
    drives: Sequence[Drive],
    parameters: FilterParameters,
    values: Values,
    prior: Mapping[str, tuple[float, float]],
) -> tuple[Array, list[Whitened], Array, Array]:
    """Return a Gauss-Newton step, the whitened arrays by drive, and the posterior and prior information matrices."""
    arm = values["forward"], values["left"]
    whitened = [_whitened(PreparedDrive(_with_arm(drive, arm)), parameters, values) for drive in drives]
    before = np.diag([1 / std**2 for _, std in prior.values()])
    pull = before @ [mean - values[name] for name, (mean, _) in prior.items()]
    information = before.copy()
    for _, nu, columns, weight in whitened:
        information += np.einsum("f,fik,fil->kl", weight, columns, columns)
        pull += np.einsum("f,fik,fi->k", weight, columns, nu)
    return np.asarray(np.linalg.solve(information, pull), np.float64), whitened, information, before


def _deviations(
    step: Array, whitened: Sequence[Whitened], information: Array, before: Array
) -> tuple[float, float]:
    """Return the standard deviations of the lever arm, forward and left, m.

    Each is `STD_FACTOR` times the larger of two estimates: the model-based estimate, and the sandwich estimate from
    blocks of the drives (White, 1980).
    """
    scatter, inverse = before.copy(), np.linalg.inv(information)
    for time, nu, columns, weight in whitened:
        scores = np.einsum("f,fik,fi->fk", weight, columns, nu - columns @ step)
        block = ((time - time[0]) / BLOCK_LENGTH).astype(np.intp)
        sums = np.zeros((block[-1] + 1, len(step)))
        np.add.at(sums, block, scores)
        scatter += sums.T @ sums
    both = np.diag(inverse), np.diag(inverse @ scatter @ inverse)
    forward, left, *_ = (STD_FACTOR * np.sqrt(np.maximum(*both))).tolist()
    return forward, left


def _others(p: FilterParameters) -> dict[str, tuple[float, float]]:
    """Return the prior mean and standard deviation of each unknown except the lever arm."""
    model = MODELS[p.model]
    rolling = {} if model.tilts else {"scale_ax": ROLLING, "scale_ay": ROLLING}
    names = SCALES if model.measures_imu else (*SCALES, "latency")
    names += () if model.measures_imu or p.lateral_noise is None else ("rear_axle", "tire_slip")
    mean = {"rear_axle": HALF_A_WHEELBASE, "latency": p.latency}
    return {name: (mean.get(name, 0.0), {**PRIOR_STD, **rolling}[name]) for name in names}


def _whitened(ready: PreparedDrive, parameters: FilterParameters, values: Values) -> Whitened:
    run = partial(_run, ready, parameters, values)
    start = run(values)
    if not np.isfinite(start.nis).all():
        name = ready.drive.name
        raise InputError(
            f"the filter fails on {name}; repair the faults that `sigmaswarm doctor` finds, or omit the drive"
        )
    moved = [run({**values, name: v + STEP[name]}).innovation for name, v in values.items()]
    slopes = [(nu - start.innovation) / STEP[name] for name, nu in zip(values, moved, strict=True)]
    columns = -np.linalg.solve(np.linalg.cholesky(start.covariance), np.stack(slopes, axis=-1))
    return start.time, start.normalized, np.asarray(columns, np.float64), (DOF + 2.0) / (DOF + start.nis)


def _run(ready: PreparedDrive, p: FilterParameters, at: Values, values: Values) -> Innovations:
    """Return the innovations of a filter with the unknowns ``values``, on a drive prepared with the unknowns ``at``."""
    start, line = ready.initial, ready.timeline()
    c, s = math.cos(start.mean[THETA]), math.sin(start.mean[THETA])
    x, y = (values[name] - at[name] for name in ARM)
    mean = start.mean.copy()
    mean[:2] -= c * x - s * y, s * x + c * y
    driving = line.driving.copy()
    driving[:, : len(SCALES)] *= 1.0 + np.array([values[name] for name in SCALES])
    arm = [*(values[name] for name in ARM), line.drive.antenna_height]
    drive = replace(line.drive, metadata={**line.drive.metadata, "gps_lever_arm_m": arm})
    moved = replace(line, drive=drive, driving=driving)
    p = replace(p, **{name: value for name, value in values.items() if hasattr(p, name)})
    drive_pass = FilterPass(moved, replace(start, mean=mean), Targets.none(moved))
    return FilterRun(drive_pass, p).finished().innovations
