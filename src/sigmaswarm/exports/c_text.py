"""Formatting of C source (numbers, names, wrapped lines, comments), and syntax trees of the Python source."""

import ast
import inspect
import io
import math
import re
import textwrap
import tokenize
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

from sigmaswarm.filters.compiled import unroll


@cache
def parsed(function: Callable[..., Any]) -> tuple[ast.FunctionDef, dict[int, list[str]]]:
    source = textwrap.dedent(inspect.getsource(function))
    definition = unroll.parsed(source).body[0]
    assert isinstance(definition, ast.FunctionDef)
    return definition, _comments(source)


def numeral(value: float) -> ast.Name:
    return ast.Name("INFINITY" if math.isinf(value) else f"R({value!r})")


def name_of(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else ""


def number_of(node: ast.expr) -> float | None:
    match = re.fullmatch(r"R\(([-+.\de]+)\)|\d+", node.id) if isinstance(node, ast.Name) else None
    return float(match[1] or match[0]) if match else None


def is_boolean(node: ast.expr) -> bool:
    binary = isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd | ast.BitOr)
    return binary or isinstance(node, ast.Compare | ast.BoolOp)


def declaration(kind: str, name: str) -> str:
    """Declare a variable in C. The type of a matrix is, for example, ``real [][5]``."""
    kind, bracket, lengths = kind.partition(" [")
    return f"{kind} {name}{bracket[1:]}{lengths}".replace("* ", "*")


def uses(text: str, name: str) -> bool:
    is_used = re.search(rf"\b{re.escape(name)}(?!\w)", text) is not None
    return is_used or (name == "b" and "P[" in text)


def wrapped(lines: list[str]) -> list[str]:
    joined = [""]
    for line in lines:
        match = re.match(r"( +(?:const )?(?:real|bool) )(\w+.*;)$", line)
        last = joined[-1]
        if match and "(*" not in line and last.startswith(match[1]) and len(last) + len(match[2]) < 118:
            joined[-1] = f"{last[:-1]}, {match[2]}"
        else:
            joined.append(line)
    wrapped: list[str] = []
    for line in joined[1:]:
        further = " " * (len(line) - len(line.lstrip()) + 4)
        within = textwrap.wrap(line, 120, subsequent_indent=further, break_long_words=False)
        wrapped += [line] if len(line) <= 120 else within
    return wrapped


def in_c(comment: str) -> str:
    """Return a comment without backquotes, with true and false in lower case."""
    return re.sub(r"\b(True|False)\b", lambda match: match[0].lower(), comment.replace("`", ""))


@cache
def constants_of(module: Any) -> dict[str, str]:
    """Return descriptions of a module's constants, by name: the string below a definition, or the comment on its line.

    Constants that are defined together have one key: their names, separated by commas.
    """
    definitions = re.findall(
        r'^([A-Z]\w*(?:, [A-Z]\w*)*) = .*?(?:  # (.*)|\n"""([^"]*)""")?$',
        inspect.getsource(module),
        re.MULTILINE,
    )
    return {
        names: in_c(" ".join((comment or re.split(r"[.]\s", text)[0]).split()))
        for names, comment, text in definitions
    }


def with_constants(text: str, modules: Iterable[Any]) -> str:
    """Replace ``@CONSTANTS@`` by definitions of the constants in ``modules`` that the text uses but does not define."""
    used = set(re.findall(r"\b[A-Z][A-Z_0-9]+\b", re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)))
    used -= set(re.findall(r"#define (\w+)", text))
    lines: list[str] = []
    for module in modules:
        for names, description in constants_of(module).items():
            group = [name for name in names.split(", ") if name in used]
            used -= {*group}
            if group and "," in names and description:
                lines += textwrap.wrap(f"/* {description} */", 120, subsequent_indent=" * ")
            comment = f" /* {description} */" if description and "," not in names else ""
            for name in group:
                value = vars(module)[name]
                value = float(value) if isinstance(value, float) else value  # not a number of NumPy
                lines += textwrap.wrap(f"#define {name} {value!r}{comment}", 120, subsequent_indent="    ")
    return text.replace("@CONSTANTS@", "\n".join(lines))


def _comments(source: str) -> dict[int, list[str]]:
    comments: dict[int, list[str]] = {}
    waiting: list[str] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            text = in_c(token.string.lstrip("# "))
            if text.startswith(("fmt:", "noqa")):
                continue
            if token.line.lstrip().startswith("#"):
                waiting.append(text)
            else:
                comments.setdefault(token.start[0], []).append(text)
        elif token.type == tokenize.NAME and waiting:
            comments.setdefault(token.start[0], []).extend(waiting)
            waiting = []
    return comments
