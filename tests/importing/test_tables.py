"""Dialects of tables, names and units of columns, forms of positions: read correctly, or rejected in one line."""

import re
import shlex
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from importing.logs import a_drive, assert_close, imported
from sigmaswarm import simulate
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.importing.convert import import_drive
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.readers import dialect
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import TableChoice
from sigmaswarm.importing.truth import require_same_axes
from sigmaswarm.importing.units import parse_unit
from support import diagonal, quickly, several, some

DRIVE = a_drive()
IMU, GPS, TRUTH = DRIVE.imu, DRIVE.gps, DRIVE.truth
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
HEAD = ["t", *AXES]


def imu_rows(scale: dict[str, float] | None = None) -> list[list[str]]:
    scale = scale or {}
    columns = [IMU.time, *(getattr(IMU, a) * scale.get(a, 1.0) for a in AXES)]
    return [[repr(float(v)) for v in row] for row in zip(*columns, strict=True)]


def write_fixes(folder: Path, lat: Any = None, lon: Any = None, head: str = "t,lat,lon") -> None:
    lat, lon = GPS.lat if lat is None else lat, GPS.lon if lon is None else lon
    rows = [f"{t!r},{a},{b}" for t, a, b in zip(GPS.time.tolist(), lat, lon, strict=True)]
    (folder / "gps.csv").write_text("\n".join([head, *rows]))


def table(lines: Sequence[str], end: str = "\n") -> str:
    return end.join(lines) + end


def joined(rows: list[list[str]], separator: str = ",", form: str = "{}", end: str = "") -> list[str]:
    return [separator.join(form.format(c) for c in row) + end for row in rows]


ROWS = imu_rows()
COMMA = [[c.replace(".", ",") for c in row] for row in ROWS]
UNITS = ["s", "m/s^2", "m/s^2", "m/s^2", "rad/s", "rad/s", "rad/s"]
DIALECTS: dict[str, str] = {
    "header behind #": table(["#" + ",".join(HEAD), *joined(ROWS)]),
    "header behind # and a blank": table(["# made by a logger", "# " + ",".join(HEAD), *joined(ROWS)]),
    "header behind %": table(["%" + ",".join(HEAD), *joined(ROWS)]),
    "units row": table([",".join(HEAD), ",".join(UNITS), *joined(ROWS)]),
    "units row in brackets": table([";".join(HEAD), ";".join(f"[{u}]" for u in UNITS), *joined(ROWS, ";")]),
    "units row behind #": table(["#" + ",".join(HEAD), "#" + ",".join(UNITS), *joined(ROWS)]),
    "lines above": table(["Logger 2, firmware 1.3", "Serial: 12", "", ",".join(HEAD), *joined(ROWS)]),
    "lines above with commas": table(["Logger,2", "rate,100", ",".join(HEAD), *joined(ROWS)]),
    "many lines above": table([*(f"setting {k}: {k}" for k in range(40)), ",".join(HEAD), *joined(ROWS)]),
    "groups above": table([",Accelerometer,,,Gyroscope,,", "t,x,y,z,x,y,z", *joined(ROWS)]),
    "sep=;": table(["sep=;", ";".join(HEAD), *joined(ROWS, ";")]),
    "sep=,": table(["sep=,", ",".join(HEAD), *joined(ROWS)], "\r\n"),
    "decimal commas": table([";".join(HEAD), *joined(COMMA, ";")]),
    "decimal commas behind tabs": table(["\t".join(HEAD), *joined(COMMA, "\t")], "\r\n"),
    "decimal commas, padded": table(["; ".join(HEAD), *joined(COMMA, ";", "{:>28}")]),
    "decimal commas in quotes": table([",".join(HEAD), *joined(COMMA, ",", '"{}"')]),
    "pipes above commas": table(["|".join(HEAD), *joined(ROWS)]),
    "tabs above commas": table(["\t".join(HEAD), *joined(ROWS)]),
    "semicolons above tabs": table([";".join(HEAD), *joined(ROWS, "\t")]),
    "names with units between pipes": table(
        [",".join(f'"{n}"|"{u}"|-3.0|3.0|10' for n, u in zip(HEAD, UNITS, strict=True)), *joined(ROWS)]
    ),
    "padded": table([",".join(f"{n:>28}" for n in HEAD), *joined(ROWS, ",", "{:>28}")]),
    "padded behind": table([", ".join(HEAD), *joined(ROWS, ",", "{:<28}")]),
    "parted by blanks": table(["   ".join(HEAD), *joined(ROWS, "  ", "{:>28}")]),
    "trailing separators in rows": table([",".join(HEAD), *joined(ROWS, end=",")]),
    "trailing separators everywhere": table([";".join(HEAD) + ";", *joined(ROWS, ";", end=";")]),
    "trailing separator in the header": table([",".join(HEAD) + ",", *joined(ROWS)]),
    "quotes": table([",".join(f'"{n}"' for n in HEAD), *joined(ROWS, ",", '"{}"')]),
    "byte order mark before sep=": "\ufeff" + table(["sep=;", ";".join(HEAD), *joined(ROWS, ";")], "\r\n"),
    "byte order mark before #": "\ufeff" + table(["#" + ",".join(HEAD), *joined(ROWS)]),
    "byte order mark before quotes": "\ufeff" + table([",".join(f'"{n}"' for n in HEAD), *joined(ROWS)]),
    "byte order mark": "﻿" + table([",".join(HEAD), *joined(ROWS)], "\r\n"),
    "an index without a name": table(
        [",".join(["", *HEAD]), *(f"{k},{row}" for k, row in enumerate(joined(ROWS)))]
    ),
    "minus signs of typesetting": table([",".join(HEAD), *joined(ROWS)]).replace(",-", ",\u2212"),
    "a header below properties": table(
        [
            *(
                "Properties",
                "Channels\t7\t",
                "Samples" + "\t300" * 6,
                "Unit" + "\t1" * 6,
                "***End***" + "\t" * 6,
            ),
            *("\t".join(HEAD), *joined(ROWS, "\t")),
        ]
    ),
    "names of several words, parted by blanks": table(
        [
            f"{'Time':>9}" + "".join(f"{w} {i}".rjust(14) for w in ("Acc", "Gyro") for i in "XYZ"),
            *joined(ROWS, "  "),
        ]
    ),
    "axes behind the names of their vectors": table(
        [
            "seq,time,orientation,x,y,z,w,angular_velocity,x,y,z,linear_acceleration,x,y,z",
            *(f"{k},{r[0]},,0,0,0,1,,{','.join(r[4:])},,{','.join(r[1:4])}" for k, r in enumerate(ROWS)),
        ]
    ),
    "comments among the rows": table(
        [",".join(HEAD), *joined(ROWS[:50]), "# a marker, pressed", *joined(ROWS[50:])]
    ),
}


