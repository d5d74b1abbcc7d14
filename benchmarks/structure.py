"""Measure the structure of a checkout: size, names, options, imports.

    python benchmarks/structure.py                     # this checkout
    python benchmarks/structure.py OTHER               # another one
    python benchmarks/structure.py BEFORE AFTER        # both, and their ratio
    python benchmarks/structure.py --list CHECKOUT     # with the names behind the figures

Command-line options and public names of a checkout are read by its own ``.venv/bin/python``, if it exists. Needs grimp,
a dependency of import-linter. Run this program with Python 3.11: in later versions, an f-string is several tokens.
"""

import argparse
import ast
import json
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import grimp

PACKAGE = "sigmaswarm"
RECORDER = "carla_recorder"  # a separate distribution, at the top of the checkout
KERNELS = "filters/compiled"
LONG, MANY, SHORT = 60, 7, 40
SKIPPED_TOKENS = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
INTERFACE = """
import json, warnings
warnings.simplefilter("ignore")
import sigmaswarm
from sigmaswarm.cli.app import app
options = {}
for name in app:
    if name.startswith("-"):
        continue
    arguments = app[name].assemble_argument_collection()
    options[name] = [a.names[0] for a in arguments if a.names[0].startswith("-")]
print(json.dumps({"names": sigmaswarm.__all__, "options": options}))
"""
RULES = {
    "source files": "*.py under src/ and carla_recorder/",
    "source lines": "all lines of these files, including blank lines and comments",
    "source tokens": "names, numbers, strings, operators; without docstrings, comments, line ends and indentation",
    "template lines": "all lines of other files under src/: C, HTML, JavaScript, CSS and others",
    "test files": "*.py under tests/",
    "test lines": "all lines of these files",
    "docs words": "words of *.md under docs/ (without _build) and at the top of the checkout; no changelog",
    "public names": "sigmaswarm.__all__ without errors and warnings",
    "options": "options of all commands, without positional arguments, --help and --version",
    "classes": "class statements at the top of a module",
    "module constants": "names in capitals that a module assigns at its top level",
    "functions over 60 lines": "def to the last line, docstring included, without decorators; outside filters/compiled",
    "functions over 60 lines, kernels": "the same in filters/compiled",
    "functions over 7 parameters": "self and cls not counted; outside filters/compiled",
    "functions over 7 parameters, kernels": "the same in filters/compiled",
    "functions of at most 4 lines": "def to the last line, docstring included",
    "import cycles": "sets of modules that import each other, also within functions and only for types",
    "arrows between folders": "ordered pairs of folders of the package, A != B, where a module of A imports one of B",
    "imports between folders": "pairs of modules behind these arrows",
    "files under 40 lines": "source files, __init__.py files with docstrings alone not counted",
    "files under 80 lines": "the same",
    "names used once": "functions, classes and constants of modules whose name occurs once more in the source",
    "fmt: off": "formatter switched off: comments fmt: off and fmt: skip",
}

Figures = dict[str, int]
Names = dict[str, list[str]]


def sources(root: Path) -> list[Path]:
    """Return the source files."""
    return sorted(
        p for top in (root / "src", root / RECORDER) for p in top.rglob("*.py") if "tests" not in p.parts
    )


def lines_of(paths: Iterator[Path] | list[Path]) -> int:
    """Count all lines of text files."""
    return sum(len(p.read_text(errors="replace").splitlines()) for p in paths)


