"""Translate the kernels of the compiled filter to C99 for one filter, without terms that are 0 in this filter."""

import ast
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from typing import Any, NamedTuple

from sigmaswarm.exports.c_names import CALLS, INPUTS, PARAMETERS, RENAMED, STATES
from sigmaswarm.exports.c_text import in_c, is_truth, name_of, number_of, numeral, parsed, uses, wrapped
from sigmaswarm.filters.compiled.layout import COVARIANCE, MEAN, N_KEPT, NAMES, QUATERNION, at
from sigmaswarm.filters.compiled.unroll import Kernel

_SIGNS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    ast.BitAnd: "&&", ast.BitOr: "||", ast.And: "&&", ast.Or: "||",
}  # fmt: skip
_UNKNOWN = (NameError, TypeError, AttributeError, KeyError, SyntaxError, ValueError)
_MISSING = "no row in C: "


def parameter_name(parameter: str) -> str:
    """Return the name of a C parameter, for example ``rows`` of ``real rows[][6]``."""
    return parameter.split()[-1].lstrip("*").partition("[")[0]


class Elements(NamedTuple):
    """An array that a function unpacks: the C parameter, and the C text of each element."""

    parameter: str
    texts: Sequence[str]


class Emitter:
    """C functions of one filter.

    Parameters
    ----------
    rows : dict
        Rows of the kernel by name: C text, a number, or None if the C code does not contain the row.
    states : sequence of str
        C names of the filter's states.
    settings : dict
        Values of parameters and globals, by name, in all functions.
    names : dict of str to str
        C names of functions by Python name; all other functions keep their names.
    """

    def __init__(
        self,
        rows: Mapping[str, str | float | None],
        states: Sequence[str] = STATES,
        settings: Mapping[str, Any] | None = None,
        names: Mapping[str, str] | None = None,
    ) -> None:
        self.rows, self.states, self.texts = rows, states, list[str]()
        self.settings, self.names = settings or {}, names or {}
        self.signatures: dict[str, tuple[str, list[list[str]]]] = {}  # by name in Python

    def add(
        self, function: Any, name: str = "", translation: "type[_Function] | None" = None, **known: Any
    ) -> None:
        """Translate a kernel or a plain function, after the functions that it calls.

        ``name`` is the name in calls, by default that of the function. ``known`` contains the values of parameters. If
        ``known["e"]`` is an `Elements`, the function writes its results to these elements.
        """
        if isinstance(function, Kernel):
            function, known = function.source, {**function.known, **known}
        absent = {parameter: 0 for parameter, value in known.items() if value is None}
        known = {**known, **absent, **self.settings}
        self.texts.append((translation or _Function)(self, function, name or function.__name__, known).text())

    def signature_of(
        self, name: str, function: Any, translation: "type[_Function]"
    ) -> tuple[str, list[list[str]]]:
        """Return the C name and parameters of a called function, which is translated at its first call.

        ``name`` is the function's name in the call.
        """
        if name not in self.signatures:
            self.add(function, name, translation)
        return self.signatures[name]

    def call(self, function: str) -> str:
        name, signature = self.signatures[function]
        parameters = dict.fromkeys(parameter_name(p) for each in signature for p in each)
        return f"{name}({', '.join(parameters)})"

    def text(self) -> str:
        code = re.sub(r"/\*.*?\*/", "", "\n".join(self.texts), flags=re.DOTALL)
        rows = set(re.findall(r"work->(\w+)", code))
        names = [row.lower() for row in NAMES if row.lower() in rows]
        names += [f"{block}[N]" for block in ("C1", "C2") if block in rows]
        listed = textwrap.fill(", ".join(names), 110, subsequent_indent=" " * 9)
        struct = f"typedef struct {{\n    real {listed};\n}} Work;\n"
        return "\n".join([struct, *self.texts])


