"""What the site's reference is made of: pages of the commands, and which page has which public name."""

import inspect
import re
import sys
from pathlib import Path
from unittest.mock import patch

DOCS = Path(__file__).parent
COMMANDS = DOCS / "reference" / "generated" / "commands"


def commands() -> dict[str, str]:
    """A page for each command of the command line, in its order: Markdown, made of its own help."""
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
    """Write the commands' pages where the site looks for them; untouched where nothing changed."""
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
    """Which page of the reference has a public name: the names in its autosummary."""
    found: dict[str, str] = {}
    for page in sorted((DOCS / "reference").glob("*.md")):
        for block in re.findall(r"\.\. autosummary::\n(.*?)```", page.read_text(), re.DOTALL):
            names = [line.strip() for line in block.splitlines() if line.strip() and ":" not in line]
            found |= dict.fromkeys(names, page.stem)
    return found
