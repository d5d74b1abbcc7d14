"""The results of a study: statistics of its scores and tunings."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.experiments.statistics import (
    Known,
    bootstrap,
    corrected_interval,
    crossed_bootstrap,
    drive_means,
    holm,
    improvement,
    rank_biserial,
    signed_rank,
    spread,
    trial_interval,
    trial_means,
)
from sigmaswarm.experiments.study.config import ALL, MAIN, PROTOCOLS, UNTUNED, StudyConfig
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.paper import PAPER_RESULTS
from sigmaswarm.experiments.study.record import (
    Convergence,
    DriveCount,
    PairedComparison,
    PairedStatistics,
    Results,
    RivalResults,
    ScoreStatistics,
    TrialTuning,
    Variant,
    VariantSummary,
)
from sigmaswarm.experiments.study.scores import ScoreTable, labels_of, measures_of
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.tuning.box import TouchedBound
from sigmaswarm.tuning.search import Trial

STABLE = 0.01
"""Share of its last value within which a convergence counts as stable."""


def results_of(
    design: Design,
    trials: Mapping[Task, Trial],
    parameters: Mapping[Task, FilterParameters],
    touched: Mapping[Task, list[TouchedBound]],
    scores: ScoreTable,
    rivals: RivalResults | None = None,
) -> Results:
    """Everything that results.json says."""
    known: Known = {}
    return Results(
        config=design.config,
        drives=DriveCount(
            count=len(design.drives), strata=len(set(design.strata)), fingerprint=design.fingerprint()
        ),
        protocols=PROTOCOLS,
        methods=labels_of(design.config),
        measures=measures_of(design.config),
        summary=list(_summaries(scores, known)),
        comparisons=list(_comparisons(scores, known)),
        tunings=[_tuning(task, trials[task], parameters[task], touched[task]) for task in trials],
        convergence=list(_convergences(trials)),
        paper=PAPER_RESULTS,
        rivals=rivals,
    )


def _ratio(design: Design) -> float:
    train, test = design.split(0)
    return len(test) / len(train)


def resampling(design: Design) -> np.random.Generator:
    """The bootstrap's source of chance: the same for each figure, so that none depends on the others."""
    return np.random.default_rng(design.config.seed)


def _summaries(scores: ScoreTable, known: Known) -> Iterator[VariantSummary]:
    """Of every variant and measure, over all conditions and in each."""
    design = scores.design
    ratio = _ratio(design)
    each = dict.fromkeys(condition for condition in design.conditions if condition != (ALL, ALL))
    for (protocol, method), measures in scores.values.items():
        for measure, values in measures.items():
            for place in ((ALL, ALL), *each):
                chosen = [i for i, c in enumerate(design.conditions) if place in ((ALL, ALL), c)]
                strata = [design.strata[i] for i in chosen]
                found = summarize(values[:, chosen], strata, ratio, resampling(design), known)
                if found.n_drives:
                    of = {"protocol": protocol, "method": method, "measure": measure}
                    yield VariantSummary(**of, maneuver=place[0], environment=place[1], **dict(found))


def summarize(
    values: Array,
    strata: Sequence[str],
    test_per_train: float,
    rng: np.random.Generator,
    known: Known | None = None,
) -> ScoreStatistics:
    """Mean, spread and intervals of scores (trials, drives); ``test_per_train`` is the ratio of the split's sizes."""
    each, drives = trial_means(values), drive_means(values)
    each = each[~np.isnan(each)]
    return ScoreStatistics(
        mean=float(np.mean(each)) if len(each) else None,
        sd=spread(each),
        trial_interval=trial_interval(each),
        corrected_t_interval=corrected_interval(each, test_per_train),
        bootstrap_interval=crossed_bootstrap(values, strata, rng, known),
        n_trials=len(each),
        n_drives=int(np.count_nonzero(~np.isnan(drives))),
    )


def _comparisons(scores: ScoreTable, known: Known) -> Iterator[PairedComparison]:
    """The PSO-UKF of each protocol against every other method that is untuned or tuned under the same one."""
    for protocol in PROTOCOLS:
        others = [v for v in scores.values if v[0] in (UNTUNED, protocol) and v[1] != MAIN]
        for measure in compared_measures(scores.design.config):
            yield from against(scores, (protocol, MAIN), measure, others, known)


def compared_measures(config: StudyConfig) -> list[str]:
    """All but NIS, of which neither low nor high is better."""
    return [measure for measure in measures_of(config) if measure != "nis"]


def against(
    scores: ScoreTable,
    variant: Variant,
    measure: str,
    others: Sequence[Variant],
    known: Known | None = None,
) -> Iterator[PairedComparison]:
    """A variant against others; p is corrected over these."""
    design, (protocol, method) = scores.design, variant
    own = scores.values[variant][measure]
    found: dict[str, PairedStatistics] = {}
    for other in others:
        theirs = scores.values[other].get(measure)
        if theirs is not None and np.any(np.isfinite(theirs)):
            found[other[1]] = compare_paired(own, theirs, design.strata, resampling(design), known)
    corrected = holm([row.p for row in found.values()])
    for (other, row), p in zip(found.items(), corrected, strict=True):
        yield PairedComparison(
            protocol=protocol, measure=measure, method=method, against=other, **dict(row), holm_p=p
        )


def compare_paired(
    method: Array,
    other: Array,
    strata: Sequence[str],
    rng: np.random.Generator,
    known: Known | None = None,
) -> PairedStatistics:
    """A method against another on the drives that both have a value for; each of shape (trials, drives)."""
    a, b = drive_means(method), drive_means(other)
    both = np.isfinite(a) & np.isfinite(b)
    a, b, kept = a[both], b[both], [s for s, k in zip(strata, both, strict=True) if k]
    difference = a - b
    return PairedStatistics(
        mean_difference=float(np.mean(difference)) if len(a) else None,
        interval=bootstrap(np.asarray, [difference], kept, rng, known),
        p=signed_rank(a, b),
        rank_biserial=rank_biserial(difference),
        improvement=float(improvement(a.mean(), b.mean())) if len(a) else None,
        improvement_interval=bootstrap(improvement, [a, b], kept, rng, known),
        n_drives=len(a),
    )


def _tuning(
    task: Task, trial: Trial, parameters: FilterParameters, touched: list[TouchedBound]
) -> TrialTuning:
    return TrialTuning(
        protocol=task.protocol,
        method=task.method,
        group=task.group,
        trial=task.trial,
        cost=trial.cost,
        parameters=parameters.to_dict(),
        touched_bounds=touched,
        evaluations=trial.evaluations,
        failures=trial.failures,
        folder=f"trials/{task.folder}/trial-{task.trial:03d}",
    )


def _convergences(trials: Mapping[Task, Trial]) -> Iterator[Convergence]:
    """Over the trials of every tuned variant and group."""
    best: dict[tuple[str, str, str], list[Array]] = {}
    for task, trial in trials.items():
        best.setdefault((task.protocol, task.method, task.group), []).append(trial.best)
    for (protocol, method, group), each in best.items():
        low, median, high = np.quantile(each, [0.1, 0.5, 0.9], axis=0)
        yield Convergence(
            protocol=protocol,
            method=method,
            group=group,
            low=low.tolist(),
            median=median.tolist(),
            high=high.tolist(),
            stable=stable_generation(median),
        )


def stable_generation(costs: Array) -> int:
    """The first generation, from 1 on, from which on the cost stays within 1% of its last value."""
    away = np.abs(costs - costs[-1]) > STABLE * abs(float(costs[-1]))
    return int(np.flatnonzero(away)[-1]) + 2 if away.any() else 1