class _Function(ast.NodeTransformer):
    """Translation of one function to C.

    A rewritten expression contains C text in place of each name and each number, for example ``R(0.5)``.
    """

    def __init__(
        self, emitter: Emitter, function: Callable[..., Any], key: str, known: dict[str, Any]
    ) -> None:
        definition, self.comments = parsed(function)
        self.emitter, self.key, self.definition = emitter, key, definition
        self.name = emitter.names.get(key, key.lstrip("_"))
        self.known, self.names = known, {**function.__globals__, **known, "at": at}
        self.is_kernel = any(each.arg == "w" for each in definition.args.args)
        self.body = self.chosen(definition.body[ast.get_docstring(definition) is not None :])
        nodes = [node for statement in self.body for node in ast.walk(statement)]
        stored = [n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        stored += [name_of(n.target) for n in nodes if isinstance(n, ast.AugAssign)]
        self.changing = {n for n in stored if stored.count(n) > 1}
        self.numbers: dict[str, ast.expr] = {}  # locals with a known value
        self.declared, self.lines, self.outs, self.returns = set[str](), list[str](), list[str](), ""

    def text(self) -> str:
        self.block(self.body, 1)
        self.drop_unused()
        code, signature = "\n".join(self.lines), list[list[str]]()
        for each in self.definition.args.args:
            parameters_in_c = self.parameters_of(each.arg)
            signature.append([p for p in parameters_in_c if uses(code, parameter_name(p))])
        self.emitter.signatures[self.key] = self.name, signature
        parameters = dict.fromkeys(p for each in signature for p in each)
        parameters = [*parameters, *(f"real *{out}" for out in self.outs)]
        parameters = [p.replace(" ", "\0") for p in parameters]  # no line break within a parameter
        head = f"static {self.returns or 'void'} {self.name}({', '.join(parameters)})"
        if "P[" in code:
            self.lines.insert(0, "    real(*P)[N] = b->covariance;")
        documented = (ast.get_docstring(self.definition) or "").split("\n\n")[0].split()
        doc = textwrap.fill(in_c(" ".join(documented)), 116, subsequent_indent=" * ")
        comment = f"/* {doc} */\n" if documented else ""
        head = textwrap.fill(head, 118, subsequent_indent="    ").replace("\0", " ")
        return f"{comment}{head}\n{{\n" + "\n".join(wrapped(self.lines)) + "\n}\n"

    def parameters_of(self, name: str) -> tuple[str, ...]:
        if isinstance(given := self.known.get(name), Elements):
            return (given.parameter,)
        renamed = PARAMETERS.get(name) if self.is_kernel else None
        return (f"real {self.local(name)}",) if renamed is None else renamed

    def chosen(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        """Return the statements without branches that never run."""
        chosen: list[ast.stmt] = []
        for statement in statements:
            known = self.value(statement.test) if isinstance(statement, ast.If) else None
            if isinstance(statement, ast.If) and known is not None:
                chosen += self.chosen(statement.body if known else statement.orelse)
                continue
            if isinstance(statement, ast.If | ast.For):
                body = self.chosen(statement.body)
                statement = copy(statement)
                statement.body = body
            chosen.append(statement)
        return chosen

    def drop_unused(self) -> None:
        """Remove local variables that only removed terms used; keep calls of kernels."""
        for line in reversed(list(self.lines)):
            match = re.match(r"( +)const (?:real|bool) (\w+) = ([^;]*;)$", line)
            if match and len(re.findall(rf"(?<!>)\b{match[2]}\b", "\n".join(self.lines))) == 1:
                kept = [f"{match[1]}(void){match[3]}"] if re.match(r"\w+\([^()]*work\);", match[3]) else []
                place = self.lines.index(line)
                self.lines[place : place + 1] = kept

    # ---- statements ----

    def put(self, line: str, depth: int) -> None:
        self.lines.append("    " * depth + line)

    def block(self, statements: list[ast.stmt], depth: int) -> None:
        for statement in statements:
            first = len(self.lines)
            for comment in self.comments.get(statement.lineno, []):
                self.put(f"/* {comment} */", depth)
            after_comments = len(self.lines)
            match statement:
                case ast.Assign([ast.Tuple(elts=targets)], ast.Call() as call):
                    self.store_results(targets, call, depth)
                case ast.Assign([ast.Tuple(elts=targets)], ast.Tuple(elts=values)):
                    self.store_all(targets, values, depth)
                case ast.Assign([ast.Tuple(elts=targets)], ast.Name(array)) if array in self.known:
                    pairs = zip(map(ast.unparse, targets), self.known[array].texts, strict=True)
                    self.numbers |= {target: ast.Name(text) for target, text in pairs}
                case ast.Assign([target], value):
                    self.store_all([target], [value], depth)
                case ast.AugAssign(target, ast.BitOr(), value):
                    self.put(f"{self.c(target)} |= {self.c(value)};", depth)
                case ast.AugAssign(target, op, value):
                    self.add_to(target, _SIGNS[type(op)], self.fold(value), depth)
                case ast.For(ast.Name(name), steps, body):
                    self.loop(name, steps, body, depth)
                case ast.While(test, body):
                    self.nested(f"while ({self.c(test)}) {{", body, depth)
                case ast.If():
                    self.branch("if", statement, depth)
                case ast.Break():
                    self.put("break;", depth)
                case ast.Expr(ast.Call() as call):
                    self.put(f"{self.call(call)};", depth)
                case ast.Return(ast.Tuple(elts=values)) if "e" in self.known:
                    places = [ast.Name(text) for text in self.known["e"].texts]
                    self.declared |= {place.id for place in places}
                    self.store_all([*places], values, depth)
                case ast.Return(ast.Tuple(elts=values)):
                    for k, each in enumerate(values):
                        self.outs.append(f"{each.id}_out" if isinstance(each, ast.Name) else f"result{k + 1}")
                        self.put(f"*{self.outs[-1]} = {self.c(each)};", depth)
                case ast.Return(ast.expr() as value):
                    self.returns = self.returns or "real"
                    self.put(f"return {self.c(value)};", depth)
                case _:
                    raise self.refused(statement)
            if len(self.lines) == after_comments:
                del self.lines[first:]

    def store_results(self, targets: list[ast.expr], call: ast.Call, depth: int) -> None:
        """Print a call with results, which C returns through pointers."""
        if ast.unparse(call.func) == "spread_of" and number_of(self.fold(call.args[0])) == 0.0:
            # extended filter: sigma points without spread; d/4 is only a divisor, so any value but 0 is correct
            self.store_all(targets, [ast.Constant(1.0), ast.Constant(1.0), ast.Constant(0.0)], depth)
            return
        outs: list[str] = []
        for each in targets:
            assert isinstance(each, ast.Name)
            name = "unused" if each.id == "_" else self.local(each.id)
            if name not in self.declared:
                self.put(f"real {name};", depth)
                self.declared.add(name)
            outs.append(f"&{name}")
        self.put(f"{self.call(call, outs)};", depth)

    def store_all(self, targets: list[ast.expr], values: list[ast.expr], depth: int) -> None:
        """Print simultaneous assignments one after another; raise an error if one reads an earlier target."""
        folded = [self.fold(value) for value in values]
        written: set[str] = set()
        for k, (target, value) in enumerate(zip(targets, folded, strict=True)):
            if name_of(target) in self.known:
                continue
            fixed = name_of(target) and name_of(target) not in self.changing
            if fixed and number_of(value) is not None:
                self.numbers[name_of(target)] = value
                continue
            place, mirror = self.written(target)
            if place is None or place in written:
                continue
            if any(uses(self.print(v), place) for v in folded[k + 1 :]):
                raise TypeError(f"{self.name}: {ast.unparse(target)} is read after it was written")
            if not isinstance(target, ast.Name):
                written.add(place)
            self.store(target, place, mirror, value, depth)

    def store(self, target: ast.expr, place: str, mirror: str, value: ast.expr, depth: int) -> None:
        if place == "b->failed":  # OK = OK if a test holds else 0
            assert isinstance(value, ast.IfExp)
            self.put(f"if (!({self.print(value.test)})) {{", depth)
            self.put("b->failed = true;", depth + 1)
            self.put("}", depth)
            return
        declared = ""
        if isinstance(target, ast.Name) and place not in self.declared:
            declared = "" if target.id in self.changing else "const "
            declared += "bool " if is_truth(value) else "real "
            self.declared.add(place)
        if place != self.print(value):
            self.put(f"{declared}{place} = {mirror and mirror + ' = '}{self.print(value)};", depth)

    def add_to(self, target: ast.expr, sign: str, value: ast.expr, depth: int) -> None:
        place, mirror = self.written(target)
        if place is None or place in self.known or (number_of(value) == 0.0 and sign in "+-"):
            return
        self.put(f"{place} {sign}= {self.print(value)};", depth)
        if mirror:
            self.put(f"{mirror} = {place};", depth)

    def loop(self, name: str, steps: ast.expr, body: list[ast.stmt], depth: int) -> None:
        if name == "l":  # the columns
            self.block(body, depth)
            return
        listed = isinstance(steps, ast.Tuple) and not isinstance(steps.elts[0], ast.Starred)
        if isinstance(steps, ast.Name) or listed:
            rows = self.evaluate(steps)
            nodes = [node for statement in body for node in ast.walk(statement)] if len(rows) > 1 else []
            self.changing |= {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
            for value in rows:  # unroll the loop
                self.known, before = {**self.known, name: value}, self.known
                self.block(body, depth)
                self.known = before
            return
        if isinstance(steps, ast.Call) and ast.unparse(steps.func) == "range":
            end, value = ast.unparse(steps.args[-1]), self.value(steps.args[-1])
            if value is not None:
                end = "N" if value in (self.known.get("n"), self.names.get("N")) else str(value)
            first = self.index(steps.args[0]) if len(steps.args) == 2 else "0"
            self.nested(f"for (int {name} = {first}; {name} < {end}; {name}++) {{", body, depth)
        else:  # all states, beginning at one of them
            first, *_ = values = list(self.evaluate(steps))
            assert values == [*range(first, len(values)), *range(first)]
            self.put(f"for (int k = {first}; k < N + {first}; k++) {{", depth)
            self.nested(f"    const int {name} = k % N;", body, depth)

    def branch(self, head: str, statement: ast.If, depth: int) -> None:
        self.nested(f"{head} ({self.c(statement.test)}) {{", statement.body, depth)
        if statement.orelse:
            self.lines.pop()
            match statement.orelse:
                case [ast.If() as other]:
                    self.branch("} else if", other, depth)
                case body:
                    self.nested("} else {", body, depth)
        elif head != "if":  # MISRA rule 15.7
            self.lines.pop()
            self.put("} else {", depth)
            self.put("/* nothing */", depth + 1)
            self.put("}", depth)

    def nested(self, head: str, body: list[ast.stmt], depth: int) -> None:
        self.put(head, depth)
        before, n_lines = set(self.declared), len(self.lines)
        self.block(body, depth + 1)
        self.declared = before
        if len(self.lines) == n_lines and head.startswith("for"):
            self.lines.pop()  # no term is left
        else:
            self.put("}", depth)

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
        """Return the `place` of an assignment's target; None if the target is not stored in C."""
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
        return numeral(node.value) if isinstance(node.value, float) else ast.Name(str(node.value))

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
                return numeral(eval(f"{a!r} {_SIGNS[type(node.op)]} {b!r}"))
            case _:
                return ast.BinOp(left, node.op, right)

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        left, right = self.visit(node.left), self.visit(node.comparators[0])
        a, b = number_of(left), number_of(right)
        if a is None or b is None:
            return ast.Compare(left, node.ops, [right])
        return ast.Name(str(eval(f"{a!r} {_SIGNS[type(node.ops[0])]} {b!r}")).lower())

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        test, body, orelse = self.visit(node.test), self.visit(node.body), self.visit(node.orelse)
        known = {"true": body, "false": orelse}.get(name_of(test))
        return ast.IfExp(test, body, orelse) if known is None else known

    def call(self, node: ast.Call, outs: list[str] | None = None) -> str:
        name = ast.unparse(node.func)
        if name in CALLS:
            return f"{CALLS[name]}({', '.join(map(self.c, node.args))})"
        printed, signature = self.emitter.signature_of(name, self.names[name], type(self))
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
                text = f"{self.print(left, 2 if chained else 3)} {_SIGNS[type(op)]} {self.print(right, 3)}"
                binds = 2
            case ast.BinOp(left, op, right) if type(op) in _SIGNS:
                binds = 5 if isinstance(op, ast.Add | ast.Sub) else 6
                text = f"{self.print(left, binds)} {_SIGNS[type(op)]} {self.print(right, binds + 1)}"
            case ast.BoolOp(op, values):
                text, binds = f" {_SIGNS[type(op)]} ".join(self.print(v, 3) for v in values), 2
            case ast.Compare(left, [op], [right]):
                text, binds = f"{self.print(left, 4)} {_SIGNS[type(op)]} {self.print(right, 4)}", 3
            case ast.IfExp(test, body, orelse):
                text = f"{self.print(test, 2)} ? {self.print(body, 2)} : {self.print(orelse, 1)}"
                binds = 1
            case _:
                raise self.refused(node)
        return f"({text})" if binds < outer else text