@pytest.mark.parametrize("form", some(DIALECTS))
def test_dialects(tmp_path: Path, form: str):
    (tmp_path / "imu.csv").write_text(DIALECTS[form], encoding="utf-8")
    write_fixes(tmp_path)
    got = imported(tmp_path)
    assert_close(got.drive.imu, IMU, "time ax ay az gx gy gz", 1e-12)
    assert any("decimal commas" in n for n in got.notes) == ("decimal commas" in form)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("folder", [False, True])
def test_unicode_text_of_spreadsheets(tmp_path: Path, encoding: str, *, folder: bool):
    text = "\ufeff" * (encoding != "utf-16") + table(["\t".join(HEAD), *joined(ROWS, "\t")], "\r\n")
    (tmp_path / "imu.txt").write_bytes(text.encode(encoding))
    write_fixes(tmp_path)
    got = imported(tmp_path) if folder else imported(tmp_path / "imu.txt", gps=tmp_path / "gps.csv")
    assert_close(got.drive.imu, IMU, "time ax ay az gx gy gz", 1e-12)


def test_prose_in_a_comment_is_no_header(tmp_path: Path):
    (tmp_path / "imu.txt").write_text(table(["# Created at Wed May 01 2024 here", *joined(ROWS, " ")]))
    assert dialect.dialect_of(tmp_path / "imu.txt", tmp_path / "imu.txt").names == (
        *(f"c{k}" for k in range(1, 8)),
    )
    (tmp_path / "imu.txt").write_text(table(["# A, B, C, D, E, F, G", *joined(ROWS)]))
    assert dialect.dialect_of(tmp_path / "imu.txt", tmp_path / "imu.txt").names == (*"ABCDEFG",)


def test_of_a_table_with_a_header_few_rows_are_split(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    calls: list[str] = []
    monkeypatch.setattr(dialect, "split", lambda line, by: calls.append(line) or line.split(by))
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *20 * joined(ROWS)]))
    assert dialect.dialect_of(tmp_path / "imu.csv", tmp_path / "imu.csv").names == (*HEAD,)
    assert len(calls) < 2000 < 20 * len(ROWS)


@pytest.mark.parametrize("fault", ["commas everywhere", "carriage returns"])
def test_a_text_that_is_converted_by_the_named_command(tmp_path: Path, fault: str):
    head = ",".join(HEAD)
    form = [[f"{float(c):.9f}".replace(".", ",") for c in row] for row in ROWS]
    content = table([head, *joined(form)]) if "commas" in fault else table([head, *joined(ROWS)], "\r")
    (tmp_path / "imu.csv").write_text(content, newline="")
    write_fixes(tmp_path)
    with pytest.raises(InputError, match="for example with: ") as caught:
        imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv")
    subprocess.run(str(caught.value).partition("for example with: ")[2], shell=True, check=True, cwd=tmp_path)
    got = imported(tmp_path / "new.csv", gps=tmp_path / "gps.csv")
    assert_close(got.drive.imu, IMU, "time ax ay az gx gy gz", 1e-8)


def test_separators_of_thousands_are_no_decimal_commas(tmp_path: Path):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(
        tmp_path,
        lon=[f'{v!r},"{1200 + k:,.1f}"' for k, v in enumerate(GPS.lon.tolist())],
        head="t,lat,lon,alt",
    )
    got = imported(tmp_path)
    np.testing.assert_allclose(got.drive.gps.alt, 1200 + np.arange(len(GPS)))
    assert not any("decimal commas" in note for note in got.notes)


@pytest.mark.parametrize("name", ["drive.log", "DATA.DAT", "imu.asc", "data"])
def test_a_table_of_any_name_is_recognized(tmp_path: Path, name: str):
    (tmp_path / name).write_text(DIALECTS["lines above"])
    write_fixes(tmp_path)
    got = imported(tmp_path / name, gps=tmp_path / "gps.csv")
    assert_close(got.drive.imu, IMU, "time ax ay az gx gy gz", 1e-12)


def test_a_column_of_another_encoding_in_the_header(tmp_path: Path):
    head = ",".join([*HEAD, "größe"])
    (tmp_path / "imu.csv").write_bytes(table([head, *(r + ",1" for r in joined(ROWS))]).encode("latin-1"))
    write_fixes(tmp_path)
    assert_close(imported(tmp_path).drive.imu, IMU, "time ax gz", 1e-12)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (joined(ROWS), "imu.csv: has no header; its columns are called c1 to c7"),
        ([",".join(UNITS), *joined(ROWS)], "imu.csv: has no header"),
        (["# no names", *joined(ROWS)], "imu.csv: has no header"),
        (
            [",".join(HEAD), *joined(ROWS[:60]), ",".join([*ROWS[60], "7"]), *joined(ROWS[61:])],
            "row 62: has 8 cells, but the header has 7",
        ),
        ([",".join(HEAD[:5]), *joined(ROWS)], "row 2: has 7 cells, but the header has 5"),
    ],
)
def test_the_first_fault_is_named_and_always_the_same(tmp_path: Path, lines: list[str], said: str):
    (tmp_path / "imu.csv").write_text(table(lines))
    write_fixes(tmp_path)
    messages = set()
    for _ in range(3):
        with pytest.raises(InputError, match=re.escape(said)) as caught:
            imported(tmp_path)
        messages.add(str(caught.value))
    assert len(messages) == 1


def test_of_several_columns_of_text_the_first_is_named(tmp_path: Path):
    rows = [[*row[:2], "bad", "worse", *row[4:]] for row in ROWS]
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS[:9]), *joined(rows[9:])]))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match="row 10 of the data, column ay: 'bad' is not a number"):
        imported(tmp_path)


@pytest.mark.parametrize("titled", [True, False])
def test_columns_without_a_header_can_be_mapped(tmp_path: Path, titled: bool):
    (tmp_path / "imu.csv").write_text(table(joined(ROWS)))
    write_fixes(tmp_path)
    if not titled:
        (tmp_path / "gps.csv").write_text((tmp_path / "gps.csv").read_text().partition("\n")[2])
    with pytest.raises(InputError, match=r"has no header; .* map them with --map; .*--show .*proposes"):
        imported(tmp_path)
    settings = inspect_request(Request(tmp_path)).settings
    maps = [f"{column}={text}" for column, text in settings["maps"].items()]
    drive = imported(tmp_path, choice=TableChoice(dict(settings["tables"])), maps=maps).drive
    assert_close(drive.imu, IMU, "time ax ay az gx gy gz", 1e-12)
    assert_close(drive.gps, GPS, "lat", 1e-9)


def test_a_name_of_any_length_is_read_in_a_moment(tmp_path: Path):
    name = "a" + " " * 130_000 + "[b"
    (tmp_path / "imu.csv").write_text(
        table([",".join([*HEAD, name, "(" * 9999]), *(r + ",1,1" for r in joined(ROWS))])
    )
    write_fixes(tmp_path)
    assert_close(imported(tmp_path).drive.imu, IMU, "time ax gz", 1e-12)


