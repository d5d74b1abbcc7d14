"""Generate the pages of the commands, and find the reference page of each public name."""

import inspect
import re
import sys
from pathlib import Path
from unittest.mock import patch

DOCS = Path(__file__).parent
COMMANDS = DOCS / "reference" / "generated" / "commands"


def commands() -> dict[str, str]:
    """Return a Markdown page with the help of each command, by name, in the order of the command line."""
    from sigmaswarm.cli.app import app

    return {name: _page(name) for name in app if not name.startswith("-")}


def _page(name: str) -> str:
    from sigmaswarm.cli.app import app
    from sigmaswarm.cli.options import HELP_ALL

    with patch.object(sys, "argv", [HELP_ALL]):
        text = app[name].generate_docs(output_format="markdown", usage_name=f"sigmaswarm {name}")
    body = text[text.index("```console") :].replace("```console", "```text", 1)
    # Indented examples become blocks that can be copied.
    body = re.sub(
        r"\n\n((?:    sigmaswarm .*\n)+)", lambda m: f"\n\n```console\n{inspect.cleandoc(m[1])}\n```\n", body
    )
    body = body.replace("**Arguments**:", "## Arguments").replace("**Parameters**:", "## Options")
    return f"# sigmaswarm {name}\n\n{body.strip()}\n"


def write_commands() -> None:
    """Write the pages of the commands; do not touch unchanged files, so that Sphinx does not build them again."""
    COMMANDS.mkdir(parents=True, exist_ok=True)
    pages = {f"{name}.md": text for name, text in commands().items()}
    for old in COMMANDS.glob("*.md"):
        if old.name not in pages:
            old.unlink()
    for name, text in pages.items():
        file = COMMANDS / name
        if not file.exists() or file.read_text() != text:
            file.write_text(text)


def homes() -> dict[str, str]:
    """Return the reference page of each public name: the page whose autosummary lists the name."""
    found: dict[str, str] = {}
    for page in sorted((DOCS / "reference").glob("*.md")):
        for block in re.findall(r"\.\. autosummary::\n(.*?)```", page.read_text(), re.DOTALL):
            names = [line.strip() for line in block.splitlines() if line.strip() and ":" not in line]
            found |= dict.fromkeys(names, page.stem)
    return found
