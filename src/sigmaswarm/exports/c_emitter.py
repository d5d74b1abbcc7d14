"""Print the compiled filter's kernels as C99 for one column: the same text, without the loop over columns."""

import ast
import inspect
import io
import math
import re
import textwrap
import tokenize
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sigmaswarm.filters.compiled.layout import COVARIANCE, MEAN, NAMES, QUATERNION
from sigmaswarm.filters.compiled.unroll import Kernel

STATES = (
    *("X", "Y", "VX", "VY", "HEADING", "ACCEL_X", "ACCEL_Y", "GYRO", "ROLL", "PITCH", "GYRO_X", "GYRO_Y"),
    *("FIX_ERROR_X", "FIX_ERROR_Y"),
)
"""Names of a state's places in C, in the order of the largest model."""
FIX_ERROR = STATES[-2:]
"""Of these, the states that are appended to any model."""
PARAMETERS = {
    "w": ("InsGpsBelief *b", "Work *work"),
    "u": ("real dt", "real steps", "const InsGpsSample *sample"),
    "z": ("const InsGpsFix *fix",),
    "lever": ("const real *lever",),
    "wheels": ("const Wheels *wheels",),
}
"""C's parameters in place of a kernel's; a function has those that it uses."""
INPUTS = {
    **{"DT": "dt", "Q_SCALE": "steps", "AX": "sample->ax", "AY": "sample->ay", "GZ": "sample->yaw_rate"},
    **{"AZ": "sample->az", "GX": "sample->gx", "GY": "sample->gy"},
    **{"FIX_X": "(fix->x - b->origin[0])", "FIX_Y": "(fix->y - b->origin[1])"},
    **{"FIX_VAR_X": "fix->variance[0]", "FIX_VAR_Y": "fix->variance[1]"},
    **{"SPEED": "wheels->speed", "AGE": "wheels->age", "MORE": "wheels->more"},
}
"""What stands for an element of a step, a fix and a reading."""
CALLS = {"math.sqrt": "SQRT", "math.exp": "EXP", "np.floor": "FLOOR", "abs": "FABS"}
RENAMED = {"b": "b0", "since": "passed", "near": "is_near", "far": "is_far"}
"""Local names that C uses for something else."""
_PRECEDENCE: dict[type, int] = {ast.Add: 5, ast.Sub: 5, ast.Mult: 6, ast.Div: 6}
_SIGNS: dict[type, str] = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"},
    **{ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="},
    **{ast.BitAnd: "&&", ast.BitOr: "||", ast.And: "&&", ast.Or: "||"},
}
_ATOM, _NOT_EVALUATED = 9, (NameError, TypeError, AttributeError, KeyError, SyntaxError, ValueError)


@dataclass
class Emitter:
    """Functions of one filter, printed one after another.

    Parameters
    ----------
    rows : dict
        C's text for rows that hold parameters, or a number: terms that it makes 0 are left out. None: a row that C
        does not have.
    states : sequence of str
        Names in C of the filter's states.
    """

    rows: Mapping[str, str | float | None]
    states: Sequence[str] = STATES
    texts: list[str] = field(default_factory=list)
    results: dict[str, int] = field(default_factory=dict)  # how many numbers a function gives
    used: set[str] = field(default_factory=set)  # rows of scratch
    constants: dict[str, float] = field(default_factory=dict)
    signatures: dict[str, tuple[str, list[list[str]]]] = field(default_factory=dict)  # by name in Python

    def add(self, function: Any, name: str = "", **known: Any) -> None:
        """Print a kernel or a plain function, under another ``name`` if given."""
        if isinstance(function, Kernel):
            function, known = function.source, {**function.known, **known}
        self.texts.append(_Function(self, function, name or function.__name__.lstrip("_"), known).text())

    def text(self) -> str:
        """All of it: constants, the struct, the functions."""
        constants = [f"#define {name} R({value!r})\n" for name, value in self.constants.items()]
        return "\n".join(["".join(constants), self.struct(), *self.texts])

    def struct(self) -> str:
        """What one kernel leaves for another."""
        single = sorted({n for n in self.used if n[:3] not in ("C1_", "C2_")}, key=NAMES.index)
        arrays = [f"{n}[N]" for n in ("C1", "C2") if any(u.startswith(n + "_") for u in self.used)]
        names = textwrap.fill(
            ", ".join([*(n.lower() for n in single), *arrays]), 110, subsequent_indent=" " * 9
        )
        return f"typedef struct {{\n    real {names};\n}} Work;\n"


