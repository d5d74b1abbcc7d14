"""The results of a study: statistics of its scores, tunings and networks."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

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
from sigmaswarm.experiments.study.config import (
    ALL,
    BESIDE,
    MAIN,
    PAPER_RESULTS,
    PROTOCOLS,
    UNTUNED,
    StudyConfig,
)
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.networks import Trained, Training
from sigmaswarm.experiments.study.record import (
    Convergence,
    CurvePoint,
    DriveCount,
    Effort,
    ElsewhereSummary,
    PairedComparison,
    PairedStatistics,
    Results,
    RivalResults,
    ScoreStatistics,
    TrialTuning,
    Variant,
    VariantSummary,
)
from sigmaswarm.experiments.study.scores import ScoreTable
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.tuning.box import TouchedBound
from sigmaswarm.tuning.search import Trial

STABLE = 0.01
"""Relative distance from the last cost within which a search has settled."""


def results_of(
    design: Design,
    trials: Mapping[Task, Trial],
    parameters: Mapping[Task, FilterParameters],
    touched: Mapping[Task, list[TouchedBound]],
    scores: ScoreTable,
    rivals: RivalResults | None = None,
) -> Results:
    """Return the content of results.json."""
    known: Known = {}
    return Results(
        config=design.config,
        drives=DriveCount(
            count=len(design.drives), strata=len(set(design.strata)), fingerprint=design.fingerprint()
        ),
        protocols=PROTOCOLS,
        methods={name: method.label for name, method in design.config.methods.items()},
        measures=design.config.measures,
        summary=list(_summaries(scores, known)),
        comparisons=list(_comparisons(scores, known)),
        tunings=[
            TrialTuning(
                protocol=task.protocol,
                method=task.method,
                group=task.group,
                trial=task.trial,
                cost=trial.cost,
                parameters=parameters[task].to_dict(),
                touched_bounds=touched[task],
                evaluations=trial.evaluations,
                failures=trial.failures,
                folder=f"trials/{task.folder}/trial-{task.trial:03d}",
            )
            for task, trial in trials.items()
        ],
        convergence=list(_convergences(trials)),
        paper=PAPER_RESULTS,
        rivals=rivals,
    )


def _rng(design: Design) -> np.random.Generator:
    """Return the bootstrap's generator, the same for each figure, so that none depends on the others."""
    return np.random.default_rng(design.config.seed)


def _summaries(scores: ScoreTable, known: Known) -> Iterator[VariantSummary]:
    """Summarize every variant and measure, over all conditions and in each."""
    design = scores.design
    train, test = design.split(0)
    each = dict.fromkeys(condition for condition in design.conditions if condition != (ALL, ALL))
    for (protocol, method), measures in scores.values.items():
        for measure, values in measures.items():
            for place in ((ALL, ALL), *each):
                chosen = [i for i, c in enumerate(design.conditions) if place in ((ALL, ALL), c)]
                strata = [design.strata[i] for i in chosen]
                found = summarize(values[:, chosen], strata, len(test) / len(train), _rng(design), known)
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
    """Compute mean, spread and intervals of scores (trials, drives); ``test_per_train`` is a ratio of drives."""
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
    """Compare the PSO-UKF of each protocol with every method without tuning or tuned under the same protocol."""
    for protocol in PROTOCOLS:
        others = [v for v in scores.values if v[0] in (UNTUNED, protocol) and v[1] != MAIN]
        for measure in _compared(scores.design.config):
            yield from _against(scores, (protocol, MAIN), measure, others, known)


def _compared(config: StudyConfig) -> list[str]:
    """All measures but NIS, where neither low nor high is better."""
    return [measure for measure in config.measures if measure != "nis"]


def _against(
    scores: ScoreTable,
    variant: Variant,
    measure: str,
    others: Sequence[Variant],
    known: Known | None = None,
) -> Iterator[PairedComparison]:
    """Compare a variant with others; p is corrected over these."""
    design, (protocol, method) = scores.design, variant
    own = scores.values[variant][measure]
    found: dict[str, PairedStatistics] = {}
    for other in others:
        theirs = scores.values[other].get(measure)
        if theirs is not None and np.any(np.isfinite(theirs)):
            found[other[1]] = compare_paired(own, theirs, design.strata, _rng(design), known)
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
    """Compare two methods, scores (trials, drives), on the drives with a value of both."""
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


def _convergences(trials: Mapping[Task, Trial]) -> Iterator[Convergence]:
    """Compute the convergence of every tuned variant and group."""
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
            stable=_stable_generation(median),
        )


