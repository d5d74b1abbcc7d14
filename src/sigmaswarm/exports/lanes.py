"""Table of the parameters that differ between the filters of an exported filter bank."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.exports.features import NUMBERS
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
        prior = OffsetPrior(tuning)
        return [tuning, *(prior.parameters(offsets) for offsets in self._offsets(prior)[1:])]

    def _offsets(self, prior: OffsetPrior) -> np.ndarray:
        return prior.first(np.random.default_rng([self.seed, 0]))[: self.n]

    def context(self, tuning: FilterParameters) -> dict[str, Any]:
        """Return the variables of a bank for the templates."""
        filters = self.filters(tuning)
        one = {"lanes": self.n, "filters": filters, "q": "process_noise", "r": "measurement_noise"}
        if self.n == 1:
            return one
        prior = OffsetPrior(tuning)
        return one | {
            "q": f"lanes[b->lane].{one['q']}",
            "r": f"lanes[b->lane].{one['r']}",
            "description": f"{tuning.model}, {tuning.kind}: bank of {self.n} filters with different parameters",
            "lane_fields": {name: NUMBERS[name.upper()] for name in _numbers(tuning)},
            "lane_rows": zip(
                filters, prior.penalty(self._offsets(prior)), map(_numbers, filters), strict=True
            ),
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
