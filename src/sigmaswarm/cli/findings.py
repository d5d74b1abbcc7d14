"""Print a diagnosis on the terminal, and the commands that repair the drive."""

import re
import shlex
import warnings
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sigmaswarm.cli.output import Output, Remark
from sigmaswarm.files import free_path
from sigmaswarm.wording import as_sentence, count_of, printable, sentences

if TYPE_CHECKING:
    from sigmaswarm.datasets.dataset import Dataset
    from sigmaswarm.doctor.findings import Diagnosis, Finding
    from sigmaswarm.drives.drive import Drive
    from sigmaswarm.drives.reader import Location

Remedy = tuple[str, Path | None]
"""Command that repairs or shows the faults in a drive, and folder of the repaired copy (None if there is no copy)."""


def print_diagnosis(
    output: Output,
    diagnosis: "Diagnosis",
    folder: "Location | None" = None,
    printed: "Diagnosis | None" = None,
) -> None:
    """Print the findings about a drive; notes are printed only with ``--verbose``.

    ``folder`` is the folder of the drive, for commands in remedies. For a copy, ``printed`` is the diagnosis of the
    original, whose findings are not printed again.
    """
    known = {(f.code, f.what) for f in printed.findings} if printed else set[tuple[str, str]]()
    faults = [f for f in diagnosis.findings if f.severity != "note"]
    new = [f for f in faults if (f.code, f.what) not in known]
    serious = sum(f.severity == "serious" for f in faults)
    summary = count_of(serious, "SERIOUS fault") if serious else "no serious fault"
    if not serious and "no-start" in {f.code for f in faults}:
        summary = "NO FILTER CAN START"
    summary += f", {count_of(len(faults) - serious, 'warning')}"
    if known_faults := len(faults) - len(new):
        summary += f" ({f'{known_faults} ' if new else ''}printed above)"
    output.show(f"{diagnosis.drive}: {summary}")
    output.show(*(_problem(finding, folder, part=bool(diagnosis.whole)) for finding in new))
    notes = [f for f in diagnosis.findings if f.severity == "note" and (f.code, f.what) not in known]
    output.details("note", *(Remark("note", f"[{f.code}] {as_sentence(f.what)} ({f.where})") for f in notes))


def _problem(finding: "Finding", folder: "Location | None", *, part: bool) -> Remark:
    """Convert a finding to a remark. ``part`` is True for a part of a split drive, which is not repaired alone."""
    remedy = finding.remedy
    if folder is not None and finding.command:
        remedy = remedy.replace(finding.command, _with_names(finding.command, folder))
    (what, *evidence), (remedy, *more) = sentences(finding.what), sentences(remedy)
    start, end = finding.span
    place = f"({finding.where}; t = {start:.1f} to {end:.1f} s; confidence {100 * finding.confidence:.3g}%)"
    fixed = " (or doctor --fix)" if finding.repair and not part and "doctor --fix" not in remedy else ""
    return Remark(
        finding.severity,
        f"[{finding.code}] {as_sentence(what)}",
        as_sentence(finding.consequence),
        remedy.removesuffix(".") + fixed,
        " ".join(as_sentence(text) for text in (*evidence, *more, place)),
    )


def warn_of_serious(
    drives: "Dataset", places: "Sequence[Location]", printed: Collection[str] = ()
) -> list[Remedy]:
    """Warn about faults, in one warning per drive. Return the remedies for serious faults.

    A warning lists the serious faults or, if there are none, the doctor's warnings that need an action. ``printed``
    contains the codes of faults that were printed before.
    """
    from sigmaswarm.doctor.diagnose import diagnose
    from sigmaswarm.errors import SigmaswarmWarning

    remedies: list[Remedy] = []
    for diagnosis, folder in zip(drives.map(diagnose), places, strict=True):
        if diagnosis.serious:
            cut = split_command(diagnosis, folder)
            remedies.append((cut, None) if cut else repair_command(diagnosis, folder))
            codes = ", ".join(f.code for f in diagnosis.findings if f.severity == "serious")
            message = (
                f"{folder}: the doctor finds SERIOUS faults ({codes}), which distort the result; "
                f"run {remedies[-1][0]}, or suppress this warning with --trust-log"
            )
            warnings.warn(message, SigmaswarmWarning, stacklevel=2)
        elif codes := ", ".join(
            f.code
            for f in diagnosis.findings
            if f.severity == "warning" and f.code not in printed and f.needs_action
        ):
            findings = (
                f"the log makes the filter less accurate ({codes}); {_doctor(folder)} describes the faults"
            )
            warnings.warn(f"{folder}: {findings}", SigmaswarmWarning, stacklevel=2)
    return remedies


