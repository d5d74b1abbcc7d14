"""Unroll loops over states, and inline kernels into each other.

In functions with a lane ``l``, ``w.XX``, ``w[row]``, ``P[i, j]``, ``C1[i]`` and ``ROOT[i, j]`` denote elements of rows.
Loops over lanes become vector instructions, so their bodies must not contain branches (see `vectors`).
Therefore, `unrolled` unrolls the loops over the n states of a model, writes out ``tuple(... for ...)``, and replaces
names of rows by numbers. It also inlines kernels, since Numba does this slowly. The names that a function uses must be
defined before its code is generated.
"""

import ast
import hashlib
import inspect
import textwrap
import time
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

from sigmaswarm.filters.compiled.layout import COLUMNS, R, at

STATE_LOOPS = ("i", "j", "k", "row", "group")  # loop variables that are unrolled
VECTORS = ("C1", "C2", "MOVE", "PIVOT", "PRIOR", "Q", "SHIFT")
NUMBERS = ("at", "fp", "axis_of")  # functions whose calls are replaced by their values


T = TypeVar("T")
Names = dict[str, Any]


class ParsedFunction(NamedTuple):
    definition: ast.FunctionDef
    names: Names


def parsed(source: str) -> ast.Module:
    """Return the syntax tree of a function's source, with two indices for each element of ``w``."""
    tree = ast.parse(source)
    has_lane = any("l" in (getattr(node, "id", ""), getattr(node, "arg", "")) for node in ast.walk(tree))
    return _Elements().visit(tree) if has_lane else tree


class _Elements(ast.NodeTransformer):
    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        match node:
            case ast.Attribute(ast.Name("w"), name) if name in R._fields:
                row = ast.Constant(getattr(R, name))
            case ast.Subscript(ast.Name("w"), index) if not isinstance(index, ast.Tuple):
                row = index
            case ast.Subscript(ast.Name("P"), ast.Tuple(indices)):
                row = ast.Call(ast.Name("at", ast.Load()), indices, [])
            case ast.Subscript(ast.Name(block), ast.Tuple([i, j])) if block in COLUMNS:
                offset = ast.BinOp(ast.BinOp(ast.Constant(COLUMNS[block]), ast.Mult(), i), ast.Add(), j)
                row = ast.BinOp(ast.Name(block, ast.Load()), ast.Add(), offset)
            case ast.Subscript(ast.Name(block), index) if block in VECTORS:
                row = ast.BinOp(ast.Name(block, ast.Load()), ast.Add(), index)
            case _:
                return node
        index = ast.Tuple([row, ast.Name("l", ast.Load())], ast.Load())
        new = ast.Subscript(ast.Name("w", ast.Load()), index, node.ctx)
        return ast.fix_missing_locations(ast.copy_location(new, node))


def written_out(function: Callable[..., Any], /, **known: Any) -> ParsedFunction:
    """Return a function's syntax tree, with its keyword-only parameters bound to ``known``; see `unrolled`."""
    if not known and (there := getattr(function, "written", None)) is not None:
        return there
    names = function.__globals__ | known | {"at": at}
    tree = parsed(textwrap.dedent(inspect.getsource(function)))
    ast.increment_lineno(tree, function.__code__.co_firstlineno - 1)
    definition = tree.body[0]
    if not isinstance(definition, ast.FunctionDef):
        raise TypeError(f"{function} is not a plain function")
    definition.decorator_list, definition.args.kwonlyargs, definition.args.kw_defaults = [], [], []
    writer = _Writer(names, {k: v for k, v in known.items() if isinstance(v, int)})
    definition.body = writer.block(definition.body)
    written = ParsedFunction(definition, names)
    if not known:
        function.__dict__["written"] = written
    return written


Change = Callable[[ast.FunctionDef, Names], None]
"""A function of ``(definition, names)`` that changes generated code in place."""


class Generated:
    """A function with bound keyword-only parameters; its code is generated when needed, not at import.

    ``known`` contains the values of keyword-only parameters and of globals.
    """

    def __init__(self, function: Callable[..., Any], change: Change | None = None, /, **known: Any) -> None:
        self.source, self._change, self.known = function, change, known
        self.__name__ = function.__name__

    @cached_property
    def written(self) -> ParsedFunction:
        return _with_retries(self._write)

    def _write(self) -> ParsedFunction:
        definition, names = written_out(self.source, **self.known)
        definition = _copied(definition)
        if self._change is not None:
            self._change(definition, names)
        return ParsedFunction(definition, names)

    @cached_property
    def name(self) -> str:
        own = self.source.__qualname__
        return f"{own}_{_hash_of(self.known)}" if self.known else own

    @cached_property
    def function(self) -> Callable[..., Any]:
        return _with_retries(self._compile)

    def _compile(self) -> Callable[..., Any]:
        tree = ast.fix_missing_locations(ast.Module([self.written.definition], []))
        defined: Names = {}
        exec(compile(tree, self.source.__code__.co_filename, "exec"), self.written.names, defined)
        made = defined[self.__name__]
        made.written, made.__qualname__ = self.written, self.name
        return made

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)


class Kernel(Generated):
    """A function that callers inline as statements if they do not use its value."""


def unrolled(function: Callable[..., Any], /, **known: Any) -> Callable[..., Any]:
    """Return the function with its keyword-only parameters bound to ``known``, and loops over states and rows unrolled.

    ``known`` can also contain globals.
    """
    return Generated(function, **known).function


