"""Sentences and tables of a tuning, for the terminal, notebooks and the HTML report."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

from sigmaswarm import notebook
from sigmaswarm.errors import InputError
from sigmaswarm.tables import Cell, Column, Table
from sigmaswarm.tuning.diagnostics import drift_table, larger_drifts
from sigmaswarm.tuning.objectives import parse_objective
from sigmaswarm.tuning.record import End, ResultRecord, TuningRecord
from sigmaswarm.tuning.sensitivity import NOISE_SCALE
from sigmaswarm.tuning.space import searched_name
from sigmaswarm.wording import count_of

PARAMETER_MEANINGS = {
    "latency": (
        "delay with which this filter predicts the fixes best; the doctor estimates this delay as a clock offset, "
        "from turns and accelerations"
    ),
    "rear_axle": "distance of the IMU in front of the rear axle; negative: behind the rear axle",
}
RANGES = (
    'At the values in the columns "from" and "to", the cost is 1% higher than at the tuned value, with all other '
    "parameters unchanged. "
    '"At the bound" means that the cost at the bound of the search is less than 1% higher.'
)
SIGMA_POINTS = {"alpha", "beta", "kappa"}


@dataclass(frozen=True, eq=False)
class TuningView:
    """Sentences and tables of a tuning; those about costs need a record with the table [result]."""

    record: TuningRecord

    @property
    def result(self) -> ResultRecord:
        if self.record.result is None:
            raise InputError("the file has no [result] table; name a file written by `sigmaswarm tune`")
        return self.record.result

    @property
    def filter(self) -> str:
        """Name and type of the filter."""
        config, values = self.record.config, self.record.filter
        model = config.get("model", values.get("model", "a filter"))
        if isinstance(model, dict):
            return f"{model.get('name', 'a custom model')} ({model.get('kind', 'ukf')})"
        return f"{model} ({config.get('kind', values.get('kind', 'ukf'))})"

    @property
    def noun(self) -> str:
        return "log" if isinstance(self.record.config.get("model"), dict) else "drive"

    @property
    def headline(self) -> str:
        result, on = self.result, count_of(len(self.record.data), self.noun)
        return f"Tuned for {result.objective}: cost {notebook.number(result.cost)} on {on}"

    @property
    def purpose(self) -> str:
        """Filter, training drives and objective, in one or two sentences."""
        record, result = self.record, self.record.result
        if result is None:
            return f"The filter is {self.filter}; its file does not describe a tuning."
        length = sum(drive.duration_s or 0 for drive in record.data)
        on = count_of(len(record.data), self.noun) + (f" ({length / 60:.1f} min)" if length else "")
        meaning = f": {result.objective_meaning}" if result.objective_meaning else ""
        return f"{self.filter} was tuned on {on}. The objective is {result.objective}{meaning}."

    @property
    def start(self) -> str:
        cost = self.result.start_cost
        new = self.result.cost
        return (
            ""
            if cost is None
            else f"cost {new:.4f}; cost of the filter from which the search started: {cost:.4f}"
        )

    @property
    def training(self) -> str:
        result, before = self.result, ""
        if result.inflation_factor != 1.0:
            before = f"; {result.trial_costs[result.best_trial]:.4f} before process-noise inflation"
        objective = parse_objective(result.objective)
        unit = " nats per fix" if objective.likelihood and not objective.needs_truth else ""
        on = count_of(len(self.record.data), self.noun)
        return f"cost {result.cost:.4f}{unit} ({result.objective}{before}) on {on}"

    @property
    def racing(self) -> str:
        steps, full = self.result.filter_steps, self.result.filter_steps_without_racing
        if not self.record.config.get("racing") or not full:
            return ""
        return f"racing: {steps} filter steps, {steps / full:.0%} of the number without racing"

    @property
    def gap(self) -> str:
        """Comparison of the errors on validation and training drives."""
        gap = self.result.validation_gap
        if gap is None:
            return ""
        larger = f"{abs(gap):.1%} {'larger' if gap >= 0 else 'smaller'}"
        return f"errors {larger} than on the training {self.noun}s" if isfinite(gap) else "failed"

    @property
    def validation(self) -> str:
        result = self.result
        if result.validation_cost is None or not self.gap:
            return ""
        on = count_of(len(result.validation_drives), f"validation {self.noun}")
        return f"cost {result.validation_cost:.4f} on {on} ({self.gap})"

    @property
    def drifts(self) -> Table | None:
        """Drifts without fixes, if they were measured."""
        durations = [drive.duration_s or 0.0 for drive in self.record.data]
        return drift_table(self.record.forecasts, durations) if self.record.forecasts else None

    @property
    def larger_drifts(self) -> list[str]:
        """A sentence for each method that drifts less than the tuned filter."""
        return larger_drifts(self.record.forecasts)

    def parameters(self, caption: str = "") -> Table:
        """Return the table of all parameters, with the range in which the cost increases by less than 1%."""
        record, ranges = self.record, self.record.within_1_percent_of_the_cost
        touched = {
            bound.parameter: bound.place for bound in (record.result.touched_bounds if record.result else ())
        }
        rows: list[tuple[Cell, ...]] = []
        model = str(record.filter.get("model"))
        for name, value, unit, density in self._values():
            if record.filter.get("kind") == "ekf" and name in SIGMA_POINTS:
                continue
            low, high = ranges.get(searched_name(name, ranges, model), (None, None))
            place = touched.get(searched_name(name, touched, model), "")
            if (low, high) == ("-", "-"):
                place = "no effect within the bounds"
            remark = "; ".join(filter(None, (PARAMETER_MEANINGS.get(name, ""), place)))
            rows.append((name, value, unit, _end(low), _end(high), density, remark))
        if NOISE_SCALE in ranges:
            ends = map(_end, ranges[NOISE_SCALE])
            rows.append((NOISE_SCALE, 1.0, "", *ends, "", "one factor on all noise variances"))
        titles = ("parameter", "value", "unit", "from", "to", "density", "remark")
        return Table(caption, tuple(map(Column, titles)), tuple(rows))

    def _values(self) -> Iterator[tuple[str, Cell, str, str]]:
        """Yield name, value, unit and density of each number of the filter."""
        units = self.record.units
        names = {
            "process_noise": [f"q_{state}" for state in units.get("states", [])],
            "measurement_noise": ["r_x", "r_y"],
            "bias_std": ["accel_bias_std", "gyro_bias_std"],
        }
        for field, value in self.record.filter.items():
            unit = units.get(field, "")
            if not isinstance(value, list):
                yield field, value, unit if isinstance(unit, str) else "", ""
                continue
            for i, entry in enumerate(value):
                name = dict(enumerate(names.get(field, []))).get(i, f"{field}[{i}]")
                one = unit if isinstance(unit, str) else unit[i] if i < len(unit) else ""
                density = (
                    self.record.densities.get(name.removeprefix("q_"), "") if name.startswith("q_") else ""
                )
                yield name, entry, one, density


def _end(end: End | None) -> Cell:
    return "at the bound" if end == "-" else end
