"""Propose the command that imports a log of another format, for errors of commands that need a drive."""

import re
from pathlib import Path
from shlex import quote

TEXTS = (".csv", ".tsv", ".txt")
# Words that show the content of a table, in its name or first line
_AXES = re.compile(r"(?<![a-z])[ag]_?[xyz](?![a-z])", re.IGNORECASE)
_MOTION = re.compile(r"acc(?!urac)|gyro|angular|imu", re.IGNORECASE)
_PLACE = re.compile(r"lat|lon|gps|gnss|east|north|utm|posi", re.IGNORECASE)
_XY = re.compile(r"(?<![a-z])[xy](?![a-z])", re.IGNORECASE)


def import_remedy(log: Path) -> str:
    """Return the command that imports a log of another format, or the folder of the log, as the remedy of an error."""
    log = _whole_log(log)
    out = Path("drives") / log.resolve().name.removesuffix(log.suffix)
    return f"to make a drive from a log: sigmaswarm import {quote(str(log))} --out {quote(str(out))}"


def _whole_log(file: Path) -> Path:
    """Return the file; return its folder if the file has only IMU samples or only fixes, but the folder has both."""
    if file.suffix.lower() not in TEXTS or not file.is_file():
        return file
    tables = [table for table in sorted(file.parent.iterdir()) if table.suffix.lower() in TEXTS]
    content = {table: _content(table) for table in tables[:100]}
    together = {kind for names in content.values() for kind in names}
    return file.parent if len(content.get(file, ())) == 1 and len(together) == 2 else file


def _content(table: Path) -> set[str]:
    """Return the sensors, "imu" and "gps", that the name and the first line of a table show."""
    with table.open(encoding="utf-8", errors="replace") as lines:
        title = lines.readline(4096)
    text = f"{table.stem},{title}"
    axes = _AXES.search(title) is not None
    imu = axes or _MOTION.search(text) is not None
    # x and y are the axes of the IMU, unless the table has other columns for these
    place = _PLACE.search(text) is not None or (_XY.search(title) is not None and (axes or not imu))
    return {kind for kind, present in (("imu", imu), ("gps", place)) if present}
