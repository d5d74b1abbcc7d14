"""Print a diagnosis on the terminal, and the commands that repair the drive."""

import re
import shlex
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sigmaswarm.cli.terminal import console
from sigmaswarm.files import free_path
from sigmaswarm.wording import count_of, printable

if TYPE_CHECKING:
    from sigmaswarm.datasets.dataset import Dataset
    from sigmaswarm.doctor.findings import Diagnosis, Finding
    from sigmaswarm.drives.drive import Drive
    from sigmaswarm.drives.reader import Location

Remedy = tuple[str, Path | None]
"""Command that repairs or shows the faults of a drive; folder of the repaired copy, or None if there is no copy."""
_STYLES = {"serious": "bold red", "warning": "yellow", "note": "dim"}


def print_diagnosis(
    diagnosis: "Diagnosis", explained: set[str] | None = None, folder: "Location | None" = None
) -> None:
    """Print the findings about a drive.

    ``explained``: messages that were printed before. A note that was printed before is only counted; new messages are
    added to the set. ``folder``: folder of the drive, for commands in remedies.
    """
    from rich.table import Table
    from rich.text import Text

    serious, warned, noted = (sum(f.severity == s for f in diagnosis.findings) for s in _STYLES)
    summary = f"{count_of(serious, 'SERIOUS fault')}" if serious else "no serious fault"
    summary += f", {count_of(warned, 'warning')}, {count_of(noted, 'note')}"
    out = console(soft_wrap=True)
    out.print(Text.assemble((diagnosis.drive, "bold"), f": {summary}"))
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(width=9)
    table.add_column(overflow="fold")
    explained, repeated = set() if explained is None else explained, 0
    for finding in diagnosis.findings:
        message = _in_words(finding, part=bool(diagnosis.whole))
        message = message if folder is None else _with_names(message, folder)
        if finding.severity == "note" and message in explained:
            repeated += 1
            continue
        explained.add(message)
        table.add_row(Text(f"  {finding.severity}", _STYLES[finding.severity]), Text(message))
    if repeated:
        table.add_row(Text("  note", _STYLES["note"]), Text(f"{count_of(repeated, 'note')} printed above."))
    out.print(table)
    out.print()


def _in_words(finding: "Finding", *, part: bool) -> str:
    """Format a finding as three lines (fault; place and confidence; remedy), or a note as one line.

    ``part``: True for a part of a split drive, which is not repaired alone.
    """
    what = f"{finding.what[0].upper()}{finding.what[1:]}."
    if finding.severity == "note":
        return f"{what} [{finding.where}]"
    start, end = finding.span
    return (
        f"{what}\n"
        f"[{finding.code}] {finding.where}; t = {start:.1f} to {end:.1f} s; "
        f"confidence {100 * finding.confidence:.3g}%\n"
        f"-> {finding.remedy}{' (--fix does this)' if finding.repair and not part else ''}"
    )