def test_a_name_with_backticks(tmp_path: Path):
    head = ["t", "`acc_x`", "acc`_y", "acc_z", *AXES[3:]]
    (tmp_path / "imu.csv").write_text(table([",".join(head), *joined(ROWS)]))
    write_fixes(tmp_path)
    maps = ["ax=`'acc_x'`", "ay=`acc'_y`"]
    got = imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", maps=maps)
    assert_close(got.drive.imu, IMU, "time ax ay az gz", 1e-12)


G = 9.80665
IMU_UNITS = [
    *(
        ("a", u, k)
        for u, k in [
            ("g", G),
            ("mg", G / 1e3),
            ("ug", G / 1e6),
            ("ft/s^2", 0.3048),
            ("cm/s2", 0.01),
            ("Gal", 0.01),
            ("mm/s^2", 1e-3),
            ("m s^-2", 1.0),
            ("m/s/s", 1.0),
            ("m·s⁻²", 1.0),
        ]
    ),
    *(
        ("g", u, k)
        for u, k in [
            ("deg/s", np.pi / 180),
            ("°/s", np.pi / 180),
            ("dps", np.pi / 180),
            ("mdps", np.pi / 180e3),
            ("mrad/s", 1e-3),
            ("deg/h", np.pi / 648e3),
            ("rpm", np.pi / 30),
            ("rev/s", 2 * np.pi),
            ("rad s^-1", 1.0),
            ("deg/min", np.pi / 10800),
        ]
    ),
]


@pytest.mark.parametrize(
    ("form", "letter", "unit", "factor"),
    quickly(
        [(form, *unit) for form in ("{} [{}]", "{} ({})") for unit in IMU_UNITS],
        lambda form, *unit: IMU_UNITS.index(unit) % 5 == 2 * (form == "{} [{}]"),
    ),
)
def test_units_of_the_imu(tmp_path: Path, letter: str, unit: str, factor: float, form: str):
    mine = [a for a in AXES if a[0] == letter]
    rows = imu_rows(dict.fromkeys(mine, 1 / factor))
    head = ["t", *(form.format(a, unit) if a in mine else a for a in AXES)]
    (tmp_path / "imu.csv").write_text(table([",".join(head), *joined(rows)]), encoding="utf-8")
    write_fixes(tmp_path)
    assert_close(imported(tmp_path).drive.imu, IMU, "time ax ay az gx gy gz", 1e-9)


@pytest.mark.parametrize(
    ("force", "rate"),
    diagonal(
        ["accel_g_{}", "acc_g_{}", "accelerometer_G_{}", "Accel [g] {}", "a{}_in_g"],
        ["gyro_dps_{}", "gyr_deg_s_{}", "gyroscope_deg_per_s_{}", "g{}_in_dps"],
    ),
)
def test_units_in_the_middle_of_names(tmp_path: Path, force: str, rate: str):
    names = [*(force.format(i) for i in "xyz"), *(rate.format(i) for i in "xyz")]
    rows = imu_rows(dict.fromkeys(AXES[:3], 1 / G) | dict.fromkeys(AXES[3:], 180 / np.pi))
    (tmp_path / "imu.csv").write_text(table([",".join(["t", *names]), *joined(rows)]))
    write_fixes(tmp_path)
    assert_close(imported(tmp_path).drive.imu, IMU, "time ax ay az gx gy gz", 1e-9)


@pytest.mark.parametrize(
    ("force", "rate", "factors"),
    [
        ("mps2_{}", "dps_{}", (1.0, np.pi / 180)),
        ("mg_acc_{}", "mdps_{}", (G / 1e3, np.pi / 180e3)),
        ("cm_s2_acc_{}", "rad_s_gyro_{}", (0.01, 1.0)),
        ("mg_a{}", "mradps_g{}", (G / 1e3, 1e-3)),
    ],
)
def test_units_at_the_beginning_of_names(tmp_path: Path, force: str, rate: str, factors: tuple[float, float]):
    names = [form.format(i) for form in (force, rate) for i in "xyz"]
    rows = imu_rows({a: 1 / factors[a[0] == "g"] for a in AXES})
    (tmp_path / "imu.csv").write_text(table([",".join(["t", *names]), *joined(rows)]))
    write_fixes(tmp_path)
    assert_close(imported(tmp_path).drive.imu, IMU, "time ax ay az gx gy gz", 1e-9)


@pytest.mark.parametrize("field", ["mg_{}", "mG_{}", "mag_{}"])
def test_an_established_name_goes_before_a_unit_that_may_be_of_a_magnetic_field(tmp_path: Path, field: str):
    head = [field.format(i) for i in "xyz"]
    lines = [",".join(["t", *head, *AXES]), *(f"{row[0]},-250,90,-430,{','.join(row[1:])}" for row in ROWS)]
    (tmp_path / "imu.csv").write_text(table(lines))
    write_fixes(tmp_path)
    assert_close(imported(tmp_path).drive.imu, IMU, "time ax ay az gx gy gz", 1e-12)


def test_a_magnetic_field_alone_is_no_acceleration(tmp_path: Path):
    head = ["t", *AXES[3:], "mG_x", "mG_y", "mG_z"]
    lines = [",".join(head), *(f"{row[0]},{','.join(row[4:])},200,0,-430" for row in ROWS)]
    (tmp_path / "imu.csv").write_text(table(lines))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match="no column for ax"):
        imported(tmp_path)


def test_g_in_a_name_may_mean_gravity(tmp_path: Path):
    """Values in m/s2 are refused with an option that reads them; accelerations without g have priority."""
    head = ["t", *(f"acc_g_{i}" for i in "xyz"), *AXES[3:]]
    (tmp_path / "imu.csv").write_text(table([",".join(head), *joined(ROWS)]))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match="scale is wrong") as caught:
        imported(tmp_path)
    got = imported(tmp_path, maps=re.findall(r'"(imu\.[^"]+)"', str(caught.value)))
    assert_close(got.drive.imu, IMU, "ax ay az", 1e-4)
    both = [
        ",".join([row, *cells[1:4]]) for row, cells in zip(joined(ROWS), imu_rows({"az": 2.0}), strict=True)
    ]
    (tmp_path / "imu.csv").write_text(table([",".join([*head, "acc_x", "acc_y", "acc_z"]), *both]))
    np.testing.assert_allclose(imported(tmp_path).drive.imu.az, 2 * IMU.az)


LENGTHS = [
    *(("km", 1e3), ("ft", 0.3048), ("mm", 1e-3), ("cm", 0.01)),
    *(("mi", 1609.344), ("nmi", 1852.0), ("meters", 1.0), ("in", 0.0254)),
]
SPEEDS = [
    *(("km/h", 1 / 3.6), ("knots", 1852 / 3600), ("mph", 0.44704)),
    *(("cm/s", 0.01), ("kts", 1852 / 3600), ("ft/s", 0.3048)),
]


