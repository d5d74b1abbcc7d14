"""Convert columns of positions to a drive's units, by the unit in the name or by the magnitude of the values."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import polars as pl

from sigmaswarm.importing.names import read_names, split_words
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.table_columns import (
    MAX_DAMAGED_SHARE,
    NO_VALUE,
    Columns,
    Conversion,
    column_numbers,
    is_placeholder,
    median_of,
    quoted_column,
    refused,
    unknown_unit,
)
from sigmaswarm.importing.units import in_si, other_units, possible_units
from sigmaswarm.wording import quoted

# Units of time in the names of latitude and longitude (min, s) mean arcminutes and arcseconds: number of these units
# per degree, by the factor of the unit to s
_ARCS = {60.0: "60", 1.0: "3600"}
# m; a larger number is in another unit, and as m it would stretch the track by 0.14% or more
MAX_ALTITUDE = 9000.0
RADIUS = 6_378_137.0  # m, radius of Web Mercator's sphere
EDGE = 2.01e7  # m, coordinate at the edge of Web Mercator's map


def describe_web_mercator(columns: Columns, role: Role) -> str:
    """Describe x and y that may be Web Mercator, with the remedy; "" if their magnitude or a name contradicts this."""
    sizes = [median_of(columns.numbers(n).abs()) for n in "xy" if n in columns]
    if len(sizes) < 2 or not 1e5 < min(sizes) <= max(sizes) < EDGE or "utm" in columns.names["y"].plain:
        return ""
    x, y = (f"{columns.text(n)}/{RADIUS:.0f}" for n in "xy")
    read = f"{columns.text('x')} and {columns.text('y')} are read as m east and north"
    maps = f'"{role}.lat=degrees(2*atan2(exp({y}), 1)) - 90" "{role}.lon=degrees({x})"'
    return f"{read}; if they are Web Mercator (EPSG:3857), write --map {maps}"


def map_options(columns: Columns, role: Role, whats: Sequence[str], form: str) -> str:
    return "--map " + " ".join(f'"{role}.{what}={form.format(columns.text(what))}"' for what in whats)


def geographic_position(columns: Columns, role: Role) -> dict[str, Conversion]:
    """Convert latitude and longitude to degrees, by their unit, form or magnitude, and by the letters N, S, E, W."""
    both = ("lat", "lon")
    dms = _are_dms(*(columns.frame[columns.names[what].column] for what in both))
    forms = dict.fromkeys(both, "dms({})") if dms else {**columns.degrees}
    possible = _possible(columns)
    # lat_min may also be the smallest latitude in degrees
    arcs = {} if "1" in possible else {f: k for f, k in _ARCS.items() if k in possible}
    for what in () if forms else both:
        name = columns.names[what]
        if name.unit is None:
            continue
        if name.unit.text.lower().startswith(("ddm", "dddm")):
            forms[what] = "ddmm({})"
        elif name.unit.dimension == "angle":
            text = in_si(name.unit, "{}")
            forms[what] = text[len("radians(") : -1] if text.startswith("radians(") else f"degrees({text})"
        elif name.unit.dimension == "time" and name.unit.factor in arcs:
            forms[what] = f"{{}}/{arcs[name.unit.factor]}"
        else:
            fault = unknown_unit(name, what, "angle", role).partition("; ")[0]
            return {what: refused(f"{fault}; {_with_other_units(columns, role)}")}
    found = Conversion("{}") if forms else _place_form(columns, role)
    if found.fault:
        return dict.fromkeys(both, found)
    places: dict[str, Conversion] = {}
    hemispheres = _hemispheres(columns)
    for what in both:
        text = forms.get(what, found.expression).replace("{}", columns.text(what))
        condition, fault = hemispheres.get(what, ("", ""))
        text = f"where({condition}, -abs({text}), {text})" if condition else text
        remedy = f'{fault}, write --map "{role}.{what}={text}"'
        places[what] = refused(remedy) if fault else Conversion(text, found.note)
    return places


def _are_dms(lat: pl.Series, lon: pl.Series) -> bool:
    """Return True for texts with degree marks or hemisphere letters: 48°07'02.3"N, 11 31.5 E, N48.12.

    Degrees and minutes must be joined in one number (4807.038) in both latitude and longitude, or in neither.
    """
    if lat.dtype != pl.String or lon.dtype != pl.String:
        return False
    both = [values.str.strip_chars().drop_nulls() for values in (lat, lon)]
    both = [values.filter(~values.str.to_lowercase().is_in(NO_VALUE)) for values in both]
    number = r"\d+(?:[.,]\d+)?"
    form = rf"^[NSEW]? *[+-]?{number}(?:[ °º:d'′’m]+{number}){{0,2}}[ °º'′’\"″”ms]*[NSEW]?$"
    fit = all(len(v) and (v.str.contains(form) & v.str.contains("[°ºNSEW]")).all() for v in both)
    joined = [v.str.contains(r"^\D*\d{4}").any() for v in both]
    return fit and joined[0] == joined[1]


def _hemispheres(columns: Columns) -> dict[str, tuple[str, str]]:
    """Find the hemispheres. Return, for lat and lon, the expression for southern or western rows, and the fault.

    The letters are in columns with names such as N/S, or in the columns that follow the coordinates. In the second case
    the columns must contain only these letters, and the coordinates must have no signs.
    """
    frame, found, sure = columns.frame, dict[str, tuple[str, str]](), list[bool]()
    for what, name, words in (("lat", "ns", "north|south"), ("lon", "ew", "east|west")):
        place, named = columns.names[what].column, name in columns
        after = frame.columns[frame.columns.index(place) + 1 :]
        column = columns.names[name].column if named else (*after, place)[0]
        rows = frame.filter(pl.col(place).is_not_null())
        if column == place or frame.schema[column] != pl.String:
            continue
        if frame.schema[place].is_nested() or not len(rows):
            continue
        cells = rows[column].fill_null("").unique(maintain_order=True).to_list()
        texts = [cell for cell in cells if re.fullmatch(f"(?i) *(?:[{name}]|{words}) *", cell)]
        numbers = rows[place].cast(pl.String).str.strip_chars()
        filled = numbers.filter(
            ~is_placeholder(numbers.cast(pl.Float64, strict=False)).fill_null(value=False)
        )
        sure.append(named or (len(texts) == len(cells) and not filled.str.contains("^-|[NSEW]").any()))
        unset = name[1] if any(text.islower() for text in texts) else name[1].upper()
        negative = [text for text in texts if text.strip()[0].lower() == name[1]] or [unset]
        fault = ""
        other = [c for c in cells if re.fullmatch(" *[A-Za-z] *", c) and c not in texts]
        if named and rows[column].is_in(other).sum() > MAX_DAMAGED_SHARE * len(rows):
            negative, (first, last) = other[:1], words.split("|")
            fault = f"column {quoted(column)}: {quoted(other[0])} is neither {first} nor {last}; if it means {last}"
        if named or texts:
            found[what] = " or ".join(f"{quoted_column(column)} == '{text}'" for text in negative), fault
    names = {"lat": "ns", "lon": "ew"}
    return {what: pair for what, pair in found.items() if names[what] in columns or sure == [True, True]}


def degrees_as_meters(columns: Columns, role: Role) -> str:
    """Describe x and y that are likely degrees, since they change by less than 0.001 per row; otherwise return ""."""
    values = [columns.numbers(what) for what in ("x", "y")]
    changes = [v.diff().abs().replace(0.0, None).drop_nulls() for v in values]
    steps = [median_of(v) for v in changes]
    ranges = [float(v.max() or 0) - float(v.min() or 0) for v in values]  # pyright: ignore[reportArgumentType]
    # If the vehicle is stationary most of the time, the median steps are noise.
    if all(far < 20 * step for far, step in zip(ranges, steps, strict=True)):
        steps = [float(v.max() or 0) for v in changes]  # pyright: ignore[reportArgumentType]
    far = min(median_of(v.abs()) for v in values) > 0.5
    small = far and columns.largest("x") <= 180 and columns.largest("y") <= 90
    if not small or columns.names["x"].unit or not 0 < min(steps) < 3e-4 or max(steps) > 1e-3:
        return ""
    x, y = columns.text("x"), columns.text("y")
    return (
        f"columns {x} and {y} change by {max(steps):.1g} from row to row, as degrees do; write --map "
        f'"{role}.lat={y}" "{role}.lon={x}" for degrees, or --map "{role}.x={x}" "{role}.y={y}" "{role}.lat=" for m'
    )


def from_ecef(columns: Columns) -> dict[str, Conversion]:
    """Convert x, y, z from the center of the earth (ECEF, WGS84) to degrees (Bowring). Return {} for other coordinates.

    UTM coordinates near 57 degrees have the norm of ECEF coordinates, but their z is an altitude.
    """
    if not columns.has("x", "y", "z"):
        return {}
    units = {columns.names[n].unit for n in "xyz"}
    unit = units.pop()
    if units or (unit is not None and unit.dimension != "length"):
        return {}
    low, high = (float(columns.norms(["x", "y", "z"]).quantile(q) or 0.0) for q in (0.1, 0.9))
    factors = (1.0, 0.01, 1e-3) if unit is None else (unit.factor,)
    factor = next((f for f in factors if 6.34e6 < f * low <= f * high < 6.4e6), None)
    stated = all("ecef" in columns.names[n].plain for n in "xyz")
    if factor is None or not (stated or factor * median_of(columns.numbers("z").abs()) > MAX_ALTITUDE):
        return {}
    x, y, z = (columns.text(n) if factor == 1 else f"({columns.text(n)}*{factor:g})" for n in "xyz")
    angle = f"atan2({z}*1.00336409, hypot({x}, {y}))"
    lat = f"degrees(atan2({z} + 42841.3115*sin({angle})**3, hypot({x}, {y}) - 42697.6727*cos({angle})**3))"
    note = f"{x}, {y} and {z} are read as coordinates from the center of the earth (ECEF)"
    return {"lat": Conversion(lat, note), "lon": Conversion(f"degrees(atan2({y}, {x}))")}


def _place_form(columns: Columns, role: Role) -> Conversion:
    """Guess the unit of latitude and longitude from their magnitude. {} in the expression stands for the column."""
    both = ("lat", "lon")
    cells = [columns.frame[columns.names[what].column] for what in both]
    if cells[0].dtype == cells[1].dtype and not cells[0].dtype.is_nested():
        apart = columns.frame.filter(cells[0] != cells[1])  # the same number in both is a placeholder
        columns = replace(columns, frame=apart)
    lat, lon = (columns.numbers(what).filter(columns.numbers(what) != 0).abs() for what in both)
    if not len(lat) or not len(lon):
        return Conversion("{}")
    low, high = map(median_of, (lat, lon))
    if low < 1.571 and high < 3.1416:
        radians, degrees = (map_options(columns, role, both, form) for form in ("degrees({})", "{}"))
        options = f"{radians} for radians, {degrees} for degrees"
        fault = f"latitude and longitude are below 1.6 and 3.2 and may be radians; write {options}"
        return refused(fault)
    if low <= 90 and high <= 360:
        return Conversion("{}")
    if low <= 180 and high <= 90:
        exchanged = f'--map "{role}.lat={columns.text("lon")}" "{role}.lon={columns.text("lat")}"'
        fault = f"the latitude of about {low:.6g} exceeds 90: latitude and longitude are exchanged; write {exchanged}"
        return refused(fault)
    minutes = all((v % 100 >= 60).sum() <= MAX_DAMAGED_SHARE * len(v) for v in (lat, lon))
    if low <= 9000 and high <= 18060 and minutes:
        note = "latitude and longitude are read as degrees and minutes, ddmm.mmmm"
        other = f"; if they are arcminutes, write {map_options(columns, role, both, '{}/60')}"
        return Conversion("ddmm({})", note + other * (low <= 5400 and high <= 10800))
    if [columns.names[what].plain for what in both] == ["position_lat", "position_long"] and low > 1e6:
        return Conversion(
            "{}*180/2147483648", "latitude and longitude are read as semicircles, as in FIT files"
        )
    if low <= 9e8 and high <= 36e8 and (low > 90e6 or high > 180e6):
        other = f"; if they are milliarcseconds, write {map_options(columns, role, both, '{}/3.6e6')}"
        note = "latitude and longitude are read as 1e-7 degrees"
        return Conversion("{}*1e-7", note + (other if low <= 90 * 3.6e6 and high <= 180 * 3.6e6 else ""))
    fault = f"a latitude of about {low:.6g} and a longitude of about {high:.6g} are not in degrees"
    return refused(f"{fault}; {_with_other_units(columns, role)}")


def _with_other_units(columns: Columns, role: Role) -> str:
    return f"write {other_units(role, [columns.text(n) for n in ('lat', 'lon')], _possible(columns))}"


def _possible(columns: Columns) -> list[str]:
    return possible_units(*(median_of(columns.numbers(what).abs()) for what in ("lat", "lon")))


_PLACES = {"lat": {"lat", "latitude"}, "lon": {"lon", "lng", "long", "longitude"}}
_PARTS = {
    **dict.fromkeys(("d", "deg", "degs", "degree", "degrees"), 1),
    **dict.fromkeys(("m", "min", "mins", "minute", "minutes"), 60),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 3600),
}


def degree_parts(frame: pl.DataFrame) -> dict[str, tuple[str, str]]:
    """Return, for lat and lon, the column of degrees and the expression of the sum, deg; {} if either is not found.

    If latitude and longitude are also in one column each, these columns are returned, with an empty expression, since
    the separate degrees and minutes may lack the sign.
    """
    found: dict[str, tuple[str, str]] = {}
    whole: dict[str, tuple[str, str]] = {}
    for what, names in _PLACES.items():
        groups: dict[tuple[str, ...], dict[int, str]] = {}
        for column in frame.columns:
            words = split_words(column)
            if words[-1:] and words[-1] in _PARTS and names & {*words[:-1]}:
                groups.setdefault((*words[:-1],), {}).setdefault(_PARTS[words[-1]], column)
        fitting = [parts for parts in groups.values() if _are_parts(frame, parts)]
        sums = [(parts[1], _sum_of_parts(parts)) for parts in fitting]
        found |= {what: sums[0]} if sums else {}
        used = {column for parts in fitting for column in parts.values()}
        others = [n.column for n in read_names(frame.columns) if n.meaning == what and n.column not in used]
        others = [column for column in others if (column_numbers(frame[column]) != 0).any()]
        whole |= {what: (others[0], "")} if others else {}
    return {} if len(found) < len(_PLACES) else whole if len(whole) == len(_PLACES) else found


def _are_parts(frame: pl.DataFrame, parts: Mapping[int, str]) -> bool:
    if not {1, 60} <= parts.keys():
        return False
    values = {part: column_numbers(frame[column]) for part, column in parts.items()}
    whole = [values[part] for part in sorted(values)[:-1]]
    below = all(v.is_between(0, 60).all() for part, v in values.items() if part > 1)
    return below and all(len(v) and (v == v.round()).all() for v in whole)


def _sum_of_parts(parts: Mapping[int, str]) -> str:
    degrees = quoted_column(parts[1])
    rest = " + ".join(f"{quoted_column(column)}/{part}" for part, column in sorted(parts.items()) if part > 1)
    return f"{degrees} + where({degrees} < 0, -1, 1)*({rest})"
