"""Translate expressions to C99: find the places of rows and states, and omit terms that are 0 in the filter."""

import ast
from collections.abc import Callable
from copy import copy
from typing import Any

from sigmaswarm.exports.c_emitter import CALLS, INPUTS, PARAMETERS, RENAMED, Emitter, parameter_name
from sigmaswarm.exports.c_text import name_of, number_of, numeral, parsed
from sigmaswarm.filters.compiled.layout import COVARIANCE, MEAN, N_KEPT, NAMES, QUATERNION, at

SIGNS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    ast.BitAnd: "&&", ast.BitOr: "||", ast.And: "&&", ast.Or: "||",
}  # fmt: skip
_UNKNOWN = (NameError, TypeError, AttributeError, KeyError, SyntaxError, ValueError)
_MISSING = "no row in C: "


class Expressions(ast.NodeTransformer):
    """Translation of the expressions of one function to C.

    A rewritten expression contains C text in place of each name and each number, for example ``R(0.5)``.
    """

    def __init__(
        self, emitter: Emitter, function: Callable[..., Any], key: str, known: dict[str, Any]
    ) -> None:
        self.definition, self.comments = parsed(function)
        self.emitter, self.key = emitter, key
        self.name = emitter.names.get(key, key.lstrip("_"))
        self.known, self.names = known, {**function.__globals__, **known, "at": at}
        self.is_kernel = any(each.arg == "w" for each in self.definition.args.args)
        self.numbers: dict[str, ast.expr] = {}  # locals with a known value

    # ---- places ----

    def evaluate(self, node: ast.expr) -> Any:
        return eval(ast.unparse(node), self.names | self.known)

    def value(self, node: ast.expr) -> Any:
        """Return the value of an expression, or None if it depends on the state."""
        if isinstance(node, ast.BinOp) and ast.unparse(node.left) == "events":
            return None if self.evaluate(node.right) else 0  # 0: this filter does not have the event
        try:
            return self.evaluate(node)
        except _UNKNOWN:
            return None

    def local(self, name: str) -> str:
        return RENAMED.get(name, name)

    def written(self, node: ast.expr) -> tuple[str | None, str]:
        """Return the `place` of an assignment's target, or None if the target is not stored in C."""
        place, mirror = self.place(node)
        return (None if place is not None and " * " in place else place), mirror

    def place(self, node: ast.expr) -> tuple[str | None, str]:
        """Return the C text of a local variable or an element of ``w``, and of a covariance's mirrored element."""
        if isinstance(node, ast.Name):
            return self.local(node.id), ""
        assert isinstance(node, ast.Subscript)
        index = node.slice.elts[0] if isinstance(node.slice, ast.Tuple) else node.slice
        row = self.value(index)
        if row is None:
            return self.place_in_loop(index)
        name = NAMES[row]
        if name in self.emitter.rows:
            text = self.emitter.rows[name]
            return (text if isinstance(text, str) else None), ""
        if name in MEAN:
            return f"b->mean[{self.emitter.states[MEAN.index(name)]}]", ""
        if name in QUATERNION:
            return f"b->attitude[{QUATERNION.index(name)}]", ""
        if name in COVARIANCE:
            return self.mirrored(*(self.emitter.states[MEAN.index(letter)] for letter in name))
        if name[:3] in ("C1_", "C2_"):
            return f"work->{name[:2]}[{self.emitter.states[MEAN.index(name[3:])]}]", ""
        if row < N_KEPT:  # only scratch rows, which a step writes before it reads them, can be in Work
            raise TypeError(f"{self.name}: row {name} has no C text; add it to c_kernels._rows")
        return f"work->{name.lower()}", ""

    def place_in_loop(self, index: ast.expr) -> tuple[str | None, str]:
        match index:
            case ast.Call(_, [i, j]):
                return self.mirrored(self.index(i), self.index(j))
            case ast.BinOp(ast.Name("Q"), _, right):
                return str(self.emitter.rows["Q"]).format(self.index(right)), ""
            case ast.BinOp(ast.Name(block), _, right):
                return f"work->{block}[{self.index(right)}]", ""
            case _:
                return f"b->mean[{self.index(index)}]", ""

    def mirrored(self, i: str, j: str) -> tuple[str, str]:
        return f"P[{i}][{j}]", f"P[{j}][{i}]" if i != j else ""

    def index(self, node: ast.expr) -> str:
        place = self.value(node)
        return ast.unparse(node) if place is None else str(self.emitter.states[place])

    # ---- expressions ----

    def refused(self, node: ast.AST) -> TypeError:
        return TypeError(f"{self.name}: {ast.unparse(node)} is not in the subset that the emitter translates")

    def fold(self, node: ast.expr) -> ast.expr:
        """Rewrite an expression with C names and without terms that are 0 in this filter."""
        return self.visit(node)

    def c(self, node: ast.expr) -> str:
        return self.print(self.fold(node))

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Rewrite a copy, since the parsed function is reused."""
        new = copy(node)
        for name, value in ast.iter_fields(node):
            if isinstance(value, list):
                setattr(new, name, [self.visit(each) for each in value])
            elif isinstance(value, ast.AST):
                setattr(new, name, self.visit(value))
        return new

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return numeral(node.value) if isinstance(node.value, float) else ast.Name(str(node.value).lower())

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id.isupper() and isinstance(self.names.get(node.id), int | float):
            return ast.Name(f"R({node.id})")  # a constant
        return self.numbers.get(node.id, ast.Name(self.local(node.id)))

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        value = self.evaluate(node)
        return ast.Name(self.emitter.states[value]) if isinstance(value, int) else numeral(value)

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        match node:
            case ast.Subscript(ast.Name("w"), ast.Tuple([index, *_])):
                row = self.value(index)
                number = None if row is None else self.emitter.rows.get(NAMES[row])
                if isinstance(number, float):
                    return numeral(number)
                return ast.Name(self.place(node)[0] or _MISSING + ast.unparse(node))
            case ast.Subscript(ast.Name(array), index):
                return ast.Name(INPUTS[array][self.value(index)])
            case _:
                raise self.refused(node)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        return ast.Name(self.call(node))

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        operand = self.visit(node.operand)
        value = number_of(operand)
        if value is None or isinstance(node.op, ast.Not):
            return ast.UnaryOp(node.op, operand)
        return numeral(-value if value else 0.0)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        left, right = self.visit(node.left), self.visit(node.right)
        if name_of(left) == "events":
            return ast.Name(f"(events & EVENT_{ast.unparse(node.right)}) != 0u")
        a, b = number_of(left), number_of(right)
        match node.op:
            case ast.Add() if a == 0.0:
                return right
            case ast.Add() | ast.Sub() if b == 0.0:
                return left
            case ast.Sub() if a == 0.0:
                return ast.UnaryOp(ast.USub(), right)
            case ast.Mult() if a == 0.0 or b == 0.0:
                return numeral(0.0)
            case ast.Mult() if a == 1.0:
                return right
            case ast.Mult() | ast.Div() if b == 1.0:
                return left
            case ast.Div() if a == 0.0:
                return left
            case ast.BitAnd() if "true" in (name_of(left), name_of(right)):
                return right if name_of(left) == "true" else left
            case _ if a is not None and b is not None:  # computed in double
                return numeral(eval(f"{a!r} {SIGNS[type(node.op)]} {b!r}"))
            case _:
                return ast.BinOp(left, node.op, right)

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        left, right = self.visit(node.left), self.visit(node.comparators[0])
        a, b = number_of(left), number_of(right)
        if a is None or b is None:
            return ast.Compare(left, node.ops, [right])
        return ast.Name(str(eval(f"{a!r} {SIGNS[type(node.ops[0])]} {b!r}")).lower())

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        test, body, orelse = self.visit(node.test), self.visit(node.body), self.visit(node.orelse)
        known = {"true": body, "false": orelse}.get(name_of(test))
        return ast.IfExp(test, body, orelse) if known is None else known

    def call(self, node: ast.Call, outs: list[str] | None = None) -> str:
        name = ast.unparse(node.func)
        if name in CALLS:
            return f"{CALLS[name]}({', '.join(map(self.c, node.args))})"
        printed, signature = self.emitter.signature_of(name, self.names[name])
        arguments: list[str] = []
        for each, theirs in zip(node.args, signature, strict=True):
            if self.is_kernel and isinstance(each, ast.Name) and each.id in PARAMETERS:
                names = [parameter_name(parameter) for parameter in theirs]
                arguments += [name for name in names if name not in arguments]
            elif theirs:
                arguments.append(self.c(each))
        return f"{printed}({', '.join([*arguments, *(outs or [])])})"

    def print(self, node: ast.expr, outer: int = 0) -> str:
        """Return the C text of a rewritten expression, in parentheses if its precedence is lower than ``outer``."""
        match node:
            case ast.Name(text):
                if text.startswith(_MISSING):
                    raise TypeError(f"{self.name}: {text}")
                return text
            case ast.UnaryOp(ast.USub(), operand):
                text, binds = f"-{self.print(operand, 7)}", 7
            case ast.UnaryOp(ast.Not(), operand):
                text, binds = f"!({self.print(operand)})", 8
            case ast.BinOp(left, ast.BitAnd() | ast.BitOr() as op, right):
                chained = isinstance(left, ast.BinOp) and type(left.op) is type(op)
                text = f"{self.print(left, 2 if chained else 3)} {SIGNS[type(op)]} {self.print(right, 3)}"
                binds = 2
            case ast.BinOp(left, op, right) if type(op) in SIGNS:
                binds = 5 if isinstance(op, ast.Add | ast.Sub) else 6
                text = f"{self.print(left, binds)} {SIGNS[type(op)]} {self.print(right, binds + 1)}"
            case ast.BoolOp(op, values):
                text, binds = f" {SIGNS[type(op)]} ".join(self.print(v, 3) for v in values), 2
            case ast.Compare(left, [op], [right]):
                text, binds = f"{self.print(left, 4)} {SIGNS[type(op)]} {self.print(right, 4)}", 3
            case ast.IfExp(test, body, orelse):
                text = f"{self.print(test, 2)} ? {self.print(body, 2)} : {self.print(orelse, 1)}"
                binds = 1
            case _:
                raise self.refused(node)
        return f"({text})" if binds < outer else text