def test_factors_of_units():
    """All units of the tests of imports, which are quick for some of them only."""
    units = [(unit, "acceleration" if letter == "a" else "rate", k) for letter, unit, k in IMU_UNITS]
    units += [(unit, "length", k) for unit, k in LENGTHS] + [(unit, "speed", k) for unit, k in SPEEDS]
    for text, dimension, factor in units:
        unit = parse_unit(text)
        assert unit is not None and unit.dimension == dimension
        assert unit.factor == pytest.approx(factor, rel=1e-12), text


@pytest.mark.parametrize(("unit", "factor"), several(LENGTHS, 3))
def test_units_of_places(tmp_path: Path, unit: str, factor: float):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, GPS.x / factor, GPS.y / factor, f"t,x [{unit}],y [{unit}]")
    assert_close(imported(tmp_path).drive.gps, GPS, "x y", 1e-6)


@pytest.mark.parametrize(("unit", "factor"), several(SPEEDS))
def test_units_of_speeds(tmp_path: Path, unit: str, factor: float):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path)
    lines = (tmp_path / "gps.csv").read_text().split("\n")
    speeds = [f"speed [{unit}]", *map(repr, (GPS.speed / factor).tolist())]
    head = [
        lines[0] + ",course",
        *(f"{line},{c!r}" for line, c in zip(lines[1:], GPS.course.tolist(), strict=True)),
    ]
    (tmp_path / "gps.csv").write_text("\n".join(f"{a},{b}" for a, b in zip(head, speeds, strict=True)))
    assert_close(imported(tmp_path).drive.gps, GPS, "speed", 1e-9)


def maps_in(message: str) -> list[str]:
    """What a message says to map."""
    return re.findall(r'"([^"=]*=[^"]*)"', message)


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (["t", "ax [parsec/s2]", *AXES[1:]], "the unit 'parsec/s2' is not known"),
        (["t", *AXES[:5], "gz [m]"], "is a unit of length, not of rate"),
        (["t", "ax", "ay", "az [foo]", *AXES[3:]], "the unit 'foo' is not known"),
        (["t [fortnights]", *AXES], "the unit 'fortnights' is not known"),
    ],
)
def test_an_unknown_unit_is_refused_and_the_remedy_helps(tmp_path: Path, head: list[str], said: str):
    (tmp_path / "imu.csv").write_text(table([",".join(head), *joined(ROWS)]))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match=re.escape(said)) as caught:
        imported(tmp_path)
    assert "imu.csv" in str(caught.value)
    got = imported(tmp_path, maps=maps_in(str(caught.value)))
    assert_close(got.drive.imu, IMU, "time ax ay az gx gy gz", 1e-9)


@pytest.mark.parametrize(
    ("letter", "per", "unit"),
    [
        ("a", 16384 / G, ""),
        ("a", 4096 / G, ""),
        ("a", 2048 / G, " [LSB]"),
        ("g", 131 * 180 / np.pi, ""),
        ("g", 131 * 180 / np.pi, " (counts)"),
    ],
)
def test_raw_counts_are_refused_and_the_remedy_helps(tmp_path: Path, letter: str, per: float, unit: str):
    mine = [a for a in AXES if a[0] == letter]
    rows = imu_rows(dict.fromkeys(mine, per))
    whole = [
        [str(round(float(c))) if h[0] == letter else c for h, c in zip(HEAD, row, strict=True)]
        for row in rows
    ]
    head = ["t", *(a + unit if a in mine else a for a in AXES)]
    (tmp_path / "imu.csv").write_text(table([",".join(head), *joined(whole)]))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match=r"contain raw counts.*16-bit sensors") as caught:
        imported(tmp_path)
    got = imported(tmp_path, maps=maps_in(str(caught.value)))
    assert_close(got.drive.imu, IMU, "time " + " ".join(mine), 1 / per)


def ddmm(value: float) -> str:
    degrees = int(abs(value))
    return f"{'-' if value < 0 else ''}{degrees * 100 + (abs(value) - degrees) * 60:.9f}"


def dms(value: float, letter: str) -> str:
    minutes = abs(value) * 60 % 60
    return f"{int(abs(value))}°{int(minutes)}'{minutes % 1 * 60:.6f}''{letter}"


PLACES: dict[str, tuple[str, Callable[[float], str], Callable[[float], str]]] = {
    "radians, named": (
        "t,lat [rad],lon [rad]",
        lambda a: repr(float(np.radians(a))),
        lambda b: repr(float(np.radians(b))),
    ),
    "radians in the name": (
        "t,lat_rad,lon_rad",
        lambda a: repr(float(np.radians(a))),
        lambda b: repr(float(np.radians(b))),
    ),
    "degrees, named": ("t,Latitude (deg),Longitude (deg)", repr, repr),
    "milliarcseconds, named": ("t,lat_mas,lon_mas", lambda a: repr(a * 3.6e6), lambda b: repr(b * 3.6e6)),
    "1e-7 degrees": ("t,lat,lon", lambda a: str(round(a * 1e7)), lambda b: str(round(b * 1e7 + 3e9 - 3e9))),
    "1e-7 degrees, named": (
        "t,lat [degE7],lon [1e-7 deg]",
        lambda a: str(round(a * 1e7)),
        lambda b: str(round(b * 1e7)),
    ),
    "semicircles of FIT": (
        "t,position_lat,position_long",
        lambda a: str(round(a * 2**31 / 180)),
        lambda b: str(round(b * 2**31 / 180)),
    ),
    "ddmm.mmmm": ("t,lat,lon", ddmm, ddmm),
    "degrees, with names of FIT": ("t,position_lat,position_long", repr, repr),
    "microdegrees in the name": ("t,lat_udeg,lon_udeg", lambda a: repr(a * 1e6), lambda b: repr(b * 1e6)),
    "ddmm.mmmm in the name": ("t,lat_ddmm,lon_dddmm", ddmm, ddmm),
    "ddmm.mmmm, named": ("t,lat [ddmm.mmmm],lon [dddmm.mmmm]", ddmm, ddmm),
    "0 to 360": ("t,lat,lon", repr, lambda b: repr(b % 360)),
    "0 to 360, named": ("t,Latitude (deg),Longitude (deg)", repr, lambda b: repr(b % 360)),
    "0 to 360 in 1e-7 degrees": (
        "t,lat,lon",
        lambda a: str(round(a * 1e7)),
        lambda b: str(round(b % 360 * 1e7)),
    ),
    "0 to 360 in radians": (
        "t,lat [rad],lon [rad]",
        lambda a: repr(float(np.radians(a))),
        lambda b: repr(float(np.radians(b % 360))),
    ),
    "hemispheres": ("t,lat,lat_dir,lon,lon_dir", lambda a: f"{abs(a)!r},N", lambda b: f"{abs(b)!r},W"),
    "hemispheres of ddmm": (
        "t,lat,N/S,lon,E/W",
        lambda a: f"{ddmm(abs(a))},N",
        lambda b: f"{ddmm(abs(b))},W",
    ),
    "small letters and signs": ("t,lat,N/S,lon,E/W", lambda a: f"{a!r},n", lambda b: f"{b!r},w"),
    "letters in columns of any name": ("t,lat,q,lon,r", lambda a: f"{a!r},N", lambda b: f"{abs(b)!r},W"),
    "letters of several spellings": (
        "t,lat,N/S,lon,E/W",
        lambda a: f"{a!r},N",
        lambda b: f"{abs(b)!r},{('W', 'w', 'West')[round(abs(b) * 1e9) % 3]}",
    ),
    "degrees, minutes, seconds and letters": (
        "t,lat,lat_dir,lon,lon_dir",
        lambda a: f"{dms(a, '')},N",
        lambda b: f"{dms(b, '')},W",
    ),
    "ddmm.mmmm with letters": ("t,lat,lon", lambda a: f"{ddmm(a)} N", lambda b: f"{ddmm(abs(b))} W"),
    "letters in the cell": ("t,lat,lon", lambda a: f"{a:.9f}N", lambda b: f"W {abs(b):.9f}"),
    "degrees, minutes, seconds": ("t,lat,lon", lambda a: dms(a, "N"), lambda b: dms(b, "W")),
    "degrees and minutes": (
        "t,lat,lon",
        lambda a: f"{int(a)} {(a - int(a)) * 60:.8f} N",
        lambda b: f"-{int(-b)}° {(-b - int(-b)) * 60:.8f}",
    ),
}


