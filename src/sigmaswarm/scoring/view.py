"""Tables and sentences of an evaluation, for the terminal, notebooks and the HTML report."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from sigmaswarm import notebook
from sigmaswarm.drives.fingerprint import START_RULE, DriveRecord
from sigmaswarm.scoring.consistency import (
    DOF,
    FORECASTS,
    LEVELS,
    MIN_COVERAGE,
    TRACKING,
    Consistency,
    RadiusRecord,
    describe_ratio,
    factor_of,
    verdicts,
)
from sigmaswarm.scoring.methods import (
    AGAINST,
    BASELINE,
    DRIFTS,
    FIXES,
    FIXES_ALONE_NOTE,
    HOW_TO_COMPARE,
    NO_OUTAGES,
    Measure,
    baseline_note,
    in_sentence,
    measures,
    with_outages,
)
from sigmaswarm.scoring.records import EvaluationRecord, Measured, ScoresRecord
from sigmaswarm.scoring.remarks import (
    describe_drives,
    estimate_position_errors,
    partly_scored,
    restarted,
    worse_than_raw,
    worse_than_untuned,
)
from sigmaswarm.scoring.score import MIN_HEADING_SPEED
from sigmaswarm.scoring.targets import LONG_OUTAGE_LENGTH, OUTAGE_FIRST_AFTER, SHORT_OUTAGE_LENGTH
from sigmaswarm.tables import Cell, Column, Table
from sigmaswarm.wording import as_sentence, describe_change, describe_pair

LATE_START = 5.0  # s from the start of a drive; if the scores start later, this is reported
NO_TRUTH = (
    "there is no truth, so errors of position and heading are unknown. A drift is the distance from a fix that was "
    "hidden from the filter, so it includes the error of this fix. The mean NIS shows whether the tuned filter's "
    "predictions of the fixes are as accurate as its covariances state"
)


@dataclass(frozen=True, eq=False)
class EvaluationView:
    """Tables and sentences of an evaluation. ``names`` are the display names of the methods, in order."""

    scores: ScoresRecord
    setup: EvaluationRecord
    names: Mapping[str, str]

    @property
    def measures(self) -> Mapping[str, Measure]:
        return measures(self.setup.outage_length_s)

    @property
    def without_truth(self) -> bool:
        return all(drive.has_truth is False for drive in self.setup.data)

    def best_baseline(self, measure: str) -> str | None:
        known = {m: v for m in ("raw_gps", FIXES, BASELINE) if (v := self.scores.mean_of(m, measure))}
        return min(known, key=known.__getitem__, default=None)

    # ---- tables ----

    def mean_table(self) -> Table:
        means = self.scores.mean
        return self._table("Mean over drives", [("mean", m, "", means[m]) for m in self.names if m in means])

    def drive_table(self) -> Table:
        failed = self.scores.failed
        rows = [
            (drive, m, " (failed)" * (m in failed.get(drive, ())), by_method[m])
            for drive, by_method in self.scores.drives.items()
            for m in self.names
            if m in by_method
        ]
        return self._table("Each drive", rows)

    def _table(self, caption: str, rows: Sequence[tuple[str, str, str, Measured]]) -> Table:
        """Return a table from rows (drive, method, remark, scores)."""
        methods, known = self.scores.known(self.names, self.measures)
        rows = [(d, m, r, with_outages(m, scores)) for d, m, r, scores in rows if m in methods]
        rows = [row for row in rows if row[1] != "imu_only" or any(row[3].get(m) is not None for m in known)]
        columns = Column("drive"), Column("method"), *(_column(self.measures[m]) for m in known)
        strong = frozenset(i for i, row in enumerate(rows) if row[1] == "tuned")
        cells = tuple(
            (drive, self.names[m] + remark, *map(scores.get, known)) for drive, m, remark, scores in rows
        )
        return Table(caption, columns, cells, strong)

    def drift_table(self) -> Table:
        drifts = self.scores.drifts
        known = [m for m in self.measures if any(m in by_measure for by_measure in drifts.values())]
        columns = [Column("drive"), Column("method")]
        for m in known:
            columns += [Column("outages"), _column(self.measures[m]), Column("range over placements", "m")]
        rows: list[tuple[Cell, ...]] = []
        for drive, by_measure in drifts.items():
            for method in (m for m in self.names if m not in NO_OUTAGES and m in self.scores.mean):
                cells: list[Cell] = []
                for m in known:
                    one, value = by_measure.get(m), self.scores.drives[drive].get(method, {}).get(m)
                    cells += [one and float(one.outages), value, one and one.drift_range(method)]
                rows.append((drive, self.names[method], *cells))
        strong = frozenset(i for i, row in enumerate(rows) if row[1] == self.names["tuned"])
        caption = "RMS drifts over all random placements of the outages"
        return Table(caption, tuple(columns), tuple(rows), strong)

    def consistency_table(self) -> Table:
        columns: list[tuple[Column, Callable[[Consistency], Cell]]] = [
            (Column("fixes"), lambda c: c.n_fixes),
            (Column("mean NIS"), lambda c: c.mean_nis),
            (Column("consistent"), lambda c: c.nis_band),
            (Column("in 95% gate", "%", "{:.0f}".format), lambda c: 100 * c.inside_gate),
            *([] if self.without_truth else [(Column("mean NEES"), lambda c: c.mean_nees)]),
            (Column("correlation", number="{:+.2f}".format), lambda c: c.autocorrelation[0]),
            (Column("whiteness p", number="{:.2g}".format), lambda c: c.white_p),
        ]
        rows = tuple(
            (drive, *(c and value_of(c) for _, value_of in columns))
            for drive, c in self.scores.consistency.items()
        )
        return Table("", (Column("drive"), *(column for column, _ in columns)), rows)

    def radius_table(self) -> Table:
        columns = [Column(f"{level} radius", "m") for level in ("95%", "99.9%")]
        columns.append(Column("correlated fix error", "m"))
        if not self.without_truth:
            inside = [Column(f"in {level} radius", "%", "{:.1f}".format) for level in ("95%", "99.9%")]
            columns += [Column("number of errors", number="{:.0f}".format), *inside]
            columns.append(Column("filter's standard deviation"))

        def cells(record: RadiusRecord) -> tuple[Cell, ...]:
            near, far, ratio = record.inside_95, record.inside_999, record.sigma_ratio
            known: tuple[Cell, ...] = (None,) * 4
            if near is not None and far is not None and ratio is not None:
                known = (float(record.n), 100 * near, 100 * far, describe_ratio(ratio))
            return (record.radius_95_m, record.radius_999_m, record.lasting_m, *known)[: len(columns)]

        shown = self.measures
        where = {m: shown[m].title.removesuffix(" drift") for m in DRIFTS if m in shown}
        where = {TRACKING: "all fixes"} | where
        rows = tuple(
            (drive, where[key], *cells(record))
            for drive, records in self.scores.radius.items()
            for key, record in records.items()
            if key in where
        )
        return Table("Stated radius of the position", (Column("drive"), Column("case"), *columns), rows)

    # ---- sentences ----

    def result(self) -> str:
        """Return a sentence on the position error, or on the drift in outages if there is no truth."""
        drives, mean_of = describe_drives(self.setup.data), self.scores.mean_of
        for measure, what in (
            ("position_rmse_m", "has a position RMSE of {} m"),
            ("outage_drift_m", f"has a drift of {{}} m in outages of {self.setup.outage_length_s:g} s"),
        ):
            tuned = mean_of("tuned", measure)
            if tuned is None:
                continue
            rivals = AGAINST, self.best_baseline(measure)  # a comparison with a bad method proves little
            comparisons = [
                _compared(tuned, value, in_sentence(m, self.names[m]))
                for m in rivals
                if m and (value := mean_of(m, measure))
            ]
            compared = f", {' and '.join(comparisons)}," if comparisons else ""
            return f"The tuned filter {what.format(f'{tuned:.3g}')}{compared} on {drives}."
        if any(mean_of("tuned", measure) is not None for measure in DRIFTS):
            return (
                f"On {drives}, there is no time for an outage of {(length := self.setup.outage_length_s):g} s; use a "
                f"part with at least {_least(length):g} s after the start of the filter."
            )
        return f"On {drives}, the tuned filter failed, or there is no truth, so scores are missing."

    def _not_better(self) -> dict[str, str]:
        """Return a message for each method with at most the drift or heading error of the tuned filter."""
        mean_of = self.scores.mean_of
        messages: dict[str, str] = {}
        for method in (m for m in (AGAINST, FIXES, BASELINE) if m in self.names):
            name = in_sentence(method, self.names[method])
            lost = [
                f"{self.measures[m].title} ({describe_pair(tuned, other, self.measures[m].unit)})"
                for m in (*DRIFTS, *["heading_rmse_deg"] * (method != FIXES))
                if m in self.measures
                and (tuned := mean_of("tuned", m)) is not None
                and (other := mean_of(method, m)) is not None
                and tuned >= other
            ]
            if lost:
                messages[method] = f"the tuned filter is NOT better than {name} in the {', '.join(lost)}"
        return messages

    def coverage(self) -> tuple[str, ...]:
        data = self.setup.data
        late = [f"{t:.0f} s into {d.name}" for d in data if (t := d.scored_from_s or 0.0) > LATE_START]
        without_truth = [drive.name for drive in data if drive.has_truth is False]
        sentences = [f"Filters and scores start {', '.join(late)}, at {START_RULE}."] if late else []
        sentences += map(as_sentence, partly_scored(data))
        sentences += [f"{', '.join(without_truth)}: {NO_TRUTH}."] if without_truth else []
        sentences += map(as_sentence, estimate_position_errors(self.scores, data))
        sentences += [
            f"{name}: no filter used {n} of the fixes, since they are stale: they repeat an earlier fix, although the "
            "vehicle may have moved."
            for name, n in self.scores.stale_fixes.items()
        ]
        return tuple(sentences)

    def explanations(self) -> tuple[str, ...]:
        methods = self.scores.mean
        fitted = "the training drives" if self.setup.fixes_alone else "each drive"
        return (
            *([f"{baseline_note(self.names['tuned'])}."] if BASELINE in methods else []),
            *([f"{FIXES_ALONE_NOTE.format(fitted)}."] if FIXES in methods else []),
            *([] if AGAINST in methods else [f"{HOW_TO_COMPARE}."]),
        )

    def radii(self) -> tuple[str, ...]:
        sentences: list[str] = []
        for drive, records in self.scores.radius.items():
            if (record := records.get(TRACKING)) is None:
                continue
            inside, ratio = record.inside_95, record.sigma_ratio
            coverage = "" if inside is None else f", and {100 * inside:.0f}% are"
            own = "" if ratio is None else f" The filter's own standard deviation is {describe_ratio(ratio)}."
            lasting = f" This radius includes correlated fix errors of {record.lasting_m:.2g} m per axis."
            sentences.append(
                f"{drive}: 95% of the position errors should be within {record.radius_95_m:.2g} m (median radius)"
                f"{coverage}.{lasting * bool(record.lasting_m)}{own}"
            )
        return tuple(sentences)

    def verdicts(self) -> dict[str, str]:
        """Return a sentence for each kind of verdict. Drives on which the filter failed are omitted: see `warnings`."""
        failed = {drive for drive, methods in self.scores.failed.items() if "tuned" in methods}
        kinds = verdicts([one for drive, one in self.scores.consistency.items() if drive not in failed])
        return {kind: as_sentence(message) for kind, message in kinds.items()}

    def warnings(self) -> tuple[str, ...]:
        """Return the warnings as sentences, the most serious first."""
        data = self.setup.data
        sentences: list[str] = []
        if any(drive.seen_s for drive in data):
            sentences += [
                "the evaluation uses training data of the filter, so expect larger errors on other drives"
            ]
        if failed := [drive for drive, methods in self.scores.failed.items() if "tuned" in methods]:
            sentences.append(f"the tuned filter failed on {', '.join(failed)}")
        sentences += worse_than_raw(self.scores)
        sentences += (self._not_better() | worse_than_untuned(self.scores, self.measures)).values()
        sentences += restarted(self.scores)
        sentences += [
            f"on {drive} the stated 95% radius contains only {100 * record.inside_95:.0f}% of the position errors"
            for drive, by_pass in self.scores.radius.items()
            if (record := by_pass.get(TRACKING))
            and record.inside_95 is not None
            and record.inside_95 < MIN_COVERAGE
        ]
        sentences += self.setup.truth_offsets.values()
        return tuple(map(as_sentence, (*sentences, *self._one_drive())))

    def _one_drive(self) -> tuple[str, ...]:
        data = self.setup.data
        known = data[0].duration_s if len(data) == 1 else None
        return (
            (f"The scores are from one drive of {known:.0f} s, and may differ on other drives.",)
            if known
            else ()
        )

    def findings(self) -> tuple[str, ...]:
        return tuple(
            as_sentence(message) for messages in self.setup.findings.values() for message in messages
        )

    def sentences(self, added: Iterable[str] = ()) -> tuple[str, ...]:
        """Return the sentences below a table, the most important first. The sentences ``added`` follow the verdicts."""
        positions = map(as_sentence, estimate_position_errors(self.scores, self.setup.data))
        one_drive = self._one_drive()
        first = (
            self.result(),
            *(warning for warning in self.warnings() if warning not in one_drive),
            *positions,
            *one_drive,
            *self.verdicts().values(),
            *added,
            *self.radii(),
        )
        second = (*self.coverage(), *self.drifts(), *self.explanations())
        return tuple(dict.fromkeys((*first, *second)))

    def outage_lengths(self) -> set[float]:
        """Return the lengths, s, of the outages that the evaluation of the tuned filter contains."""
        lengths = SHORT_OUTAGE_LENGTH, self.setup.outage_length_s, LONG_OUTAGE_LENGTH
        known = zip(DRIFTS, lengths, strict=True)
        return {length for m, length in known if self.scores.mean_of("tuned", m) is not None}

    def missing_scores(self) -> tuple[str, ...]:
        """Return a sentence for each drift that is missing for some drives, and for a missing heading error."""
        slow = f"did not exceed {MIN_HEADING_SPEED:g} m/s according to the truth"
        lengths = SHORT_OUTAGE_LENGTH, self.setup.outage_length_s, LONG_OUTAGE_LENGTH
        reasons = {
            m: f"can't contain such an outage, which needs {_least(length):g} s after the start of the filter"
            for m, length in zip(DRIFTS, lengths, strict=True)
        }
        reasons |= {"heading_rmse_deg": slow}
        without_truth = {drive.name for drive in self.setup.data if not drive.has_truth}
        sentences: list[str] = []
        for m, reason in reasons.items():
            lacking = [
                drive
                for drive, of in self.scores.drives.items()
                if m in self.measures and all(values.get(m) is None for values in of.values())
            ]
            if lacking := [drive for drive in lacking if m in DRIFTS or drive not in without_truth]:
                drives = lacking[0] if len(lacking) == 1 else f"{len(lacking)} drives"
                sentences.append(f"No {self.measures[m].title}: {drives} {reason}.")
        return tuple(sentences)

    def drifts(self) -> tuple[str, ...]:
        return tuple(
            f"{measure.title} of the tuned filter: {drift:.3g} m. {described}."
            for m, measure in self.measures.items()
            if (drift := self.scores.mean_of("tuned", m)) is not None
            and (described := self.scores.describe_drift(m))
        )

    # ---- notebooks and print ----

    def to_text(self) -> str:
        """Return at most 15 lines for `print`."""
        table = self.mean_table()
        methods = replace(table, columns=table.columns[1:], rows=tuple(row[1:] for row in table.rows))
        return "\n".join([self.result(), methods.to_text(), *self.warnings()[:3]])

    def to_html(self) -> str:
        by_drive, remarks = self.drive_table().to_html(), notebook.html_list("Warnings:", self.warnings())
        if len(self.scores.drives) == 1:
            return by_drive + remarks
        details = f"<details><summary>each drive</summary>{by_drive}</details>"
        return f"{self.mean_table().to_html()}{remarks}{details}"


def accuracy_section(view: EvaluationView) -> str:
    """Return the section on accuracy in README.md of an exported configuration of robot_localization."""
    names = {**view.names, BASELINE: "default process noise, same inputs", "tuned": "ekf.yaml"}
    named = replace(view, names=names)
    drives = ", ".join(view.scores.drives)
    return "\n".join([f"\n## Accuracy on {drives}\n", named.mean_table().to_markdown(), named.result(), ""])


def explained_consistency(nees: bool) -> str:
    what = "the mean of NIS is"
    if nees:
        what = "the means of NIS (predictions of the fixes) and NEES (errors) are"
    return (
        f"This table shows whether the tuned filter's {'predictions and errors' if nees else 'predictions'} agree "
        f"with its covariances. If they do, {what} 2. Above 2 the filter is overconfident, below 2 underconfident."
        f"{'' if nees else f' {FORECASTS}.'} Innovations of a consistent filter are white: they are not "
        "correlated from fix to fix. p is the probability that white innovations are at least as correlated as these "
        "(Ljung-Box test, lags of 1 to 10 fixes). A p below 0.01 means that innovations are correlated. The cause is "
        "usually the receiver: correlated errors of the fixes average out less than the filter assumes."
    )


def explained_radius() -> str:
    factors = [factor_of(level) for level in LEVELS]
    return (
        "With a probability of 95% or 99.9%, the position error should lie within the corresponding radius. The radii "
        "in the table are medians over the drive. The variance per axis is the sum of the filter's variance and the "
        "variance of correlated fix errors. The variance of correlated fix errors is the total variance of the fixes "
        "minus the variances of their white noise and of the errors that the filter models. The total is the square "
        "of the stated standard deviation. If none is stated, the total is the variance of the white noise or, if this "
        "noise is small, the square of 2.1 m. The radii are "
        f"{factors[0]:.2f} and {factors[1]:.2f} standard deviations, from Student's t with {DOF:g} degrees of freedom, "
        "since a covariance is tuned with few independent errors of a training drive. Covariances in estimates and "
        "exports are those of the filter, without correlated fix errors."
    )


def explained_scores(view: EvaluationView) -> str:
    with_truth = view.scores.known(view.names, view.measures)[1][0] == "position_rmse_m"
    drifts = rmse = ""
    if view.scores.drifts:
        drifts = (
            " For the drift, each method runs again with hidden fixes, for up to eight random placements of the "
            "outages. The drift is the RMS error at the ends of all outages."
        )
        if not with_truth:
            drifts += " Since there is no truth, the drift is relative to the hidden fixes and includes their errors."
    if with_truth:
        rmse = " RMSE: square root of the mean squared error. 50% and 95%: quantiles of the position error."
    return (
        f"Lower is better. Outages last {SHORT_OUTAGE_LENGTH:g}, {view.setup.outage_length_s:g} and "
        f"{LONG_OUTAGE_LENGTH:g} s.{drifts}{rmse} "
        'The method "IMU only" uses no fixes after the start of the filter, so it has no outage drift.'
    )


def with_training(drive: DriveRecord, tuned_on: Sequence[DriveRecord]) -> DriveRecord:
    """Mark a drive as a training drive if it has the hash of a training drive.

    For other drives ``seen_s`` stays unknown, since they may contain a part of a training drive.
    """
    same = [one.name for one in tuned_on if one.sha256 == drive.sha256 and one.sha256]
    if drive.seen_s is not None or not same:
        return drive
    return drive.model_copy(update={"seen_s": drive.duration_s or 0.0, "seen_in": same})


def _compared(tuned: float, other: float, name: str) -> str:
    change = describe_change(100 * (other - tuned) / other, "lower", "HIGHER")
    return f"{change} {name} ({other:.3g} m)"


def _least(length: float) -> float:
    """Return the shortest time, s, from the start of a filter to the end of an outage."""
    return OUTAGE_FIRST_AFTER + length


def _column(measure: Measure) -> Column:
    return Column(measure.title, measure.unit)