def _stable_generation(costs: Array) -> int:
    """Return the first generation, counted from 1, after which the cost stays within 1% of its last value."""
    away = np.abs(costs - costs[-1]) > STABLE * abs(float(costs[-1]))
    return int(np.flatnonzero(away)[-1]) + 2 if away.any() else 1


def rival_results(
    trials: Mapping[Task, Trial],
    networks: Mapping[Training, Trained],
    scores: ScoreTable,
    elsewhere: Mapping[str, ScoreTable],
    curve: Mapping[str, Array],
) -> RivalResults:
    """Return the results of a study with rivals.

    ``curve``: scores of the networks of the learning curves, in their order, shape (networks, drives) each.
    """
    whole = {training.task: found for training, found in networks.items() if training.minutes is None}
    less = [(training, found) for training, found in networks.items() if training.minutes is not None]
    return RivalResults(
        efforts=list(_efforts(scores.design, trials, whole)),
        gains=list(_gains(scores, whole)),
        elsewhere=[
            row for place, table in elsewhere.items() for row in _elsewhere(place, table, scores.design)
        ],
        curve=list(_curve(scores, whole, less, curve)),
    )


def _efforts(
    design: Design, trials: Mapping[Task, Trial], networks: Mapping[Task, Trained]
) -> Iterator[Effort]:
    """Sum up the data and numbers behind each variant; a network's include those of its filter."""

    def labelled(trial: int) -> float:
        times = [design.prepared[i].drive.imu.time for i in design.split(trial)[0]]
        return sum(float(time[-1] - time[0]) for time in times)

    truth = float(np.mean([labelled(trial) for trial in range(design.config.trials)]))
    numbers: dict[Variant, float] = {task.variant: float(len(trial.point)) for task, trial in trials.items()}
    learned: dict[Variant, float] = {}
    for variant in dict.fromkeys(task.variant for task in networks):
        own = [network for task, network in networks.items() if task.variant == variant]
        learned[variant] = float(np.mean([network.driven for network in own]))
        trained = float(np.mean([network.learned.record.network.numbers for network in own]))
        numbers[variant] = numbers[variant[0], BESIDE] + trained
    for (protocol, method), count in numbers.items():
        yield Effort(
            protocol=protocol,
            method=method,
            labelled_s=truth,
            learned_s=learned.get((protocol, method)),
            numbers=count,
        )


def _gains(scores: ScoreTable, networks: Iterable[Task]) -> Iterator[PairedComparison]:
    """Compare each network with its filter, drive by drive, in the measures that it changes."""
    for protocol, method in dict.fromkeys(task.variant for task in networks):
        for measure in _compared(scores.design.config):
            own, alone = (scores.values[protocol, m].get(measure) for m in (method, BESIDE))
            if own is None or alone is None or np.allclose(own, alone, rtol=1e-9, atol=0.0, equal_nan=True):
                continue
            yield from _against(scores, (protocol, method), measure, [(protocol, BESIDE)])


def _elsewhere(place: str, scores: ScoreTable, home: Design) -> Iterator[ElsewhereSummary]:
    """Summarize every variant and measure over all drives of one place."""
    design = scores.design
    ratio = len(design.drives) / len(home.split(0)[0])
    for (protocol, method), measures in scores.values.items():
        for measure, values in measures.items():
            found = summarize(values, design.strata, ratio, _rng(home))
            if found.n_drives:
                of = {"place": place, "protocol": protocol, "method": method, "measure": measure}
                yield ElsewhereSummary(**of, maneuver=ALL, environment=ALL, **dict(found))


def _curve(
    scores: ScoreTable,
    networks: Mapping[Task, Trained],
    less: Sequence[tuple[Training, Trained]],
    curve: Mapping[str, Array],
) -> Iterator[CurvePoint]:
    """Score each network of the first trial after no training, after parts of it, and after all of it."""
    for task, whole in networks.items():
        if task.trial:
            continue
        first = {
            m: {k: values[0] for k, values in scores.values[task.protocol, m].items()}
            for m in (BESIDE, task.method)
        }
        points = [(0.0, first[BESIDE])]
        for k, (training, found) in enumerate(less):
            if training.network == task.method:
                points.append((found.driven, {measure: values[k] for measure, values in curve.items()}))
        for driven, each in [*points, (whole.driven, first[task.method])]:
            for measure, values in each.items():
                known = np.flatnonzero(~np.isnan(values))
                strata = [scores.design.strata[i] for i in known]
                yield CurvePoint(
                    method=task.method,
                    minutes=round(driven / 60.0, 3),
                    measure=measure,
                    mean=float(np.mean(values[known])) if len(known) else None,
                    interval=bootstrap(np.asarray, [values[known]], strata, _rng(scores.design)),
                    n_drives=len(known),
                )