@pytest.mark.parametrize("form", some(PLACES))
def test_forms_of_places(tmp_path: Path, form: str):
    head, lat, lon = PLACES[form]
    west = (-GPS.lon - 100).tolist()
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, [lat(a) for a in GPS.lat.tolist()], [lon(b) for b in west], head)
    got = imported(tmp_path).drive.gps
    np.testing.assert_allclose(got.lat, GPS.lat, atol=1e-7)
    np.testing.assert_allclose(got.lon, west, atol=1e-7)


@pytest.mark.parametrize(
    ("sign", "flags"),
    [
        (-1, ("N", "N E S W")),
        (1, ("S SSE", "W WSW")),
        (1, ("N", "W WSW")),
        (1, ("OK S", "W")),
        (1, ("", "W")),
        (-1, ("N", "E")),
    ],
)
def test_flags_after_the_coordinates_change_no_sign(tmp_path: Path, sign: int, flags: tuple[str, str]):
    """Letters are hemispheres only if both coordinates have them, and no sign and no other text."""
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    lat, lon = (
        [
            f"{sign * a!r},{(all_of.split() or [''])[k % len(all_of.split() or [''])]}"
            for k, a in enumerate(values)
        ]
        for values, all_of in zip((GPS.lat.tolist(), GPS.lon.tolist()), flags, strict=True)
    )
    write_fixes(tmp_path, lat, lon, "t,lat,status,lon,wind")
    got = imported(tmp_path).drive.gps
    np.testing.assert_allclose([got.lat, got.lon], [sign * GPS.lat, sign * GPS.lon])


def test_letters_of_other_languages_are_refused_and_the_remedy_helps(tmp_path: Path):
    """O is west in Spanish and French, and east in German."""
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, None, [f"{ddmm(b)},O" for b in GPS.lon.tolist()], "t,lat,lon [dddmm.mmmm],lon_dir")
    with pytest.raises(InputError, match="'O' is neither east nor west; if it means west, write") as caught:
        imported(tmp_path)
    got = imported(tmp_path, maps=maps_in(str(caught.value))).drive.gps
    np.testing.assert_allclose([got.lat, got.lon], [GPS.lat, -GPS.lon], atol=1e-7)


@pytest.mark.parametrize(("unit", "factor"), [("x g", G), ("10^-3 g", G / 1e3), ("N/kg", 1.0)])
def test_the_remedy_for_an_unknown_unit_of_accelerations_is_the_one_that_gravity_shows(
    tmp_path: Path, unit: str, factor: float
):
    head = ["t", *(f"{a} [{unit}]" if a[0] == "a" else a for a in AXES)]
    rows = imu_rows(dict.fromkeys(AXES[:3], 1 / factor))
    (tmp_path / "imu.csv").write_text(table([",".join(head), *joined(rows)]))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match="is not known") as caught:
        imported(tmp_path)
    got = imported(tmp_path, maps=maps_in(str(caught.value)))
    assert_close(got.drive.imu, IMU, "time ax ay az gx gy gz", 1e-9)


@pytest.mark.parametrize("scale", [1e3, 100.0])
def test_an_altitude_in_another_unit_is_left_out_and_the_remedy_helps(tmp_path: Path, scale: float):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    lon = [f"{b!r},{(h + 400) * scale!r}" for b, h in zip(GPS.lon.tolist(), GPS.alt.tolist(), strict=True)]
    write_fixes(tmp_path, None, lon, "t,lat,lon,height")
    got = imported(tmp_path)
    (said,) = [note for note in got.notes if "is not an altitude in m" in note]
    assert got.drive.gps.alt is None
    assert said.endswith(" if it is in mm, *1e-2 if it is in cm")
    again = imported(tmp_path, maps=[maps_in(said)[0].replace("1e-3", repr(1 / scale))]).drive.gps
    np.testing.assert_allclose(again.alt, GPS.alt + 400)


@pytest.mark.parametrize("role", ["gps", "truth"])
def test_degrees_called_x_and_y_are_refused_and_the_remedy_helps(tmp_path: Path, role: str):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, GPS.lon.tolist(), GPS.lat.tolist(), "t,X,Y")
    (tmp_path / "gps.csv").rename(tmp_path / f"{role}.csv")
    if role == "truth":
        write_fixes(tmp_path)
    with pytest.raises(InputError, match=r"columns X and Y change by .* as degrees do") as caught:
        imported(tmp_path)
    maps = maps_in(str(caught.value))
    got = getattr(imported(tmp_path, maps=maps[:2]).drive, role)
    assert_close(got, imported(tmp_path, maps=maps[:2]).drive.gps, "x y", 1e-6)
    assert np.ptp(got.x) > 10
    if role == "gps":
        assert_close(imported(tmp_path, maps=maps[2:]).drive.gps, replace(GPS, x=GPS.lon, y=GPS.lat), "x y")


def test_a_truth_in_meters_that_stands_is_not_taken_for_degrees(tmp_path: Path):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path)
    time = np.arange(0.0, GPS.time[-1], 0.01)
    noise = np.random.default_rng(1).normal(0.0, 1e-4, (2, len(time)))
    x, y = np.where(time < 20, 0, time - 20) + 30 + noise[0], 20 + noise[1]
    rows = [f"{t!r},{a!r},{b!r}" for t, a, b in zip(time.tolist(), x.tolist(), y.tolist(), strict=True)]
    (tmp_path / "truth.csv").write_text("\n".join(["t,x,y", *rows]))
    np.testing.assert_allclose(np.ptp(imported(tmp_path).drive.truth.x), np.ptp(x))


