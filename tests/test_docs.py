"""The commands in the documents are valid, and the targets of links exist.

A pytest plugin executes the Python blocks.
"""

import json
import re
import shlex
from pathlib import Path

import pytest

from sigmaswarm.cli.app import app

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MADE = {DOCS / "_build", DOCS / "reference" / "generated"}
PAGES = [ROOT / "README.md", *(p for p in sorted(DOCS.rglob("*.md")) if not MADE & set(p.parents))]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def commands():
    for page in PAGES:
        for block in re.findall(r"```console\n(.*?)```", page.read_text(), re.DOTALL):
            for line in block.splitlines():
                if line.strip().startswith("sigmaswarm "):
                    yield pytest.param(line.strip(), id=f"{page.relative_to(ROOT)}: {line.strip()}")


@pytest.mark.parametrize("line", list(commands()))
def test_shown_commands_parse(line):
    app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)


def links():
    """Yield the links of a page to files and anchors: page, target as written."""
    for page in [
        *PAGES,
        *(ROOT / f"{name}.md" for name in ("CONTRIBUTING", "CHANGELOG", "SECURITY")),
        *NOTEBOOKS,
    ]:
        for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
            if not re.match(r"[a-z]+:", target):
                yield pytest.param(page, target, id=f"{page.relative_to(ROOT)}: {target}")


def prose(page: Path) -> str:
    """Return the text of a page without code; the text cells of a notebook."""
    text = page.read_text()
    if page.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as repository hosts generate them."""
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
    assert {f"docs/{page.name}" for page in PAGES if page.parent == DOCS} <= listed
    for page in PAGES:
        others = {p.values[1].partition("#")[0] for p in links() if p.values[0] == page} - {"", page.name}
        assert len(others) > 1, f"{page.name} leads nowhere"


def contents(page: Path):
    """Return the pages in the table of contents of a page of the site."""
    for block in re.findall(r"```{toctree}\n(.*?)```", page.read_text(), re.DOTALL):
        for line in block.splitlines():
            name = re.sub(r".*<(.*)>", r"\1", line.strip())
            if name and not name.startswith(":") and "*" not in name:
                yield next(
                    p for e in (".md", ".ipynb") if (p := (page.parent / f"{name}{e}").resolve()).exists()
                )


def test_the_site_s_contents_hold_every_page_once():
    found, ahead = [DOCS / "index.md"], [DOCS / "index.md"]
    while ahead:
        below = [page for page in contents(ahead.pop()) if page.suffix == ".md" or page in NOTEBOOKS]
        found, ahead = found + below, ahead + [page for page in below if page.suffix == ".md"]
    assert len(found) == len(set(found))
    assert set(PAGES) - {ROOT / "README.md"} <= set(found)


def held():
    """Return the tests that docs/promises.md names."""
    text = (ROOT / "docs" / "promises.md").read_text()
    return sorted(set(re.findall(r"`(tests/[\w/]+\.py(?:::\w+)?)`", text)))


@pytest.mark.parametrize("named", held())
def test_every_promise_is_held_by_a_test(named):
    path, _, name = named.partition("::")
    assert (f"def {name}(" if name else "def test_") in (ROOT / path).read_text()


def test_every_promise_names_a_test():
    text = (ROOT / "docs" / "promises.md").read_text()
    rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| promise")]
    assert len(rows) > 25
    for row in rows:
        assert re.search(r"`tests/[\w/]+\.py|python -m fuzzing", row.split(" | ")[-1]), row


def guide_paths():
    """Yield the paths in the contributor guide, each with the folders that its paragraph or row names."""
    text = prose(ROOT / "CONTRIBUTING.md")
    for paragraph in re.split(r"\n(?=- |\||\n)", text):
        names = re.findall(r"`([\w./-]+(?:/|\.(?:py|md|toml|in|js|txt)))`", paragraph)
        folders = {name.rpartition("/")[0] for name in names}
        yield from ((name, folders) for name in names)


@pytest.mark.parametrize(("name", "folders"), [pytest.param(*case, id=case[0]) for case in guide_paths()])
def test_paths_in_the_contributor_guide_exist(name: str, folders: set[str]):
    bases = ROOT, ROOT / "src/sigmaswarm"
    assert any((base / folder / name).exists() for base in bases for folder in {"", *folders})


def test_the_readme_has_at_most_120_lines():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120
