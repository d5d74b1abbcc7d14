"""Find the dialect of a text table from its first lines: separator, header, units, decimal commas."""

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from shlex import quote

from sigmaswarm.errors import InputError
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.readers.rows_of_kinds import MAX_ROWS, NAMED, packed_cells, require_one_kind
from sigmaswarm.importing.source import first_bytes
from sigmaswarm.importing.table_columns import NO_NUMBER, NO_VALUE
from sigmaswarm.importing.units import COUNTS, parse_unit

HEADER_BYTES = 4_000_000
# Largest numbers of characters and of lines that are examined; at least four lines are examined
SAMPLE, MAX_LINES = 200_000, 300
# In order of preference if two fit equally well; the comma is last, since it may be a decimal comma
SEPARATORS = (";", "\t", "|", ",")
MINUS = "\u2212"  # minus sign of spreadsheets and typesetting
BLANKS = " "  # separator that stands for any number of blanks
COMMENTS = "#%!"
_NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:([.,'’ \u00a0\u202f])\d{3})(?:\1\d{3})*(?:[.,]\d+)?")
_DIGITS = re.compile(r"\d{8} ?\d{4,6}[\d.]{0,10}")  # a date and a time of day without separators
_OTHER_SEPARATORS = frozenset(SEPARATORS) - {","}
_EMPTY, _NO_NUMBER = frozenset((*NO_VALUE, "inf", "-inf")), re.compile(NO_NUMBER)
_AXES = ("x", "y", "z", "w")
Rows = Sequence[Sequence[str]]
_HEADER, _COVARIANCE = ("sec", "nanosec", "frame_id"), [f"_covariance[{k}]" for k in range(9)]
_VECTORS = (("orientation", "xyzw"), ("angular_velocity", "xyz"), ("linear_acceleration", "xyz"))
_FIX = ("status", "service", "latitude", "longitude", "altitude")
# Fields of sensor_msgs/Imu and NavSatFix, by number of values
_MESSAGES = {
    40: [
        *_HEADER,
        *(f"{v}{part}" for v, axes in _VECTORS for part in [*map(".{}".format, axes), *_COVARIANCE]),
    ],
    18: [*_HEADER, *_FIX, *_COVARIANCE, "type"],
}


@dataclass(frozen=True)
class Dialect:
    separator: str
    names: tuple[str, ...]  # names of columns; a unit from a row of units follows in brackets
    skip: int  # number of lines above the first row of values
    encoding: str = "utf8"
    numeric: tuple[int, ...] = ()  # indices of the columns with numbers or dates
    comma_columns: tuple[int, ...] = ()  # indices of the columns with decimal commas
    surplus: int = 0  # number of empty last cells in each row for which the header has no names
    remarks: tuple[str, ...] = ()  # sentences for the user


def dialect_of(file: Path, shown_as: Path) -> Dialect:
    lines, encoding = _lines(file, shown_as)
    stated = re.fullmatch(r'"?sep=(.)"?', lines[0].strip(" \r")) if lines else None
    begin = 1 if stated else 0
    rows = [
        i for i in _first_lines(lines, begin) if lines[i].strip() and lines[i].lstrip()[:1] not in COMMENTS
    ]
    packed = packed_cells([lines[i] for i in rows], shown_as)
    separator = stated[1] if stated else _separator([lines[i] for i in rows])
    cells = {i: split(lines[i], separator) for i in rows}
    numeric = _numeric_columns([cells[i] for i in rows[-40:]])
    first = next((i for i in rows if _is_data(cells[i], numeric)), None)
    if first is None:  # only texts: the first line is the header
        names = _titles(lines[rows[0]], separator) if rows else []
        skip, remarks = rows[0] + 1 if rows else 0, (packed,) if packed else ()
        return Dialect(separator, tuple(names), skip, encoding, remarks=remarks)
    # a header below a table of properties, whose rows begin with words (LabVIEW)
    heads = [i for i in rows if i > first and not _is_data(cells[i], numeric) and _meanings(cells[i]) > 2]
    begins = [
        next((cell for cell in cells[i][numeric[0] :] if cell.strip().lower() not in _EMPTY), "")
        for i in rows
        if heads and first <= i < heads[0]
    ]
    if heads and not any(map(is_value, begins)):
        first = next((i for i in rows if i > heads[0] and _is_data(cells[i], numeric)), first)
    data = [cells[i] for i in rows if i >= first]
    above = [i for i in range(begin, first) if lines[i].strip()]
    width, most = Counter(map(len, data)).most_common(1)[0][0], max(map(len, data))
    filled = [
        max((k for k, c in enumerate(row, 1) if c.strip()), default=0) for row in data if len(row) == width
    ]
    empty = width - max(filled)
    names = _header([lines[i] for i in above], separator, width, most, empty)
    commented = all(lines[i].lstrip()[0] in COMMENTS for i in above)
    if not names or commented or all(row[0].lstrip()[:1] == "$" for row in data):
        _require_one_kind(lines[first : first + MAX_ROWS], separator, shown_as)
    surplus = width - len(names) if 0 < width - len(names) <= empty else 0
    notes = [packed] if packed else []
    if not names:
        last = lines[above[-1]] if above else "#"
        if last.lstrip()[:1] not in COMMENTS and len(found := _titles(last, separator)) > 1:
            remedy = f"write a header with {width} names"
            if width == 2 * len(found) and separator == ",":
                join = rf"sed -E '{first + 1},$s/([^,]*),([^,]*)(,|$)/\1.\2\3/g' {quote(shown_as.name)} > new.csv"
                remedy = f"if each number has a decimal comma, join its cells, for example with: {join}"
            raise InputError(
                f"{shown_as}, row {first + 1}: has {width} cells, but the header has {len(found)}; {remedy}"
            )
        if names := _of_message(data[0]):
            notes.append(
                f"{shown_as.name}: each row is read as a message of {width} values, in the format of "
                "`ros2 topic echo --csv`"
            )
        names = names or [""] * most
    if not any(name and not name.startswith(" [") for name in names):
        notes.append(
            f"{shown_as.name}: has no header; its columns are called c1 to c{len(names)}; write a header line such as "
            "t,ax,ay,az,gx,gy,gz, or map them with --map"
        )
    names = [f"c{k}{name}" if name[:1] in ("", " ") else name for k, name in enumerate(names, 1)]
    commas = tuple(k for k in numeric if _has_decimal_commas([row[k] for row in data if k < len(row)]))
    if commas:
        notes.append(f"{shown_as.name}: numbers have decimal commas")
    return Dialect(separator, tuple(names), first, encoding, tuple(numeric), commas, surplus, tuple(notes))


def _require_one_kind(lines: Sequence[str], separator: str, shown_as: Path) -> None:
    rest = (line for line in lines if line.strip() and line.lstrip()[:1] not in COMMENTS)
    require_one_kind([split(line, separator) for line in rest], separator, shown_as)


def _of_message(row: Sequence[str]) -> list[str]:
    """Return the fields of sensor_msgs/Imu or NavSatFix if a row has the form of `ros2 topic echo --csv`, or []."""
    fields = _MESSAGES.get(len(row), [])
    if not fields or is_value(row[2]) or not (row[0] + row[1]).isdigit() or int(row[1]) >= 1_000_000_000:
        return []
    values = [float(cell) if _NUMBER.fullmatch(cell) else math.nan for cell in row[3:8]]
    turn, placed = sum(v * v for v in values[:4]), abs(values[2]) <= 90 and abs(values[3]) <= 180
    return fields if (abs(turn - 1) < 0.05 if "orientation.w" in fields else placed) else []


def is_table(file: Path) -> bool:
    """Return True if the last 6 to 20 lines of the first 64 KiB are rows of at least three cells, mostly numbers.

    The numbers may have names, as in `ax:0.1`.
    """
    head = first_bytes(file, 65536)
    if b"\0" in head:
        return False
    lines = [
        NAMED.sub("1", line) for line in head.decode("utf-8", "replace").split("\n")[:-1] if line.strip()
    ]
    lines = lines[-20:]
    cells = [split(line, _separator(lines)) for line in lines]
    return len(lines) > 5 and all(len(c) > 2 and sum(map(is_value, c)) > 0.5 * len(c) for c in cells)


def _is_empty(cell: str) -> bool:
    return cell.strip().lower() in _EMPTY or _NO_NUMBER.search(cell) is not None


def _has_decimal_commas(cells: Sequence[str]) -> bool:
    """Return True if a column has commas, none of them before a dot, and 90% of its first 100 cells are numbers."""
    commas = [cell for cell in cells if "," in cell]
    if not commas or any("." in cell.partition(",")[2] for cell in commas):
        return False
    filled = [cell.strip() for cell in cells if not _is_empty(cell)][:100]
    numbers = sum(any(form.fullmatch(cell) for form in (_NUMBER, _GROUPED)) for cell in filled)
    return numbers >= 0.9 * len(filled)


def _lines(file: Path, shown_as: Path) -> tuple[list[str], str]:
    head = first_bytes(file, HEADER_BYTES)
    if head[:2] in (b"\xff\xfe", b"\xfe\xff") or head[:4] == b"\0\0\xfe\xff":
        raise InputError(f"{shown_as}: is text in UTF-32; save it as UTF-8")
    if b"\r" in head and b"\n" not in head:
        raise InputError(
            f"{shown_as}: lines end with a carriage return alone; convert the file, for example with: "
            f"tr '\\r' '\\n' < {quote(shown_as.name)} > new.csv"
        )
    cut = head if len(head) < HEADER_BYTES else head[: head.rfind(b"\n") + 1]
    try:
        return cut.decode("utf-8-sig").replace(MINUS, "-").split("\n"), "utf8"
    except UnicodeDecodeError:
        return cut.decode("latin-1").split("\n"), "utf8-lossy"


def _first_lines(lines: Sequence[str], begin: int) -> list[int]:
    size, places = 0, list[int]()
    for i, line in enumerate(lines[begin : begin + MAX_LINES], begin):
        size += len(line)
        places.append(i)
        if size > SAMPLE and len(places) > 3:
            break
    return places


def split(line: str, separator: str) -> list[str]:
    line = line.rstrip("\r")
    if separator == BLANKS:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except (csv.Error, StopIteration):  # a quote that is not closed
        return line.split(separator)


def is_value(cell: str) -> bool:
    cell = cell.strip()
    if len(cell) > 40:
        return False
    if _NUMBER.fullmatch(cell):
        return True
    if not cell or not _OTHER_SEPARATORS.isdisjoint(cell):
        return False
    dated = cell[0].isdigit() and any(mark in cell for mark in ":-/") and not re.search(r": *[A-Za-z]", cell)
    return dated or any(form.fullmatch(cell) for form in (_DIGITS, _GROUPED))


def _separator(lines: Sequence[str]) -> str:
    """Return the separator with which the rows of the most frequent length have the most values.

    If no separator gives values, return the most frequent separator in the first line.
    """
    best, most = "", 0.0
    for separator in (*SEPARATORS, BLANKS):
        if separator == BLANKS and best:
            break
        profile = [(len(c), sum(map(is_value, c))) for c in (split(line, separator) for line in lines[-40:])]
        widths = Counter(n for n, values in profile if n > 1 and values)
        if widths:
            width = widths.most_common(1)[0][0]
            score = float(sum(values for n, values in profile if n == width))
            best, most = (separator, score) if score > most else (best, most)
    return best or max(",;\t|", key=(lines[0] if lines else "").count)


def _numeric_columns(rows: Rows) -> list[int]:
    """Return the indices of columns with numbers or dates in at least half of their filled cells."""
    filled, values = Counter[int](), Counter[int]()
    for row in rows:
        for k, cell in enumerate(row):
            if not _is_empty(cell):
                filled[k] += 1
                values[k] += is_value(cell)
    return sorted(k for k in values if values[k] and values[k] >= 0.5 * filled[k])


def _is_data(cells: Sequence[str], numeric: Sequence[int]) -> bool:
    if len(cells) < 2 or not numeric:
        return False
    filled = [cells[k] for k in numeric if k < len(cells) and not _is_empty(cells[k])]
    values = sum(map(is_value, filled))
    return bool(filled) and len(cells) > 0.5 * max(numeric) and values >= 0.5 * len(filled)


def _header(above: Sequence[str], separator: str, width: int, most: int, empty: int) -> list[str]:
    """Read the names from one of the last four lines above the data: the line with the most recognized names.

    ``width`` and ``most`` are the usual and the largest number of cells of a row. ``empty`` is the number of last cells
    that are always empty.
    """
    fitting = [_fitting(line, separator, width, most, empty) for line in above]
    # words in a comment are prose if no name is known, and if they do not look like names
    prose = [
        line.lstrip()[:1] in COMMENTS
        and _titles(line, BLANKS) == c
        and not (_meanings(c) or re.search(r"\t|_|[A-Za-z]\d", line))
        for line, c in zip(above, fitting, strict=True)
    ]
    fitting = [[] if words else cells for words, cells in zip(prose, fitting, strict=True)]
    places = [k for k in range(max(len(above) - 4, 0), len(above)) if fitting[k]]
    if not places:
        return []
    place = max(places, key=lambda k: (_meanings(fitting[k]), k))
    titles, units = fitting[place], [*fitting, []][place + 1]
    if not _are_units(units, titles):
        upper = fitting[place - 1] if place else []
        titles, units = (upper, titles) if _are_units(titles, upper) else (titles, [])
        titles = titles or [""] * len(units)
    if units:
        titles = [_with_unit(n, u) for n, u in zip(titles, units, strict=False)] + titles[len(units) :]
    groups = fitting[place - 1] if place and not units else []
    if len(set(titles)) < len(titles) == len(groups) > len(set(groups)):  # Accelerometer,,,Gyroscope,,
        filled = accumulate(groups, lambda before, group: group or before)
        titles = [f"{group} {title}".strip() for group, title in zip(filled, titles, strict=True)]
    while empty and len(titles) == width and not titles[-1].strip():
        titles, width, empty = titles[:-1], width - 1, empty - 1
    # x, y, z after each of several vectors, as bags are printed
    if any(titles.count(axis) > 1 for axis in _AXES):
        last = accumulate(titles, lambda before, title: before if title in _AXES else title)
        titles = [
            f"{vector} {title}" if title in _AXES else title
            for vector, title in zip(last, titles, strict=True)
        ]
    counted = titles[1:] if not titles[0] else titles
    # pandas writes 0, 1, 2 ... for columns without names
    if counted == [str(k) for k in range(len(counted))]:
        titles = [f"c{k}" for k in range(1, len(titles) + 1)]
    return titles


def _fitting(line: str, separator: str, width: int, most: int, empty: int) -> list[str]:
    """Split a line into one cell for each column, with any separator, preferably that of the rows; [] if none fits."""
    for other in (separator, *(s for s in (*SEPARATORS, BLANKS) if s != separator)):
        cells = _titles(line, other)
        wide = re.split(r"\s{2,}", line.strip()) if other == BLANKS else []  # names of several words
        cells = wide if len(wide) == width else cells
        if len(cells) == width + 1 and not cells[-1].strip():
            cells = cells[:-1]
        short = 0 < width - len(cells) <= empty
        if len(cells) > 1 and (len(cells) == width or short or (len(cells) >= most and other == separator)):
            return cells
    return []


def _titles(line: str, separator: str) -> list[str]:
    """Split a header into names. Cells such as "name"|"unit"|... become names with units."""
    line = line.strip("\r")
    if line.lstrip(" ")[:1] in (*COMMENTS, "/"):  # a leading tab is a separator
        line = line.lstrip(" " + COMMENTS + "/")
    cells = [c.strip() for c in split(line, separator)]
    if separator != "|" and len(cells) > 1 and all("|" in c for c in cells):
        parts = [[p.strip(' "') for p in c.split("|")] for c in cells]
        return [_with_unit(p[0], p[1]) for p in parts]
    return [c.strip('" ') for c in cells]


def _are_units(cells: Sequence[str], above: Sequence[str] = ()) -> bool:
    """Return True if a cell is a known unit, and the other cells have no more known names than the line above."""
    units = {c: parse_unit(c.strip("[]() ")) for c in cells if c.strip()}
    known = {c for c, u in units.items() if u is not None and (u.known or u.text.lower() in COUNTS)}
    return bool(known) and _meanings([c for c in cells if c not in known]) <= _meanings(above)


def _meanings(cells: Sequence[str]) -> int:
    return sum(read_name(c).meaning is not None for c in cells[:100])


def _with_unit(name: str, unit: str) -> str:
    unit = re.sub(r"^[\[(](.*)[\])]$", r"\1", unit.strip())
    return f"{name} [{unit}]" if unit else name


def uneven_row(file: Path, dialect: Dialect) -> tuple[int, int] | None:
    """Find the first row with a filled cell beyond the last name. Return its line number and number of cells."""
    most = len(dialect.names)
    with file.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            cells = split(line.rstrip("\n"), dialect.separator) if line[:1] != "#" else []
            if number > dialect.skip and any(cell.strip() for cell in cells[most:]):
                return number, len(cells)
    return None