@pytest.mark.parametrize(("scale", "digits"), [(2000.0, 9), (60.0, 0)])
def test_fast_and_whole_rates_are_refused_with_the_way_for_degrees(tmp_path: Path, scale: float, digits: int):
    rows = [
        [c if k < 4 else repr(round(float(c) * scale, digits)) for k, c in enumerate(row)] for row in ROWS
    ]
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(rows)]))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match=r"unknown unit \(their values reach .*deg/s: radians\(column\)"):
        imported(tmp_path)
    got = imported(tmp_path, maps=[f"{a}=radians({a})" for a in AXES[3:]]).drive.imu
    np.testing.assert_allclose(got.gz, np.radians([float(row[-1]) for row in rows]), atol=1e-9)


@pytest.mark.parametrize("scale", [1e3, 1e3 * 180 / np.pi])
def test_rates_that_no_car_has_are_no_degrees(tmp_path: Path, scale: float):
    """Rates in mrad/s or mdps without a unit were once taken as deg/s."""
    rows = imu_rows(dict.fromkeys(AXES[3:], scale))
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(rows)]))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match=r"unknown unit \(their values reach .*mrad/s: each column\*1e-3"):
        imported(tmp_path)
    got = imported(tmp_path, maps=[f"{a}={a}/{scale!r}" for a in AXES[3:]])
    assert_close(got.drive.imu, IMU, "gx gy gz", 1e-9)


@pytest.mark.parametrize("scale", [np.pi / 180, 3600.0, 1e6])
def test_places_that_may_be_two_things_are_refused_and_the_remedy_helps(tmp_path: Path, scale: float):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, (GPS.lat * scale).tolist(), (GPS.lon * scale).tolist())
    said = (
        "latitude and longitude"
        if scale < 1
        else "a latitude of about .* and a longitude of about .* are not in degrees"
    )
    with pytest.raises(InputError, match=said) as caught:
        imported(tmp_path)
    maps = [m for m in maps_in(str(caught.value)) if scale < 1 or m.endswith(("/3600", "/1e6")[scale == 1e6])]
    assert_close(imported(tmp_path, maps=maps[:2]).drive.gps, GPS, "lat lon", 1e-9)


@pytest.mark.parametrize("south", [0.0, 15.0])
def test_milliarcseconds_that_may_be_1e_7_degrees_are_told_with_the_way(tmp_path: Path, south: float):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, ((GPS.lat - south) * 3.6e6).tolist(), (GPS.lon * 3.6e6).tolist())
    maps = [m for note in imported(tmp_path).notes if "milliarcseconds" in note for m in maps_in(note)]
    got = imported(tmp_path, maps=maps).drive.gps
    np.testing.assert_allclose(got.lat, GPS.lat - south, atol=1e-9)


def test_web_mercator_is_told_with_the_way(tmp_path: Path):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    x, y = np.radians(GPS.lon), np.log(np.tan(np.pi / 4 + np.radians(GPS.lat) / 2))
    write_fixes(tmp_path, 6_378_137 * x, 6_378_137 * y, "t,x,y")
    (said,) = (note for note in imported(tmp_path).notes if "Web Mercator" in note)
    assert_close(imported(tmp_path, maps=maps_in(said)).drive.gps, GPS, "lat lon", 1e-9)
    assert said.startswith("x and y are read as m east and north; if they are Web Mercator")


@pytest.mark.parametrize(
    ("factor", "unit"), [(1.0, ""), (1.0, " [m]"), (100.0, ""), (100.0, " [cm]"), (1e3, "")]
)
def test_coordinates_from_the_center_of_the_earth(tmp_path: Path, factor: float, unit: str):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    lat, lon, e2 = np.radians(GPS.lat), np.radians(GPS.lon), 6.69437999014e-3
    n = 6_378_137 / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    places = np.column_stack(
        [n * np.cos(lat) * np.cos(lon), n * np.cos(lat) * np.sin(lon), n * (1 - e2) * np.sin(lat)]
    )
    rows = [",".join(map(repr, row)) for row in np.column_stack([GPS.time, factor * places]).tolist()]
    (tmp_path / "gps.csv").write_text(table([",".join(["t", *(f"ecef_{i}{unit}" for i in "xyz")]), *rows]))
    assert_close(imported(tmp_path).drive.gps, GPS, "lat lon", 1e-8)


@pytest.mark.parametrize(
    "cell",
    some(["0", "0.0", "-999", "1e10", "-9999.0", "", "n/a", "NaN", "---.--", "-1.#IND", "181.0", "1e38"]),
)
@pytest.mark.parametrize("count", quickly([(1,), (5,)], lambda count: count == 5))
def test_placeholders_are_no_fixes(tmp_path: Path, cell: str, count: int):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    lat = [cell] * count + list(map(repr, GPS.lat[count:].tolist()))
    lon = [cell] * count + list(map(repr, GPS.lon[count:].tolist()))
    write_fixes(tmp_path, lat, lon)
    got = imported(tmp_path)
    assert_close(got.drive.gps, GPS.select(slice(count, None)), "time lat lon", 1e-12)
    np.testing.assert_allclose(got.drive.origin[:2], (GPS.lat[count], GPS.lon[count]))
    assert any("left out" in note or "no fix" in note for note in got.notes)


@pytest.mark.parametrize("place", [(12.0, 50.0), (0.0, 0.0001), (-48.1, 11.0)])
def test_a_first_fix_far_from_the_rest_is_left_out(tmp_path: Path, place: tuple[float, float]):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, [place[0], *GPS.lat[1:].tolist()], [place[1], *GPS.lon[1:].tolist()])
    got = imported(tmp_path)
    np.testing.assert_allclose(got.drive.origin[:2], (GPS.lat[1], GPS.lon[1]))
    assert any("km from the others is left out, including the first" in note for note in got.notes)


HUGE = (
    "1e38",
    "-1e38",
    "3.4028234663852886e38",
    "9.96921e36",
    "-9223372036854775808",
    "1.7976931348623157e308",
)


@pytest.mark.parametrize("value", some(["-999", "1e10", "9999", "-32768", "nan", "3.4028235e38", *HUGE], 4))
def test_placeholders_of_the_imu_are_no_samples(tmp_path: Path, value: str):
    rows = [[*r[:3], value, *r[4:]] if k in (5, 6, 500) else r for k, r in enumerate(ROWS)]
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(rows)]))
    write_fixes(tmp_path)
    got = imported(tmp_path)
    assert len(got.drive.imu) == len(IMU) - 3 and np.abs(got.drive.imu.az).max() < 20
    assert any("3 rows are left out, since a cell is empty" in note for note in got.notes)
    assert any("is a placeholder" in note for note in got.notes) == (value != "nan")