def split_command(diagnosis: "Diagnosis", folder: "Location") -> str:
    """Return the command that splits a drive, if a serious finding recommends a split; otherwise an empty string."""
    commands = (f.command for f in diagnosis.findings if f.severity == "serious" and f.command)
    return _with_names(next(commands, ""), folder)


def _with_names(command: str, folder: "Location") -> str:
    """Replace the placeholders in a finding's command by the drive and a free folder."""
    names = {"DRIVE": shlex.quote(str(folder)), "parts": str(free_path("parts"))}
    return " ".join(names.get(word, word) for word in command.split())


def affects_axes(diagnosis: "Diagnosis") -> bool:
    """Return True if a finding above the severity "note" concerns the IMU's axes or signs."""
    from sigmaswarm.doctor.repairs import AXIS_ACTIONS

    faults = [finding for finding in diagnosis.findings if finding.severity != "note"]
    return any(f.code == "mounting-changed" or (f.repair and f.repair.action in AXIS_ACTIONS) for f in faults)


def has_repairable(diagnosis: "Diagnosis") -> bool:
    return any(finding.repair and finding.severity != "note" for finding in diagnosis.findings)


def has_unrepairable(diagnosis: "Diagnosis") -> bool:
    return any(finding.severity == "serious" and not finding.repair for finding in diagnosis.findings)


def repair_command(diagnosis: "Diagnosis", folder: "Location") -> Remedy:
    """Return the command that repairs a drive, and the folder of the repaired copy.

    If a serious fault can't be repaired, or there is nothing to repair, return the command that shows the faults, and
    None. For a part of a drive, return the command that repairs the whole drive, if this is possible.
    """
    command = _doctor(folder)
    if diagnosis.whole:
        whole = diagnosis_of_whole(folder)
        return repair_command(*whole) if whole and has_repairable(whole[0]) else (command, None)
    if not has_repairable(diagnosis) or has_unrepairable(diagnosis):
        return command, None
    out = _free(diagnosis)
    return f"{command} --fix {out.parent}", out


def diagnosis_of_whole(part: "Location") -> "tuple[Diagnosis, Path] | None":
    """Diagnose the drive from which a part was split. Return None if the folder of this drive is not found."""
    from sigmaswarm.doctor.diagnose import diagnose
    from sigmaswarm.drives.split import find_whole

    if not (whole := find_whole(part)):
        return None
    drive, folder = whole
    return diagnose(drive), folder


def repair_and_split(diagnosis: "Diagnosis", folder: Path, options: Sequence[str] = ()) -> Iterator[str]:
    """Yield the commands that repair a drive and split the copy with ``options``.

    Yield nothing if the drive needs no repair. If a serious finding requires a split at a certain time, yield only the
    command for this split.
    """
    if cut := split_command(diagnosis, folder):
        yield f"next: {cut}"
        return
    if not (diagnosis.serious or has_repairable(diagnosis)):
        return
    command, copy = exchanging(diagnosis, folder) or repair_command(diagnosis, folder)
    if copy is None:
        yield f"next: {command}    (then correct the serious faults in the log, and split again)"
        return
    yield f"next: {command}    (repair the whole drive, then split again)"
    parts = str(free_path("parts"))
    yield f"then: {shlex.join(['sigmaswarm', 'split', str(copy), '--out', parts, *options])}"


def mirror_maps(diagnosis: "Diagnosis") -> list[str]:
    """Return the arguments of --map, with placeholders, in the remedy for mirrored fixes.

    Return [] if there is no such remedy, or if the doctor can repair the fixes.
    """
    mirrored = (f for f in diagnosis.findings if f.code == "mirrored-fixes" and not f.repair)
    maps = re.search(r'exchange .* --map((?: "[^"]*")+)', next((f.remedy for f in mirrored), ""))
    return re.findall(r'"([^"]*)"', maps[1]) if maps else []


