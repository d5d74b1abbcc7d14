"""Refuse texts whose rows are not a table: several kinds of rows, or cells with names or several numbers."""

import re
from collections.abc import Iterator, Sequence
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
_VALUE = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan"
NAMED = re.compile(rf"([A-Za-z_]\w*) *[:=] *(?:{_VALUE})(?= *[,;\s]|$)")
_POINT = r"[+-]?\d*\.\d+(?:[eE][+-]?\d+)?"
# Three or more numbers in brackets or quotes; those in quotes have decimal points, since "1,234,567" is a single number
_VECTOR = re.compile(
    rf"[\[({{] *((?:{_VALUE})(?: *[,; ] *(?:{_VALUE})){{2,}}) *[\])}}]|\" *({_POINT}(?: *[,; ] *{_POINT}){{2,}}) *\""
)
_OUTER = re.compile(r"\"(?=[\[({])|(?<=[\])}])\"")  # quotes around brackets
_CELL = re.compile(rf"{_VALUE}|[\w.:+-]*\d[\w.:+-]*")
_NO_NAMES, _NO_BRACKETS = r"s/[A-Za-z_][A-Za-z0-9_]* *[:=] *//g", r"s/[]\"(){}[]//g"
# Keys of a cell such as {'x': 0.1, 'y': 0.2, 'z': 9.8}
_KEYS = re.compile(r"(?:'|\"\"?)?[xyzw](?:'|\"\"?)? *: *")
_NO_KEYS = r"s/[\x27\"]*[xyzw][\x27\"]* *: *//g"
_SEPARATED = "s/[[:space:]]*[,;|[:space:]][[:space:]]*/,/g"
_POINTS = re.compile(r"\bPOINT *(?:Z|M|ZM)? *\(", re.IGNORECASE)
_PRINTED = re.compile(r"[\d:.]+ -> ")
PARTS = {2: "xy", 3: "xyz", 4: "xyzw"}
MIN_NAMES = 3  # smallest number of names in a row that are reported
LAST_ROWS = 20  # number of last rows that are examined


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
    """Return the first words of all rows if rows with different first words have different lengths; otherwise {}."""
    found = [_WORD.match(row[0]) for row in rows]
    last = [max(k for k, cell in enumerate(row) if k == 0 or cell.strip()) for row in rows]
    # A row with only a name and a time, such as an invalid fix, is not a separate kind.
    kinds = {(word[1], end) for word, end in zip(found, last, strict=True) if word and end > 1}
    words = {word for word, _ in kinds}
    several = 1 < len(words) <= MAX_KINDS and len({end for _, end in kinds}) > 1
    return words if all(found) and several else set()


def _codes(rows: Sequence[Sequence[str]], place: int) -> set[str]:
    """Return the codes (words or numbers) in a column if they determine the lengths of the rows; otherwise {}.

    Rows with the same code must have the same length. At least two codes must have different lengths, unless one of
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
    """Return True if rows with the flag "no fix" have only the first cells of the other rows, in the same ranges."""
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


def packed_cells(lines: Sequence[str], shown_as: Path) -> str:
    """Return a message on cells with several numbers, and a command that splits them; "" if there are none.

    An `InputError` is raised instead if the cells contain separators or names, or if rows begin with the times of a
    serial monitor.
    """
    rows = [_OUTER.sub("", line.strip()) for line in lines if line.strip()]
    if not rows:
        return ""
    keyed = "{" in rows[-1] and _KEYS.search(rows[-1]) is not None
    rows = [_KEYS.sub("", row) for row in rows] if keyed else rows
    last = rows[-1]
    if _POINTS.search(last):  # see `with_points` in `scanning`
        return ""
    if all(_PRINTED.match(row) for row in rows[-LAST_ROWS:]):
        command = f"sed -E 's/^[0-9:.]+ -> //' {quote(shown_as.name)} > new.csv"
        raise InputError(
            f"{shown_as}: rows begin with times of a serial monitor; remove these times, for example with: {command}"
        )
    named = [found[1] for found in NAMED.finditer(last)]
    if len(named) >= max(MIN_NAMES, len(_cells(NAMED.sub("1", last))) / 2) and len({*named}) == len(named):
        before = [f"c{k + 1}" for k in range(len(_cells(last[: _start(last)])))]
        header = [*(["t"] if len(before) == 1 and "t" not in named else before), *named]
        what, edit = f"cells contain names ({named[0]}, {named[1]} ...)", f"{_NO_NAMES}; {_SEPARATED}"
        if all([found[1] for found in NAMED.finditer(row)] == named for row in rows[-LAST_ROWS:]):
            raise InputError(_sentence(shown_as, rows, what, header, edit, named=True, titles=0))
    elif vectors := _vectors(last):
        what = f"cells contain several numbers ({vectors[0][:40]})"
        titles = 0 if _VECTOR.search(rows[0]) else 1
        header = [*_titles(rows[0], last)] if titles else []
        edit = f"{f'{_NO_KEYS}; ' * keyed}{_NO_BRACKETS}; {_SEPARATED}"
        message = _sentence(shown_as, rows, what, header, edit, named=False, titles=titles)
        if ";" in vectors[0] or ("," in vectors[0] and '"' not in lines[-1]):
            raise InputError(message)
        return message
    return ""


def _vectors(row: str) -> list[str]:
    return [found[1] or found[2] for found in _VECTOR.finditer(row)]


def _start(row: str) -> int:
    found = NAMED.search(row)
    return found.start() if found else 0


def _cells(text: str) -> list[str]:
    return [cell for cell in re.split(r"\s*[,;|\s]\s*", text.strip(" \t,;|")) if cell]


def _titles(header: str, row: str) -> Iterator[str]:
    """Yield the names of the split columns: a vector's name acc becomes acc_x, acc_y, acc_z."""
    names = [name.strip(' "') for name in re.split(r"[,;\t]", header)]
    counts = [len(_cells(found)) for found in _vectors(row)]
    plain = len(_cells(_VECTOR.sub("", row)))
    if len(names) == plain + sum(counts):
        yield from names
        return
    found = re.finditer(rf"{_VECTOR.pattern}|[^,;\s]+", row)
    sizes = [len(_cells(cell[1] or cell[2] or "1")) for cell in found]
    if len(sizes) != len(names):
        return
    for name, size in zip(names, sizes, strict=True):
        yield from (
            [f"{name}_{part}" for part in PARTS.get(size, map(str, range(size)))] if size > 1 else [name]
        )


def _sentence(
    shown_as: Path,
    rows: Sequence[str],
    what: str,
    header: Sequence[str],
    edit: str,
    *,
    named: bool,
    titles: int,
) -> str:
    remove = r"[A-Za-z_][A-Za-z0-9_]* *[:=] *" if named else r"[\]\"(){}\[]"
    edited = [_cells(re.sub(remove, "", row)) for row in rows[titles:][-LAST_ROWS:]]
    works = header and all(len(cells) == len(header) and all(map(_CELL.fullmatch, cells)) for cells in edited)
    remedy = "write one number in each cell, below a header such as t,ax,ay,az,gx,gy,gz"
    if works:
        first = "1d; " * titles
        command = f"(echo {quote(','.join(header))}; sed -E '{first}{edit}' {quote(shown_as.name)}) > new.csv"
        remedy = f"write one number in each cell, for example with: {command}"
    return f"{shown_as}: {what}; {remedy}"