def docstring_lines(tree: ast.Module) -> set[int]:
    """Return the first lines of docstrings, whose tokens are not counted."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    bodies = [node.body for node in ast.walk(tree) if isinstance(node, documented)]
    # A string below an assignment is also a docstring.
    bare = [
        s for body in bodies for s in body if isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant)
    ]
    return {s.lineno for s in bare if isinstance(s.value, ast.Constant) and isinstance(s.value.value, str)}


def code_tokens(path: Path, tree: ast.Module) -> list[str]:
    """Return the tokens of a file that are counted: see `RULES`."""
    skipped_lines = docstring_lines(tree)
    with tokenize.open(path) as file:
        tokens = list(tokenize.generate_tokens(file.readline))
    return [
        t.string
        for t in tokens
        if t.type not in SKIPPED_TOKENS and not (t.type == tokenize.STRING and t.start[0] in skipped_lines)
    ]


def functions(
    tree: ast.AST, prefix: str = ""
) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Yield qualified names and nodes of all functions."""
    for node in ast.iter_child_nodes(tree):
        name = prefix
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            name = f"{prefix}.{node.name}".lstrip(".")
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield name, node
        yield from functions(node, name)


def n_lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Count the lines of a function."""
    return (node.end_lineno or node.lineno) - node.lineno + 1


def n_parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Count the parameters of a function, without self and cls."""
    arguments = node.args
    named = [a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
    starred = [a for a in (arguments.vararg, arguments.kwarg) if a]
    return len([name for name in named if name not in ("self", "cls")]) + len(starred)


def constants(tree: ast.Module) -> list[str]:
    """Return the constants that a module assigns at its top level."""
    found: list[str] = []
    for node in tree.body:
        targets = (
            node.targets
            if isinstance(node, ast.Assign)
            else [node.target]
            if isinstance(node, ast.AnnAssign)
            else []
        )
        names = [n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)]
        found += [name for name in names if re.fullmatch(r"_*[A-Z][A-Z0-9_]*", name)]
    return found


