"""Check the prose of README, CONTRIBUTING, docs, docstrings, messages and the changelog's first version.

`make check` runs it.

    python tests/prose.py                  # print what breaks a rule; exit code 1 if anything does
    python tests/prose.py --sample 3000 --seed 1   # draw words to read as an editor

A sample has equal parts of README and CONTRIBUTING, docs, help and messages, and docstrings. Rules are constructions,
sentence length and headings. An option or a file may be called anything: code is skipped.
"""

import argparse
import ast
import inspect
import random
import re
import sys
import textwrap
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

ROOT = Path(__file__).parents[1]
LONGEST = 36  # words of a sentence
CONSTRUCTIONS = {
    r"\b(fore)?(told|tells?)\b(?! cmake)": "report, estimate, predict",
    r"\b(said|says?)\b": "state, report",
    r"\bbesides?\b": "next to, relative to, in addition to",
    r"\b(nobody|whoever|whosoever)\b": "name the subject",
    r"\bwhat is (asked|said|told)\b": "name it",
    r"\bheld\b(?![- ](out|back))": "evaluated, kept, contained",
    r"\b(bears?|bidden|hindsight|anew|untuned|amiss)\b": "use the field's term",
    r"\bturned away\b": "rejected",
    r"\bdoubts?\b": "warning, uncertainty",
    r"\bmay as well\b": "can also",
    r"\b(wants|asks for itself|goes by|speaks of|knows when)\b": "code is not a person",
    r"\bnone of [^.]{0,60}\b(no|not|without)\b": "double negative",
    r"(?:^|[.!?] )(nor|so (?:is|are|does|do|has|have)|only (?:then|so))\b": "inversion",
    r"\bput before the doctor\b|\bas it asks\b|\bas [a-z]+ has it\b": "idiom",
    r"\b(beats?|beaten)\b": "be better than",
    r"\btuned against\b": "tuned with",
    r"\b(metre|colour|behaviour|licence|manoeuvre|neighbour|optimis|normalis|(grey|centre)\b|(label|level|model)led)": (
        "American spelling"
    ),
}
HEADING = re.compile(r"(what|how(?!-to)|why|where|when|whether|who)\b|.*[.?!:]$", re.IGNORECASE)
# Strings that are not prose: units, types, markup, patterns, formats and C.
NOT_PROSE = re.compile(
    r"^#|^m meter|^const |^\w+ \| \w+|^\w+\[[^;]*\]$|/>|</|<svg|\w=\"[\w#]|\(\?|\\[bdswp(]|[;{]\n?$|^X %|^%"
)
VOCABULARIES = ("importing/names.py", "importing/units.py", "exports/filterpy.py")  # names, not sentences
CODE = re.compile(r"`[^`]*`|--[a-z-]+|\$[^$]*\$|<[^>]*>")

Text = tuple[str, int, str]  # file, line, paragraph


def pages() -> Iterator[Path]:
    """Yield README, CONTRIBUTING and the pages of docs."""
    yield ROOT / "README.md"
    yield ROOT / "CONTRIBUTING.md"
    generated = {ROOT / "docs/_build", ROOT / "docs/reference/generated"}
    yield from (p for p in sorted((ROOT / "docs").rglob("*.md")) if not generated & set(p.parents))


def paragraphs(text: str, name: str, first: int = 1) -> Iterator[Text]:
    """Yield headings, table rows, list items and paragraphs, each on one line, without code and link targets."""
    start, lines, fenced = first, [], False
    for number, line in enumerate([*text.splitlines(), ""], first):
        fence = line.lstrip().startswith(("```", "~~~"))
        fenced ^= fence
        alone = fence or fenced or not line.strip() or line.startswith(("#", "|", "    ", "<!--", "!["))
        if lines and (alone or re.match(r"\s*([-*]|\d+\.) ", line)):
            yield name, start, " ".join(lines)
            lines = []
        if not alone:
            start = start if lines else number
            lines.append(line.strip())
        elif line.startswith(("#", "|", "![")) and not fenced:
            yield name, number, line
        # Empty lines, code and formulas only end a paragraph.


