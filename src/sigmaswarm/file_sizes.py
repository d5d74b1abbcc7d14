"""Check the sizes of files before they are read, since a small or damaged file can claim any size.

With these limits, sigmaswarm rejects a bad file within 10 s and with at most 1.5 GB of memory.
"""

import re
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from sigmaswarm.errors import InputError

if TYPE_CHECKING:
    import zipfile

MAX_LINE_BYTES = 1 << 20  # bytes of a line of text
MAX_CELLS = 120_000_000  # cells of a Parquet table, 1 GB: a week of an IMU at 50 Hz, with 4 columns
MAX_COLUMNS = 1000
MAX_TOML_BYTES = 1 << 20  # bytes; parsing takes 3 s
MAX_JSON_BYTES = 1 << 26  # bytes; parsing needs 0.6 GB
MAX_MEMBERS = 10_000  # arrays of an npz file
MAX_UNPACKED_BYTES = 1_000_000_000  # bytes of all arrays of an npz file

_PACKED = {
    b"\x1f\x8b": "gzip",
    b"\x28\xb5\x2f\xfd": "Zstandard",
    b"\x78\x01": "zlib",
    b"\x78\x9c": "zlib",
    b"\x78\xda": "zlib",
}
"""First bytes of compressed files. polars unpacks such files to any size, regardless of their names."""
# A dotted key of TOML with more than 64 parts; the time of tomllib grows with the square of the number of parts.
_LONG_KEY = re.compile(rb"""(?<![\w"'.-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){64}""")


def require_regular(path: Path) -> None:
    """Reject pipes, sockets and devices, since reading them may never end."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return  # reading the file raises an error with the reason
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise InputError(
            f"{path}: is not a regular file; copy its content into a regular file, and specify that file"
        )


def require_text(path: Path, shown_as: Path | None = None) -> tuple[bytes, int]:
    """Refuse compressed text and lines over `MAX_LINE_BYTES` bytes. Return the first line and the number of lines.

    ``shown_as`` is the name of the file in messages, if the file was unpacked to another place. The number of lines
    includes empty lines, since polars reads empty lines as rows.
    """
    require_regular(path)
    shown = shown_as or path
    with path.open("rb") as file:
        head = file.read(8)
        if packed := next((kind for first, kind in _PACKED.items() if head.startswith(first)), None):
            raise InputError(f"{shown}: is compressed ({packed}); unpack it, and specify the unpacked file")
        file.seek(0)
        begun, lines = 0, 0  # number of bytes since the end of the last line, number of lines
        while block := file.read(MAX_LINE_BYTES):
            first, last = block.find(b"\n"), block.rfind(b"\n")
            if begun + (len(block) if first < 0 else first) > MAX_LINE_BYTES:
                what = f"is longer than {MAX_LINE_BYTES} bytes"
                why = "so the file is probably damaged or not a table; copy it again"
                raise InputError(f"{shown}, row {lines + 1}: {what}, {why}")
            begun = begun + len(block) if last < 0 else len(block) - last - 1
            lines += block.count(b"\n")
        file.seek(0)
        return file.readline(), lines


def read_bounded(path: Path, most: int) -> bytes:
    require_regular(path)
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise InputError(
            f"{path}: is larger than {most / 1e6:.0f} MB; sigmaswarm did not write this file, or it is damaged"
        )
    return content


def read_toml_text(path: Path) -> str:
    """Return the text of a TOML file without the byte-order mark. Refuse a file that would take long to parse."""
    content = read_bounded(path, MAX_TOML_BYTES)
    if match := _LONG_KEY.search(content):
        row = content.count(b"\n", 0, match.start()) + 1
        raise InputError(f"{path}, row {row}: a key has more than 64 parts; correct or delete the line")
    return content.decode("utf-8-sig")


def require_members(path: Path, members: "list[zipfile.ZipInfo]") -> None:
    unpacked = sum(member.file_size for member in members)
    if len(members) > MAX_MEMBERS or unpacked > MAX_UNPACKED_BYTES:
        raise InputError(
            f"{path}: contains {len(members)} arrays with {unpacked / 1e6:.0f} MB in total; the limits are "
            f"{MAX_MEMBERS} arrays and {MAX_UNPACKED_BYTES / 1e6:.0f} MB; sigmaswarm did not write this file, or it is "
            "damaged"
        )
