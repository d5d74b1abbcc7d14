"""Commands that the documents show must be ones that the program takes, and links lead somewhere.

Their Python blocks run by themselves.
"""

import json
import re
import shlex
from pathlib import Path

import pytest

from sigmaswarm.cli.app import app

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def commands():
    for page in PAGES:
        for block in re.findall(r"```console\n(.*?)```", page.read_text(), re.DOTALL):
            for line in block.splitlines():
                if line.startswith("sigmaswarm "):
                    yield pytest.param(line, id=f"{page.name}: {line}")


@pytest.mark.parametrize("line", list(commands()))
def test_shown_commands_parse(line):
    app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)


def links():
    """Every link of a page to a file or a place in one: page, target as it stands there."""
    for page in [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *NOTEBOOKS]:
        for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
            if not re.match(r"[a-z]+:", target):
                yield pytest.param(page, target, id=f"{page.name}: {target}")


def prose(page: Path) -> str:
    """What of a page is not code; of a notebook its text cells."""
    text = page.read_text()
    if page.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def anchors(page: Path) -> set[str]:
    """The places that a page's headings make, as web views of a repository name them."""
    names: set[str] = set()
    for heading in re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE):
        shown = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower()
        name = re.sub(r"[^\w\- ]", "", shown).strip().replace(" ", "-")
        again = (f"{name}-{i}" for i in range(1, 1000))
        names.add(name if name not in names else next(n for n in again if n not in names))
    return names


@pytest.mark.parametrize(("page", "target"), list(links()))
def test_links_point_at_what_is_there(page: Path, target: str):
    path, _, anchor = target.partition("#")
    to = page.parent / path if path else page
    assert to.exists()
    assert not anchor or anchor in anchors(to), f"{to.name} has {sorted(anchors(to))}"


def test_every_page_is_in_the_readme_and_leads_on():
    listed = {p.values[1].partition("#")[0] for p in links() if p.values[0].name == "README.md"}
    assert {f"docs/{page.name}" for page in PAGES if page.parent.name == "docs"} <= listed
    for page in PAGES:
        others = {p.values[1].partition("#")[0] for p in links() if p.values[0] == page} - {"", page.name}
        assert len(others) > 1, f"{page.name} leads nowhere"


def held():
    """The tests that docs/promises.md names."""
    text = (ROOT / "docs" / "promises.md").read_text()
    return sorted(set(re.findall(r"`(tests/[\w/]+\.py(?:::\w+)?)`", text)))


@pytest.mark.parametrize("named", held())
def test_every_promise_is_held_by_a_test(named):
    path, _, name = named.partition("::")
    assert f"def {name or 'test_'}" in (ROOT / path).read_text()