def warn_of_serious(drives: "Dataset", places: "Sequence[Location]") -> list[Remedy]:
    """Warn about faults, in one warning per drive; return the remedies for serious faults.

    A warning lists the serious faults or, if there are none, the doctor's warnings.
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
        elif warned := [f.code for f in diagnosis.findings if f.severity == "warning"]:
            findings = f"the doctor warns of {', '.join(warned)}; for details run {_doctor(folder)}"
            warnings.warn(f"{folder}: {findings}", SigmaswarmWarning, stacklevel=2)
    return remedies


def split_command(diagnosis: "Diagnosis", folder: "Location") -> str:
    """Return the command that splits a drive, if a serious finding recommends a split; otherwise an empty string."""
    remedies = [finding.remedy for finding in diagnosis.findings if finding.severity == "serious"]
    match = re.search(r"sigmaswarm split DRIVE --at \S+ --out parts", " ".join(remedies))
    return _with_names(match[0], folder) if match else ""


def _with_names(text: str, folder: "Location") -> str:
    """Insert the drive and a free folder in the command that splits a drive."""
    return re.sub(
        r"(sigmaswarm split )DRIVE( --at [\d. ]+ --out )parts",
        lambda found: f"{found[1]}{shlex.quote(str(folder))}{found[2]}{free_path('parts')}",
        text,
    )


def affects_axes(diagnosis: "Diagnosis") -> bool:
    """Return True if a finding about the axes or signs of the IMU is serious or a warning."""
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
    """Diagnose the drive from which a part was split; None if its folder is not found."""
    from sigmaswarm.cli.whole_drive import find_whole
    from sigmaswarm.doctor.diagnose import diagnose

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
    """Return the steps that repair the whole drive of a part, and the folder of that drive (if unknown, of the part).

    There are no steps if the drive needs no repair.
    """
    if whole := diagnosis_of_whole(part):
        return [*repair_and_split(*whole)], whole[1]
    name = printable(diagnosis.whole)
    return [
        f"next: repair the whole drive {name} (sigmaswarm doctor DRIVE --fix mended), then split again"
    ], part


def too_short_for_outages(drive: "Drive") -> str:
    """Describe a drive that ends before its first outage would begin; return "" for a longer drive."""
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
    """Return the options of `tune` that add the receiver's velocity, if it agrees with the positions; else ""."""
    use = " ".join(finding.what for finding in diagnosis.findings if finding.code == "use")
    options = re.search(r"write (--use .*)$", use)
    return options[1] if options and "velocity" in options[1].split() else ""


def with_velocity(diagnosis: "Diagnosis") -> list[str]:
    """Return the lines after the command of a tuning, if the log has a velocity that `tune` does not use by default."""
    if not (options := velocity_options(diagnosis)):
        return []
    reason = "the log has the receiver's velocity, which may reduce the errors, but tune does not use it by default"
    return [
        f"      ({reason}; tune a second filter with {options}, and compare both with evaluate --against)"
    ]


def next_steps(diagnosis: "Diagnosis", out: Path, drive: "Drive") -> Iterator[str]:
    """Yield the next steps after a printed diagnosis of a drive, which is in the folder ``out``."""
    from sigmaswarm.drives.split import part_of

    part = part_of(drive)
    ready, following = out, f"sigmaswarm plot {shlex.quote(str(out))}"
    if cut := split_command(diagnosis, out):
        yield from (f"next: {cut}", f"then: sigmaswarm doctor {free_path('parts')} --fix mended")
        return
    if diagnosis.whole and (diagnosis.serious or has_repairable(diagnosis)):
        lines, whole = repair_whole(diagnosis, out)
        if lines:
            yield from lines
            return
        following = f"{_doctor(whole)}    (the whole drive needs no repair)"
    elif diagnosis.serious or has_repairable(diagnosis):
        command, copy = exchanging(diagnosis, out) or repair_command(diagnosis, out)
        go_on = f"{command}    (then continue with {copy}, not with {out})"
        following, ready = (go_on, copy) if copy else ("correct the serious faults in the log", out)
    elif no_start := next((finding for finding in diagnosis.findings if finding.code == "no-start"), None):
        yield f"next: {no_start.remedy}"
        return
    elif part != "test" and (short := too_short_for_outages(drive)):
        yield f"next: use a longer drive; {short}"
        return
    yield f"next: {following}"
    if part == "test":
        yield f"then: sigmaswarm evaluate TUNING {shlex.quote(str(ready))} --out {free_path('evaluation')}"
        yield "      (this part is held out: TUNING is a filter that was tuned on the other part)"
        return
    if part:
        yield f"then: sigmaswarm tune {shlex.quote(str(ready))} --out {free_path('tuned')}"
        yield "      (keep the other part for the evaluation)"
        yield from with_velocity(diagnosis)
        return
    yield f"then: sigmaswarm split {shlex.quote(str(ready))} --out {free_path('parts')}"
    tune = f"sigmaswarm tune {shlex.quote(str(ready))} --out {free_path('tuned')}"
    yield f"      (if you have another drive for the evaluation, run this command instead of split: {tune})"
    yield from with_velocity(diagnosis)