def plain(text: str) -> str:
    """Return a paragraph without code, link targets and emphasis."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return CODE.sub("X", text).replace("**", "").replace("*", "")


def faults(text: str) -> Iterator[str]:
    """Yield the faults of a paragraph."""
    words = plain(text)
    if words.startswith("#") and HEADING.match(words.lstrip("# ")):
        yield "a heading is a noun phrase, or an imperative on a how-to"
    for pattern, remedy in CONSTRUCTIONS.items():
        for match in re.finditer(pattern, words, re.IGNORECASE):
            yield f"{match.group().strip()!r}: {remedy}"
    for sentence in () if words.startswith("|") else re.split(r"(?<=[.!?:;])\s+", words):
        n = len(sentence.split())
        if n > LONGEST:
            yield f"a sentence of {n} words: {sentence[:50]}..."


def docstrings(cli: bool) -> Iterator[Text]:
    """Yield the paragraphs of docstrings (of attributes too) of the command line, or of the rest of src."""
    for path in sorted((ROOT / "src").rglob("*.py")):
        if ("cli" in path.parts) == cli:
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Expr) and isinstance(text := getattr(node.value, "value", None), str):
                    yield from paragraphs(described(text), str(path.relative_to(ROOT)), node.lineno)


def described(docstring: str) -> str:
    """Return a docstring with the descriptions of parameters as paragraphs, without their names, which are code."""
    body, *sections = re.split(r"(?m)^(\w[\w ]+\n-{3,})$", inspect.cleandoc(docstring))
    for head, section in zip(sections[::2], sections[1::2], strict=True):
        if head.startswith(("Attributes", "Parameters", "Raises", "Returns", "Warns", "Yields")):
            section = textwrap.dedent(re.sub(r"(?m)^\S.*$", "", section))
        body += f"\n\n{section}"
    return body


def messages() -> Iterator[Text]:
    """Yield the strings in src of three or more words that are not docstrings; an inserted value becomes X."""
    for path in sorted((ROOT / "src").rglob("*.py")):
        if "/".join(path.parts[-2:]) in VOCABULARIES:
            continue
        for line, text in strings(ast.parse(path.read_text())):
            if len(text.split()) > 2 and not NOT_PROSE.search(text):
                yield str(path.relative_to(ROOT)), line, text


def strings(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and text of the string literals of a syntax tree, without docstrings."""
    if isinstance(node, ast.JoinedStr):
        parts = (v.value if isinstance(v, ast.Constant) else "X" for v in node.values)
        yield node.lineno, "".join(str(part) for part in parts)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.lineno, node.value
    elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
        for child in ast.iter_child_nodes(node):
            yield from strings(child)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sample", type=int, metavar="WORDS", help="print paragraphs drawn by chance")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    changes = (ROOT / "CHANGELOG.md").read_text().split("\n## ")[1]
    readme, contributing, *docs = (
        [*paragraphs(page.read_text(), str(page.relative_to(ROOT)))] for page in pages()
    )
    parts = [
        [*readme, *contributing],
        [*chain(*docs)],
        [*docstrings(cli=True), *messages()],
        [*docstrings(cli=False)],
    ]
    if options.sample:
        for part in parts:
            part = [
                text for text in part if len(re.findall(r"[a-z]{2,}", plain(text[2]))) > 3
            ]  # omits texts that are only code
            random.Random(options.seed).shuffle(part)
            left = options.sample / len(parts)
            while left > 0 and part:
                file, line, text = part.pop()
                left -= len(text.split())
                print(f"{file}:{line}: {text}")
        return
    texts = [*paragraphs(changes, "CHANGELOG.md", 3), *chain(*parts)]
    found = [f"{file}:{line}: {fault}" for file, line, text in texts for fault in faults(text)]
    print(*found, sep="\n") if found else print("prose: no fault")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
