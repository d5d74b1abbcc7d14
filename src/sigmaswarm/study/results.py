"""results.json and scores.csv: what a study found, for whoever reads it.

scores.csv is the long table: protocol, trial, method, drive, maneuver, environment, measure, value. A row is a held-out
drive of a trial; ``inf`` is a filter that failed; what can't be measured on a drive has no row.

results.json holds (null where a figure can't be said):

    schema         1
    config         what study.toml says
    drives         count, strata (number of conditions), fingerprint
    protocols      {name: {objective, scale}}; methods that nothing is tuned for have the protocol "untuned"
    methods        {name: what people call it}
    measures       {name: what it is, with its unit}
    summary        [{protocol, method, measure, maneuver, environment, mean, sd, trial_interval, corrected_t_interval,
                   bootstrap_interval, n_trials, n_drives}]: see `statistics.Summary`; maneuver and environment are
                   "all" in the rows over all conditions
    comparisons    [{protocol, measure, method, against, mean_difference, interval, p, holm_p, rank_biserial,
                   improvement, improvement_interval, n_drives}]: pso-ukf under each protocol against every other
                   method; see `statistics.Comparison`; Holm's correction is over the methods of a protocol and measure
    tunings        [{protocol, method, group, trial, cost, parameters, touched_bounds, evaluations, failures, folder}]:
                   folder is relative to the study's, and is that of the trial; its history.npz has the best and
                   median cost of each generation
    convergence    [{protocol, method, group, low, median, high, stable}]: quantiles (10%, 50%, 90%) over trials of the
                   best cost after each generation; stable: the generation from which on the median is within 1% of its
                   last value
    paper          the paper's figures, as `paper.py` has them
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.files import finite, write_json, write_whole
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.study.config import PROTOCOLS
from sigmaswarm.study.design import ALL, Design, Task
from sigmaswarm.study.paper import PAPER_RESULTS
from sigmaswarm.study.scores import LABELS, MEASURES, Cell, ScoreTable
from sigmaswarm.study.statistics import compare, holm, summarize
from sigmaswarm.tuning.box import TouchedBound
from sigmaswarm.tuning.search import Trial

STABLE = 0.01
"""Share of its last value within which a convergence counts as stable."""


@dataclass(frozen=True, eq=False)
class Results:
    """What results.json holds, and the scores behind it."""

    content: dict[str, Any]
    scores: ScoreTable

    def summary(
        self, protocol: str, method: str, measure: str, maneuver: str = ALL, environment: str = ALL
    ) -> dict[str, Any] | None:
        """One row of ``summary``, None where there is none."""
        wanted = (protocol, method, measure, maneuver, environment)
        keys = ("protocol", "method", "measure", "maneuver", "environment")
        return next((row for row in self.content["summary"] if tuple(row[k] for k in keys) == wanted), None)


def write_results(
    out: Path,
    design: Design,
    trials: Mapping[Task, Trial],
    parameters: Mapping[Task, FilterParameters],
    touched: Mapping[Task, list[TouchedBound]],
    scores: ScoreTable,
) -> Results:
    """Write results.json and scores.csv."""
    content: dict[str, Any] = {
        "schema": 1,
        "config": design.config.model_dump(mode="json"),
        "drives": {
            "count": len(design.drives),
            "strata": len(set(design.strata)),
            "fingerprint": design.fingerprint(),
        },
        "protocols": {name: {"objective": o, "scale": s} for name, (o, s) in PROTOCOLS.items()},
        "methods": LABELS,
        "measures": {name: meaning for name, (meaning, _) in MEASURES.items()},
        "summary": _summary(scores),
        "comparisons": _comparisons(scores),
        "tunings": [_tuning(t, trials[t], parameters[t], touched[t]) for t in trials],
        "convergence": _convergence(trials),
        "paper": PAPER_RESULTS,
    }
    content = finite(content)
    write_whole(out / "scores.csv", scores.to_frame().write_csv())
    write_json(out / "results.json", content, indent=1)
    return Results(content, scores)


def _ratio(design: Design) -> float:
    train, test = design.split(0)
    return len(test) / len(train)


def _rng(design: Design) -> np.random.Generator:
    """The bootstrap's source of chance: the same for each figure, so that none depends on the others."""
    return np.random.default_rng(design.config.seed)


