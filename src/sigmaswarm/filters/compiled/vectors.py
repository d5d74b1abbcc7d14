"""Loops over lanes, emitted as vector instructions of LLVM.

Numba would have to infer the types of several thousand lines in these loops, which takes half a minute or more. Since
all numbers in kernels are doubles, each loop over lanes is instead converted directly to LLVM instructions. It becomes
a separate function, whose arguments are the array of rows and a tuple of the scalars that have the same value in all
lanes. The name of this function contains a hash of its text, so all callers use the same function and get identical
results.

The body of a loop over lanes must not contain branches. It may contain assignments to names and to ``w.XX`` or
``w[row]`` with a row number known at compilation, elements of tuples, arithmetic, comparisons, ``&``, ``|``, ``a if
test else b``, `math.sqrt`, `math.log`, `math.exp`, `numpy.floor` and `abs`. Calls of plain functions with such bodies
are inlined. ``n += test`` counts the lanes in which a test is true.
"""

import ast
import builtins
import hashlib
import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from sigmaswarm.filters.compiled.layout import LANES, N_ROWS, WIDEST
from sigmaswarm.filters.compiled.unroll import Names, written_out

# Only these flags of fast-math are used, since NaN and inf must keep their meaning.
FLAGS = ("contract", "reassoc", "nsz", "arcp")

_DOUBLE, _WHOLE = ir.DoubleType(), ir.IntType(64)
_ARITHMETIC = {
    ast.Add: (operator.add, "fadd"),
    ast.Sub: (operator.sub, "fsub"),
    ast.Mult: (operator.mul, "fmul"),
    ast.Div: (operator.truediv, "fdiv"),
}
_LOGIC = {ast.BitAnd: "and_", ast.BitOr: "or_"}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "=="}
_FUNCTIONS = {math.sqrt: "sqrt", math.log: "log", math.exp: "exp", np.floor: "floor", abs: "fabs"}


def put_loops(definition: ast.FunctionDef, names: Names) -> None:
    """Replace a function's loops over lanes by calls, and add the called functions to its ``names``."""
    definition.body = _Loops(definition, names).block(definition.body)


class _Loops(ast.NodeTransformer):
    def __init__(self, definition: ast.FunctionDef, names: Names) -> None:
        self.names, self.title = names, definition.name
        stored = {
            n.id for n in ast.walk(definition) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
        }
        self.locals = stored | {argument.arg for argument in definition.args.args}

    def block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        return self.generic_visit(ast.Module(statements, [])).body

    def visit_For(self, node: ast.For) -> Any:
        if ast.unparse(node.iter) != "range(LANES)":
            return self.generic_visit(node)
        called = f"_{self.title.strip('_')}_{_hash(node.body, self.names)}"
        loop = _Loop(called, node.body, self.names, *_used_outside(node.body, self.locals))
        self.names[called] = _as_intrinsic(loop)
        call = f"{called}(w, ({''.join(name + ', ' for name in loop.shared)}))"
        new = [call] if not loop.counted else [f"_counts = {call}"]
        new += [f"{name} += _counts[{k}]" for k, name in enumerate(loop.counted)]
        return [ast.copy_location(statement, node) for statement in ast.parse("\n".join(new)).body]


class _Loop(NamedTuple):
    """A loop over lanes: the name of its function, its body, and the values of the names in it.

    ``shared`` are the names of the enclosing function that the loop reads; ``counted`` are the names that it adds to.
    """

    called: str
    body: list[ast.stmt]
    names: Names
    shared: list[str]
    counted: list[str]


def _used_outside(body: list[ast.stmt], outside: set[str]) -> tuple[list[str], list[str]]:
    """Return ``shared`` and ``counted`` of `_Loop`."""
    made, shared, counted = {"w", "l"}, dict[str, None](), list[str]()
    for statement in body:
        match statement:
            case ast.AugAssign(target=ast.Name(id=name), op=op) if name not in made and name not in counted:
                if not isinstance(op, ast.Add):
                    raise TypeError(f"a loop over lanes may only count with +=: {ast.unparse(statement)}")
                counted.append(name)
        for node in ast.walk(statement):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in outside - made:
                shared[node.id] = None
        made |= {
            n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
        }
    carried = made & set(shared) - set(counted)
    if carried:
        raise TypeError(
            f"cannot be a loop over lanes: {min(carried)} carries a value from one lane to the next"
        )
    return [name for name in shared if name not in counted], counted


