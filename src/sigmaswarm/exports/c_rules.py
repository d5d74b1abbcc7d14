"""Translate the rules for samples and fixes (standstill, stale fixes, gaps) from the library's functions to C99.

The exported C code has its own type for times, since the float build counts ticks. ``seconds_between`` returns the
difference of two times. ``SECONDS`` converts seconds that are added to a time.
"""

# pyright: reportPrivateUsage=false

import ast
import textwrap
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from sigmaswarm.drives import events, gaps, odometer, stale_fixes, standstill
from sigmaswarm.exports.c_emitter import WHEELS, Emitter, parameter_name
from sigmaswarm.exports.c_functions import Function
from sigmaswarm.exports.c_text import declaration
from sigmaswarm.filters.compiled import live

MODULES = gaps, stale_fixes, standstill, odometer, events
"""Modules whose constants the rules use."""


def by_name(names: Mapping[str, str]) -> dict[str, str]:
    """Return the type of each name. ``names`` contains, by type, the names separated by blanks."""
    return {name: kind for kind, some in names.items() for name in some.split()}


POINTERS = by_name(
    {
        "const InsGpsFix *": "fixes rows",
        "const InsGpsReading *": "readings",
        "Wheels *": "wheels",
        "InsGpsBlock *": "memory",
        "const real *": "means",
        "ins_gps_time *": "until",
        "InsGpsEstimate *": "done",
    }
)
"""C types of arrays, by default ``real *``. The array ``kinds`` is a field of the fixes."""
FIELDS = {
    "fixes": ("time", "x", "y"),
    "rows": ("time",),
    "readings": ("time", "speed"),
    "wheels": WHEELS,
    "done": ("lateral_slot", "standstill_slot", "odometer_slot", "odometer_time"),
}
TIMES = ("now", "before", "taken")
ENUMERATORS = {
    "HELD": "INS_GPS_AT_REST",
    **{name: f"INS_GPS_{name}" for name in ("NEW", "STALE", "STALE_MOVING")},
    **{name: f"EVENT_{name}" for name in ("LATERAL", "STANDSTILL", "ODOMETER")},
}
SAMPLE = {
    "slot": "slot_of(f, sample->time)",
    "now": "sample->time",
    "before": "before",
    "ay": "sample->ay",
    "stands": "stands",
    "readings": "f->readings",
    "come": "readings_until(f->readings, f->n_readings, sample->time)",
    "done": "b",
    "wheels": "&wheels",
}
"""C arguments of `drives.events.sample_events`."""
_TIME, _KIND = "ins_gps_time", "InsGpsFixKind"
_TYPES = {float: "real", int: "int", bool: "bool", None: "void"}
_CALLS = {"min": "SMALLER", "max": "LARGER"}
_CASTS = {"int": "(int)", "float": "(real)"}


def rules_of(features: Mapping[str, Any], used: int) -> dict[str, str]:
    """Return the C text of the rules and of the call of `sample_events`, by name. For ``used`` see `events.bits_of`."""
    emitter = Emitter(Rule, settings={"used": used})
    emitter.add(live._until, "fixes_until")
    if features["odometer"]:
        emitter.add(live._until, "readings_until", _OfReadings)
    functions = [gaps.gap_of, gaps.usual_after, stale_fixes.kind_of]
    if features["standstill"]:
        functions += [standstill.updated_calm, standstill.matches_stop, standstill.fixes_are_still]
    for function in (*functions, *([events.sample_events] if used else [])):
        emitter.add(function)
    values = {"rules": "\n".join(emitter.texts)}
    if used:
        name, signature = emitter.signatures["sample_events"]
        arguments = [SAMPLE[parameter_name(p)] for each in signature for p in each]
        call = f"{name}({', '.join(arguments)})"
        values["sample_events"] = textwrap.fill(call, 100, subsequent_indent=" " * 8)
    return values


