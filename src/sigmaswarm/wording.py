"""How messages show what comes from files: on one line, without what steers a terminal, and not at any length."""

from collections.abc import Iterable

MOST_CHARACTERS = 60
"""Of a name or a cell in a message."""
MOST_NAMES = 12
"""Of a list in a message."""


TO_DO = "TO DO: "
"""Begins what asks for action, so that it is told from what is good to know; such sentences are told first."""


def to_do(remedy: str, why: str) -> str:
    """What to do, and why, for people."""
    return f"{TO_DO}{remedy}: {why}"


def in_order(remarks: Iterable[str]) -> list[str]:
    """First what asks for action."""
    return sorted(remarks, key=lambda remark: not remark.startswith(TO_DO))


def counted(n: int, noun: str) -> str:
    """``1 drive``, ``2 drives``."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def visible(text: str, kept: str = "\n\t") -> str:
    """The text with control characters but ``kept`` as escapes: a name may hold what moves a terminal's cursor."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in kept else ascii(c)[1:-1] for c in text)


def shown(text: object, most: int = MOST_CHARACTERS) -> str:
    """A name or a cell as a message shows it: control characters escaped, as repr does, and cut."""
    whole = str(text)
    return visible(whole[:most], kept="") + ("..." if len(whole) > most else "")


def quoted(text: object, most: int = MOST_CHARACTERS) -> str:
    """The same between quotes."""
    whole = str(text)
    return repr(whole[:most]) + ("..." if len(whole) > most else "")


def names_shown(names: Iterable[object], mark: str = "") -> str:
    """The first names of a list, each shown between ``mark``, and how many more there are."""
    every = [f"{mark}{shown(name)}{mark}" for name in names]
    more = f" and {len(every) - MOST_NAMES} more" if len(every) > MOST_NAMES else ""
    return ", ".join(every[:MOST_NAMES]) + more
