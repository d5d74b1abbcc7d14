"""Table of the parameters that differ between the filters of an exported filter bank."""

from dataclasses import dataclass

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.exports.features import NUMBERS, listed
from sigmaswarm.filters.bank.offsets import OffsetPrior
from sigmaswarm.filters.compiled.layout import LANES
from sigmaswarm.filters.models import MODELS, NOISE_OF, SENSORS
from sigmaswarm.filters.parameters import FilterParameters


@dataclass(frozen=True)
class Lanes:
    """Number of filters and seed of their parameters, as in a `LiveFilterBank` without searches."""

    n: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.n <= LANES:
            raise InputError(
                f"lanes = {self.n} is out of range; choose 2 to {LANES} for a filter bank, or 1 for the filter alone"
            )

    def filters(self, tuning: FilterParameters) -> list[FilterParameters]:
        """Return the parameters of each filter of the bank; filter 0 has the tuned parameters."""
        spread = OffsetPrior(tuning)
        return [tuning, *(spread.parameters(offsets) for offsets in self._offsets(spread)[1:])]

    def _offsets(self, spread: OffsetPrior) -> np.ndarray:
        return spread.first(np.random.default_rng([self.seed, 0]))[: self.n]

    def values(self, tuning: FilterParameters) -> dict[str, str]:
        filters = self.filters(tuning)
        biases = {"GYRO_BIAS_STDS": listed([p.bias_std[1] for p in filters])}
        if self.n == 1:
            return {"Q": "process_noise", "R": "measurement_noise", "LANES": "1", **biases}
        spread = OffsetPrior(tuning)
        penalties = spread.penalty(self._offsets(spread)).tolist()
        return {
            **biases,
            "LANE_FIELDS": "\n".join(f"    real {n}; /* {NUMBERS[n.upper()]} */" for n in _numbers(tuning)),
            "Q": "lanes[b->lane].process_noise",
            "R": "lanes[b->lane].measurement_noise",
            "LANES": str(self.n),
            "DESCRIPTION": f"{tuning.model}, {tuning.kind}: bank of {self.n} filters with different parameters",
            "LANE_ROWS": ",\n".join(map(_row, filters, penalties)),
        }

    def numbers(self, tuning: FilterParameters) -> dict[str, str]:
        return {name.upper(): f"lanes[b->lane].{name}" for name in _numbers(tuning)} if self.n > 1 else {}


_NUMBERS = ("accuracy_scale", *NOISE_OF.values(), "rear_axle", "tire_slip")
"""Scalar parameters that may differ between the filters, in addition to Q, R and the initial `bias_std`."""


def _numbers(p: FilterParameters) -> dict[str, float]:
    biases = zip(SENSORS, p.bias_std, strict=True) if MODELS[p.model].sensors else ()
    numbers: dict[str, float | None] = {f"{sensor}_bias_std": std for sensor, std in biases}
    numbers |= {name: getattr(p, name) for name in _NUMBERS}
    numbers["tire_slip"] = numbers["tire_slip"] or None
    if p.lateral_noise is None:
        del numbers["rear_axle"], numbers["tire_slip"]
    return {name: float(value) for name, value in numbers.items() if value is not None}


def _row(p: FilterParameters, penalty: float) -> str:
    fields = [
        f".process_noise = {{{listed(p.process_noise, 'R({})')}}}",
        f".measurement_noise = {{{listed(p.measurement_noise, 'R({})')}}}",
        f".penalty = R({penalty!r})",
        *(f".{name} = R({value!r})" for name, value in _numbers(p).items()),
    ]
    return "    {" + ",\n     ".join(fields) + "}"