def _hash(body: list[ast.stmt], names: Names) -> str:
    """Hash a loop's text, the values of its names, and the functions that it calls."""
    parts = [ast.dump(statement) for statement in body]
    for name in sorted({n.id for s in body for n in ast.walk(s) if isinstance(n, ast.Name)}):
        value = names.get(name)
        if isinstance(value, int | float | tuple):
            parts.append(f"{name} {value!r}")
        elif callable(value) and value not in _FUNCTIONS:
            inner = written_out(value)
            parameters = ast.dump(inner.definition.args)
            parts.append(f"{name} {parameters} {_hash(inner.definition.body, inner.names)}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]


def _as_intrinsic(loop: _Loop) -> Any:
    """Return the function ``called(w, (shared ...))`` for Numba.

    It calls the compiled loop, which is generated first if it does not exist yet.
    """

    def call(typing_context, w, numbers):
        def generate(context, builder, signature, arguments):
            array = context.make_array(w)(context, builder, arguments[0])
            values = [
                context.cast(builder, builder.extract_value(arguments[1], k), kind, types.float64)
                for k, kind in enumerate(numbers)
            ]
            function = builder.module.globals.get(loop.called)
            if function is None:
                width = WIDEST if _has_avx512(context.codegen()) else WIDEST // 2
                function = _put_loop(builder.module, loop, width)
            lanes = builder.extract_value(array.shape, 1)
            result = builder.call(function, [array.data, lanes, *values])
            return result if loop.counted else context.get_dummy_value()

        result = types.UniTuple(types.int64, len(loop.counted)) if loop.counted else types.void
        return result(w, numbers), generate

    return intrinsic(call)


def _has_avx512(codegen: Any) -> bool:
    return "+avx512f" in codegen.magic_tuple()[2]


def _put_loop(module: ir.Module, loop: _Loop, width: int) -> ir.Function:
    """Return the loop as a function ``(w, lanes, shared ...)``, which processes ``width`` lanes at a time."""
    vector = ir.VectorType(_DOUBLE, width)
    result = ir.ArrayType(_WHOLE, len(loop.counted)) if loop.counted else ir.VoidType()
    kind = ir.FunctionType(result, [_DOUBLE.as_pointer(), _WHOLE, *(_DOUBLE for _ in loop.shared)])
    function = ir.Function(module, kind, loop.called)
    function.linkage = "linkonce_odr"
    function.args[0].add_attribute("noalias")
    for attribute in ("noinline", "nounwind"):
        function.attributes.add(attribute)
    # By default, LLVM uses half the width on Intel processors, since wide vectors once reduced the clock rate. The
    # attribute is added directly to the set, since llvmlite does not know it.
    set.add(function.attributes, '"prefer-vector-width"="512"')
    entry, body, end = (function.append_basic_block(name) for name in ("entry", "body", "end"))
    builder = ir.IRBuilder(entry)
    rows, lanes, *numbers = function.args
    values = {
        name: _broadcast(builder, vector, number) for name, number in zip(loop.shared, numbers, strict=True)
    }
    builder.branch(body)
    builder.position_at_end(body)
    lane = builder.phi(_WHOLE)
    counts = {name: builder.phi(_WHOLE) for name in loop.counted}
    frame = _Frame(loop.names, values | counts)
    block = builder.lshr(lane, _WHOLE(LANES.bit_length() - 1))
    offset = builder.add(lane, builder.mul(block, _WHOLE((N_ROWS - 1) * LANES)))
    _Emitter(builder, vector, builder.gep(rows, [offset])).block(loop.body, frame)
    after = builder.add(lane, _WHOLE(width))
    for phi, before, behind in (
        (lane, _WHOLE(0), after), *((phi, _WHOLE(0), frame.values[name]) for name, phi in counts.items()),
    ):  # fmt: skip
        phi.add_incoming(before, entry)
        phi.add_incoming(behind, body)
    builder.cbranch(builder.icmp_signed("<", after, lanes), body, end)
    builder.position_at_end(end)
    if not loop.counted:
        builder.ret_void()
        return function
    sums = ir.Constant(result, ir.Undefined)
    for number, name in enumerate(loop.counted):
        sums = builder.insert_value(sums, frame.values[name], number)
    builder.ret(sums)
    return function


def _broadcast(builder: ir.IRBuilder, vector: ir.VectorType, number: Any) -> Any:
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.IntType(32)(0))
    indices = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(first, undefined, indices)


class _Frame(NamedTuple):
    names: Names
    values: dict[str, Any]