def exchanging(diagnosis: "Diagnosis", folder: "Location") -> Remedy | None:
    """Return the command that corrects mirrored fixes in a copy of a drive, and the folder of the copy.

    Return None if the fixes are not mirrored, or if the doctor can repair the fixes.
    """
    maps = [re.sub(r"COLUMN_OF_([A-Z]+)", lambda m: m[1].lower(), text) for text in mirror_maps(diagnosis)]
    if not maps:
        return None
    out = _free(diagnosis)
    return shlex.join(["sigmaswarm", "import", str(folder), "--out", str(out), "--map", *maps]), out


def _free(diagnosis: "Diagnosis") -> Path:
    return free_path("mended", diagnosis.drive)


def _doctor(folder: "Location") -> str:
    return f"sigmaswarm doctor {shlex.quote(str(folder))}"


def repair_whole(diagnosis: "Diagnosis", part: "Location") -> "tuple[list[str], Location]":
    """Return the steps that repair the whole drive of a part, and the folder of this drive (of the part, if unknown).

    There are no steps if the drive needs no repair.
    """
    if whole := diagnosis_of_whole(part):
        return [*repair_and_split(*whole)], whole[1]
    name = printable(diagnosis.whole)
    return [
        f"next: repair the whole drive {name} (sigmaswarm doctor DRIVE --fix mended), then split again"
    ], part


def too_short_for_outages(drive: "Drive") -> str:
    """Describe a drive that ends before its first outage would begin. Return "" for a longer drive."""
    from sigmaswarm.drives.alignment import StartFailure, find_start
    from sigmaswarm.scoring.targets import OUTAGE_FIRST_AFTER as least

    start = find_start(drive)
    if isinstance(start, StartFailure) or (left := float(drive.imu.time[-1]) - start.time) >= least:
        return ""
    return (
        f"{printable(drive.name)} is too short for a tuning: {left:.1f} s follow the start of a "
        f"filter, and at least {least:g} s are needed"
    )


def velocity_options(diagnosis: "Diagnosis") -> str:
    """Return the options of `tune` that add the receiver's velocity. Return "" if velocity and positions disagree."""
    use = " ".join(finding.what for finding in diagnosis.findings if finding.code == "use")
    options = re.search(r"write (--use .*)$", use)
    return options[1] if options and "velocity" in options[1].split() else ""


def next_steps(diagnosis: "Diagnosis", out: Path, drive: "Drive") -> Iterator[str]:
    """Yield the next commands after a printed diagnosis of a drive, which is in the folder ``out``."""
    from sigmaswarm.drives.split import part_of

    part, ready, repair = part_of(drive), out, ""
    no_start = next((finding for finding in diagnosis.findings if finding.code == "no-start"), None)
    if cut := split_command(diagnosis, out):
        yield from (f"next: {cut}", f"then: sigmaswarm doctor {free_path('parts')} --fix mended")
        return
    if diagnosis.whole and (diagnosis.serious or has_repairable(diagnosis)):
        lines, whole = repair_whole(diagnosis, out)
        if lines:
            yield from lines
            return
        repair = f"{_doctor(whole)}    (the whole drive needs no repair)"
    elif diagnosis.serious or has_repairable(diagnosis):
        repair, copy = exchanging(diagnosis, out) or repair_command(diagnosis, out)
        repair = repair if copy else "correct the serious faults in the log"
        if no_start:
            yield from (f"next: {repair}", "      (then a filter may be able to start)")
            return
        if copy is None:
            yield f"next: {repair}, then check it again"
            return
        ready = copy
    elif no_start:
        yield f"next: {no_start.remedy}"
        return
    elif part != "test" and (short := too_short_for_outages(drive)):
        yield f"next: use a longer drive; {short}"
        return
    why = "    (writes a copy with the repairs that reduce errors)" * (" --fix " in repair)
    yield from [f"next: {repair}{why}"] if repair else []
    then, place = "then" if repair else "next", shlex.quote(str(ready))
    if part == "test":
        yield f"{then}: sigmaswarm evaluate TUNING {place} --out {free_path('evaluation')}"
        yield "      (this part is held out: TUNING is a filter that was tuned on the other part)"
    elif part:
        yield f"{then}: sigmaswarm tune {place} --out {free_path('tuned')}"
        yield "      (keep the other part for the evaluation)"
    else:
        yield f"{then}: sigmaswarm split {place} --out {free_path('parts')}"
        yield f"or, with another drive for the evaluation: sigmaswarm tune {place} --out {free_path('tuned')}"
