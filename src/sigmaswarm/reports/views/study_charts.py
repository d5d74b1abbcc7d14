"""The charts of a study: means with their intervals, spread over drives, and convergence."""

from collections.abc import Sequence
from math import inf, nan
from typing import Literal

from sigmaswarm.experiments.study.config import ALL, UNTUNED
from sigmaswarm.experiments.study.record import Convergence, Interval, Results, Spread
from sigmaswarm.reports.style import GREEN, SLATE, STUDY_LOOKS
from sigmaswarm.reports.views.charts import (
    Axis,
    Band,
    Boxes,
    Chart,
    Curve,
    Intervals,
    Look,
    Mark,
    Points,
    Rule,
    short_number,
)

COLORS = {
    UNTUNED: SLATE,
    "paper": STUDY_LOOKS["paper-pso-ukf"].color,
    "honest": STUDY_LOOKS["honest-pso-ukf"].color,
}
"""Colors of the protocols."""
REACH = 12
"""The scale ends at this multiple of the lowest mean, so that the good ones can be told apart."""


def means_chart(
    results: Results, measure: str, reach: float = REACH, mark: float | None = None
) -> Chart | None:
    """Draw the means of every method with two intervals, on a logarithmic scale."""
    rows = [(row, row.mean) for row in results.means(measure) if row.mean]
    if not rows:
        return None
    means = [mean for _, mean in rows]
    low, high = min(means) / 3, min(min(means) * reach, 2 * max(means))
    wide, narrow = (
        [getattr(row, name) for row, _ in rows] for name in ("bootstrap_interval", "trial_interval")
    )
    points = Points(
        x=[min(mean, high) for mean in means],
        y=range(len(rows)),
        look=Look(SLATE, dash="none", symbol="circle", size=6.75),
        colors=tuple(COLORS[row.protocol] for row, _ in rows),
        symbols=tuple("triangle-right" if mean > high else "circle" for mean in means),
        texts=tuple(short_number(mean) if mean > high else "" for mean in means),
        hovers=tuple(
            f"{results.label(row.method, row.protocol)}: {mean:.3g}\n95% for new drives: {_text(far)}"
            f"\n95% over trials: {_text(near)}"
            for (row, mean), far, near in zip(rows, wide, narrow, strict=True)
        ),
    )
    known = [mean <= high for mean in means]
    marks: list[Mark] = [
        _intervals(
            narrow, known, (low, high), Look(SLATE, 7.0, opacity=0.4), "95% over trials, as in the paper"
        ),
        _intervals(wide, known, (low, high), Look(SLATE, 1.5), "95% for new drives (bootstrap)"),
        points,
    ]
    return Chart(
        results.measures[measure],
        (*_rule(mark), *marks),
        x=Axis(scale="log", range=(low, 1.15 * high)),
        y=Axis(categories=tuple(results.label(row.method, row.protocol) for row, _ in rows)),
        broad=True,
    )


def _text(interval: Interval) -> str:
    low, high = interval
    return "–" if low is None or high is None else f"{low:.3g} to {high:.3g}"


def _intervals(
    each: Sequence[Interval], known: Sequence[bool], reach: tuple[float, float], look: Look, name: str
) -> Intervals:
    """Draw the intervals of the means on the scale, cut at its ends."""
    shown = [
        (max(low, reach[0]), min(high, reach[1]))
        if near and low is not None and high is not None
        else (nan, nan)
        for (low, high), near in zip(each, known, strict=True)
    ]
    lows, highs = zip(*shown, strict=True)
    return Intervals("x", range(len(each)), lows, highs, look, name)


def _rule(mark: float | None) -> tuple[Rule, ...]:
    return () if mark is None else (Rule("x", mark, Look(SLATE, 1.0, "dash")),)


def spread_chart(
    results: Results,
    spreads: Sequence[Spread],
    measure: str,
    mark: float | None = None,
    *,
    all_rows: bool = False,
) -> Chart | None:
    """Draw boxes over the drives (quartiles, whiskers from 5 to 95%) on a logarithmic scale.

    ``all_rows``: include methods without this measure.
    """
    rows = [s for s in spreads if s.measure == measure and s.high > 0]
    if not rows:
        return None
    of = spreads if all_rows else rows
    names = list(dict.fromkeys(results.label(s.method, s.protocol) for s in of))
    boxes: list[Boxes] = []
    for protocol in dict.fromkeys(s.protocol for s in rows):
        own = [s for s in rows if s.protocol == protocol]
        quantiles = ([getattr(s, name) for s in own] for name in ("low", "first", "median", "third", "high"))
        places = [names.index(results.label(s.method, protocol)) for s in own]
        boxes.append(Boxes("x", places, *quantiles, look=Look(COLORS[protocol], opacity=0.6)))
    failed = sum(s.failed for s in rows)
    note = f" ({failed} drives on which a filter failed left out)" if failed else ""
    return Chart(
        f"{results.measures[measure]}{note}",
        (*_rule(mark), *boxes),
        x=Axis(scale="log"),
        y=Axis(categories=tuple(names)),
        broad=True,
    )


def convergence_chart(
    results: Results,
    protocol: str,
    methods: Sequence[str] = (),
    scale: Literal["linear", "log"] = "log",
) -> Chart | None:
    """Draw the best cost after each generation, of all methods or of some: the paper's Fig. 2."""
    mine = [c for c in results.convergence if c.protocol == protocol and c.method in (methods or [c.method])]
    if any(c.group != ALL for c in mine):  # a line a condition: only one method finds room
        mine = [c for c in mine if c.method == mine[0].method]
    if not mine:
        return None
    objective = results.protocols[protocol].objective
    return Chart(
        f"Cost over generations, {protocol}",
        tuple(mark for c in mine for mark in _course(results, c, alone=len(mine) == 1)),
        x=Axis("generation"),
        y=Axis(f"cost: {objective}, m", scale, (0 if scale == "linear" else None, None)),
    )


def _course(results: Results, course: Convergence, *, alone: bool) -> list[Mark]:
    """Draw the middle 80% of the trials, their median, and where it settles."""
    key = f"{course.protocol}-{course.method}"
    color = STUDY_LOOKS[key].color if key in STUDY_LOOKS else GREEN
    whole = course.group == ALL
    low, middle, high = (
        [inf if v is None else v for v in values] for values in (course.low, course.median, course.high)
    )
    x, theirs = range(1, len(middle) + 1), results.paper["figure_2"]["stable_generation"]
    band = Band(x, low, high, Look(color, opacity=0.15), "10 to 90% of the trials" if alone else "")
    name = "median" if alone else results.label(course.method) if whole else course.group
    settled = Points(
        [course.stable],
        [middle[course.stable - 1]],
        Look(color, dash="none", symbol="diamond", size=6.75),
        f"within 1% from generation {course.stable} on (the paper: {theirs})" if alone else "",
        hovers=(f"within 1% of its end from generation {course.stable} on",),
    )
    return [*([band] if whole else []), Curve(x, middle, Look(color, 2.0), name), settled]