class _Emitter:
    """Emit code without branches for one vector of lanes. Values are vectors, known numbers, or tuples of these."""

    def __init__(self, builder: ir.IRBuilder, vector: ir.VectorType, lanes: Any) -> None:
        """``lanes`` points to the first row's lanes that form the vector."""
        self.builder, self.vector, self.lanes = builder, vector, lanes
        self.rows: dict[int, Any] = {}

    def block(self, statements: list[ast.stmt], frame: _Frame) -> Any:
        for statement in statements:
            if isinstance(statement, ast.Return):
                return self.value(statement.value, frame)
            self.statement(statement, frame)
        return None

    def statement(self, node: ast.stmt, frame: _Frame) -> None:
        match node:
            case ast.Assign(targets=[target], value=value):
                self.assign(target, self.value(value, frame), frame)
            case ast.AugAssign(target=target, op=op, value=value):
                self.assign(
                    target, self.binary(op, self.value(target, frame), self.value(value, frame)), frame
                )
            case ast.Expr(value=ast.Constant()):
                pass
            case ast.Expr(value=ast.Call() as call):
                self.value(call, frame)
            case _:
                raise TypeError(f"not supported in a loop over lanes: {ast.unparse(node)}")

    def assign(self, target: ast.expr, value: Any, frame: _Frame) -> None:
        match target:
            case ast.Name(id=name):
                frame.values[name] = value
            case ast.Tuple(elts=targets):
                for element, part in zip(targets, value, strict=True):
                    self.assign(element, part, frame)
            case _:
                row = self.row(target, frame)
                self.rows[row] = self.as_vector(value)
                self.builder.store(self.rows[row], self.address(row), align=8 * self.vector.count)

    def row(self, node: ast.expr, frame: _Frame) -> int:
        match node:
            case ast.Subscript(value=ast.Name(id="w"), slice=ast.Tuple(elts=[row, ast.Name(id="l")])):
                number = self.value(row, frame)
                if isinstance(number, int) and 0 <= number < N_ROWS:
                    return number
        raise TypeError(f"the row of a lane must be a constant: {ast.unparse(node)}")

    def address(self, row: int) -> Any:
        address = self.builder.gep(self.lanes, [_WHOLE(row * LANES)])
        return self.builder.bitcast(address, self.vector.as_pointer())

    def value(self, node: ast.expr, frame: _Frame) -> Any:
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                if name in frame.values:
                    return frame.values[name]
                if name in frame.names:
                    return frame.names[name]
                return getattr(builtins, name)
            case ast.Attribute(value=ast.Name(id=name), attr=attribute):
                return getattr(frame.names[name], attribute)
            case ast.Subscript(value=ast.Name() as parts, slice=ast.Constant(value=index)):
                return self.value(parts, frame)[index]
            case ast.Subscript():
                row = self.row(node, frame)
                if row not in self.rows:
                    self.rows[row] = self.builder.load(self.address(row), align=8 * self.vector.count)
                return self.rows[row]
            case ast.Tuple(elts=parts):
                return tuple(self.value(part, frame) for part in parts)
            case ast.BinOp(left=left, op=op, right=right):
                return self.binary(op, self.value(left, frame), self.value(right, frame))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                value = self.value(operand, frame)
                return -value if isinstance(value, int | float) else self.builder.fneg(value, flags=FLAGS)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return self.builder.not_(self.value(operand, frame))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                a, b = (self.as_vector(self.value(operand, frame)) for operand in (left, right))
                if isinstance(op, ast.NotEq):  # true for NaN
                    return self.builder.fcmp_unordered("!=", a, b)
                return self.builder.fcmp_ordered(_COMPARISONS[type(op)], a, b)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                chosen, other = (self.as_vector(self.value(branch, frame)) for branch in (body, orelse))
                return self.builder.select(self.value(test, frame), chosen, other)
            case ast.Call(func=function, args=arguments, keywords=[]):
                return self.call(self.value(function, frame), arguments, frame)
        raise TypeError(f"not supported in a loop over lanes: {ast.unparse(node)}")

    def binary(self, op: ast.operator, a: Any, b: Any) -> Any:
        if type(op) in _LOGIC:
            return getattr(self.builder, _LOGIC[type(op)])(a, b)
        if type(op) not in _ARITHMETIC:
            raise TypeError(f"not supported in a loop over lanes: {type(op).__name__}")
        in_python, in_llvm = _ARITHMETIC[type(op)]
        if isinstance(a, int | float) and isinstance(b, int | float):
            return in_python(a, b)
        if isinstance(a, ir.Value) and a.type == _WHOLE:
            return self.builder.add(a, self.lanes_of(b))
        return getattr(self.builder, in_llvm)(self.as_vector(a), self.as_vector(b), flags=FLAGS)

    def lanes_of(self, test: Any) -> Any:
        bits = self.builder.bitcast(test, ir.IntType(self.vector.count))
        return self.builder.zext(self.builder.ctpop(bits), _WHOLE)

    def as_vector(self, value: Any) -> Any:
        known = isinstance(value, int | float)
        return ir.Constant(self.vector, [float(value)] * self.vector.count) if known else value

    def call(self, function: Callable[..., Any], arguments: list[ast.expr], frame: _Frame) -> Any:
        if function in _FUNCTIONS:
            (value,) = (self.as_vector(self.value(argument, frame)) for argument in arguments)
            return self.builder.call(self.builtin(_FUNCTIONS[function]), [value], fastmath=FLAGS)
        inner = written_out(function)
        given = {
            parameter.arg: self.value(argument, frame)
            for parameter, argument in zip(inner.definition.args.args, arguments, strict=True)
            if parameter.arg not in ("w", "l")
        }
        return self.block(inner.definition.body, _Frame(inner.names, given))

    def builtin(self, name: str) -> ir.Function:
        module, name = self.builder.module, f"llvm.{name}.v{self.vector.count}f64"
        there = module.globals.get(name)
        return there or ir.Function(module, ir.FunctionType(self.vector, [self.vector]), name)
