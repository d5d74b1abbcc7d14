"""The notebooks of examples/ are executed completely, and their statements are true."""

import ast
import inspect
import json
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

import sigmaswarm

EXAMPLES = Path(__file__).parents[1] / "examples"


def code(path: Path) -> list[dict[str, Any]]:
    return [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]


def texts(cell: dict[str, Any]) -> str:
    """Return the output of a cell as text."""
    shown = [output.get("text") or output["data"].get("text/markdown", "") for output in cell["outputs"]]
    return "".join("".join(text) for text in shown)


def lines(cell: dict[str, Any]) -> list[str]:
    """Return the Python code of a cell, without commands of IPython."""
    return [line for line in "".join(cell["source"]).splitlines() if not line.startswith(("%", "!"))]


MANEUVERS = '"turns", "brake"'
SIZES = '"environments": ("clear",), "runs": 2, "trials": 2, "particles": 8, "generations": 12'
CHANGES = {
    "parameters": ("SIZE = SMALL", f'SIZE = {{"maneuvers": ({MANEUVERS}), {SIZES}}}'),
    "drives": ("simulate_many(", f"simulate_many(maneuvers=({MANEUVERS}), "),
    "twice": ("paper=True", "paper=True, trials=1"),
}
"""Replacements that shorten the paper's notebook, by cell."""


@pytest.fixture(
    scope="module", params=[pytest.param(size, marks=pytest.mark.long) for size in ("tiny", "as it is")]
)
def paper(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> dict[str, dict[str, Any]]:
    """Execute the paper's notebook in a fresh kernel; return its cells by id."""
    copy = Path(shutil.copy(EXAMPLES / "paper.ipynb", tmp_path_factory.mktemp("examples")))
    if request.param == "tiny":
        notebook = json.loads(copy.read_text())
        for cell in notebook["cells"]:
            was, now = CHANGES.get(cell["id"], ("", ""))
            source = "".join(cell["source"])
            assert was in source
            cell["source"] = source.replace(was, now) if was else source
        copy.write_text(json.dumps(notebook))
    done = subprocess.run(
        [sys.executable, EXAMPLES / "execute.py", copy], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert [p.name for p in copy.parent.iterdir()] == ["paper.ipynb"]  # no other file is written
    return {cell["id"]: cell for cell in code(copy)}


def test_no_cell_fails_or_complains(paper: dict[str, dict[str, Any]]):
    kinds = [(o["output_type"], o.get("name")) for cell in paper.values() for o in cell["outputs"]]
    assert {kind for kind, _ in kinds} == {"stream", "display_data", "execute_result"}
    assert {name for _, name in kinds} == {"stdout", None}


def test_every_claim_holds(paper: dict[str, dict[str, Any]]):
    claims = texts(paper["claims"]).splitlines()
    assert len(claims) == 6
    assert [claim for claim in claims if not claim.startswith("yes ")] == []


def test_the_paper_s_figures_stand_beside_ours(paper: dict[str, dict[str, Any]]):
    for name, figure in (("table-1", "21,607"), ("table-2", "2.80 [2.62, 2.98]"), ("table-3", "18.60")):
        assert figure in texts(paper[name])
    for name in ("sweep", "convergence", "trajectory"):
        assert any("image/png" in output.get("data", {}) for output in paper[name]["outputs"])


@pytest.mark.parametrize("name", ["paper", "dataframes"])
def test_a_notebook_uses_names_that_exist(name: str):
    """Check that public names exist, and that listed options exist; `make test-long` executes the notebook."""
    tree = ast.parse("\n".join(line for cell in code(EXAMPLES / f"{name}.ipynb") for line in lines(cell)))
    names = {alias.asname or alias.name for n in ast.walk(tree) if isinstance(n, ast.Import) for alias in n.names
             if alias.name == "sigmaswarm"}  # fmt: skip
    called = 0
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("sigmaswarm"):
            module = import_module(str(node.module))
            assert all(hasattr(module, alias.name) for alias in node.names)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in names:
            assert hasattr(sigmaswarm, node.attr), node.attr
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[0] in names:
            function = getattr(sigmaswarm, ast.unparse(node.func).split(".")[1])
            options = [keyword.arg for keyword in node.keywords if keyword.arg]
            taken = inspect.signature(function).parameters.values()
            if isinstance(function, FunctionType) and not any(p.kind == p.VAR_KEYWORD for p in taken):
                assert {*options} <= {p.name for p in taken}
                called += 1
    assert called


def test_what_is_checked_in_was_executed_in_order_and_is_small():
    path = EXAMPLES / "paper.ipynb"
    cells = code(path)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert not any(output["output_type"] == "error" for cell in cells for output in cell["outputs"])
    assert path.stat().st_size < 500_000
    parameters = next("".join(cell["source"]) for cell in cells if cell["id"] == "parameters")
    assert "SIZE = SMALL" in parameters
    assert "OUT = None" in parameters


@pytest.mark.long
def test_two_frames_become_a_tuned_filter_and_nothing_is_written(tmp_path: Path):
    """Execute the notebook on data frames: figures are drawn, the tuned filter is printed in C, no file is written."""
    copy, text = tmp_path / "dataframes.ipynb", (EXAMPLES / "dataframes.ipynb").read_text()
    assert "duration=120" in text
    copy.write_text(text.replace("duration=120", "duration=60, imu_rate=50.0"))
    done = subprocess.run(
        [sys.executable, EXAMPLES / "execute.py", copy],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["dataframes.ipynb"]
    cells = code(copy)
    assert not any(
        o["output_type"] == "error" or o.get("name") == "stderr" for c in cells for o in c["outputs"]
    )
    assert sum("image/png" in o.get("data", {}) for c in cells for o in c["outputs"]) == 2
    assert any("ins_gps.c" in str(o) for o in cells[-1]["outputs"])


def test_a_failing_cell_is_told_and_nothing_is_written(tmp_path: Path):
    cell = {"cell_type": "code", "id": "a", "metadata": {}, "outputs": [], "execution_count": None}
    notebook = {"nbformat": 4, "nbformat_minor": 5, "metadata": {}, "cells": [cell | {"source": "1 / 0"}]}
    path = tmp_path / "bad.ipynb"
    path.write_text(json.dumps(notebook))
    done = subprocess.run(
        [sys.executable, EXAMPLES / "execute.py", path], capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "ZeroDivisionError" in done.stderr
    assert json.loads(path.read_text()) == notebook
