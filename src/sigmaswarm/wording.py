"""Parts of messages: counts, lists of names, and values from files, on one line without control characters."""

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pydantic import ValidationError

MAX_CHARACTERS = 60  # largest length of a name or a cell
MAX_NAMES = 12
TO_DO = "TO DO: "  # begins remarks that require action
REASON = ". Reason: "  # follows the remedy in these remarks


def to_do(remedy: str, why: str) -> str:
    """Return a remark. ``why`` is a sentence on the fault, perhaps one on the consequence, then evidence."""
    return f"{TO_DO}{remedy}{REASON}{why}"


def sort_remarks(remarks: Iterable[str]) -> list[str]:
    """Sort remarks so that those that require action come first."""
    return sorted(remarks, key=lambda remark: not remark.startswith(TO_DO))


def sentences(text: str) -> list[str]:
    """Split a text after each period that a capital letter follows."""
    return re.split(r"(?<=[^. ]\.) (?=[A-Z])", text)


def as_sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:].removesuffix('.')}."


def count_of(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 'es' if noun.endswith('x') else 's'}"


def describe_change(percent: float, less: str, more: str) -> str:
    """Describe a difference: "12% lower than" or "equal within 0.5% to". A positive ``percent`` gives ``less``."""
    if abs(percent) < 0.5:
        return "equal within 0.5% to"
    return f"{abs(percent):.0f}% {less if percent > 0 else more} than"


def describe_pair(value: float, other: float, unit: str) -> str:
    """Write two numbers with as many digits as they need to differ, at most 6."""
    for digits in range(3, 7):
        texts = f"{value:.{digits}g}", f"{other:.{digits}g}"
        if texts[0] != texts[1]:
            return f"{' instead of '.join(texts)} {unit}"
    return f"both {value:.3g} {unit}"


def rows_left_out(count: int, rows: str = "") -> str:
    """Return a note that rows are left out; ``rows`` describes these rows, as in " of imu.csv"."""
    return f"{count_of(count, 'row')}{rows} {'is' if count == 1 else 'are'} left out"


def escape_controls(text: str, kept: str = "\n\t") -> str:
    """Escape control characters except ``kept``, since a name may contain commands to a terminal."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in kept else ascii(c)[1:-1] for c in text)


def printable(text: object, most: int = MAX_CHARACTERS) -> str:
    """Format a name or a cell for a message, with escaped control characters and at most ``most`` characters."""
    whole = str(text)
    return escape_controls(whole[:most], kept="") + ("..." if len(whole) > most else "")


def quoted(text: object) -> str:
    whole = str(text)
    return repr(whole[:MAX_CHARACTERS]) + ("..." if len(whole) > MAX_CHARACTERS else "")


def printable_value(value: object) -> str:
    """Format a value from a file for a message. Python does not convert integers of more than 4300 digits to text."""
    try:
        return printable(repr(value))
    except (ValueError, RecursionError):
        return "an unreadable value"


class Mistake(NamedTuple):
    """The first error that pydantic found, for a message.

    ``key`` is empty for an error of the whole record, and ``value`` is empty for a table. ``kind`` is pydantic's error
    type.
    """

    key: str
    value: str
    kind: str
    message: str


def first_mistake(error: "ValidationError") -> Mistake:
    first = error.errors(include_url=False)[0]
    message = " ".join(first["msg"].removeprefix("Value error, ").split()).replace("Input should", "should")
    value = "" if isinstance(first["input"], dict) else printable_value(first["input"])
    return Mistake(printable(".".join(map(str, first["loc"]))), value, first["type"], printable(message, 600))


def list_names(names: Iterable[object], mark: str = "") -> str:
    """Format the first names of a list, each in quotation marks ``mark``, and the number of the other names."""
    shown = [f"{mark}{printable(name)}{mark}" for name in names]
    others = f" and {len(shown) - MAX_NAMES} more" if len(shown) > MAX_NAMES else ""
    return ", ".join(shown[:MAX_NAMES]) + others
