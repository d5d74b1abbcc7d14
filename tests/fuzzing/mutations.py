"""Damage of sound files: bytes, cells, columns and lines, with checksums, chunks and zip files adjusted."""

import gzip
import io
import re
import sqlite3
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any

from hypothesis import strategies as st

Draw = Callable[[st.SearchStrategy[Any]], Any]
LARGEST = 8 << 20
"""Bytes of a broken file at most, and of what a fault is made in."""

WORDS = (
    *(
        b"nan",
        b"-inf",
        b"1e308",
        b"-1e308",
        b"1e400",
        b"0",
        b"-1",
        b"1e9",
        b"1e18",
        b"-0.0",
        b"1_000",
        b"0x10",
    ),
    *(
        b"9223372036854775807",
        b"18446744073709551615",
        b"9" * 30,
        b"1700000000000000000",
        b"91",
        b"181",
        b"360",
    ),
    *(
        b"",
        b" ",
        b"null",
        b"true",
        b"abc",
        b'"',
        b'""',
        b"'",
        b",",
        b";",
        b"\t",
        b"\n",
        b"\r\n",
        b"\r",
        b"\0",
    ),
    *(
        b"\xff\xfe",
        b"\xe9",
        b"#",
        b"%",
        b"[",
        b"{",
        b"=",
        b"1,5",
        b"2023-11-14T22:13:20Z",
        b"\x1b[31m",
        b"[/x]",
    ),
    *(b"1e16", b"-1e77", b"1e155", b"1e200", b"9" * (1 << 20) + b"9"),
    *(b"24:00:00", b"99/99/9999", b"0000/00/00", b"$GNGGA,", b"../../x", b"t", b"ax", b"lat", b"t "),
)
NUMBERS = (0, 1, 127, 255, 32767, 65535, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1, 10**18)
FLOATS = (float("nan"), float("inf"), 1e308, -1e308, -1.0, 1e-320)
TOML = ("nan", "inf", "1e999", "-1", "[]", "{}", "''", '"a/b"', "true", "[1,2,3]", "9" * 5000, "[" * 3000)
TOML += ("1e16", "-1e308", "{a={a={a=1}}}", "1979-05-27", "[[1.0],[1.0]]", '"\\u0000]]>*/"')
KEYS = ("a" + ".a" * 5000, "[a" + ".b" * 5000 + "]", "[[origin]]", "time_origin_s", "scenario", "repaired")
ODD_SQL = (None, "abc", b"\0\1", "", -1, 2**63 - 1, 1e308, 0)


def _span(draw: Draw, data: bytes, most: int = 1000) -> tuple[int, int]:
    begin = draw(st.integers(0, len(data)))
    return begin, begin + draw(st.sampled_from([n for n in (1, 2, 4, 8, 16, 100, 1000) if n <= most]))


def cut(draw: Draw, data: bytes) -> bytes:
    return data[: draw(st.one_of(st.integers(0, len(data)), st.integers(0, 64)))]


def flip(draw: Draw, data: bytes) -> bytes:
    broken = bytearray(data)
    for at in draw(st.lists(st.integers(0, max(len(data) - 1, 0)), min_size=1, max_size=8)):
        if data:
            broken[at] ^= 1 << draw(st.integers(0, 7))
    return bytes(broken)


def overwrite(draw: Draw, data: bytes) -> bytes:
    begin, end = _span(draw, data)
    return data[:begin] + draw(st.sampled_from([b"\0", b"\xff", b"A"])) * (end - begin) + data[end:]


def number(draw: Draw, data: bytes) -> bytes:
    """Put a number at the ends of a range somewhere."""
    if draw(st.booleans()):
        new = struct.pack("<d", draw(st.sampled_from(FLOATS)))
    else:
        size = draw(st.sampled_from([1, 2, 4, 8]))
        new = (draw(st.sampled_from(NUMBERS)) % 256**size).to_bytes(size, "little")
    begin = draw(st.integers(0, len(data)))
    return data[:begin] + new + data[begin + len(new) :]


