"""What a study with rivals says of them: what each took, what it is worth elsewhere, and its learning curve."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.experiments.statistics import bootstrap
from sigmaswarm.experiments.study.config import ALL, BESIDE
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.networks import Taught, Training
from sigmaswarm.experiments.study.record import (
    CurvePoint,
    Effort,
    ElsewhereSummary,
    PairedComparison,
    RivalResults,
)
from sigmaswarm.experiments.study.results import against, compared_measures, resampling, summarize
from sigmaswarm.experiments.study.scores import ScoreTable
from sigmaswarm.tuning.search import Trial


def rival_results(
    trials: Mapping[Task, Trial],
    taught: Mapping[Task, Taught],
    scores: ScoreTable,
    elsewhere: Mapping[str, ScoreTable],
    curve: Mapping[Training, tuple[Taught, Mapping[str, Array]]],
) -> RivalResults:
    """Everything that results.json says of them."""
    return RivalResults(
        efforts=list(_efforts(scores.design, trials, taught)),
        gains=list(_gains(scores, taught)),
        elsewhere=[
            row for place, table in elsewhere.items() for row in _summaries(place, table, scores.design)
        ],
        curve=list(_curve(scores, taught, curve)),
    )


def _efforts(design: Design, trials: Mapping[Task, Trial], taught: Mapping[Task, Taught]) -> Iterator[Effort]:
    """What each variant took: the tunings, and the networks with the filters beside them."""
    labelled = float(np.mean([_labelled(design, trial) for trial in range(design.config.trials)]))
    numbers: dict[tuple[str, str], float] = {}
    for task, trial in trials.items():
        numbers[task.protocol, task.method] = float(len(trial.point))
    for (protocol, method), count in numbers.items():
        effort = Effort(protocol=protocol, method=method, labelled_s=labelled, learned_s=None, numbers=count)
        yield effort
    for protocol, method in dict.fromkeys((task.protocol, task.method) for task in taught):
        own = [t for task, t in taught.items() if (task.protocol, task.method) == (protocol, method)]
        learned = [t.learned.record.network.numbers for t in own]
        yield Effort(
            protocol=protocol,
            method=method,
            labelled_s=labelled,
            learned_s=float(np.mean([t.driven for t in own])),
            numbers=numbers[protocol, BESIDE] + float(np.mean(learned)),
        )


def _gains(scores: ScoreTable, taught: Mapping[Task, Taught]) -> Iterator[PairedComparison]:
    """Each network against its filter, drive by drive; not in what it leaves as it is, but for a sum's last digit."""
    for protocol, method in dict.fromkeys((task.protocol, task.method) for task in taught):
        for measure in compared_measures(scores.design.config):
            own, alone = (scores.values[protocol, m].get(measure) for m in (method, BESIDE))
            if own is None or alone is None or np.allclose(own, alone, rtol=1e-9, atol=0.0, equal_nan=True):
                continue
            yield from against(scores, (protocol, method), measure, [(protocol, BESIDE)])


def _labelled(design: Design, trial: int) -> float:
    """s of driving with truth that a trial's tunings see."""
    drives = [design.prepared[i].drive for i in design.split(trial)[0]]
    return sum(float(drive.imu.time[-1] - drive.imu.time[0]) for drive in drives)


def _summaries(place: str, scores: ScoreTable, home: Design) -> Iterator[ElsewhereSummary]:
    """Of every variant and measure, over all drives of one place."""
    design = scores.design
    ratio = len(design.drives) / len(home.split(0)[0])
    for (protocol, method), measures in scores.values.items():
        for measure, values in measures.items():
            found = summarize(values, design.strata, ratio, resampling(home))
            if found.n_drives:
                of = {"place": place, "protocol": protocol, "method": method, "measure": measure}
                yield ElsewhereSummary(**of, maneuver=ALL, environment=ALL, **dict(found))


def _curve(
    scores: ScoreTable,
    taught: Mapping[Task, Taught],
    curve: Mapping[Training, tuple[Taught, Mapping[str, Array]]],
) -> Iterator[CurvePoint]:
    """Of each network in the first trial: none, less and less of what it learns from left out, and all of it."""
    for task, whole in taught.items():
        if task.trial:
            continue
        alone = {m: values[0] for m, values in scores.values[task.protocol, BESIDE].items()}
        points: list[tuple[float, Mapping[str, Array]]] = [(0.0, alone)]
        points += [
            (less.driven, told) for training, (less, told) in curve.items() if training.network == task.method
        ]
        points.append(
            (whole.driven, {m: values[0] for m, values in scores.values[task.protocol, task.method].items()})
        )
        for driven, told in points:
            for measure, values in told.items():
                yield _point(scores.design, task.method, driven / 60.0, measure, values)


def _point(design: Design, method: str, minutes: float, measure: str, values: Array) -> CurvePoint:
    known = np.flatnonzero(~np.isnan(values))
    strata: Sequence[str] = [design.strata[i] for i in known]
    interval = (
        bootstrap(np.asarray, [values[known]], strata, resampling(design)) if len(known) else (np.nan, np.nan)
    )
    return CurvePoint(
        method=method,
        minutes=round(minutes, 3),
        measure=measure,
        mean=float(np.mean(values[known])) if len(known) else None,
        interval=interval,
        n_drives=len(known),
    )
