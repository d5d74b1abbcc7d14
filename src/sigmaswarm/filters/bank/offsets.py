"""Offsets of a bank's filters from the tuned parameters, mostly in decades of variance."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import warn_deprecated
from sigmaswarm.filters.compiled.layout import CONSTANTS, LANES, LETTERS
from sigmaswarm.filters.models import MODELS, NOISE_OF
from sigmaswarm.filters.parameters import FilterParameters

OFFSET_DOF = 4.0  # degrees of freedom of Student's t, the prior of an offset; allows a few large offsets
Q_STD, WALK_STD, R_STD, OTHER_STD = 0.5, 0.7, 0.7, 0.4
"""Standard deviations, in decades, of the offsets of Q, of Q for biases, of R, and of other variances."""
# decades, for a smaller R; less than R_STD, since fixes in a city seem accurate until they jump
R_DOWN_STD = 0.45
SCALE_STD = 0.7  # decades, for a factor of all variances, which hardly changes the estimates
START_STD = 1.5  # decades, for the initial variance of the biases; `OffsetPrior.first` only increases it
AXLE_STD = 0.7  # m, standard deviation of the offset of the rear axle
R, SCALE, START, AXLE = "r", "scale", "bias_start", "rear_axle"
FIXED_OFFSETS = (
    {},
    {START: 2.0},
    {START: 4.0},
    {R: -1.4},
    {R: -2.8},
    {R: 1.2},
    {R: 2.5, START: 3.0},
    {R: 4.5, START: 3.0},
)
"""Offsets of the first eight filters, in decades of variance: none, then those for larger initial biases and other
receivers."""

WARNING_OFFSET, WARNING_AXLE_OFFSET = 0.5, 0.5  # largest offsets without a warning, decades and m
_MEANS = {
    R: "R is {times}, which indicates a different receiver",
    SCALE: "the common factor of all variances is {times}; the tuning did not determine this factor",
    **dict.fromkeys(
        NOISE_OF, "the noise variance of {name} is {times}, which indicates a different vehicle or mounting"
    ),
}


@dataclass(frozen=True)
class OffsetPrior:
    """Prior distribution of the offsets of a bank's filters from the tuned parameters."""

    tuning: FilterParameters

    @cached_property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of each offset by name, in decades of variance; for the rear axle in m."""
        p, stds = self.tuning, dict[str, float]()
        for state in MODELS[p.model].states:
            stds[f"q_{state.shared}"] = WALK_STD if state.bias_of else Q_STD
        stds |= {R: R_STD, SCALE: SCALE_STD}
        stds |= {name: OTHER_STD for name, noise in NOISE_OF.items() if getattr(p, noise) is not None}
        if MODELS[p.model].sensors:
            stds[START] = START_STD
        if p.lateral_noise is not None:
            stds[AXLE] = AXLE_STD
        return stds

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(self.deviations)

    @cached_property
    def std(self) -> Array:
        return np.array(list(self.deviations.values()))

    @cached_property
    def lasting(self) -> Array:
        """Mask, (d,): 1 for offsets that still have an effect after the start, otherwise 0."""
        return np.array([0.0 if name == START else 1.0 for name in self.names])

    def first(self, rng: np.random.Generator) -> Array:
        """Draw the initial offsets of a bank, (LANES, d); filter 0 has the tuned parameters."""
        offsets = rng.standard_normal((LANES, len(self.names))) * self.std
        if START in self.names:
            start = self.names.index(START)
            offsets[:, start] = np.abs(offsets[:, start])
        for lane, fixed in enumerate(FIXED_OFFSETS):
            if fixed and not set(fixed) & set(self.names):
                continue  # a model without biases
            offsets[lane] = [fixed.get(name, 0.0) for name in self.names]
        return offsets

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        biased = [lane for lane, changes in enumerate(FIXED_OFFSETS) if START in changes and R not in changes]
        receivers = [lane for lane, changes in enumerate(FIXED_OFFSETS) if R in changes]
        others = [*range(len(FIXED_OFFSETS), LANES)]
        if START not in self.names:
            biased, others = [], [*biased, *others]
        groups = {"other biases": biased, "other receivers": receivers, "found by the search": others}
        return {"the tuning": [0]} | {name: lanes for name, lanes in groups.items() if lanes}

    def penalty(self, offsets: Array) -> Array:
        """Return log-prior penalties (m,) of offsets (m, d): sums of -log of Student's t density, without constants."""
        relative = offsets / self.std
        r = relative[..., self.names.index(R)]
        r[r < 0.0] *= R_STD / R_DOWN_STD
        return 0.5 * (OFFSET_DOF + 1.0) * np.log1p(np.square(relative) / OFFSET_DOF).sum(axis=-1)

    @cached_property
    def _decades(self) -> Array:
        """Derivative of each constant (decades) with respect to each offset (decades), (N_CONSTANTS, d)."""
        decades = np.zeros((len(CONSTANTS), len(self.names)))

        def grows(constant: str, name: str) -> None:
            decades[CONSTANTS.index(constant), self.names.index(name)] = 1.0

        for state in MODELS[self.tuning.model].states:
            grows(f"Q_{LETTERS[state.name]}", f"q_{state.shared}")
        for constant in ("RX", "RY", "ACCURACY"):
            grows(constant, R)
        for name in self.names:
            if name in NOISE_OF:
                grows(f"R_{name.upper()}", name)
        decades[:, self.names.index(SCALE)] = decades.any(axis=1)
        return decades

    def constants(self, tuned: Array, offsets: Array) -> Array:
        """Return the constants (N_CONSTANTS, m) for offsets (m, d), from the tuned constants (N_CONSTANTS, 1)."""
        constants = tuned * 10.0 ** (self._decades @ offsets.T)
        if AXLE in self.names:
            constants[CONSTANTS.index("REAR_AXLE")] += offsets[:, self.names.index(AXLE)]
        return constants

    def warnings(self, moved: Array) -> tuple[str, ...]:
        """Return warnings about offsets (d,) that indicate a vehicle or sensors other than those of the tuning."""
        messages, changes = list[str](), dict(zip(self.names, moved.tolist(), strict=True))
        common = changes[SCALE]
        if abs(common) > WARNING_OFFSET:
            messages.append(_MEANS[SCALE].format(times=_times(common)))
        for name, offset in changes.items():
            if name == AXLE:
                if abs(offset) > WARNING_AXLE_OFFSET:
                    where = "back" if offset > 0 else "ahead"
                    messages.append(
                        f"the rear axle is {abs(offset):.1f} m farther {where} than in the tuning"
                    )
            elif name not in (START, SCALE):
                is_its_own = abs(offset) > WARNING_OFFSET or abs(common) <= WARNING_OFFSET
                if is_its_own and abs(offset + common) > WARNING_OFFSET:
                    usual = "the noise variance of {name} is {times}, which indicates a different IMU"
                    values = {"name": name.removeprefix("q_"), "times": _times(offset + common)}
                    messages.append(_MEANS.get(name, usual).format(**values))
        return tuple(messages)

    def said(self, moved: Array) -> tuple[str, ...]:
        """Deprecated name of ``warnings``."""
        warn_deprecated("OffsetPrior.said", "OffsetPrior.warnings")
        return self.warnings(moved)

    def parameters(self, offsets: Array) -> FilterParameters:
        p, decades = self.tuning, dict(zip(self.names, offsets.tolist(), strict=True))
        shared = [f"q_{state.shared}" for state in MODELS[p.model].states]
        scale = 10.0 ** decades[SCALE]
        r = scale * 10.0 ** decades[R]
        changed = {
            noise: scale * 10.0 ** decades[name] * getattr(p, noise)
            for name, noise in NOISE_OF.items()
            if name in decades
        }
        q = [scale * 10.0 ** decades[name] * q for name, q in zip(shared, p.process_noise, strict=True)]
        return replace(
            p,
            process_noise=tuple(q),
            measurement_noise=tuple(r * variance for variance in p.measurement_noise),
            accuracy_scale=None if p.accuracy_scale is None else r * p.accuracy_scale,
            bias_std=tuple(10.0 ** (decades.get(START, 0.0) / 2) * std for std in p.bias_std),
            rear_axle=p.rear_axle + decades.get(AXLE, 0.0),
            **changed,
        )


def _times(decades: float) -> str:
    return f"{10.0**decades:.2g} times the tuned value"
