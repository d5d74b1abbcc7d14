"""Measure the power of the tests: change the source in small ways, and count the changes that the tests find.

    python benchmarks/mutants.py CHECKOUT --number 200 --out mutants.json           # draw and run, or continue
    python benchmarks/mutants.py OTHER --like mutants.json --out other.json         # the same mutants in other code
    python benchmarks/mutants.py CHECKOUT --number 200 --out mutants.json --draw    # only draw

A mutant is identified by the qualified name of its function, the kind of change, and its ordinal among the changes of
this kind in the function. In other code, the function is found by its module, or by its name if this name is unique. If
the function does not exist, another mutant of the same package is drawn.

A test file is run for a mutant if it imports the mutated module or the function (distance 0), if it imports a module
that imports the mutated module or is in the test folder of its package (1), or if it is one import farther (2). Files
with a smaller distance and a shorter time come first, up to `BUDGET` seconds, as measured without mutants.

Each mutant runs in a copy of the checkout with the Python of the checkout. A timeout counts as killed, and is recorded
as a timeout.
"""

import argparse
import ast
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from structure import functions

BUDGET = 60.0
"""Processor time (s) of the test files of a mutant, as measured without mutants."""
TIMEOUT = 120.0
"""Largest processor time (s) of a mutant; the wall time may be four times as long, since the machine may be busy."""
LEFT_OUT = {".git", ".venv", "__pycache__", ".pytest_cache", ".ruff_cache", ".import_linter_cache", "_build"}
FLIPPED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
SWAPPED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
}


@dataclass(frozen=True)
class Mutant:
    """A change of the source, by names that also exist in other versions of the code."""

    module: str
    function: str
    kind: str
    ordinal: int


@dataclass(frozen=True)
class Site:
    """Place of a mutant in the source, and the new text."""

    mutant: Mutant
    path: Path
    start: tuple[int, int]
    end: tuple[int, int]
    text: str


def changed(node: ast.AST) -> Iterator[tuple[str, ast.AST, ast.AST]]:
    """Yield the changes of a node: kind, replaced node, new node."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in FLIPPED:
        flipped = FLIPPED[type(node.ops[0])]()
        yield "comparison", node, ast.Compare(node.left, [flipped, *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.BinOp) and type(node.op) in SWAPPED and not _is_text(node):
        yield "arithmetic", node, ast.BinOp(node.left, SWAPPED[type(node.op)](), node.right)
    elif isinstance(node, ast.BoolOp):
        swapped = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield "and-or", node, ast.BoolOp(swapped, node.values)
    elif isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)):
        other = not node.value if isinstance(node.value, bool) else node.value + 1
        yield "constant", node, ast.Constant(other)
    elif isinstance(node, (ast.If, ast.While, ast.IfExp)):
        yield "condition", node.test, ast.UnaryOp(ast.Not(), node.test)
    elif isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
        yield "return", node.value, ast.Constant(None)


def _is_text(node: ast.BinOp) -> bool:
    sides = (node.left, node.right)
    return any(
        isinstance(s, ast.JoinedStr) or (isinstance(s, ast.Constant) and isinstance(s.value, str))
        for s in sides
    )


def _is_none(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def code_of(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a function in order, without annotations, decorators, f-strings and inner functions."""
    skipped = ("annotation", "returns", "decorator_list")
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            inner = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.JoinedStr))
            if isinstance(child, ast.AST) and name not in skipped and not inner:
                yield child
                yield from code_of(child)


def sites_of(root: Path) -> list[Site]:
    """Return all mutants of a checkout and their places."""
    found: list[Site] = []
    for top in (root / "src", root / "carla_recorder"):
        for path in sorted(top.rglob("*.py")):
            parts = path.relative_to(top if top.name == "src" else root).with_suffix("").parts
            module = ".".join(parts).removesuffix(".__init__")
            for function, node in functions(ast.parse(path.read_text())):
                count: Counter[str] = Counter()
                for inner in code_of(node):
                    for kind, old, new in changed(inner):
                        mutant = Mutant(module, function, kind, count[kind])
                        count[kind] += 1
                        text = f"({ast.unparse(ast.fix_missing_locations(new))})"
                        start = (old.lineno, old.col_offset)  # type: ignore[attr-defined]
                        end = (old.end_lineno, old.end_col_offset)  # type: ignore[attr-defined]
                        found.append(Site(mutant, path.relative_to(root), start, end, text))
    return found