def _summary(scores: ScoreTable) -> list[dict[str, Any]]:
    design = scores.design
    ratio = _ratio(design)
    names = list(dict.fromkeys(design.conditions))
    places = [(ALL, ALL), *[(m, e) for m, e in names if (m, e) != (ALL, ALL)]]
    rows: list[dict[str, Any]] = []
    for (protocol, method), measures in scores.values.items():
        for measure, values in measures.items():
            for maneuver, environment in places:
                chosen = [
                    i
                    for i, c in enumerate(design.conditions)
                    if (maneuver, environment) == (ALL, ALL) or c == (maneuver, environment)
                ]
                strata = [design.strata[i] for i in chosen]
                found = summarize(values[:, chosen], strata, ratio, _rng(design))
                if found.n_drives:
                    where = {"maneuver": maneuver, "environment": environment}
                    rows.append(
                        {"protocol": protocol, "method": method, "measure": measure} | where | asdict(found)
                    )
    return rows


def _comparisons(scores: ScoreTable) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for protocol in PROTOCOLS:
        others: list[Cell] = [c for c in scores.values if c[0] in ("untuned", protocol) and c[1] != "pso-ukf"]
        for measure in MEASURES:
            if measure != "nis":  # neither low nor high is better
                rows += _against(scores, protocol, measure, others)
    return rows


def _against(scores: ScoreTable, protocol: str, measure: str, others: list[Cell]) -> list[dict[str, Any]]:
    """The PSO-UKF of a protocol against each of the others."""
    design = scores.design
    own = scores.values[protocol, "pso-ukf"][measure]
    rows: list[dict[str, Any]] = []
    for cell in others:
        theirs = scores.values[cell].get(measure)
        if theirs is None or not np.any(np.isfinite(theirs)):
            continue
        found = asdict(compare(own, theirs, design.strata, _rng(design)))
        rows.append(
            {"protocol": protocol, "measure": measure, "method": "pso-ukf", "against": cell[1]} | found
        )
    for row, p in zip(rows, holm([row["p"] for row in rows]), strict=True):
        row["holm_p"] = p
    return rows


def _tuning(
    task: Task, trial: Trial, parameters: FilterParameters, touched: list[TouchedBound]
) -> dict[str, Any]:
    return {
        "protocol": task.protocol,
        "method": task.method,
        "group": task.group,
        "trial": task.trial,
        "cost": trial.cost,
        "parameters": parameters.to_dict(),
        "touched_bounds": list(map(str, touched)),
        "evaluations": trial.evaluations,
        "failures": trial.failures,
        "folder": f"trials/{task.folder}/trial-{task.trial:03d}",
    }


def _convergence(trials: Mapping[Task, Trial]) -> list[dict[str, Any]]:
    kinds = dict.fromkeys((t.protocol, t.method, t.group) for t in trials)
    rows: list[dict[str, Any]] = []
    for protocol, method, group in kinds:
        best = np.array(
            [
                trial.best
                for t, trial in trials.items()
                if (t.protocol, t.method, t.group) == (protocol, method, group)
            ]
        )
        low, median, high = np.quantile(best, [0.1, 0.5, 0.9], axis=0)
        bands = {"low": low.tolist(), "median": median.tolist(), "high": high.tolist()}
        rows.append(
            {
                "protocol": protocol,
                "method": method,
                "group": group,
                **bands,
                "stable": stable_generation(median),
            }
        )
    return rows


def stable_generation(costs: Array) -> int:
    """The first generation, from 1 on, from which on the cost stays within 1% of its last value."""
    away = np.abs(costs - costs[-1]) > STABLE * abs(float(costs[-1]))
    return int(np.flatnonzero(away)[-1]) + 2 if away.any() else 1
