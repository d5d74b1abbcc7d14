"""The reference manual contains every public name and every option of every command; examples use the names."""

import importlib.util
import re
from functools import cache
from pathlib import Path

import pytest

import sigmaswarm
from sigmaswarm.cli.app import app

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "docs" / "reference"


def script(name: str):
    """Import a script of the docs, which is not part of a package."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / "docs" / f"{name}.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


generate = script("generate")
commands = cache(generate.commands)


REACHABLE = {*sigmaswarm.__all__, *sigmaswarm._modules()}


def test_every_public_name_is_in_the_reference():
    assert set(generate.homes()) == REACHABLE


@pytest.mark.parametrize("name", sorted(REACHABLE))
def test_an_example_that_runs_uses_the_name(name: str):
    page = (REFERENCE / f"{generate.homes()[name]}.md").read_text()
    blocks = "".join(re.findall(r"```python.*?\n(.*?)```", page, re.DOTALL))
    assert re.search(rf"\bss\.{name}\b", blocks)


COMMANDS = [name for name in app if not name.startswith("-")]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_the_command_s_page(name: str):
    page = commands()[name]
    assert page.startswith(f"# sigmaswarm {name}\n")
    assert f"```console\nsigmaswarm {name} " in page  # an example to copy
    found = app[name].assemble_argument_collection()
    arguments = [
        a for a in found if a.parameter.show is not False and a.name != "*"
    ]  # * is a record of options
    assert arguments
    for argument in arguments:
        entry = re.search(rf"^\* `[^`\n]*{re.escape(argument.name)}\b[^\n]*`: *(\S.*)$", page, re.MULTILINE)
        assert entry, f"{argument.name} is missing, or not explained"


def test_every_command_is_in_the_overview():
    overview = (REFERENCE / "commands.md").read_text()
    assert [name for name in COMMANDS if f"- `sigmaswarm {name}`: " not in overview] == []


def steps():
    """Return the names on the page about the way of one parameter set, and the file that the page states for each."""
    text = (ROOT / "docs" / "explanation" / "road.md").read_text()
    for name, file in re.findall(r"\[`([\w.]+)`\]\(\.\./\.\./(src/[\w/]+\.py)\)", text):
        if not name.endswith(".py"):
            yield pytest.param(name, file, id=name)


@pytest.mark.parametrize(("name", "file"), list(steps()))
def test_the_road_of_a_parameter_set_leads_to_what_it_names(name: str, file: str):
    source = (ROOT / file).read_text()
    for part in name.split("."):
        assert re.search(rf"^ *(def|class) {part}\b|^{part}\b.* = ", source, re.MULTILINE), part


def test_the_figures_of_real_drives_are_those_of_the_results():
    found = script("pictures").held_out()
    assert len(found) >= 7
    assert all({"with truth", "without truth", "raw fixes"} == set(of) for of in found.values())
    text = (ROOT / "docs" / "results.md").read_text()
    (rmse, drift), (other_rmse, other_drift) = (
        found["kitti-09-26-0101"][tuned] for tuned in ("with truth", "without truth")
    )
    row = rf"0101 \| .* \| 1.38 \| {rmse:.2f}; {other_rmse:.2f}; .* \| {drift:.2f}; {other_drift:.2f}; "
    assert re.search(row, text)