def mutated(source: str, site: Site) -> str:
    """Return the source with the change; columns count bytes, as in `ast`."""
    lines = source.encode().splitlines(keepends=True)
    (first, left), (last, right) = site.start, site.end
    head, tail = lines[first - 1][:left], lines[last - 1][right:]
    return b"".join([*lines[: first - 1], head + site.text.encode() + tail, *lines[last:]]).decode()


def package_of(module: str) -> str:
    """Return the package of a module, below sigmaswarm."""
    parts = module.split(".")
    return parts[1] if len(parts) > 2 else parts[0]


def drawn(sites: list[Site], number: int, seed: int) -> list[Site]:
    """Draw mutants: two from each package, then from all packages uniformly; at most two per function."""
    rng = random.Random(seed)
    shuffled = list(sites)
    rng.shuffle(shuffled)
    count: Counter[tuple[str, str]] = Counter()
    order: list[Site] = []
    for site in shuffled:
        function = site.mutant.module, site.mutant.function
        count[function] += 1
        if count[function] <= 2:
            order.append(site)
    by_package: dict[str, list[Site]] = defaultdict(list)
    for site in order:
        by_package[package_of(site.mutant.module)].append(site)
    chosen = [site for name in sorted(by_package) for site in by_package[name][:2]][:number]
    taken = {s.mutant for s in chosen}
    return chosen + [s for s in order if s.mutant not in taken][: number - len(chosen)]


def found_again(wanted: list[Mutant], sites: list[Site], seed: int) -> list[Site]:
    """Find mutants in other code; replace each mutant that is not found by another one of the same package."""
    exact = {s.mutant: s for s in sites}
    by_name: dict[tuple[str, str, int], list[Site]] = defaultdict(list)
    for site in sites:
        by_name[site.mutant.function, site.mutant.kind, site.mutant.ordinal].append(site)
    chosen: list[Site] = []
    gone: list[Mutant] = []
    for mutant in wanted:
        alike = by_name[mutant.function, mutant.kind, mutant.ordinal]
        site = exact.get(mutant) or (alike[0] if len(alike) == 1 else None)
        if site is None:
            gone.append(mutant)
        else:
            chosen.append(site)
    spare = drawn(sites, len(sites), seed + 1)
    for mutant in gone:
        taken = {s.mutant for s in chosen}
        free = [s for s in spare if s.mutant not in taken]
        near = [s for s in free if package_of(s.mutant.module) == package_of(mutant.module)]
        chosen.append((near or free)[0])
    print(f"{len(wanted) - len(gone)} mutants found again, {len(gone)} drawn anew")
    return chosen


# --- tests ------------------------------------------------------------------------------------------------------------


class Tests:
    """Selection of the test files for a mutant, by imports, names and duration."""

    def __init__(self, root: Path, scratch: "Scratch", known: dict[str, Any]) -> None:
        self.scratch = scratch
        self.seconds: dict[str, float | None] = known
        self.files = {
            str(p.relative_to(root)): p.read_text() for p in sorted(root.glob("tests/**/test_*.py"))
        }
        self.imports = {name: _imported(text) for name, text in self.files.items()}
        self.used_by = _importers(root)

    def of(self, mutant: Mutant) -> list[str]:
        """Return the test files for a mutant: those with a small distance and a short time come first."""
        name = mutant.function.rpartition(".")[2]
        folder = f"tests/{package_of(mutant.module)}/"
        near, order = {mutant.module}, list[str]()
        for distance in range(3):
            hit = [
                file
                for file, imports in self.imports.items()
                if file not in order
                and (
                    imports & near
                    or (distance == 0 and name in {imported.rpartition(".")[2] for imported in imports})
                    or (distance == 1 and file.startswith(folder))
                )
            ]
            order += sorted(hit, key=lambda file: len(self.files[file]))
            near = {importer for module in near for importer in self.used_by[module]}
            if self._full(order):
                break
        return self._within_budget(order)

    def _full(self, order: list[str]) -> bool:
        return sum(self.seconds.get(file) or 0.0 for file in order) > BUDGET

    def _within_budget(self, order: list[str]) -> list[str]:
        chosen: list[str] = []
        left = BUDGET
        for file in order:
            if file not in self.seconds:
                verdict, seconds = self.scratch.run([file], BUDGET)
                self.seconds[file] = round(seconds, 1) if verdict == "survived" else None
            seconds = self.seconds[file]
            if seconds is not None and seconds <= left:
                chosen.append(file)
                left -= seconds
            if left < 3 or len(chosen) == 12:
                break
        return chosen


def _imported(text: str) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name.startswith(("sigmaswarm", "carla_recorder"))}