@pytest.mark.parametrize(("column", "value"), diagonal(["alt", "speed", "std_x"], HUGE))
def test_huge_numbers_in_columns_of_the_fixes_are_placeholders(tmp_path: Path, value: str, column: str):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    speed = np.hypot(np.gradient(GPS.x, GPS.time), np.gradient(GPS.y, GPS.time))
    cells = {"alt": GPS.alt, "speed": speed, "std_x": GPS.std_x}[column].tolist()
    rows = zip(GPS.time.tolist(), GPS.lat, GPS.lon, [value, *cells[1:]], strict=True)
    (tmp_path / "gps.csv").write_text(table([f"t,lat,lon,{column}", *(",".join(map(str, r)) for r in rows)]))
    got = imported(tmp_path)
    np.testing.assert_allclose(getattr(got.drive.gps, column), cells[1:])
    assert any(f"1 value of {column} is left out" in note for note in got.notes)


@pytest.mark.parametrize(
    "names",
    [
        ("Accelerometer", "Gyroscope", "Magnetometer"),
        ("Acceleration", "AngularVelocity", "MagneticField"),
        ("acc", "gyr", "mag"),
        ("phone_accel", "phone_gyro", "orientation"),
    ],
)
@pytest.mark.parametrize("place", some(["lat,lon", "x,y"]))
def test_x_y_z_are_of_what_the_table_is_called(tmp_path: Path, names: tuple[str, str, str], place: str):
    for name, letter in zip(names, "agg", strict=True):
        columns = [IMU.time, *(getattr(IMU, f"{letter}{i}") * (9 if name == names[2] else 1) for i in "xyz")]
        rows = [",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)]
        (tmp_path / f"{name}.csv").write_text(table(["Timestamp,X,Y,Z", *rows]))
    columns = (GPS.lat, GPS.lon) if place == "lat,lon" else (GPS.x, GPS.y)
    write_fixes(tmp_path, *columns, f"t,{place}")
    (tmp_path / "gps.csv").rename(tmp_path / "position.csv")
    got = imported(tmp_path).drive
    assert_close(got.imu, IMU, "time ax ay az gx gy gz", 1e-12)
    assert_close(got.gps, GPS, place.replace(",", " "), 1e-12)


@pytest.mark.parametrize("every", [(5, 1), (1, 5), (4, 2), (1, 1)])
def test_two_rates_of_a_sensor_are_reported(tmp_path: Path, every: tuple[int, int]):
    for name, letter, step in zip(("Accelerometer", "Gyroscope"), "ag", every, strict=True):
        columns = [IMU.time, *(getattr(IMU, f"{letter}{i}") for i in "xyz")]
        rows = [",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)][::step]
        (tmp_path / f"{name}.csv").write_text(table(["time,x,y,z", *rows]))
    write_fixes(tmp_path)
    got = imported(tmp_path)
    force, rate = (100 / step for step in every)
    said = (
        f"imu: gx, gy, gz, recorded at {rate:g} Hz, are interpolated at the times of ax, ay, az, {force:g} Hz"
    )
    assert (said in got.notes) == (force != rate) == any("recorded at" in note for note in got.notes)
    np.testing.assert_allclose(got.drive.imu.time, IMU.time[:: every[0]])


@pytest.mark.parametrize("names", [("x", "y"), ("X [m]", "Y [m]"), ("east", "north")])
def test_latitude_and_longitude_go_before_x_and_y_of_a_table(tmp_path: Path, names: tuple[str, str]):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, [f"7.5,{3 * y!r},{a!r}" for a, y in zip(GPS.lat.tolist(), GPS.y.tolist(), strict=True)],
                head=",".join(["t", *names, "latitude", "longitude"]))  # fmt: skip
    got = imported(tmp_path).drive
    assert got.frame == "wgs84"
    assert_close(got.gps, GPS, "lat lon", 1e-12)


@pytest.mark.parametrize(
    ("entry", "column"), [("gps.lat=latt", "lat"), ("imu.ax=axx", "ax"), ("gps.t=T*1", "t")]
)
def test_a_mistyped_column_is_named_with_the_column_that_was_meant(tmp_path: Path, entry: str, column: str):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path)
    with pytest.raises(InputError, match=rf"which the table does not have; perhaps `{column}`") as caught:
        imported(tmp_path, maps=[entry])
    assert "no IMU samples" not in str(caught.value)


@pytest.mark.parametrize("error", [0.6, np.pi, None])
def test_a_heading_of_truth_in_no_convention_is_reported(tmp_path: Path, error: float | None):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path)
    random = np.random.default_rng(1).uniform(-3, 3, len(TRUTH.theta))
    columns = [TRUTH.time, TRUTH.x, TRUTH.y, random if error is None else TRUTH.theta + error]
    rows = [",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)]
    (tmp_path / "truth.csv").write_text(table(["t,x,y,yaw", *rows]))
    said = [
        note
        for note in imported(tmp_path).notes
        if "the heading differs from the course by a median of" in note
    ]
    assert len(said) == 1 and "check or map the column" in said[0]


TRUTHS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "degrees, named": ("yaw_deg", np.degrees),
    "degrees in brackets": ("theta [deg]", np.degrees),
    "degrees with a sign": ("yaw (°)", np.degrees),
    "degrees, not named": ("yaw", np.degrees),
    "from north, degrees": ("heading", lambda a: np.degrees(np.pi / 2 - a) % 360),
    "from north, radians": ("yaw [rad]", lambda a: (np.pi / 2 - a) % (2 * np.pi)),
    "from north, named theta": ("theta", lambda a: np.pi / 2 - a),
}


@pytest.mark.parametrize("form", some(TRUTHS))
def test_the_heading_of_truth(tmp_path: Path, form: str):
    name, make = TRUTHS[form]
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, GPS.x, GPS.y, "t,x,y")
    columns = [TRUTH.time, TRUTH.x, TRUTH.y, make(TRUTH.theta)]
    rows = [",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)]
    (tmp_path / "truth.csv").write_text(table([f"t,x,y,{name}", *rows]), encoding="utf-8")
    got = imported(tmp_path).drive.truth
    apart = np.angle(np.exp(1j * (got.theta - TRUTH.theta)))
    assert np.abs(apart).max() < 1e-6


FRAMES: dict[str, complex] = {
    "turned": np.exp(0.6j),
    "kilometers": 1e-3,
    "turned feet": np.exp(-2j) / 0.3048,
    "turned in no known unit": 1.4 * np.exp(1j),
}


@pytest.mark.parametrize(
    ("frame", "mirrored", "place"),
    quickly(
        product(FRAMES, (False, True), ("lat,lon", "x,y")),
        lambda frame, mirrored, place: mirrored == (place == "x,y") == (list(FRAMES).index(frame) % 2 == 1),
    ),
)
def test_a_truth_with_other_axes_is_refused_and_the_remedy_helps(
    tmp_path: Path, frame: str, mirrored: bool, place: str
):
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path, *((GPS.x, GPS.y, "t,x,y") if place == "x,y" else ()))
    z = FRAMES[frame] * (TRUTH.x + 1j * TRUTH.y)
    rows = [f"{t!r},{a!r},{b!r}" for t, a, b in np.column_stack([TRUTH.time, z.real, z.imag]).tolist()]
    (tmp_path / "truth.csv").write_text(table(["t,y,x" if mirrored else "t,x,y", *rows]))
    with pytest.raises(
        InputError, match="the truth's x and y, read as m east and north, do not match"
    ) as caught:
        imported(tmp_path)
    maps = re.findall(r'"(truth\.[^"]+)"', str(caught.value))
    drive = imported(tmp_path, maps=maps).drive
    moved = [np.ptp(getattr(table, name)) for name in "xy" for table in (drive.truth, TRUTH)]
    np.testing.assert_allclose(moved[::2], moved[1::2], rtol=0.03)
    length = [float(np.sum(np.hypot(np.diff(each.x), np.diff(each.y)))) for each in (drive.truth, TRUTH)]
    assert length[0] == pytest.approx(length[1], rel=0.02 if "no known" in frame else 1e-4)
    assert ("unit seems to be ft" in str(caught.value)) == ("feet" in frame)
    known = [np.interp(GPS.time, drive.truth.time, getattr(drive.truth, n)) - getattr(GPS, n) for n in "xy"]
    assert np.std(known, axis=1).max() < 1.5