def delete(draw: Draw, data: bytes) -> bytes:
    begin, end = _span(draw, data)
    return data[:begin] + data[end:]


def repeat(draw: Draw, data: bytes) -> bytes:
    begin, end = _span(draw, data)
    return data[:end] + data[begin:end] * draw(st.sampled_from([1, 2, 50])) + data[end:]


def insert(draw: Draw, data: bytes) -> bytes:
    at, word = draw(st.integers(0, len(data))), draw(st.sampled_from(WORDS))
    times = draw(st.sampled_from([1, 1, 1, 10, 1000]))
    return data[:at] + word * min(times, LARGEST // max(len(word), 1)) + data[at:]


BYTES = (cut, flip, overwrite, number, delete, repeat, insert)


def _separator(lines: list[bytes]) -> bytes:
    head = b"\n".join(lines[:3])
    return max((b",", b" ", b"\t", b";"), key=head.count)


def cells(draw: Draw, data: bytes) -> bytes:
    lines = data.split(b"\n")
    separator = _separator(lines)
    for i in draw(st.lists(st.integers(0, len(lines) - 1), min_size=1, max_size=5)):
        row = lines[i].split(separator)
        row[draw(st.integers(0, len(row) - 1))] = draw(st.sampled_from(WORDS))
        lines[i] = separator.join(row)
    return b"\n".join(lines)


def column(draw: Draw, data: bytes) -> bytes:
    """Set, double, drop or scale a column."""
    lines = data.split(b"\n")
    separator = _separator(lines)
    at = draw(st.integers(0, lines[0].count(separator)))
    what, word = (
        draw(st.sampled_from(["set", "double", "drop", "scale", "rename"])),
        draw(st.sampled_from(WORDS))[: LARGEST // len(lines)],
    )
    factor = draw(st.sampled_from([1e-300, 1e-9, 1e-3, -1.0, 1e3, 1e6, 1e9, 1e18, 1e300]))
    broken: list[bytes] = []
    for i, line in enumerate(lines):
        row = line.split(separator)
        if at < len(row):
            if (what == "set" and i) or (what == "rename" and not i):
                row[at] = word
            elif what == "double":
                row.insert(at, row[at])
            elif what == "drop":
                del row[at]
            elif what == "scale" and re.fullmatch(rb"-?[\d.]+(e-?\d+)?", row[at]) and row[at].count(b".") < 2:
                row[at] = repr(float(row[at]) * factor).encode()
        broken.append(separator.join(row))
    return b"\n".join(broken)


def lines(draw: Draw, data: bytes) -> bytes:
    """Reverse, repeat, delete or exchange lines."""
    rows = data.split(b"\n")
    i, j = (draw(st.integers(0, len(rows) - 1)) for _ in range(2))
    what = draw(st.sampled_from(["reverse", "repeat", "delete", "exchange", "head", "behead"]))
    if what == "reverse":
        rows[1:] = rows[:0:-1]
    elif what == "repeat":
        rows[i:i] = [rows[i]] * draw(st.sampled_from([1, 2, 1000]))
    elif what == "delete":
        del rows[i : i + draw(st.sampled_from([1, 10, 1000]))]
    elif what == "exchange":
        rows[i], rows[j] = rows[j], rows[i]
    else:
        rows = rows[:1] if what == "head" else rows[1:]
    return b"\n".join(rows)


def encoding(draw: Draw, data: bytes) -> bytes:
    text = data.decode("utf-8", "replace")
    return draw(
        st.sampled_from(
            [
                text.encode("utf-16"),
                b"\xef\xbb\xbf" + data,
                ("é" + text).encode("latin-1", "replace"),
                text.replace("\n", "\r\n").encode(),
                text.replace("\n", "\r").encode(),
                text.replace(",", ";").encode(),
                text.replace(".", ",").encode(),
                text.replace(",", ',"').encode(),
                b"\0" * 10 + data,
                b"",
            ]
        )
    )


TEXT = (cells, cells, column, lines, encoding, cut, flip, insert, delete, repeat)


@cache
def bombs() -> tuple[bytes, bytes]:
    """64 MB of zeros as gzip and as zlib."""
    zeros = b"0" * (64 << 20)
    return gzip.compress(zeros, 1), zlib.compress(zeros, 1)


def packed(draw: Draw, data: bytes) -> bytes:
    """Compress a file under its old name, or make it a bomb."""
    whole = gzip.compress(data, 1)
    return draw(st.sampled_from([whole, zlib.compress(data, 1), whole + bombs()[0], bombs()[1]]))


def crossed(draw: Draw, data: bytes, other: bytes) -> bytes:
    """Put the end of another file, or all of it, in the place of this one's."""
    begin, end = draw(st.integers(0, len(data))), draw(st.integers(0, len(other)))
    return draw(st.sampled_from([other, data[:begin] + other[end:], data[:begin] + other]))


def sql(draw: Draw, data: bytes) -> bytes:
    """Put a value of any type into a cell of an SQLite file: columns take all."""
    with tempfile.NamedTemporaryFile(suffix=".db3") as file:
        file.write(data)
        file.flush()
        base = sqlite3.connect(file.name)
        try:
            tables = [row[0] for row in base.execute("select name from sqlite_master where type = 'table'")]
            table = draw(st.sampled_from(sorted(tables)))
            columns = [row[1] for row in base.execute(f"pragma table_info({table})")]
            column = draw(st.sampled_from(columns))
            rows = [row[0] for row in base.execute(f"select rowid from {table}")]
            if rows:
                value, row = draw(st.sampled_from(ODD_SQL)), draw(st.sampled_from(rows))
                with suppress(sqlite3.IntegrityError):  # a primary key takes integers alone
                    base.execute(f"update or ignore {table} set {column} = ? where rowid = ?", (value, row))
                base.commit()
        finally:
            base.close()
        file.seek(0)
        return file.read()


def ulog_record(draw: Draw, data: bytes) -> bytes:
    """Change one record of a ULog; its length is right again."""
    records, at = [], 16
    while at + 3 <= len(data):
        size = struct.unpack_from("<H", data, at)[0]
        records.append((data[at + 2 : at + 3], data[at + 3 : at + 3 + size]))
        at += 3 + size
    if not records:
        return data
    k = draw(st.integers(0, len(records) - 1))
    kind, content = records[k]
    kind = draw(st.sampled_from([kind, kind, b"?", b"B", b"F", b"A", b"D", b"Q"]))
    records[k] = kind, broken_bytes(draw, content)[:60_000]
    return data[:16] + b"".join(struct.pack("<H", len(c)) + t + c for t, c in records)


def toml(draw: Draw, data: bytes) -> bytes:
    keys = ("name", "frame", "origin", "gps_lever_arm_m", "gps_std_m", "accel_noise_density", "other")
    key = draw(st.sampled_from(keys))
    kept = [line for line in data.decode().splitlines() if not line.startswith(key)]
    if draw(st.sampled_from([False, False, True])):
        key = draw(st.sampled_from(KEYS))
        if key.startswith("["):
            return "\n".join([*kept, key]).encode()
    return "\n".join([*kept, f"{key} = {draw(st.sampled_from(TOML))}"]).encode()


def ubx_checked(data: bytes) -> bytes:
    """Messages with their checksums made right again."""
    fixed, at = bytearray(data), -1
    while (at := fixed.find(b"\xb5\x62", at + 1)) >= 0 and at + 8 <= len(fixed):
        end = at + 6 + struct.unpack_from("<H", fixed, at + 4)[0]
        if end + 2 <= len(fixed):
            a = b = 0
            for byte in fixed[at + 2 : end]:
                a = (a + byte) & 255
                b = (b + a) & 255
            fixed[end : end + 2] = bytes((a, b))
    return bytes(fixed)


def nmea_checked(data: bytes) -> bytes:
    """Sentences with their checksums made right again."""

    def checked(line: bytes) -> bytes:
        if line[:1] != b"$" or b"*" not in line:
            return line
        body, check = line[1 : line.rindex(b"*")], 0
        for byte in body:
            check ^= byte
        return b"$" + body + b"*%02X" % check

    return b"\r\n".join(checked(line) for line in data.split(b"\r\n"))


def repacked_mcap(draw: Draw, data: bytes) -> bytes:
    """Some messages or definitions broken, in chunks that are sound."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    summary = make_reader(io.BytesIO(data)).get_summary()
    found = list(make_reader(io.BytesIO(data)).iter_messages(log_time_order=False))
    wrong = set(draw(st.lists(st.integers(0, len(found) - 1), max_size=4)))
    schema_wrong = draw(st.sampled_from([None, None, *summary.schemas]))
    out = io.BytesIO()
    writer = Writer(out, chunk_size=4096)
    writer.start()
    channels: dict[int, int] = {}
    for i, (schema, channel, message) in enumerate(found):
        if channel.id not in channels:
            text = broken_bytes(draw, schema.data) if schema.id == schema_wrong else schema.data
            new = writer.register_schema(schema.name, schema.encoding, text)
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, new)
        content = message.data
        if i in wrong:
            content = broken_bytes(draw, content) if draw(st.booleans()) else broken_json(draw, content)
        writer.add_message(channels[channel.id], message.log_time, content, message.publish_time)
    writer.finish()
    return out.getvalue()


def broken_json(draw: Draw, data: bytes) -> bytes:
    """One value of a message in JSON in the place of another."""
    values = [b"null", b'"a"', b"[]", b"[[1]]", b"{}", b"1e999", b"9" * 400, b"true", b"NaN", b"-0.0"]
    places = [m.span() for m in re.finditer(rb"-?[\d.]+(?:e-?\d+)?", data)]
    begin, end = draw(st.sampled_from(places or [(0, 0)]))
    return data[:begin] + draw(st.sampled_from(values)) + data[end:]


def repacked_zip(draw: Draw, data: bytes) -> bytes:
    """A table in the zip broken; the zip is sound."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    name = draw(st.sampled_from(sorted(members)))
    members[name] = draw(st.sampled_from(TEXT))(draw, members[name])
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def broken_bytes(draw: Draw, data: bytes) -> bytes:
    """One or two faults."""
    for _ in range(draw(st.sampled_from([1, 1, 2]))):
        data = draw(st.sampled_from(BYTES))(draw, data)[:LARGEST]
    return data


def broken(draw: Draw, name: str, kind: str, data: bytes) -> bytes:
    """A file with some faults, after its kind."""
    if name.endswith(".toml"):
        return toml(draw, data) if draw(st.booleans()) else broken_bytes(draw, data)
    if name.endswith(".db3") and draw(st.booleans()):
        return sql(draw, data)
    if kind == "ulog" and draw(st.booleans()):
        return ulog_record(draw, data)
    if kind == "text" and draw(st.integers(0, 29)) == 0:
        return packed(draw, data)
    if kind in ("mcap", "zip") and draw(st.booleans()):
        return (repacked_mcap if kind == "mcap" else repacked_zip)(draw, data)
    if kind not in ("text", "nmea"):
        data = broken_bytes(draw, data)
        return ubx_checked(data) if kind == "ubx" and draw(st.booleans()) else data
    for _ in range(draw(st.sampled_from([1, 1, 1, 2]))):
        data = draw(st.sampled_from(TEXT))(draw, data)[:LARGEST]
    return nmea_checked(data) if kind == "nmea" and draw(st.booleans()) else data
