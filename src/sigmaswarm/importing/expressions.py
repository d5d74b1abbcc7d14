"""Expressions over a table's columns, as polars expressions. Text is parsed and checked, never executed.

``-acc_y * 9.80665``, ``radians(gyro_z)``, ``linear_acceleration.x``, ``accelerometer_m_s2[0]``,
```Acceleration x (m/s^2)` ``: names are columns; a column whose name is no plain name goes between backticks.

Everything is a number. An empty cell is null, and so is every result of it. A comparison is 1 or 0 in arithmetic, and a
number is true, for ``not``, ``and``, ``or``, ``where`` and ``keep``, where it is not 0.
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
from sigmaswarm.importing.dates import as_text, gps_time, parse_dates
from sigmaswarm.wording import names_shown, quoted, shown

LONGEST = 1000
"""Most characters of an expression, to limit its nesting."""


def _hypot(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    return (a * a + b * b).sqrt()


def _where(condition: pl.Expr, a: pl.Expr, b: pl.Expr) -> pl.Expr:
    true = _truth(condition)
    return pl.when(true).then(a).when(~true).then(b)


def _least(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    return pl.when(a <= b).then(a).when(b < a).then(b)


def _most(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    return pl.when(a >= b).then(a).when(b > a).then(b)


def _ddmm(a: pl.Expr) -> pl.Expr:
    """Degrees of a place in degrees and minutes, 4807.038 for 48 deg 7.038 min."""
    whole = (a.abs() / 100).floor()
    return (whole + (a.abs() - whole * 100) / 60) * a.sign()


def _number(a: pl.Expr) -> pl.Expr:
    return a.cast(pl.Float64)


def _truth(a: pl.Expr) -> pl.Expr:
    return _number(a).fill_nan(None) != 0


def _not(a: pl.Expr) -> pl.Expr:
    return ~_truth(a)


def _and(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    return _truth(a) & _truth(b)


def _or(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    return _truth(a) | _truth(b)


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
    ast.Not: _not,
    ast.And: _and,
    ast.Or: _or,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_FUNCTIONS: dict[str, tuple[int, Callable[..., pl.Expr]]] = {
    "abs": (1, pl.Expr.abs),
    "sqrt": (1, pl.Expr.sqrt),
    "exp": (1, pl.Expr.exp),
    "log": (1, pl.Expr.log),
    "sin": (1, pl.Expr.sin),
    "cos": (1, pl.Expr.cos),
    "tan": (1, pl.Expr.tan),
    "radians": (1, pl.Expr.radians),
    "degrees": (1, pl.Expr.degrees),
    "atan2": (2, pl.arctan2),
    "hypot": (2, _hypot),
    "ddmm": (1, _ddmm),
    "gps_time": (2, gps_time),
    "min": (2, _least),
    "max": (2, _most),
    "where": (3, _where),
}
"""A function of expressions: its number of arguments, and its implementation."""
FUNCTIONS = (*_FUNCTIONS, "utc")
"""Functions of expressions."""


@dataclass(frozen=True)
class Expression:
    """A compiled text: a polars expression, the columns that it uses, and those that must hold numbers."""

    polars: pl.Expr
    columns: frozenset[str]
    numbers: frozenset[str]

    @property
    def truth(self) -> pl.Expr:
        """The value as a condition; null where it is empty."""
        return _truth(self.polars)


@dataclass(frozen=True)
class _Context:
    """The text being compiled, the columns there are, and those used so far: all, and as numbers."""

    text: str
    columns: Collection[str]
    used: set[str]
    numbers: set[str]


def compile_expression(text: str, columns: Collection[str]) -> Expression:
    """Compile a text over a table's columns.

    Raises
    ------
    InputError
        The text is not an expression, names a missing column, or uses a forbidden construct.
    """
    about = _Context(text, columns, set(), set())
    try:
        polars = _build(parse(text), about)
        return Expression(polars, frozenset(about.used), frozenset(about.numbers))
    except RecursionError:
        raise InputError(f"the expression {text[:40]!r}... is nested too deeply; simplify it") from None


def integer_scale(text: str, columns: Collection[str]) -> tuple[str, float] | None:
    """The column and the factor where a text says just ``column`` or ``column * number``, else None.

    Whole numbers of nanoseconds since 1970 have more digits than a float holds: such a time is best scaled as integers.
    """
    tree = parse(text)
    factor = 1.0
    if isinstance(tree, ast.BinOp) and isinstance(tree.op, ast.Mult | ast.Div):
        right = tree.right
        if not isinstance(right, ast.Constant) or not isinstance(right.value, int | float) or not right.value:
            return None
        try:
            factor = float(right.value) if isinstance(tree.op, ast.Mult) else 1 / float(right.value)
        except (OverflowError, ZeroDivisionError):  # a whole number of 400 digits, or 1e-400
            return None
        if not math.isfinite(factor):
            return None
        tree = tree.left
    name = _column_name(tree)
    return None if name is None or name not in columns else (name, factor)


def parse(text: str) -> ast.expr:
    """The syntax tree of a text, backticked names turned into ``col("...")``."""
    if len(text) > LONGEST:
        raise InputError(f"the expression {text[:40]!r}... is longer than {LONGEST} characters; shorten it")
    plain = re.sub(r"`([^`]*)`", lambda m: f"col({m.group(1)!r})", text.strip())
    try:
        return ast.parse(plain, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(
            f"{quoted(text)} is not an expression; write for example -acc_y*9.80665, and `a name with spaces` in "
            "backticks"
        ) from None


def _column_name(node: ast.AST) -> str | None:
    """The column that a node names: a name, a.b.c, a[0], or col("any text")."""
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


def _build(node: ast.AST, about: _Context) -> pl.Expr:
    """One node of the tree, checked against what is allowed."""

    def build(inner: ast.AST) -> pl.Expr:
        return _build(inner, about)

    name = _column_name(node)
    if name is not None:
        return _column(name, about)
    match node:
        case ast.Constant(value=bool() | int() | float() as value):
            return _constant(value, about)
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_number(build(operand)))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_number(build(left)), _number(build(right)))
        case ast.Compare(left=left, ops=ops, comparators=others) if {type(o) for o in ops} <= set(_OPERATORS):
            return _chain(left, ops, others, about)
        case ast.BoolOp(op=op, values=values):
            first, *rest = (build(v) for v in values)
            for other in rest:
                first = _OPERATORS[type(op)](first, other)
            return first
        case ast.Call(func=ast.Name(id="utc"), args=[_, *_] as args, keywords=[]):
            return _utc(args, about)
        case ast.Call(func=ast.Name(id=f), args=args, keywords=[]) if f in _FUNCTIONS:
            wanted, function = _FUNCTIONS[f]
            if len(args) != wanted:
                raise InputError(
                    f"{f} in {quoted(about.text)} takes {wanted} value(s), not {len(args)}; mend the expression"
                )
            return function(*(_number(build(a)) for a in args))
        case _:
            raise InputError(
                f"{quoted(ast.unparse(node))} in {quoted(about.text)} is not allowed; use columns, numbers, "
                f"+ - * / ** %, comparisons, and {', '.join(FUNCTIONS)}"
            )


def _chain(left: ast.expr, ops: list[ast.cmpop], others: list[ast.expr], about: _Context) -> pl.Expr:
    """``a < b < c`` as ``a < b and b < c``; text on one side compares as text."""
    pairs = zip([left, *others], ops, others, strict=False)
    return pl.all_horizontal(*(_compare(a, op, b, about) for a, op, b in pairs))


def _compare(a: ast.expr, op: ast.cmpop, b: ast.expr, about: _Context) -> pl.Expr:
    name = _column_name(a)
    if isinstance(b, ast.Constant) and isinstance(b.value, str) and name is not None:
        _require_column(name, about)
        return _OPERATORS[type(op)](pl.col(name).cast(pl.String), pl.lit(b.value))
    return _OPERATORS[type(op)](_number(_build(a, about)), _number(_build(b, about)))


def _constant(value: float, about: _Context) -> pl.Expr:
    try:
        return pl.lit(float(value))
    except OverflowError:
        raise InputError(f"{quoted(about.text)} has a number beyond 1.8e308; write a smaller one") from None


def _column(name: str, about: _Context) -> pl.Expr:
    """A column as float64, null where it is empty, NaN or no number; or a constant."""
    if name in _CONSTANTS and name not in about.columns:
        return pl.lit(_CONSTANTS[name])
    _require_column(name, about)
    about.numbers.add(name)
    return pl.col(name).cast(pl.Float64, strict=False).fill_nan(None)


def _require_column(name: str, about: _Context) -> None:
    if name not in about.columns:
        near = difflib.get_close_matches(name, about.columns, 1, 0.5)
        hint = f"perhaps `{shown(near[0])}`" if near else f"there are {names_shown(about.columns, '`')}"
        raise InputError(f"{quoted(about.text)} names the column {quoted(name)}, which is not there; {hint}")
    about.used.add(name)


def _utc(args: list[ast.expr], about: _Context) -> pl.Expr:
    """Seconds since 1970 of dates in a column, or a day and a time of day in two, and how they are written."""
    form = ""
    match args[-1]:
        case ast.Constant(value=str(text)):
            form, args = text, args[:-1]
        case _:
            pass
    names = [name for arg in args if (name := _column_name(arg)) is not None]
    if len(names) < len(args) or not names:
        raise InputError(
            f"utc(...) in {quoted(about.text)} takes the name of a column, or of two, and how dates are written, as "
            "utc(date, '%d.%m.%Y %H:%M:%S'); mend the expression"
        )
    for name in names:
        _require_column(name, about)
    return parse_dates(as_text(names), form)


def terms_of(text: str) -> list[str]:
    """The two terms of a sum; the text itself where it is no sum."""
    tree = parse(text)
    if isinstance(tree, ast.BinOp) and isinstance(tree.op, ast.Add):
        return [ast.unparse(tree.left), ast.unparse(tree.right)]
    return [text]
