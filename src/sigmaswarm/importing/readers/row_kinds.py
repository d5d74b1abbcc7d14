"""Refuse texts with rows of several kinds, such as "IMU,..." and "GPS,...", with a command that separates them."""

import re
from collections.abc import Sequence
from pathlib import Path
from shlex import quote

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.wording import list_names

MAX_KINDS = 20
MAX_ROWS = 20_000  # largest number of rows that are examined
_WORDS = ("0", "no", "none", "false", "void", "invalid")
# Flags of rows without a fix, and the form of other flags, in lower case; 1, 2 and 3 mean no fix, a 2D fix and a 3D fix
NO_FIX: dict[str, str] = {
    **dict.fromkeys(_WORDS, r"\w+"),
    "1": "[23]",
    "v": "[ad]",
    "n": "[yadefr]",
    "f": "t",
}
KIND_CELLS = 2  # the kind is in the first or second cell, perhaps after a time
_SENSOR = re.compile("acc|gyr|imu", re.IGNORECASE)
_WORD, _CODE = re.compile(r" *\$?([A-Za-z]\w*)(?= *$|:)"), re.compile(r" *(\d{1,3}|[A-Za-z]\w*) *$")


def require_one_kind(rows: Sequence[Sequence[str]], separator: str, shown_as: Path) -> None:
    """Raise an `InputError` if rows state their kind, and the kinds have different numbers of cells."""
    for place in range(KIND_CELLS):
        kinds = _words(rows) if place == 0 else {}
        if (kinds := kinds or _codes(rows, place)) and not _are_cut(rows, place):
            break
    else:
        return
    marked = all(re.match(r"[ $]*\w+:", row[place]) for row in rows)
    keep = f'k=${place + 1}; sub(/^[$ ]+/,"",k); sub(/[^A-Za-z0-9_].*/,"",k);{" sub(/:/,FS);" * marked}'
    keep += r' sub(/\*[0-9A-Fa-f]+\r?$/,"");' * any(re.search(r"\*[0-9A-Fa-f]+ *$", row[-1]) for row in rows)
    command = (
        f"mkdir -p kinds && awk -F{quote(separator.replace(chr(9), chr(92) + 't'))} "
        f'\'{{{keep} if (k~/^({"|".join(sorted(kinds))})$/) print > ("kinds/" k ".csv")}}\' {quote(shown_as.name)}'
    )
    raise InputError(
        f"{shown_as}: has rows of several kinds ({list_names(sorted(kinds))}); write each kind to a separate file; for "
        f"example, run: {command}, and import the folder kinds"
    )


def _words(rows: Sequence[Sequence[str]]) -> set[str]:
    """Return the words with which all rows begin, if rows with different words have different lengths; else {}."""
    found = [_WORD.match(row[0]) for row in rows]
    last = [max(k for k, cell in enumerate(row) if k == 0 or cell.strip()) for row in rows]
    # A row with only a name and a time, such as an invalid fix, is not a separate kind.
    kinds = {(word[1], end) for word, end in zip(found, last, strict=True) if word and end > 1}
    words = {word for word, _ in kinds}
    several = 1 < len(words) <= MAX_KINDS and len({end for _, end in kinds}) > 1
    return words if all(found) and several else set()


def _codes(rows: Sequence[Sequence[str]], place: int) -> set[str]:
    """Return the codes (words or numbers) in a column if they determine the lengths of the rows; else {}.

    Rows with the same code must have the same length, and at least two codes must have different lengths, unless one of
    them names a sensor of an IMU. A row with only a code and a time is not a separate kind.
    """
    sizes: dict[str, set[int]] = {}
    for row in rows:
        code = _CODE.match(row[place]) if place < len(row) else None
        if code is None:
            return set()
        if len(row) > KIND_CELLS:
            sizes.setdefault(code[1], set()).add(len(row))
    known = [*sizes.values()]
    fits = 1 < len(sizes) <= MAX_KINDS and all(len(of) == 1 for of in known)
    fits = fits and (len(set.union(*known)) > 1 or any(map(_SENSOR.match, sizes)))
    return {*sizes} if fits else set()


def _are_cut(rows: Sequence[Sequence[str]], place: int) -> bool:
    """Return True if the rows with a flag of no fix have only the first cells of the other rows, in the same ranges."""
    whole = [row for row in rows if len(row) > KIND_CELLS]
    flag = min(whole, key=len)[place].strip() if whole else ""
    kinds = [[row for row in whole if (row[place].strip() == flag) == cut] for cut in (True, False)]
    width = min(map(len, whole), default=0)
    others, form = {row[place].strip().lower() for row in kinds[1]}, NO_FIX.get(flag.lower())
    if form is None or not all(re.fullmatch(form, other) for other in others):
        return False
    longer = {len(row) for row in kinds[1]}
    # 1 and 2 alone may be the numbers of sensors
    if not longer or width == min(longer) or (flag == "1" and ("3" not in others or len(longer) > 1)):
        return False
    cells = [k for k in range(width) if k != place]
    try:
        of_short, of_long = (
            np.array([[row[k] for k in cells] for row in kind], np.float64) for kind in kinds
        )
    except ValueError:  # a text
        return False
    middle, low, high = np.median(of_short, axis=0), np.min(of_long, axis=0), np.max(of_long, axis=0)
    return bool(np.all((low <= middle) & (middle <= high)))
