"""Detect rows whose cells contain a name or several numbers: `ax:0.1, ay:0.2`, `[0.1, 0.2, 0.3]`, `"0.1 0.2 0.3"`."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from shlex import quote

from sigmaswarm.errors import InputError

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
_SEPARATED = "s/[[:space:]]*[,;[:space:]][[:space:]]*/,/g"
_POINTS = re.compile(r"\bPOINT *(?:Z|M|ZM)? *\(", re.IGNORECASE)
_PRINTED = re.compile(r"[\d:.]+ -> ")
PARTS = {2: "xy", 3: "xyz", 4: "xyzw"}
MIN_NAMES = 3  # smallest number of names in a row that are reported
MAX_ROWS = 20  # number of last rows that are examined


def packed_cells(lines: Sequence[str], shown_as: Path) -> str:
    """Return a message on cells with several numbers, and a command that splits them; "" if there are none.

    Raise an `InputError` instead if the cells contain separators or names, or rows begin with a serial monitor's times.
    """
    rows = [_OUTER.sub("", line.strip()) for line in lines if line.strip()]
    if not rows:
        return ""
    last = rows[-1]
    if _POINTS.search(last):  # see `points`
        return ""
    if all(_PRINTED.match(row) for row in rows[-MAX_ROWS:]):
        command = f"sed -E 's/^[0-9:.]+ -> //' {quote(shown_as.name)} > new.csv"
        raise InputError(
            f"{shown_as}: rows begin with times of a serial monitor; remove these times, for example with: {command}"
        )
    named = [found[1] for found in NAMED.finditer(last)]
    if len(named) >= max(MIN_NAMES, len(_cells(NAMED.sub("1", last))) / 2) and len({*named}) == len(named):
        before = [f"c{k + 1}" for k in range(len(_cells(last[: _start(last)])))]
        header = [*(["t"] if len(before) == 1 and "t" not in named else before), *named]
        what, edit = f"cells contain names ({named[0]}, {named[1]} ...)", f"{_NO_NAMES}; {_SEPARATED}"
        if all([found[1] for found in NAMED.finditer(row)] == named for row in rows[-MAX_ROWS:]):
            raise InputError(_sentence(shown_as, rows, what, header, edit, named=True, titles=0))
    elif vectors := _vectors(last):
        what = f"cells contain several numbers ({vectors[0][:40]})"
        titles = 0 if _VECTOR.search(rows[0]) else 1
        header = [*_titles(rows[0], last)] if titles else []
        edit = f"{_NO_BRACKETS}; {_SEPARATED}"
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
    return [cell for cell in re.split(r"\s*[,;\s]\s*", text.strip(" \t,;")) if cell]


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
    edited = [_cells(re.sub(remove, "", row)) for row in rows[titles:][-MAX_ROWS:]]
    works = header and all(len(cells) == len(header) and all(map(_CELL.fullmatch, cells)) for cells in edited)
    remedy = "write one number in each cell, below a header such as t,ax,ay,az,gx,gy,gz"
    if works:
        first = "1d; " * titles
        command = f"(echo {quote(','.join(header))}; sed -E '{first}{edit}' {quote(shown_as.name)}) > new.csv"
        remedy = f"write one number in each cell, for example with: {command}"
    return f"{shown_as}: {what}; {remedy}"