def _with_retries(make: Callable[[], T]) -> T:
    for _ in range(9):
        try:
            return make()
        except SystemError:  # in Python 3.11, `compile` adds the recursion depths of all threads
            time.sleep(0.001)
    return make()


def _hash_of(known: Names) -> str:
    """Return a hash of bound names, which distinguishes functions that are generated from one function.

    Numba names machine code after a function's qualified name and the number of compilations in the process. Different
    kernels of two processes may therefore have the same name, and one kernel could replace the other when it is loaded
    from the cache.
    """
    parts: list[str] = []
    for name, value in sorted(known.items(), key=lambda item: item[0]):
        called = getattr(value, "py_func", value)
        named = value.name if isinstance(value, Generated) else getattr(called, "__qualname__", None)
        parts.append(f"{name} {named or repr(value)}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]


def _copied(node: Any) -> Any:
    """Copy a tree; `copy.deepcopy` takes ten times as long."""
    if isinstance(node, list):
        return [_copied(child) for child in node]
    if not isinstance(node, ast.AST):
        return node
    new = type(node)(**{name: _copied(getattr(node, name)) for name in node._fields})
    return ast.copy_location(new, node)


class _Writer(ast.NodeTransformer):
    def __init__(self, names: Names, values: dict[str, int]) -> None:
        self.names, self.values, self.calls = names, values, 0

    def block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        written: list[ast.stmt] = []
        for statement in statements:
            result = self.visit(statement)
            written += result if isinstance(result, list) else [result]
        return written

    def visit_For(self, node: ast.For) -> Any:
        if not (isinstance(node.target, ast.Name) and node.target.id in STATE_LOOPS):
            node.body = self.block(node.body)
            return node
        outer, written = self.values, list[ast.stmt]()
        for value in self._value(node.iter):
            self.values = outer | {node.target.id: value}
            written += self.block(_copied(node.body))  # a copy for each value
        self.values = outer
        return written

    def visit_If(self, node: ast.If) -> Any:
        try:
            chosen = node.body if self._value(node.test) else node.orelse
        except NameError:  # the test is not known at compilation
            node.test, node.body, node.orelse = (
                self.visit(node.test),
                self.block(node.body),
                self.block(node.orelse),
            )
            return node
        return self.block(chosen)

    def visit_Expr(self, node: ast.Expr) -> Any:
        self.generic_visit(node)
        call = node.value
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name)):
            return node
        kernel: Any = self.names.get(call.func.id)
        return self._spliced(kernel.written, call.args) if isinstance(kernel, Kernel) else node

    def _spliced(self, written: ParsedFunction, arguments: list[ast.expr]) -> list[ast.stmt]:
        """Inline a call of a kernel: return the kernel's statements, whose variables get unique names."""
        self.calls += 1
        definition = _copied(written.definition)
        parameters = [argument.arg for argument in definition.args.args]
        names = [n for n in ast.walk(definition) if isinstance(n, ast.Name)]
        stored = {n.id for n in names if isinstance(n.ctx, ast.Store)}
        if any(isinstance(node, ast.Return) for node in ast.walk(definition)):
            raise TypeError(f"{definition.name} is a kernel: it must neither return a value nor end early")
        renamed = {name: f"_{self.calls}_{name}" for name in stored.union(parameters)}
        body: list[ast.stmt] = []
        for parameter, argument in zip(parameters, arguments, strict=True):
            if isinstance(argument, ast.Name) and parameter not in stored:
                renamed[parameter] = argument.id
            else:
                body.append(ast.Assign([ast.Name(renamed[parameter], ast.Store())], argument))
        for node in names:
            if node.id not in renamed and node.id in written.names:
                renamed[node.id] = f"_{self.calls}_{node.id}"
                self.names[renamed[node.id]] = written.names[node.id]
            node.id = renamed.get(node.id, node.id)
        documented = ast.get_docstring(definition) is not None
        return [ast.fix_missing_locations(statement) for statement in (*body, *definition.body[documented:])]

    def visit_Call(self, node: ast.Call) -> Any:
        if node.args and isinstance(node.args[0], ast.GeneratorExp):
            if ast.unparse(node.func) != "tuple" or any(loop.ifs for loop in node.args[0].generators):
                raise TypeError(f"only tuple(... for k in ...) can be unrolled: {ast.unparse(node)}")
            return self._tuple(node.args[0])
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id in NUMBERS:
            return ast.Constant(self._value(node))
        return node

    def _tuple(self, node: ast.GeneratorExp) -> ast.expr:
        (loop,), outer, elements = node.generators, self.values, list[ast.expr]()
        for value in self._value(loop.iter):
            self.values = outer | {ast.unparse(loop.target): value}
            elements.append(self.visit(_copied(node.elt)))
        self.values = outer
        return ast.Tuple(elements, ast.Load())

    def visit_Attribute(self, node: ast.Attribute) -> Any:
        row = isinstance(node.value, ast.Name) and self.names.get(node.value.id) is R
        return ast.Constant(getattr(R, node.attr)) if row else self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> Any:
        known = isinstance(node.ctx, ast.Load) and node.id in self.values
        return ast.Constant(self.values[node.id]) if known else node

    def _value(self, node: ast.expr) -> Any:
        expression = ast.fix_missing_locations(ast.Expression(_copied(node)))
        return eval(compile(expression, "<unrolled>", "eval"), self.names | self.values)
