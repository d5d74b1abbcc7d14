"""Compile expressions over a table's columns to polars expressions. The text is parsed and checked, never executed.

Names refer to columns, as in ``-acc_y * 9.80665``, ``radians(gyro_z)``, ``linear_acceleration.x`` and
``accelerometer_m_s2[0]``. Backticks enclose other names: ```Acceleration x (m/s^2)` ``.

Values are numbers, and an empty cell gives null. A comparison gives 1 or 0. For ``not``, ``and``, ``or``,
``where`` and ``keep``, a number other than 0 is true. Times can also be computed as integer nanoseconds.
"""

import ast
import difflib
import math
import operator
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import SECOND, as_text, gps_time, parse_dates, parse_durations
from sigmaswarm.wording import list_names, printable, quoted

MAX_LENGTH = 1000  # characters; this also limits the nesting
ROW = "row"  # name of an added column of row numbers, from 0, unless the table has this column
# Largest number of times that polars evaluates a column; nested functions use their arguments repeatedly
MAX_USES = 1000


def _number(a: pl.Expr) -> pl.Expr:
    return a.cast(pl.Float64)


def _truth(a: pl.Expr) -> pl.Expr:
    """Return True for numbers other than 0, and null for NaN.

    Unlike ``fill_nan``, this evaluates the column only once.
    """
    return _number(a).sign().cast(pl.Int8, strict=False) != 0


def _where(condition: pl.Expr, a: pl.Expr, b: pl.Expr) -> pl.Expr:
    true = _truth(condition)
    return pl.when(true).then(a).when(~true).then(b)


def _ddmm(a: pl.Expr) -> pl.Expr:
    """Convert degrees and minutes (4807.038 is 48 deg 7.038 min) to degrees."""
    whole = (a.abs() / 100).floor()
    return (whole + (a.abs() - whole * 100) / 60) * a.sign()


_PART = r"\d+(?:\.\d+)?"
_DMS = rf"(?i)^(?:[NSEW] *)?[+-]? *{_PART}(?:[ °º:d'′’m]+{_PART}){{0,2}}[ °º'′’\"″”m]*[NSEW]?$"


def _dms(text: pl.Expr) -> pl.Expr:
    """Convert degrees, minutes and seconds in a text (48°07'02.3"S) to degrees, negative for S and W.

    A single number of four or more digits is degrees and minutes (4807.038 N). The result is null for letters other
    than N, S, E, W. It is also null for a latitude of three digits (012.5 N), which may be degrees, or degrees and
    minutes.
    """
    plain = text.str.strip_chars().str.replace_all(",", ".").str.replace(rf"(?i)(m *{_PART} *)s", "${1}")
    numbers = plain.str.extract_all(_PART)
    parts = [numbers.list.get(k, null_on_oob=True).cast(pl.Float64) for k in range(3)]
    digits = plain.str.extract(r"^\D*(\d+)").str.len_chars()
    single = numbers.list.len() == 1
    joined = single & (digits > 3)
    apart = parts[0] + parts[1].fill_null(0.0) / 60 + parts[2].fill_null(0.0) / 3600
    degrees = pl.when(joined).then(_ddmm(parts[0])).otherwise(apart)
    minutes = pl.when(joined).then(parts[0] % 100).otherwise(parts[1])
    marked, latitude = plain.str.contains("(?i)[°ºd]"), plain.str.contains("(?i)[NS]")
    unsure = (joined & marked) | (single & (digits == 3) & latitude & ~marked)
    unsure |= plain.str.contains(
        r"(?i)^[NSEW].*[NSEW]$|['′’:].*\d(?-i:s)$"
    )  # a final s may mean seconds or south
    wrong = ~plain.str.contains(_DMS) | unsure | (minutes > 60) | (parts[2] > 60)
    negative = plain.str.contains("(?i)[SW]|^[^0-9]*-")
    return pl.when(wrong).then(None).when(negative).then(-degrees).otherwise(degrees)


