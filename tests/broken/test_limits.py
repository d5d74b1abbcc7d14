"""Limits that are checked before a file is read: compression, lines, cells, columns, keys, members, pipes."""

import gzip
import io
import os
import socket
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from fuzzing.check import limited
from sigmaswarm import read_drive, write_drive
from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import MAX_LINE_BYTES
from sigmaswarm.files import read_arrays
from sigmaswarm.importing.formats import open_log
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.recipe import Recipe
from support import make_drive, quickly

ROW = b"1.0,1.0,1.0,1.0\n"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_drive(make_drive(duration=20.0), tmp_path / "d")


def sparse(path: Path, size: int = 40 << 30) -> None:
    with path.open("wb") as file:
        file.truncate(size)


def zstd(content: bytes) -> bytes:
    file = io.BytesIO()
    pl.DataFrame({"a": [1]}).write_ipc(file)  # what matters are the first bytes
    return b"\x28\xb5\x2f\xfd" + content[:100]


def long_line(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"9" * (MAX_LINE_BYTES + 1) + b"," + ROW)


TABLES: dict[str, Callable[[Path], object]] = {
    "gzip": lambda path: path.write_bytes(gzip.compress(path.read_bytes())),
    "zlib": lambda path: path.write_bytes(zlib.compress(path.read_bytes())),
    "zlib, best": lambda path: path.write_bytes(zlib.compress(path.read_bytes(), 9)),
    "zstandard": lambda path: path.write_bytes(zstd(path.read_bytes())),
    "gzip bomb": lambda path: path.write_bytes(gzip.compress(b"t,ax,ay,gz\n" + ROW * 4_000_000, 1)),
    "zeros": sparse,
    "a cell of 1 MB": long_line,
    "no line ends": lambda path: path.write_bytes(path.read_bytes().replace(b"\n", b",") * 200),
    "many columns": lambda path: path.write_bytes(b"t" + b",a" * 100_000 + b"\n" + ROW),
    "pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "device": lambda path: (path.unlink(), path.symlink_to("/dev/zero")),
}


@pytest.mark.parametrize("table", quickly([("imu",), ("truth",)], lambda table: table == "truth"))
@pytest.mark.parametrize("how", TABLES)
def test_a_table_of_a_drive_is_refused_by_its_name(how: str, table: str, drive: Path):
    file = drive / f"{table}.csv"
    TABLES[how](file)
    with limited(10), pytest.raises(InputError, match=f"{table}.csv"):
        read_drive(drive)


@pytest.mark.parametrize("how", [how for how in TABLES if how != "many columns"])
@pytest.mark.parametrize(
    "form",
    quickly([("csv",), ("nmea",), ("rtklib",), ("gnss-logger",)], lambda form: form in ("csv", "rtklib")),
)
def test_a_log_is_refused_by_its_name(how: str, form: str, tmp_path: Path):
    file = tmp_path / "log.csv"
    file.write_bytes(b"t,ax,ay,gz\n" + ROW * 10_000)
    TABLES[how](file)
    with limited(10), pytest.raises(InputError, match=r"log\.csv"), open_log(file, form):
        pass


@pytest.mark.long
@pytest.mark.parametrize("rows", [50_000_000])
def test_rows_of_parquet_are_counted_before_they_are_read(rows: int, drive: Path):
    (drive / "imu.csv").unlink()
    frame = pl.select(pl.repeat(0.0, 1_000_000).alias("t"))
    pl.concat([frame.lazy()] * (rows // 1_000_000 if rows < 10**9 else 250)).select(
        pl.col("t"), *(pl.lit(0.0).alias(name) for name in ("ax", "ay", "gz"))
    ).sink_parquet(drive / "imu.parquet")
    with limited(10), pytest.raises(InputError, match=r"imu\.parquet: has"):
        read_drive(drive)


def test_texts_in_parquet_are_not_read(drive: Path):
    imu = pl.read_csv(drive / "imu.csv")
    (drive / "imu.csv").unlink()
    imu.with_columns(pl.lit("x" * 1000).alias("note")).write_parquet(drive / "imu.parquet")
    with pytest.warns(UserWarning, match="note"):
        assert len(read_drive(drive).imu) == len(imu)
    imu.with_columns(pl.lit("x").alias("ax")).write_parquet(drive / "imu.parquet")
    with pytest.raises(InputError, match="column ax: contains String"):
        read_drive(drive)


TOMLS: dict[str, bytes] = {
    "digits": b"x = " + b"9" * 5000,
    "nested": b"x = " + b"[" * 3000 + b"]" * 3000,
    "dotted": b"a" + b".a" * 200_000 + b" = 1",
    "dotted with spaces": b"a" + b" . a" * 100_000 + b" = 1",
    "dotted header": b"[a" + b".'b'" * 100_000 + b"]",
    "large": b"#" * (2 << 20),
    "no text": b"\xff\xfe\x00",
    "zeros": b"\0" * 100,
}
READERS: dict[str, Callable[[Path], object]] = {
    "drive.toml": lambda path: read_drive(path.parent),
    "recipe.toml": Recipe.load,
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("how", [*TOMLS, "sparse", "device"])
def test_toml_is_refused_by_its_name(how: str, name: str, drive: Path):
    file = drive / name
    if how == "sparse":
        sparse(file)
    elif how == "device":
        file.unlink(missing_ok=True)
        file.symlink_to("/dev/zero")
    else:
        file.write_bytes(TOMLS[how])
    with limited(10), pytest.raises(InputError, match=name):
        READERS[name](file)


@pytest.mark.parametrize(
    "text", [b"# 1.1.1.1\n[a.b]\nc = [1.0, 2.0]\n" * 3, b'd = "' + b"1.5," * 2000 + b'"']
)
def test_numbers_with_dots_are_no_long_keys(text: bytes, tmp_path: Path):
    from sigmaswarm.file_sizes import read_toml_text

    (tmp_path / "a.toml").write_bytes(text)
    assert read_toml_text(tmp_path / "a.toml").encode() == text


def test_members_of_npz_are_counted_before_they_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sigmaswarm.file_sizes.MAX_UNPACKED_BYTES", 20_000_000)

    def many(file: zipfile.ZipFile) -> None:
        for k in range(20_000):
            file.writestr(f"{k}.npy", b"")

    def large(file: zipfile.ZipFile) -> None:
        with file.open("a.npy", "w", force_zip64=True) as member:
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                header, {"descr": "<f8", "fortran_order": False, "shape": (3_000_000,)}
            )
            member.write(header.getvalue())
            for _ in range(24):
                member.write(bytes(1_000_000))

    for fill in (many, large):
        path = tmp_path / "history.npz"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            fill(file)
        with limited(10), pytest.raises(InputError, match=r"history\.npz: contains"):
            read_arrays(path)


@pytest.mark.parametrize(
    "name", [f"a{' ' * 200_000}b", "(" * 100_000, "[" * 100_000 + "]", "a_" * 99_999, " " * 10**6]
)
def test_long_names_take_no_time(name: str):
    with limited(1):
        read_name(name)


def test_a_socket_is_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)  # a socket's path is short
    with socket.socket(socket.AF_UNIX) as it:
        it.bind("log.csv")
        with pytest.raises(InputError, match=r"log\.csv: is not a regular file"), open_log(Path("log.csv")):
            pass