def _importers(root: Path) -> dict[str, set[str]]:
    importers: dict[str, set[str]] = defaultdict(set)
    for path in (root / "src").rglob("*.py"):
        module = ".".join(path.relative_to(root / "src").with_suffix("").parts).removesuffix(".__init__")
        for target in _imported(path.read_text()):
            importers[target].add(module)
    return importers


class Scratch:
    """A copy of a checkout in which the source is changed, and the Python of the checkout."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.python = root / ".venv/bin/python"
        self.root = folder / "tree"
        shutil.copytree(root, self.root, ignore=lambda _, names: [n for n in names if n in LEFT_OUT])
        self.environment = os.environ | {"PYTHONPATH": str(self.root / "src"), "PYTHONDONTWRITEBYTECODE": "1"}

    def run(self, files: list[str], limit: float) -> tuple[str, float]:
        """Run test files; return "killed", "survived" or "timeout", and the processor time (s) with child processes."""
        words = ["-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *files]
        before = _children_seconds()
        process = subprocess.Popen(
            [str(self.python), *words],
            cwd=self.root,
            env=self.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5)),
        )
        try:
            code = process.wait(4 * limit)
        except subprocess.TimeoutExpired:
            code = -signal.SIGXCPU
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        stopped = code in (-signal.SIGXCPU, -signal.SIGKILL)
        return "timeout" if stopped else "killed" if code else "survived", _children_seconds() - before

    def try_out(self, site: Site, files: list[str]) -> tuple[str, float]:
        """Change the source, run the tests, and restore the source."""
        path = self.root / site.path
        source = path.read_text()
        path.write_text(mutated(source, site))
        try:
            return self.run(files, TIMEOUT)
        finally:
            path.write_text(source)


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def save(out: Path, state: dict[str, Any]) -> None:
    """Write the results completely or not at all."""
    part = out.with_suffix(".part")
    part.write_text(json.dumps(state, indent=1))
    part.replace(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("checkout", type=Path)
    parser.add_argument(
        "--out", type=Path, required=True, help="JSON file of results; continued if it exists"
    )
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--like", type=Path, help="results whose mutants are used again")
    parser.add_argument("--limit", type=int, help="largest number of mutants to run now")
    parser.add_argument("--draw", action="store_true", help="draw the mutants and run none")
    asked = parser.parse_args()
    root = asked.checkout.resolve()
    sites = sites_of(root)
    if asked.out.exists():
        state = json.loads(asked.out.read_text())
    else:
        if asked.like:
            wanted = [Mutant(**entry["mutant"]) for entry in json.loads(asked.like.read_text())["mutants"]]
            chosen = found_again(wanted, sites, asked.seed)
        else:
            chosen = drawn(sites, asked.number, asked.seed)
        state = {
            "seed": asked.seed,
            "sites": len(sites),
            "seconds": {},
            "mutants": [{"mutant": asdict(s.mutant)} for s in chosen],
        }
        save(asked.out, state)
    if not asked.draw:
        run_all(root, {s.mutant: s for s in sites}, state, asked.out, asked.limit)
    report(state)


def run_all(
    root: Path, sites: dict[Mutant, Site], state: dict[str, Any], out: Path, limit: int | None
) -> None:
    """Run the mutants without a verdict."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        scratch = Scratch(root, Path(folder))
        tests = Tests(root, scratch, state["seconds"])
        ahead = [entry for entry in state["mutants"] if "verdict" not in entry]
        for entry in ahead[:limit]:
            mutant = Mutant(**entry["mutant"])
            site = sites[mutant]
            files = tests.of(mutant)
            entry["verdict"], seconds = scratch.try_out(site, files) if files else ("no tests", 0.0)
            entry |= {
                "seconds": round(seconds, 1),
                "tests": files,
                "line": site.start[0],
                "text": site.text,
            }
            save(out, state)
            name = f"{mutant.module}:{mutant.function} {mutant.kind} {mutant.ordinal}"
            print(f"{entry['verdict']:9} {entry['seconds']:6.1f} s  {name}", flush=True)


def report(state: dict[str, Any]) -> None:
    """Print the fractions of killed mutants."""
    done = [entry for entry in state["mutants"] if "verdict" in entry]
    count = Counter(entry["verdict"] for entry in done)
    print(f"{len(state['mutants'])} mutants of {state['sites']} sites, {len(done)} run:", dict(count))
    if done:
        killed = count["killed"] + count["timeout"]
        print(
            f"killed: {killed / len(done):.1%}; {sum(e['seconds'] for e in done) / len(done):.1f} s a mutant"
        )


if __name__ == "__main__":
    main()