@pytest.mark.parametrize("degrees", [8, 82, -98, 0.5])
def test_the_remedy_for_a_turned_truth_is_a_rotation(degrees: float):
    t, angle = np.arange(0.0, 200.0), np.exp(1j * np.radians(degrees))
    track = 10.0 * t + 300j * np.sin(0.03 * t)
    truth, gps = ({"x": z.real, "y": z.imag} for z in (track * angle, track))
    texts = {"x": "x", "y": "y"}
    if degrees == 0.5:
        assert require_same_axes({"truth": t, "gps": t}, truth, gps, texts) == ""
        return
    with pytest.raises(InputError) as caught:
        require_same_axes({"truth": t, "gps": t}, truth, gps, texts)
    (a, b), (c, d) = (map(float, re.findall(r"(-?[0-9.]+)\*", m)) for m in maps_in(str(caught.value)))
    np.testing.assert_allclose(
        [[a, b], [c, d]], [[angle.real, angle.imag], [-angle.imag, angle.real]], atol=1e-5
    )


@pytest.mark.parametrize(
    ("late", "place"),
    several([(-18.23, "lat,lon"), (4.37, "x,y"), (1714550000.25, "lat,lon"), (12345.678, "x,y")], 3),
)
def test_a_truth_with_another_clock_is_told_with_the_offset(tmp_path: Path, place: str, late: float):
    drive = simulate("urban", run=3, duration=60.0, gps="white-1m")
    columns = {n: v for n, v in vars(drive.imu).items() if v is not None}
    pl.DataFrame(columns).write_csv(tmp_path / "imu.csv")
    lat, lon, _ = enu_to_geodetic(
        np.column_stack([drive.gps.x, drive.gps.y, 0 * drive.gps.x]), (48.0, 11.0, 0.0)
    ).T
    pl.DataFrame({"time": drive.gps.time, "lat": lat, "lon": lon}).write_csv(tmp_path / "gps.csv")
    lat, lon, _ = enu_to_geodetic(
        np.column_stack([drive.truth.x, drive.truth.y, 0 * drive.truth.x]), (48.0, 11.0, 0.0)
    ).T
    truth = {"lat": lat, "lon": lon} if place == "lat,lon" else {"x": drive.truth.x, "y": drive.truth.y}
    pl.DataFrame({"time": drive.truth.time + late, **truth}).write_csv(tmp_path / "truth.csv")
    (said,) = (note for note in imported(tmp_path).notes if "--truth-offset" in note)
    offset = float(re.search(r"--truth-offset (-?[\d.]+)", said)[1])
    assert offset == pytest.approx(-late, rel=0.0, abs=0.06)
    notes = imported(tmp_path, recipe=Recipe(truth_offset_s=offset)).notes
    assert not any("--truth-offset" in note for note in notes)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (3.0, -2.0), (0.0, 40.0)])
def test_truth_in_metres_beside_fixes_in_degrees(tmp_path: Path, shift: tuple[float, float]):
    """The assumption on its origin is reported, and the origin that is named takes the offset away."""
    (tmp_path / "imu.csv").write_text(table([",".join(HEAD), *joined(ROWS)]))
    write_fixes(tmp_path)
    columns = [TRUTH.time, TRUTH.x + shift[0], TRUTH.y + shift[1], TRUTH.theta]
    rows = [",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)]
    (tmp_path / "truth.csv").write_text(table(["t,x,y,theta", *rows]))
    (said,) = [note for note in imported(tmp_path).notes if "assumed to be the first fix" in note]
    origin = tuple(map(float, re.search(r"--origin ([-\d.,]+\d)", said)[1].split(",")[:3]))
    request = Request(tmp_path)
    drive = import_drive(replace(request, recipe=replace(request.recipe, origin=origin)), "again").drive
    for name in ("x", "y"):
        known = np.interp(drive.gps.time, drive.truth.time, getattr(drive.truth, name))
        assert abs(np.mean(getattr(drive.gps, name) - known)) < 0.05


@pytest.mark.parametrize(
    "text",
    [
        "m/s^2",
        "m s^-2",
        "deg/sec",
        "Deg/Sec",
        "rad s^-1",
        "mm/s/s",
        "°/s",
        "µg",
        "KNOTS",
        "ft/s²",
        "milli-g",
        "deg/hr",
        "cmss",
    ],
)
def test_spellings_of_units(text: str):
    unit = parse_unit(text)
    assert unit is not None and unit.known


@pytest.mark.parametrize(
    "text", ["parsec", "m/foo", "rad^2", "bananas/s", "m" * 500, "V", "16 g", "250 dps", "0s", "1e999s"]
)
def test_what_is_no_unit_is_unknown(text: str):
    unit = parse_unit(text)
    assert unit is not None and not unit.known


def test_what_is_proposed_works_as_it_is(tmp_path: Path):
    head = ["t", "acc_fwd_g", "acc_left_g", "acc_up_g", "roll_rate_dps", "pitch_rate_dps", "yaw_rate_ccw_dps"]
    rows = imu_rows({a: 1 / G if a[0] == "a" else 180 / np.pi for a in AXES})
    (tmp_path / "box.csv").write_text(table([",".join(head), *joined(rows)]))
    write_fixes(tmp_path)
    words = shlex.split(inspect_request(Request(tmp_path)).proposal)
    at = words.index("--map")
    tables = dict(
        zip((w.removeprefix("--").split("-")[0] for w in words[0:at:2]), words[1:at:2], strict=True)
    )
    request = Request(tmp_path, maps=words[at + 1 :])
    got = import_drive(replace(request, choice=replace(request.choice, tables=tables)), "pasted").drive
    assert_close(got.imu, IMU, "time ax ay az gx gy gz", 1e-9)