class _Function:
    """One function on its way to C."""

    def __init__(
        self, emitter: Emitter, function: Callable[..., Any], name: str, known: dict[str, Any]
    ) -> None:
        self.emitter, self.name, self.known = emitter, name, known
        source = textwrap.dedent(inspect.getsource(function))
        self.names: dict[str, Any] = {**function.__globals__, **known}
        definition = ast.parse(source).body[0]
        assert isinstance(definition, ast.FunctionDef)
        self.definition, self.comments = definition, _comments(source)
        self.values: dict[str, ast.expr] = {}  # locals that are a number
        self.lines: list[str] = []
        definition.body = self.chosen(definition.body)
        self.declared: set[str] = set()
        self.is_kernel = any(each.arg == "w" for each in definition.args.args)
        stored = [
            n.id for n in ast.walk(definition) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
        ]
        augmented = [
            n.target.id
            for n in ast.walk(definition)
            if isinstance(n, ast.AugAssign) and isinstance(n.target, ast.Name)
        ]
        self.changing = {n for n in stored if stored.count(n) > 1 or n in augmented}
        self.outs: list[str] = []

    def text(self) -> str:
        """The function in C."""
        body = self.definition.body
        documented = ast.get_docstring(self.definition)
        self.block(body[documented is not None :], 1)
        self.drop_unused()
        body_text = "\n".join(self.lines)
        signature: list[list[str]] = []
        for each in self.definition.args.args:
            ours = PARAMETERS.get(each.arg, ()) if self.is_kernel else ()
            ours = ours or ((f"real {self.local(each.arg)}",) if each.arg != "l" else ())
            signature.append([p for p in ours if _uses(body_text, p.split()[-1].lstrip("*"))])
        self.emitter.signatures[self.definition.name] = self.name, signature
        count = self.emitter.results.get(self.name, 0)
        parameters = [p for each in signature for p in each] + [f"real *{out}" for out in self.outs]
        head = f"static {'real' if count == 1 else 'void'} {self.name}({', '.join(parameters)})"
        if any("P[" in line for line in self.lines):
            self.lines.insert(0, "    real(*P)[N] = b->covariance;")
        doc = textwrap.fill(
            " ".join((documented or "").split("\n\n")[0].split()), 116, subsequent_indent=" * "
        )
        comment = f"/* {doc} */\n" if documented else ""
        head = textwrap.fill(head, 118, subsequent_indent="    ")
        return f"{comment}{head}\n{{\n" + "\n".join(_wrapped(self.lines)) + "\n}\n"

    def chosen(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        """The statements whose conditions hold, where those are known."""
        chosen: list[ast.stmt] = []
        for statement in statements:
            if isinstance(statement, ast.If | ast.For):
                statement.body = self.chosen(statement.body)
            try:
                known = self.evaluate(statement.test) if isinstance(statement, ast.If) else None
            except _NOT_EVALUATED:
                known = None
            if isinstance(statement, ast.If) and known is not None:
                chosen += statement.body if known else self.chosen(statement.orelse)
            else:
                chosen.append(statement)
        return chosen

    def drop_unused(self) -> None:
        """Leave out the locals that only dropped terms have read."""
        for line in reversed(list(self.lines)):
            match = re.match(r" +const (?:real|bool) (\w+) = [^;]*;$", line)
            if match and len(re.findall(rf"\b{match[1]}\b", "\n".join(self.lines))) == 1:
                self.lines.remove(line)

    # ---- statements ----

    def block(self, statements: list[ast.stmt], depth: int) -> None:
        for statement in statements:
            for comment in self.comments.get(statement.lineno, []):
                self.put(f"/* {comment} */", depth)
            getattr(self, f"on_{type(statement).__name__}")(statement, depth)

    def put(self, line: str, depth: int) -> None:
        self.lines.append("    " * depth + line)

    def on_Assign(self, node: ast.Assign, depth: int) -> None:
        target, value = node.targets[0], node.value
        if not isinstance(target, ast.Tuple):
            self.store_all([target], [value], depth)
        elif isinstance(value, ast.Tuple):
            self.store_all(target.elts, value.elts, depth)
        else:
            assert isinstance(value, ast.Call)
            if (constants := self.constant_results(value)) is not None:
                self.store_all(target.elts, constants, depth)
                return
            outs: list[str] = []
            for each in target.elts:
                assert isinstance(each, ast.Name)
                name = "unused" if each.id == "_" else self.local(each.id)
                if name not in self.declared:
                    self.put(f"real {name};", depth)
                    self.declared.add(name)
                outs.append(f"&{name}")
            self.put(f"{self.call(value, outs)};", depth)

    def constant_results(self, call: ast.Call) -> list[ast.expr] | None:
        """What `spread_of` gives of sigma points that do not spread."""
        if (
            isinstance(call.func, ast.Name)
            and call.func.id == "spread_of"
            and _number(self.fold(call.args[0])) == 0.0
        ):
            return [ast.Constant(1.0), ast.Constant(1.0), ast.Constant(0.0)]  # d/4 is divided by only
        return None

    def store_all(self, targets: list[ast.expr], values: list[ast.expr], depth: int) -> None:
        """Simultaneous assignments, one after another where none reads what an earlier one has written."""
        pairs = [(t, self.fold(v)) for t, v in zip(targets, values, strict=True)]
        for k, (target, _) in enumerate(pairs):
            name = ast.unparse(target).replace(" ", "")
            later = [ast.unparse(v).replace(" ", "") for _, v in pairs[k + 1 :]]
            if any(_mentions(v, name) for v in later) and not isinstance(target, ast.Subscript):
                raise TypeError(f"{self.name}: {ast.unparse(target)} is read after it was written")
            if isinstance(target, ast.Subscript) and any(name in v for v in later):
                raise TypeError(f"{self.name}: {name} is read after it was written")
        written: set[str] = set()
        for target, value in pairs:
            self.store(target, value, depth, written)

    def store(self, target: ast.expr, value: ast.expr, depth: int, written: set[str]) -> None:
        if isinstance(target, ast.Name):
            if target.id not in self.changing and _number(value) is not None:
                self.values[target.id] = value
                return
            name = self.local(target.id)
            kind = "bool" if _is_truth(value) else "real"
            kind = kind if target.id in self.changing else f"const {kind}"
            declare = "" if name in self.declared else f"{kind} "
            self.declared.add(name)
            if name != self.expression(value):
                self.put(f"{declare}{name} = {self.expression(value)};", depth)
            return
        place, mirror = self.place(target)
        if place == "b->failed":  # OK = OK if a test holds else 0
            assert isinstance(value, ast.IfExp)
            self.put(f"if (!({self.expression(value.test)})) {{", depth)
            self.put("b->failed = true;", depth + 1)
            self.put("}", depth)
            return
        if place is None or place in written:
            return
        written.add(place)
        if place == self.expression(value):
            return
        both = f"{place} = {mirror} = " if mirror else f"{place} = "
        self.put(f"{both}{self.expression(value)};", depth)

    def on_AugAssign(self, node: ast.AugAssign, depth: int) -> None:
        value = self.fold(node.value)
        place, mirror = self.place(node.target)
        if place is None or (_number(value) == 0.0 and isinstance(node.op, ast.Add | ast.Sub)):
            return
        self.put(f"{place} {_SIGNS[type(node.op)]}= {self.expression(value)};", depth)
        if mirror:
            self.put(f"{mirror} = {place};", depth)

    def on_For(self, node: ast.For, depth: int) -> None:
        assert isinstance(node.target, ast.Name)
        name = node.target.id
        if name == "l":
            self.block(node.body, depth)
            return
        steps = node.iter
        bound = None
        if isinstance(steps, ast.Call) and isinstance(steps.func, ast.Name) and steps.func.id == "range":
            bound = self.bound(steps.args[-1])
            first = self.index(steps.args[0]) if len(steps.args) == 2 else "0"
            head = f"for (int {name} = {first}; {name} < {bound}; {name}++) {{"
        else:
            values = list(self.evaluate(steps))
            if isinstance(steps, ast.Tuple) and not isinstance(steps.elts[0], ast.Starred):
                for value in values:  # rows, one after another
                    self.known, before = {**self.known, name: value}, self.known
                    self.block(node.body, depth)
                    self.known = before
                return
            n = len(values)
            assert values == [*range(values[0], n), *range(values[0])]
            self.put(f"for (int k = {values[0]}; k < N + {values[0]}; k++) {{", depth)
            head = f"    const int {name} = k % N;"
        self.put(head, depth) if bound else self.lines.append("    " * (depth + 1) + head.strip())
        before = set(self.declared)
        self.block(node.body, depth + 1)
        self.declared = before
        self.put("}", depth)

    def bound(self, node: ast.expr) -> str:
        try:
            value = self.evaluate(node)
        except _NOT_EVALUATED:
            return ast.unparse(node)
        return "N" if value == self.known.get("n") or value == self.names.get("N") else str(value)

    def on_If(self, node: ast.If, depth: int) -> None:
        self.put(f"if ({self.expression(self.fold(node.test))}) {{", depth)
        assert not node.orelse
        self.block(node.body, depth + 1)
        self.put("}", depth)

    def on_Expr(self, node: ast.Expr, depth: int) -> None:
        assert isinstance(node.value, ast.Call)
        self.put(f"{self.call(node.value)};", depth)

    def on_Return(self, node: ast.Return, depth: int) -> None:
        assert node.value is not None
        if not isinstance(node.value, ast.Tuple):
            self.emitter.results[self.name] = 1
            self.put(f"return {self.expression(self.fold(node.value))};", depth)
            return
        self.emitter.results[self.name] = len(node.value.elts)
        for k, each in enumerate(node.value.elts):
            self.outs.append(f"{each.id}_out" if isinstance(each, ast.Name) else f"result{k + 1}")
            self.put(f"*{self.outs[-1]} = {self.expression(self.fold(each))};", depth)

    # ---- expressions ----

    def evaluate(self, node: ast.expr) -> Any:
        return eval(
            compile(ast.fix_missing_locations(ast.Expression(node)), "<kernel>", "eval"),
            self.names | self.known,
        )

    def fold(self, node: ast.expr) -> ast.expr:
        """The expression without terms that this filter's numbers make 0."""
        return _Fold(self).visit(ast.parse(ast.unparse(node), mode="eval").body)

    def state(self, place: int) -> str:
        """The name of a state's place in C."""
        return self.emitter.states[place]

    def row(self, node: ast.expr) -> str | None:
        """The name of a row whose number is known."""
        try:
            return NAMES[self.evaluate(node)]
        except _NOT_EVALUATED:
            return None

    def place(self, node: ast.expr) -> tuple[str | None, str | None]:
        """What stands for an element of ``w``, and for its mirror image in the covariance."""
        if isinstance(node, ast.Name):
            return self.local(node.id), None
        assert isinstance(node, ast.Subscript)
        index = node.slice.elts[0] if isinstance(node.slice, ast.Tuple) else node.slice
        name = self.row(index)
        if name is None:
            return self.place_in_loop(index)
        if name in self.emitter.rows:
            text = self.emitter.rows[name]
            return (text if isinstance(text, str) else None), None
        if name in MEAN:
            return f"b->mean[{self.state(MEAN.index(name))}]", None
        if name in QUATERNION:
            return f"b->attitude[{QUATERNION.index(name)}]", None
        if name in COVARIANCE:
            return self.mirrored(*(self.state(MEAN.index(letter)) for letter in name))
        self.emitter.used.add(name)
        if name[:3] in ("C1_", "C2_"):
            return f"work->{name[:2]}[{self.state(MEAN.index(name[3:]))}]", None
        return f"work->{name.lower()}", None

    def place_in_loop(self, index: ast.expr) -> tuple[str | None, str | None]:
        if isinstance(index, ast.Call):
            return self.mirrored(*(self.index(each) for each in index.args))
        if isinstance(index, ast.BinOp) and isinstance(index.left, ast.Name):
            block = index.left.id
            if block == "Q0":
                return str(self.emitter.rows["Q"]).format(self.index(index.right)), None
            self.emitter.used.add(f"{block}_X")
            return f"work->{block}[{self.index(index.right)}]", None
        return f"b->mean[{self.index(index)}]", None

    def mirrored(self, i: str, j: str) -> tuple[str, str | None]:
        return f"P[{i}][{j}]", (f"P[{j}][{i}]" if i != j else None)

    def index(self, node: ast.expr) -> str:
        try:
            return self.state(self.evaluate(node))
        except _NOT_EVALUATED:
            return ast.unparse(node)

    def local(self, name: str) -> str:
        return RENAMED.get(name, name)

    def call(self, node: ast.Call, outs: list[str] | None = None) -> str:
        name = ast.unparse(node.func)
        if name in CALLS:
            return f"{CALLS[name]}({self.expression(node.args[0])})"
        function: Any = self.names[name]
        printed, signature = self.emitter.signatures[getattr(function, "__name__", name)]
        arguments: list[str] = []
        for each, theirs in zip(node.args, signature, strict=True):
            if self.is_kernel and isinstance(each, ast.Name) and each.id in PARAMETERS:
                arguments += [parameter.split()[-1].lstrip("*") for parameter in theirs]
            elif theirs:
                arguments.append(self.expression(self.fold(each)))
        return f"{printed}({', '.join([*arguments, *(outs or [])])})"

    def expression(self, node: ast.expr, outer: int = 0) -> str:
        text, precedence = self.priced(node)
        return f"({text})" if precedence < outer else text

    def priced(self, node: ast.expr) -> tuple[str, int]:
        """C's text and how tightly it binds."""
        match node:
            case ast.Constant(bool() | int()):
                return str(node.value), _ATOM
            case ast.Constant(float(value)):
                return f"R({value!r})", _ATOM
            case ast.Name(name):
                if name.isupper() and isinstance(value := self.names.get(name), float):
                    if name not in self.emitter.rows:
                        self.emitter.constants[name] = value
                    return name, _ATOM
                return self.local(name), _ATOM
            case ast.Attribute():
                value = self.evaluate(node)
                if isinstance(value, int):
                    return self.state(value), _ATOM
                return ("INFINITY" if math.isinf(value) else f"R({value!r})"), _ATOM
            case ast.Subscript(ast.Name("w")):
                place, _ = self.place(node)
                if place is None:
                    raise TypeError(f"{self.name}: C has no {ast.unparse(node)}")
                return place, _ATOM
            case ast.Subscript(ast.Name("lever"), index):
                return f"lever[{ast.unparse(index)}]", _ATOM
            case ast.Subscript(_, ast.Name(index)):
                return INPUTS[index], _ATOM
            case ast.UnaryOp(ast.USub(), ast.Constant(float(value))):
                return f"R({-value!r})", _ATOM
            case ast.UnaryOp(ast.USub(), operand):
                return f"-{self.expression(operand, 7)}", 7
            case ast.UnaryOp(ast.Not(), operand):
                return f"!({self.expression(operand)})", 8
            case ast.BinOp(left, op, right) if type(op) in _PRECEDENCE:
                binds = _PRECEDENCE[type(op)]
                if (pure := self.pure(node)) is not None:
                    return f"R({pure!r})", _ATOM
                return (
                    f"{self.expression(left, binds)} {_SIGNS[type(op)]} {self.expression(right, binds + 1)}",
                    binds,
                )
            case ast.BinOp(left, op, right):
                return f"{self.expression(left, 3)} {_SIGNS[type(op)]} {self.expression(right, 3)}", 2
            case ast.BoolOp(op, values):
                return f" {_SIGNS[type(op)]} ".join(self.expression(v, 3) for v in values), 2
            case ast.Compare(left, [op], [right]):
                return f"{self.expression(left, 4)} {_SIGNS[type(op)]} {self.expression(right, 4)}", 3
            case ast.IfExp(test, body, orelse):
                return (
                    f"{self.expression(test, 2)} ? {self.expression(body, 2)} : {self.expression(orelse, 1)}",
                    1,
                )
            case ast.Call():
                return self.call(node), _ATOM
            case _:
                raise TypeError(f"{self.name}: {ast.unparse(node)} is not in the emitter's subset")

    def pure(self, node: ast.expr) -> float | None:
        """The value of numbers alone, which Python computes in double."""
        named = [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and n.id != "math"]
        if named or any(isinstance(each, ast.Subscript | ast.Call) for each in ast.walk(node)):
            return None
        try:
            value = self.evaluate(node)
        except _NOT_EVALUATED:
            return None
        return float(value)


class _Fold(ast.NodeTransformer):
    """Leave out what is multiplied by 0, and factors of 1."""

    def __init__(self, function: _Function) -> None:
        self.function = function

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self.function.values.get(node.id, node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        if isinstance(node.value, ast.Name) and node.value.id == "w" and isinstance(node.slice, ast.Tuple):
            name = self.function.row(node.slice.elts[0])
            number = self.function.emitter.rows.get(name) if name else None
            if isinstance(number, float):
                return ast.Constant(number)
        return node

    def visit_Call(self, node: ast.Call) -> ast.expr:
        node.args = [self.visit(each) for each in node.args]
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        node.operand = self.visit(node.operand)
        return ast.Constant(0.0) if isinstance(node.op, ast.USub) and _number(node.operand) == 0.0 else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        left, right = self.visit(node.left), self.visit(node.right)
        node.left, node.right = left, right
        a, b = _number(left), _number(right)
        match node.op:
            case ast.Add() if a == 0.0:
                return right
            case ast.Add() | ast.Sub() if b == 0.0:
                return left
            case ast.Sub() if a == 0.0:
                return ast.UnaryOp(ast.USub(), right)
            case ast.Mult() if a == 0.0 or b == 0.0:
                return ast.Constant(0.0)
            case ast.Mult() if a == 1.0:
                return right
            case ast.Mult() | ast.Div() if b == 1.0:
                return left
            case ast.Div() if a == 0.0:
                return left
            case _:
                return node


def _number(node: ast.expr) -> float | None:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, float) else None


def _uses(text: str, name: str) -> bool:
    return re.search(rf"\b{name}\b", text) is not None or (name == "b" and "P[" in text)


def _wrapped(lines: list[str]) -> list[str]:
    """The lines, none too long, declarations of one kind together."""
    joined: list[str] = []
    for line in lines:
        match = re.match(r"( +(?:const )?(?:real|bool) )(\w+.*;)$", line)
        before = joined[-1] if joined else ""
        if match and "(*" not in line and before.startswith(match[1]) and len(before) + len(match[2]) < 118:
            joined[-1] = f"{before[:-1]}, {match[2]}"
        else:
            joined.append(line)
    wrapped: list[str] = []
    for line in joined:
        indent = " " * (len(line) - len(line.lstrip()))
        wrapped += textwrap.wrap(
            line.strip(),
            120,
            initial_indent=indent,
            subsequent_indent=indent + "    ",
            break_long_words=False,
        )
    return wrapped


def _is_truth(node: ast.expr) -> bool:
    return isinstance(node, ast.Compare | ast.BoolOp) or (
        isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd | ast.BitOr)
    )


def _mentions(text: str, name: str) -> bool:
    return any(isinstance(n, ast.Name) and n.id == name for n in ast.walk(ast.parse(text, mode="eval")))


def _comments(source: str) -> dict[int, list[str]]:
    """By line of a statement: the comments above it and behind it."""
    found: dict[int, list[str]] = {}
    waiting: list[str] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            text = token.string.lstrip("# ")
            if text.startswith(("fmt:", "noqa")):
                continue
            if token.line.lstrip().startswith("#"):
                waiting.append(text)
            else:
                found.setdefault(token.start[0], []).append(text)
        elif token.type == tokenize.NAME and waiting:
            found.setdefault(token.start[0], []).extend(waiting)
            waiting = []
    return found
