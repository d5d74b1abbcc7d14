"""Templates of exported files: whole files with places to fill in and parts that only some filters need.

``@NAME@`` is replaced by a value. Between a line ``#if FEATURE`` and its ``#else`` or ``#endif``, lines stay only if
the feature is used. Other ``#if`` lines are the C preprocessor's and stay.
"""

import re
from collections.abc import Mapping
from importlib.resources import files

_DIRECTIVE = re.compile(r"#\s*(if\w*|else|endif)\b\s*(.*)")


def fill(name: str, features: Mapping[str, bool], values: Mapping[str, str]) -> str:
    """The template ``name``, with the parts for ``features`` and with ``values`` filled in.

    Raises
    ------
    KeyError
        If the template has a place that ``values`` does not fill.
    """
    text = files("sigmaswarm.exports").joinpath("templates", name).read_text(encoding="utf-8")
    return re.sub(r"@([A-Z][A-Z_0-9]*)@", lambda place: values[place[1]], _chosen(text, features))


def _chosen(text: str, features: Mapping[str, bool]) -> str:
    """The lines whose features are used."""
    lines: list[str] = []
    open_parts: list[bool | None] = []  # whether a part is in; None: the C preprocessor's own
    for line in text.splitlines():
        directive = _DIRECTIVE.match(line)
        ours = True
        if directive is None:
            ours = False
        elif directive[1] == "else":
            part = open_parts[-1]
            ours = part is not None
            open_parts[-1] = None if part is None else not part
        elif directive[1] == "endif":
            ours = open_parts.pop() is not None
        else:
            open_parts.append(features.get(directive[2]))
            ours = open_parts[-1] is not None
        if not ours and False not in open_parts:
            lines.append(line)
    return "\n".join(lines) + "\n"