def _hypot(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    return (a * a + b * b).sqrt()


def _least(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    return pl.when(a <= b).then(a).when(b < a).then(b)


def _most(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    return -_least(-a, -b)


_OF_TEXT = {"dms": _dms, "duration": parse_durations}  # functions of a column of text
_CONSTANTS = {"pi": math.pi, "g": 9.80665}
_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: lambda a: ~_truth(a),  # pyright: ignore[reportUnknownLambdaType]
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
# For each function: how often it evaluates each argument, and its implementation
_FUNCTIONS: dict[str, tuple[tuple[int, ...], Callable[..., pl.Expr]]] = {
    **{name: ((1,), getattr(pl.Expr, name)) for name in ("abs", "sqrt", "exp", "log", "sin", "cos", "tan")},
    **{name: ((1,), getattr(pl.Expr, name)) for name in ("radians", "degrees")},
    "atan2": ((1, 1), pl.arctan2),
    "hypot": ((2, 2), _hypot),
    "ddmm": ((4,), _ddmm),
    "gps_time": ((20, 20), gps_time),
    "min": ((3, 3), _least),
    "max": ((3, 3), _most),
    "where": ((2, 1, 1), _where),
}


@dataclass(frozen=True)
class Expression:
    """A polars expression, its columns, and the columns that must contain numbers."""

    polars: pl.Expr
    columns: frozenset[str]
    numbers: frozenset[str]

    @property
    def truth(self) -> pl.Expr:
        """The expression as a condition; null for an empty value."""
        return _truth(self.polars)


def compile_expression(text: str, columns: Collection[str]) -> Expression:
    """Compile an expression over a table's columns. Raises `InputError` if it is not valid."""
    compiler = _Compiler(text, columns)
    try:
        polars = compiler.build(_parse(text))
    except RecursionError:
        raise InputError(f"the expression {text[:40]!r}... is nested too deeply; simplify it") from None
    return Expression(polars, frozenset(compiler.used), frozenset(compiler.numbers))


def is_valid_expression(text: str, columns: Collection[str]) -> bool:
    try:
        compile_expression(text, columns)
    except InputError:
        return False
    return True


def _parse(text: str) -> ast.expr:
    """Parse an expression. Names in backticks become ``col("...")``."""
    if len(text) > MAX_LENGTH:
        raise InputError(
            f"the expression {text[:40]!r}... is longer than {MAX_LENGTH} characters; shorten it"
        )
    plain = re.sub(r"`([^`]*)`", lambda m: f"col({m.group(1)!r})", text.strip())
    try:
        return ast.parse(plain, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(
            f"{quoted(text)} is not an expression; write for example -acc_y*9.80665, and `a name with spaces` in "
            "backticks"
        ) from None


def _column_name(node: ast.AST) -> str | None:
    """Return the column of a node: a name, a.b.c, a[0], or col("any text")."""
    match node:
        case ast.Name(id=name):
            return name
        case ast.Attribute(value=inner, attr=name) if (start := _column_name(inner)) is not None:
            return f"{start}.{name}"
        case ast.Subscript(value=inner, slice=ast.Constant(value=int(i))) if s := _column_name(inner):
            return f"{s}[{i}]"
        case ast.Call(func=ast.Name(id="col"), args=[ast.Constant(value=str(name))], keywords=[]):
            return name
        case _:
            return None


class _Compiler:
    def __init__(self, text: str, columns: Collection[str]) -> None:
        self.text, self.columns = text, columns
        self.used: set[str] = set()
        self.numbers: set[str] = set()
        self.uses = 1

    def build(self, node: ast.AST) -> pl.Expr:
        if (name := _column_name(node)) is not None:
            return self._column(name)
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                return self._constant(value)
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](_number(self.build(operand)))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](_number(self.build(left)), _number(self.build(right)))
            case ast.Compare(left=left, ops=ops, comparators=others) if {*map(type, ops)} <= {*_OPERATORS}:
                pairs = zip([left, *others], ops, others, strict=False)  # a < b < c as a < b and b < c
                return pl.all_horizontal(*(self._compare(a, op, b) for a, op, b in pairs))
            case ast.BoolOp(op=op, values=values):
                truths = [_truth(self.build(value)) for value in values]
                return pl.all_horizontal(truths) if isinstance(op, ast.And) else pl.any_horizontal(truths)
            case ast.Call(func=ast.Name(id="utc"), args=[_, *_] as args, keywords=[]):
                return self._utc(args)
            case ast.Call(func=ast.Name(id=f), args=[arg], keywords=[]) if f in _OF_TEXT and (
                name := _column_name(arg)
            ):
                return _OF_TEXT[f](self._use(name).cast(pl.String))
            case ast.Call(func=ast.Name(id=f), args=args, keywords=[]) if f in _FUNCTIONS:
                uses, function = _FUNCTIONS[f]
                if len(args) != len(uses):
                    raise InputError(
                        f"{f} in {quoted(self.text)} takes {len(uses)} value(s), not {len(args)}; correct the "
                        "expression"
                    )
                return function(*(_number(self._argument(a, n)) for a, n in zip(args, uses, strict=True)))
            case _:
                raise InputError(
                    f"{quoted(ast.unparse(node))} in {quoted(self.text)} is not allowed; use columns, numbers, "
                    f"+ - * / ** %, comparisons, and {', '.join((*_FUNCTIONS, *_OF_TEXT, 'utc'))}"
                )

    def _argument(self, node: ast.expr, uses: int) -> pl.Expr:
        self.uses *= uses
        if self.uses > MAX_USES:
            raise RecursionError
        built = self.build(node)
        self.uses //= uses
        return built

    def _constant(self, value: float) -> pl.Expr:
        try:
            return pl.lit(float(value))
        except OverflowError:
            raise InputError(
                f"{quoted(self.text)} has a number above 1.8e308; write a smaller number"
            ) from None

    def _column(self, name: str) -> pl.Expr:
        """Return a constant, or a column as float64; empty cells, NaN and texts become null."""
        if name in _CONSTANTS and name not in self.columns:
            return pl.lit(_CONSTANTS[name])
        self.numbers.add(name)
        return self._use(name).cast(pl.Float64, strict=False).fill_nan(None)

    def _use(self, name: str) -> pl.Expr:
        if name not in self.columns:
            near = [column for column in self.columns if column.casefold() == name.casefold()]
            near = near or difflib.get_close_matches(name, self.columns, 1, 0.5)
            hint = (
                f"perhaps `{printable(near[0])}`" if near else f"choose from {list_names(self.columns, '`')}"
            )
            raise InputError(
                f"{quoted(self.text)} names the column {quoted(name)}, which the table does not have; {hint}"
            )
        self.used.add(name)
        return pl.col(name)

    def _compare(self, a: ast.expr, op: ast.cmpop, b: ast.expr) -> pl.Expr:
        name = _column_name(a)
        if isinstance(b, ast.Constant) and isinstance(b.value, str) and name is not None:
            return _OPERATORS[type(op)](self._use(name).cast(pl.String), pl.lit(b.value))
        return _OPERATORS[type(op)](_number(self.build(a)), _number(self.build(b)))

    def _utc(self, args: list[ast.expr]) -> pl.Expr:
        """Compile ``utc(...)`` of a column of dates, or of two columns, days and times of day; a format may follow."""
        form = ""
        if isinstance(args[-1], ast.Constant) and isinstance(args[-1].value, str):
            form, args = args[-1].value, args[:-1]
        names = [name for arg in args if (name := _column_name(arg)) is not None]
        if len(names) < len(args) or not names:
            raise InputError(
                f"utc(...) in {quoted(self.text)} takes a column of dates, or several columns, and optionally their "
                "format, for example utc(date, '%d.%m.%Y %H:%M:%S'); correct the expression"
            )
        for name in names:
            self._use(name)
        return parse_dates(as_text(names), form)


def time_expression(text: str, frame: pl.DataFrame) -> pl.Expr:
    """Compile an expression of a time in s to integer nanoseconds. Integer columns keep all digits, also in a sum."""
    tree = _parse(text)
    terms = [text]
    if isinstance(tree, ast.BinOp) and isinstance(tree.op, ast.Add):
        terms = [ast.unparse(tree.left), ast.unparse(tree.right)]
    exact = [term for text in terms if (term := _exact_term(text, frame)) is not None]
    if len(exact) == len(terms):
        return pl.sum_horizontal(exact, ignore_nulls=False) if len(exact) > 1 else exact[0]
    return _rounded(compile_expression(text, frame.columns))


def with_row_numbers(frame: pl.DataFrame, first: int = 0) -> pl.DataFrame:
    """Add the column `ROW`, unless the table has it. ``first`` is the number of the first row."""
    if ROW in frame.columns:
        return frame
    return frame.with_columns(pl.int_range(first, first + len(frame)).alias(ROW))


def row_times(text: str, frame: pl.DataFrame) -> pl.Series:
    """Return the time of each row, ns; null where it is missing, or if the column contains lists or no dates."""
    numbered = with_row_numbers(frame)
    try:
        return numbered.select(time_expression(text, numbered).alias("t"))["t"]
    except pl.exceptions.PolarsError:
        return pl.Series("t", [None] * len(frame), dtype=pl.Int64)


def time_span(text: str, frame: pl.DataFrame) -> tuple[float, float] | None:
    """Return the earliest and the latest time of the rows, s; None if no row has a time."""
    times = row_times(text, frame)
    low, high = times.min(), times.max()
    return (low / SECOND, high / SECOND) if isinstance(low, int) and isinstance(high, int) else None


def _rounded(expression: Expression) -> pl.Expr:
    return (expression.polars * float(SECOND)).round().cast(pl.Int64, strict=False)


def _exact_term(text: str, frame: pl.DataFrame) -> pl.Expr | None:
    """Return ``column * number`` in ns if the column has integers (perhaps as text) or dates; otherwise None."""
    scaled = integer_scale(text, frame.columns)
    if scaled is None:
        return None
    name, factor = scaled
    kind = frame.schema[name]
    if isinstance(kind, pl.Datetime) and factor == 1:
        counted = {"ms": 1_000_000, "us": 1000, "ns": 1}[kind.time_unit]
        return _scaled(pl.col(name).dt.timestamp(kind.time_unit), counted)
    whole = round(factor * SECOND)
    if abs(whole - factor * SECOND) >= 1e-9 * whole or whole > SECOND:
        return None
    if kind.is_integer():
        return _scaled(pl.col(name).cast(pl.Int64, strict=False), whole)
    if kind == pl.String:  # padded or quoted cells
        exact = _scaled(pl.col(name).str.strip_chars().cast(pl.Int64, strict=False), whole)
        return pl.coalesce(exact, _rounded(compile_expression(text, frame.columns)))
    return None


def integer_scale(text: str, columns: Collection[str]) -> tuple[str, float] | None:
    """Return the column and factor of ``column``, ``column * number`` or ``column / number``. Return None for others.

    Such times are scaled as integers, since nanoseconds since 1970 have more digits than a float.
    """
    tree, factor = _parse(text), 1.0
    if isinstance(tree, ast.BinOp) and isinstance(tree.op, ast.Mult | ast.Div):
        right = tree.right
        if not isinstance(right, ast.Constant) or not isinstance(right.value, int | float):
            return None
        try:
            factor = float(right.value) if isinstance(tree.op, ast.Mult) else 1 / float(right.value)
        except (OverflowError, ZeroDivisionError):  # an integer of 400 digits, or 1e-400
            return None
        if not factor or not math.isfinite(factor):
            return None
        tree = tree.left
    name = _column_name(tree)
    return None if name is None or name not in columns else (name, factor)


def _scaled(count: pl.Expr, factor: int) -> pl.Expr:
    """Multiply a count by a factor; results beyond 64 bits become null."""
    most = (2**63 - 1) // max(factor, 1)
    return pl.when(count.is_between(-most, most)).then(count * factor)
