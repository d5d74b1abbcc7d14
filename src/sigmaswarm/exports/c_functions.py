"""Translate the statements of a function to C99."""

import ast
import re
import textwrap
from collections.abc import Callable
from copy import copy
from typing import Any

from sigmaswarm.exports.c_emitter import PARAMETERS, Elements, Emitter, parameter_name
from sigmaswarm.exports.c_expressions import SIGNS, Expressions
from sigmaswarm.exports.c_text import declaration, in_c, is_boolean, name_of, number_of, uses, wrapped


class Function(Expressions):
    """Translation of one function to C."""

    def __init__(
        self, emitter: Emitter, function: Callable[..., Any], key: str, known: dict[str, Any]
    ) -> None:
        super().__init__(emitter, function, key, known)
        self.body = self.chosen(self.definition.body[ast.get_docstring(self.definition) is not None :])
        nodes = [node for statement in self.body for node in ast.walk(statement)]
        stored = [n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        stored += [name_of(n.target) for n in nodes if isinstance(n, ast.AugAssign)]
        self.changing = {n for n in stored if stored.count(n) > 1}
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
        """Return the statements, without branches that never run."""
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
        """Remove local variables that were used only in removed terms. Calls of kernels are kept."""
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
                    self.add_to(target, SIGNS[type(op)], self.fold(value), depth)
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
        """Print simultaneous assignments one after another. Raise an error if one of them reads an earlier target."""
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
        declared = place
        if isinstance(target, ast.Name) and place not in self.declared:
            kind = self.kind_of(target, value)
            constant = "" if target.id in self.changing or "*" in kind else "const "
            declared = constant + declaration(kind, place)
            self.declared.add(place)
        if place != self.print(value):
            self.put(f"{declared} = {mirror and mirror + ' = '}{self.print(value)};", depth)

    def kind_of(self, target: ast.Name, value: ast.expr) -> str:
        """Return the C type of a new local variable."""
        return "bool" if is_boolean(value) else "real"

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
