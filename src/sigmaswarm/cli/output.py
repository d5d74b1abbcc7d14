"""Print the output of a command: result, problems, details (only with ``--verbose``), next commands."""

from collections import Counter
from io import StringIO
from textwrap import wrap
from typing import NamedTuple

from sigmaswarm.cli.terminal import MIN_COLUMNS, console, print_lines
from sigmaswarm.wording import REASON, TO_DO, as_sentence, count_of, sentences

INDENT = 11  # columns before the text of a remark with a label
_STYLES = {"serious": "bold red", "to do": "bold red", "warning": "yellow", "note": "dim"}


class Remark(NamedTuple):
    """A fact, its consequence, the remedy, and the evidence, which is printed only with ``--verbose``.

    ``label`` is a key of `_STYLES`, or "" for a result.
    """

    label: str
    what: str
    consequence: str = ""
    remedy: str = ""
    evidence: str = ""

    @classmethod
    def of(cls, text: str, label: str = "") -> "Remark":
        """Split a text into the fact, its consequence and the evidence.

        A text that `to_do` made begins with the remedy.
        """
        remedy, _, why = text.partition(REASON) if text.startswith(TO_DO) else ("", "", text)
        label = "to do" if remedy else label
        # without a label the text is whole sentences, which may begin with the name of a drive
        what, *more = map(as_sentence, sentences(why)) if label else sentences(why)
        return cls(label, what, " ".join(more[:1]), remedy.removeprefix(TO_DO), " ".join(more[1:]))


class Output:
    """Print the output of a command; only this class decides what is printed without ``--verbose``.

    If ``silent`` is True, nothing is printed; this is for the option ``--json``.
    """

    def __init__(self, *, verbose: bool, silent: bool = False) -> None:
        self._verbose, self._silent = verbose, silent
        self._all: list[object] = []
        self._hidden: Counter[str] = Counter()

    def show(self, *lines: object) -> None:
        """Print lines, tables and remarks; evidence is printed only with ``--verbose``."""
        self._all += lines
        for line in () if self._silent else lines:
            if isinstance(line, Remark) and line.evidence and not self._verbose:
                self._hidden["the evidence"] += 1
            print_lines(_drawn(line, self._verbose))

    def details(self, name: str, *lines: object) -> None:
        """Print lines only with ``--verbose``.

        ``name`` describes the lines in the list of hidden details: a singular noun, printed with the number of lines
        ("3 notes"), or "the" and a noun, printed as it is ("the recipe").
        """
        if self._verbose:
            self.show(*lines)
        else:
            self._all += lines
            self._hidden[name] += len(lines)

    @property
    def text(self) -> str:
        """The output with all details."""
        text = StringIO()
        print_lines(*(_drawn(line, verbose=True) for line in self._all), file=text)
        return text.getvalue()

    def next(self, *lines: object, place: object = "") -> None:
        """Name the hidden details, and print the next commands.

        ``place`` is the file or the command that shows the details. The default is the same command with ``--verbose``.
        """
        hidden = [
            name if name.startswith("the ") else count_of(n, name) for name, n in self._hidden.items() if n
        ]
        *others, last = hidden or [""]
        if names := " and ".join(filter(None, [", ".join(others), last])):
            self.show(f"details: {place}    ({names})" if place else f"--verbose adds {names}")
        self.show(*lines)


def _drawn(line: object, verbose: bool) -> object:
    """Format a remark. The remedy is one line, so that a command in it can be copied."""
    from rich.text import Text

    if not isinstance(line, Remark):
        return line
    texts = [*filter(None, (line.what, line.consequence, line.evidence * verbose))]
    if not line.label:
        return " ".join(texts)
    width = max(console().width - INDENT, MIN_COLUMNS)
    lines = [
        part for text in texts for part in wrap(text, width, break_long_words=False, break_on_hyphens=False)
    ]
    lines += [f"-> {line.remedy}"] if line.remedy else []
    label = f"  {line.label.upper() if line.label == 'serious' else line.label}"
    return Text.assemble((f"{label:{INDENT}}", _STYLES[line.label]), f"\n{'':{INDENT}}".join(lines))