class Rule(Function):
    """Translation of a rule to C. The first value of a local variable determines its type."""

    pointers, fields, times, enumerators = POINTERS, FIELDS, TIMES, ENUMERATORS

    def __init__(self, emitter: Emitter, compiled: Any, key: str, known: dict[str, Any]) -> None:
        function = getattr(compiled, "py_func", compiled)
        super().__init__(emitter, function, key, known)
        self.types = {name: _TYPES.get(kind, "real *") for name, kind in function.__annotations__.items()}
        self.types |= {name: kind for name, kind in self.pointers.items() if name in self.types}
        self.types |= {name: _TIME for name in self.types if name in self.times}
        self.types |= {"slot": "uint32_t", "events": "unsigned"}
        returns = {"kind_of": _KIND, "sample_events": "unsigned"}
        self.returns = returns.get(self.name, self.types["return"])

    def parameters_of(self, name: str) -> tuple[str, ...]:
        return () if name == "kinds" else (declaration(self.types[name], self.local(name)),)

    # ---- statements ----

    def loop(self, name: str, steps: ast.expr, body: list[ast.stmt], depth: int) -> None:
        """Print a loop over `range`."""
        self.types[name] = "int"
        assert isinstance(steps, ast.Call)
        texts = [self.print(self.fold(bound), 4) for bound in steps.args]
        first, end, step = texts if len(texts) == 3 else [*["0", *texts][-2:], "1"]
        sign, by = ("-", step[1:]) if step.startswith("-") else ("+", step)
        place = self.local(name)
        change = f"{place}{2 * sign}" if by == "1" else f"{place} {sign}= {by}"
        compared = ">" if sign == "-" else "<"
        self.nested(f"for (int {place} = {first}; {place} {compared} {end}; {change}) {{", body, depth)

    def store_all(self, targets: list[ast.expr], values: list[ast.expr], depth: int) -> None:
        pairs = list[tuple[ast.expr, ast.expr]]()
        for target, value in zip(targets, values, strict=True):
            if isinstance(target, ast.Name) and isinstance(value, ast.Tuple):
                self.types[target.id] = "real *"
                self.put(f"const real {target.id}[] = {{{', '.join(map(self.c, value.elts))}}};", depth)
                continue
            if isinstance(value, ast.Call) and ast.unparse(value.func) == "np.zeros":
                lengths = np.atleast_1d(self.evaluate(value.args[0]))
                dimensions = "".join(f"[{length}]" for length in lengths)
                zeros = "{" * len(lengths) + "R(0.0)" + "}" * len(lengths)
                self.put(f"real {ast.unparse(target)}{dimensions} = {zeros};", depth)
                continue
            if isinstance(target, ast.Name):
                self.types.setdefault(target.id, self.type_of(value))
            pairs.append((target, value))
        super().store_all([target for target, _ in pairs], [value for _, value in pairs], depth)

    def kind_of(self, target: ast.Name, value: ast.expr) -> str:
        return self.types[target.id]

    def place(self, node: ast.expr) -> tuple[str | None, str]:
        return self.c(node), ""

    # ---- expressions ----

    def type_of(self, node: ast.expr) -> str:
        match node:
            case ast.Name(name) if name in self.types:
                return self.types[name]
            case ast.Subscript(ast.Name("fixes" | "readings"), ast.Tuple([_, ast.Constant(0)])):
                return _TIME
            case ast.Subscript(ast.Name("memory"), index) if not isinstance(index, ast.Tuple):
                return "real *"
            case ast.Subscript(ast.Name("kinds")):
                return _KIND
            case ast.Subscript(ast.Name(name)) if self.types.get(name) == "const int *":
                return "int"
            case ast.Call(ast.Name("int")):
                return "int"
            case ast.BinOp(left, _, right):
                kinds = [self.type_of(left), self.type_of(right)]
                return _TIME if kinds.count(_TIME) == 1 else "int" if kinds == ["int", "int"] else "real"
            case ast.Compare() | ast.BoolOp():
                return "bool"
            case _:
                return _TYPES.get(type(self.value(node)), "real")

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        return ast.Name(f"{self.value(node)}") if self.type_of(node) == "int" else super().visit_UnaryOp(node)

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.enumerators:
            return ast.Name(self.enumerators[node.id])
        is_int = isinstance(self.names.get(node.id), int)
        return ast.Name(node.id) if is_int else super().visit_Name(node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        assert isinstance(node.value, ast.Name)
        name, indices = node.value.id, node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if name == "kinds":
            return ast.Name(f"fixes[{self.c(indices[0])}].kind")
        if name in self.fields:
            match indices[-1], self.value(indices[-1]):
                case ast.BinOp(base, _, offset), None:
                    field = self.fields[name][self.value(base)].replace("[0]", f"[{self.c(offset)}]")
                case _, None:  # an element of an array of structs
                    return ast.Name(f"&{name}[{self.c(indices[0])}]")
                case _, index:
                    field = self.fields[name][index]
            place = f"{name}->" if len(indices) == 1 else f"{name}[{self.c(indices[0])}]."
            return ast.Name(place + field)
        return ast.Name(name + "".join(f"[{self.c(index)}]" for index in indices))

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        known = [self.value(each) for each in node.values]  # known operands do not decide the result
        left = [self.visit(each) for each, value in zip(node.values, known, strict=True) if value is None]
        return left[0] if len(left) == 1 else ast.BoolOp(node.op, left)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        kinds = [self.type_of(node.left), self.type_of(node.right)]
        if kinds == [_TIME, _TIME]:
            return ast.Name(f"seconds_between({self.c(node.right)}, {self.c(node.left)})")
        if kinds[0] == _TIME:
            seconds = ast.Name(f"SECONDS({ast.unparse(node.right)})")
            return ast.BinOp(self.visit(node.left), node.op, seconds)
        return super().visit_BinOp(node)

    def call(self, node: ast.Call, outs: list[str] | None = None) -> str:
        name = ast.unparse(node.func)
        if name in _CASTS and self.type_of(node.args[0]) != _KIND:
            return _CASTS[name] + self.print(self.fold(node.args[0]), 8)
        if name in _CALLS:
            return f"{_CALLS[name]}({', '.join(map(self.c, node.args))})"
        if name == "int":
            return self.c(node.args[0])
        return super().call(node)


class _OfReadings(Rule):
    pointers: ClassVar = {"rows": "const InsGpsReading *"}
