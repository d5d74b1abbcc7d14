"""Statistics of the scores, tuning runs and networks of a study."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.experiments.statistics import (
    Draws,
    bootstrap,
    corrected_interval,
    crossed_bootstrap,
    drive_means,
    holm,
    improvement,
    rank_biserial,
    signed_rank,
    std,
    trial_interval,
    trial_means,
)
from sigmaswarm.experiments.study.config import (
    ALL,
    MAIN_METHOD,
    NETWORK_FILTER,
    NO_PROTOCOL,
    PAPER_RESULTS,
    PROTOCOLS,
)
from sigmaswarm.experiments.study.design import Design, Filters, Task, Trials
from sigmaswarm.experiments.study.networks import Networks, TrainedNetwork, Training
from sigmaswarm.experiments.study.record import (
    Convergence,
    CurvePoint,
    DriveCount,
    Effort,
    ElsewhereSummary,
    PairedComparison,
    Results,
    RivalResults,
    TrialTuning,
    Variant,
    VariantSummary,
)
from sigmaswarm.experiments.study.scores import ScoreTable
from sigmaswarm.tuning.bounds import TouchedBound


def results_of(
    trials: Trials,
    parameters: Filters,
    touched: Mapping[Task, list[TouchedBound]],
    scores: ScoreTable,
    rivals: RivalResults | None = None,
) -> Results:
    design, draws = scores.design, Draws(scores.design.config.seed)
    return Results(
        config=design.config,
        drives=DriveCount(
            count=len(design.drives), strata=len(set(design.strata)), fingerprint=design.fingerprint()
        ),
        protocols=PROTOCOLS,
        methods={name: method.label for name, method in design.config.methods.items()},
        measures=design.config.measures,
        summary=list(_summaries(scores, draws)),
        comparisons=list(_comparisons(scores, draws)),
        tunings=[
            TrialTuning(
                **vars(task),
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


def _summaries(scores: ScoreTable, draws: Draws) -> Iterator[VariantSummary]:
    design, everywhere = scores.design, (ALL, ALL)
    train, test = design.split(0)
    each = dict.fromkeys(condition for condition in design.conditions if condition != everywhere)
    for of, values in scores.columns():
        for condition in (everywhere, *each):
            chosen = [i for i, c in enumerate(design.conditions) if condition in (everywhere, c)]
            strata = [design.strata[i] for i in chosen]
            of |= {"maneuver": condition[0], "environment": condition[1]}
            summary = summarize(values[:, chosen], strata, len(test) / len(train), draws, **of)
            if summary.n_drives:
                yield summary


def summarize(
    values: Array, strata: Sequence[str], test_per_train: float, draws: Draws, **of: str
) -> VariantSummary:
    """Return mean, SD and intervals of scores, shape (trials, drives). ``of`` contains the first fields of the record.

    ``test_per_train`` is the ratio of the numbers of test and training drives.
    """
    each = trial_means(values)
    each = each[~np.isnan(each)]
    return VariantSummary(
        **of,
        mean=float(np.mean(each)) if len(each) else None,
        sd=std(each),
        trial_interval=trial_interval(each),
        corrected_t_interval=corrected_interval(each, test_per_train),
        bootstrap_interval=crossed_bootstrap(values, strata, draws),
        n_trials=len(each),
        n_drives=int(np.count_nonzero(~np.isnan(drive_means(values)))),
    )


def _comparisons(scores: ScoreTable, draws: Draws) -> Iterator[PairedComparison]:
    for protocol in PROTOCOLS:
        others = [v for v in scores.values if v[0] in (NO_PROTOCOL, protocol) and v[1] != MAIN_METHOD]
        for measure in _compared(scores):
            yield from _against(scores, (protocol, MAIN_METHOD), measure, others, draws)


def _compared(scores: ScoreTable) -> list[str]:
    """Return all measures except NIS, since a lower NIS is not better."""
    return [measure for measure in scores.design.config.measures if measure != "nis"]


def _against(
    scores: ScoreTable, variant: Variant, measure: str, others: Sequence[Variant], draws: Draws
) -> Iterator[PairedComparison]:
    """Compare a variant with other variants. ``holm_p`` is corrected over these comparisons."""
    design, (protocol, method) = scores.design, variant
    own = scores.values[variant][measure]
    rows: list[PairedComparison] = []
    for other in others:
        theirs = scores.values[other].get(measure)
        if theirs is not None and np.any(np.isfinite(theirs)):
            of = {"protocol": protocol, "measure": measure, "method": method, "against": other[1]}
            rows.append(compare_paired(own, theirs, design.strata, draws, **of))
    for row, p in zip(rows, holm([row.p for row in rows]), strict=True):
        yield row.model_copy(update={"holm_p": p})


def compare_paired(
    own: Array, theirs: Array, strata: Sequence[str], draws: Draws, **of: str
) -> PairedComparison:
    """Compare the scores of two methods, shape (trials, drives), on the drives where both means are finite.

    ``of`` contains the first fields of the record. ``holm_p`` is not corrected.
    """
    a, b = drive_means(own), drive_means(theirs)
    both = np.isfinite(a) & np.isfinite(b)
    a, b, kept = a[both], b[both], [s for s, k in zip(strata, both, strict=True) if k]
    p = signed_rank(a, b)
    return PairedComparison(
        **of,
        mean_difference=float(np.mean(a - b)) if len(a) else None,
        interval=bootstrap(np.asarray, [a - b], kept, draws),
        p=p,
        holm_p=p,
        rank_biserial=rank_biserial(a - b),
        improvement=float(improvement(a.mean(), b.mean())) if len(a) else None,
        improvement_interval=bootstrap(improvement, [a, b], kept, draws),
        n_drives=len(a),
    )


def _convergences(trials: Trials) -> Iterator[Convergence]:
    best: dict[tuple[str, str, str], list[Array]] = {}
    for task, trial in trials.items():
        best.setdefault((task.protocol, task.method, task.group), []).append(trial.best)
    for (protocol, method, group), each in best.items():
        low, median, high = np.quantile(each, [0.1, 0.5, 0.9], axis=0)
        away = np.flatnonzero(np.abs(median - median[-1]) > 0.01 * abs(median[-1]))
        yield Convergence(
            protocol=protocol,
            method=method,
            group=group,
            low=low.tolist(),
            median=median.tolist(),
            high=high.tolist(),
            stable=int(away[-1]) + 2 if len(away) else 1,
        )


def rival_results(
    trials: Trials,
    networks: Networks,
    less: Mapping[Training, TrainedNetwork],
    scores: ScoreTable,
    elsewhere: Mapping[str, ScoreTable],
    curve: Mapping[str, Array],
) -> RivalResults:
    """Return the results of a study with rivals.

    ``less`` contains networks that were trained on less data, and ``curve`` their scores by measure, shape (networks,
    drives).
    """
    draws = Draws(scores.design.config.seed)
    return RivalResults(
        efforts=list(_efforts(scores.design, trials, networks)),
        gains=list(_gains(scores, networks, draws)),
        elsewhere=list(_elsewhere(elsewhere, scores.design, draws)),
        curve=list(_curve(scores, networks, less, curve, draws)),
    )


def _efforts(design: Design, trials: Trials, networks: Networks) -> Iterator[Effort]:
    """Yield the data and free parameters of each variant. The values of a network include those of its filter."""
    durations = [ready.drive.duration for ready in design.prepared]
    splits = [design.split(trial)[0] for trial in range(design.config.trials)]
    truth = float(np.mean([sum(durations[i] for i in train) for train in splits]))
    numbers: dict[Variant, float] = {task.variant: float(len(trial.point)) for task, trial in trials.items()}
    learned: dict[Variant, float] = {}
    for variant in dict.fromkeys(task.variant for task in networks):
        own = [network for task, network in networks.items() if task.variant == variant]
        learned[variant] = float(np.mean([network.driven for network in own]))
        trained = float(np.mean([network.learned.record.network.numbers for network in own]))
        numbers[variant] = numbers[variant[0], NETWORK_FILTER] + trained
    for (protocol, method), count in numbers.items():
        yield Effort(
            protocol=protocol,
            method=method,
            labelled_s=truth,
            learned_s=learned.get((protocol, method)),
            numbers=count,
        )


def _gains(scores: ScoreTable, networks: Iterable[Task], draws: Draws) -> Iterator[PairedComparison]:
    for protocol, method in dict.fromkeys(task.variant for task in networks):
        for measure in _compared(scores):
            own, alone = (scores.values[protocol, m].get(measure) for m in (method, NETWORK_FILTER))
            if own is None or alone is None or np.allclose(own, alone, rtol=1e-9, atol=0.0, equal_nan=True):
                continue
            yield from _against(scores, (protocol, method), measure, [(protocol, NETWORK_FILTER)], draws)


def _elsewhere(tables: Mapping[str, ScoreTable], home: Design, draws: Draws) -> Iterator[ElsewhereSummary]:
    for place, scores in tables.items():
        ratio = len(scores.design.drives) / len(home.split(0)[0])
        for of, values in scores.columns():
            of |= {"maneuver": ALL, "environment": ALL}
            summary = summarize(values, scores.design.strata, ratio, draws, **of)
            if summary.n_drives:
                yield ElsewhereSummary(place=place, **dict(summary))


def _curve(
    scores: ScoreTable,
    networks: Networks,
    less: Mapping[Training, TrainedNetwork],
    curve: Mapping[str, Array],
    draws: Draws,
) -> Iterator[CurvePoint]:
    """Yield the learning curves of the first trial: no network, then networks trained on increasing amounts of data."""
    for task, whole in networks.items():
        if task.trial:
            continue
        alone, own = (
            {measure: values[0] for measure, values in scores.values[task.protocol, method].items()}
            for method in (NETWORK_FILTER, task.method)
        )
        parts = [
            (results.driven, {measure: values[k] for measure, values in curve.items()})
            for k, (training, results) in enumerate(less.items())
            if training.network == task.method
        ]
        for driven, each in [(0.0, alone), *parts, (whole.driven, own)]:
            for measure, values in each.items():
                known = np.flatnonzero(~np.isnan(values))
                strata = [scores.design.strata[i] for i in known]
                yield CurvePoint(
                    method=task.method,
                    minutes=round(driven / 60.0, 3),
                    measure=measure,
                    mean=float(np.mean(values[known])) if len(known) else None,
                    interval=bootstrap(np.asarray, [values[known]], strata, draws),
                    n_drives=len(known),
                )