def defined(tree: ast.Module) -> list[str]:
    """Return the functions, classes and constants that a module defines at its top level."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    return [node.name for node in tree.body if isinstance(node, kinds)] + constants(tree)


def import_figures(root: Path) -> tuple[Figures, Names]:
    """Measure cycles and arrows between folders."""
    sys.path.insert(0, str(root / "src"))
    for name in [n for n in sys.modules if n.split(".")[0] == PACKAGE]:
        del sys.modules[name]
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    sys.path.pop(0)
    imports = {m: graph.find_modules_directly_imported_by(m) for m in graph.modules if m != PACKAGE}
    reached = {module: _reached(module, imports) for module in imports}
    cycles = {frozenset(b for b in reached[a] if a in reached.get(b, ())) for a in imports if a in reached[a]}
    folder = {m: m if _is_package(root, m) else m.rpartition(".")[0] for m in graph.modules}
    across = [
        (folder[a], folder[b]) for a, targets in imports.items() for b in targets if folder[a] != folder[b]
    ]
    arrows = Counter((a, b) for a, b in across if b != PACKAGE or a != PACKAGE)
    figures = {
        "import cycles": len(cycles),
        "arrows between folders": len(arrows),
        "imports between folders": sum(arrows.values()),
    }
    names = {
        "import cycles": [" <-> ".join(sorted(c)) for c in cycles],
        "arrows between folders": [f"{a} -> {b} ({n})" for (a, b), n in arrows.most_common()],
    }
    return figures, names


def _reached(start: str, imports: dict[str, set[str]]) -> set[str]:
    found: set[str] = set()
    ahead = list(imports[start])
    while ahead:
        module = ahead.pop()
        if module not in found:
            found.add(module)
            ahead += imports.get(module, ())
    return found


def _is_package(root: Path, module: str) -> bool:
    return (root / "src" / module.replace(".", "/")).is_dir()


def interface_figures(root: Path) -> tuple[Figures, Names]:
    """Count public names and options, by the checkout's own Python."""
    own = root / ".venv/bin/python"
    code = f"import sys; sys.path.insert(0, {str(root / 'src')!r})\n{INTERFACE}"
    done = subprocess.run(
        [str(own if own.exists() else sys.executable), "-c", code], capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{root}: the package can't be imported:\n{done.stderr}")
    found = json.loads(done.stdout.splitlines()[-1])
    names = [n for n in found["names"] if not n.endswith(("Error", "Warning"))]
    options = [f"{command} {option}" for command, its in found["options"].items() for option in its]
    return {"public names": len(names), "options": len(options)}, {"public names": names, "options": options}


def source_figures(root: Path) -> tuple[Figures, Names]:
    """Measure the source files."""
    figures: Figures = Counter()
    names: Names = {}
    used: Counter[str] = Counter()
    definitions: list[tuple[str, str]] = []
    for path in sources(root):
        text = path.read_text()
        tree = ast.parse(text)
        relative = str(path.relative_to(root))
        tokens = code_tokens(path, tree)
        used.update(tokens)
        n = len(text.splitlines())
        definitions += [(name, relative) for name in defined(tree)]
        figures["source files"] += 1
        figures["source lines"] += n
        figures["source tokens"] += len(tokens)
        figures["classes"] += sum(isinstance(node, ast.ClassDef) for node in tree.body)
        figures["module constants"] += len(constants(tree))
        figures["fmt: off"] += len(re.findall(r"#\s*fmt:\s*(?:off|skip)", text))
        if tokens:
            for limit in (SHORT, 80):
                figures[f"files under {limit} lines"] += n < limit
            if n < SHORT:
                names.setdefault("files under 40 lines", []).append(f"{relative} ({n})")
        kernels = ", kernels" if KERNELS in relative else ""
        for name, node in functions(tree):
            figures["functions of at most 4 lines"] += n_lines(node) <= 4
            for what, value, limit in (
                ("lines", n_lines(node), LONG),
                ("parameters", n_parameters(node), MANY),
            ):
                figures[f"functions over {limit} {what}{kernels}"] += value > limit
                if value > limit:
                    names.setdefault(f"functions over {limit} {what}{kernels}", []).append(
                        f"{relative} {name} ({value})"
                    )
    once = [f"{path} {name}" for name, path in definitions if used[name] == 2]
    figures["names used once"] = len(once)
    return dict(figures), names | {"names used once": once}


def text_figures(root: Path) -> Figures:
    """Measure templates, tests and docs."""
    others = [p for p in (root / "src").rglob("*") if p.is_file() and p.suffix not in (".py", ".pyc")]
    others = [p for p in others if "__pycache__" not in p.parts and ".egg-info" not in str(p)]
    tests = sorted((root / "tests").rglob("*.py"))
    docs = [
        p for p in (root / "docs").rglob("*.md") if not any(part.startswith("_build") for part in p.parts)
    ]
    docs += [p for p in root.glob("*.md") if p.name != "CHANGELOG.md"]
    return {
        "template lines": lines_of(others),
        "test files": len(tests),
        "test lines": lines_of(tests),
        "docs words": sum(len(p.read_text().split()) for p in docs),
    }


def measure(root: Path) -> tuple[Figures, Names]:
    """Measure a checkout: figures by name, and the names behind some of them."""
    figures, names = source_figures(root)
    figures |= text_figures(root)
    for more, their in (import_figures(root), interface_figures(root)):
        figures |= more
        names |= their
    return {name: figures.get(name, 0) for name in RULES}, names


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("checkouts", nargs="*", type=Path, default=[Path(__file__).parents[1]])
    parser.add_argument("--list", action="store_true", help="print the names behind the figures")
    parser.add_argument("--rules", action="store_true", help="print how each figure is counted")
    asked = parser.parse_args()
    found = [measure(path.resolve()) for path in asked.checkouts]
    for name, rule in RULES.items():
        values = [figures[name] for figures, _ in found]
        ratio = f"{values[-1] / values[0]:8.1%}" if len(values) > 1 and values[0] else ""
        print(f"{name:38}", *(f"{value:10,}" for value in values), ratio, f"  {rule}" if asked.rules else "")
    if asked.list:
        for name, items in found[-1][1].items():
            print(f"\n{name}:", *items, sep="\n  ")


if __name__ == "__main__":
    main()
