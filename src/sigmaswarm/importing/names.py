"""Interpret names of columns: separate the name from the unit, and find the column of a drive that the name means."""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import takewhile

from sigmaswarm.importing.units import COUNTS, PARTS_OF_SECONDS, Unit, UnitDimension, parse_unit

LONGEST_NAME = 200


def _any_of(*texts: str) -> str:
    """Return a pattern of alternatives from patterns that are separated by spaces."""
    return "|".join(pattern for text in texts for pattern in text.split())


_PARTS = _any_of(*PARTS_OF_SECONDS)
TIME = _any_of(
    "t ts time time_?stamps?(?:_(?:unix|posix|utc))? stamp",
    "secs? seconds seconds_elapsed",
    "date_?time utime epoch? (?:unix|posix)(?:_?time)? utc",
    *PARTS_OF_SECONDS,
    f"interval (?:time|secs?|seconds|{_PARTS})_since_\\w{{1,20}} since_start",
    "loggingtime logging_time",
)
_OF_WEEK = _any_of(
    "i?tow sow wsec (?:time|secs?|seconds|ms)_?(?:of|in|into)_?(?:the_)?week week_(?:secs?|seconds|time)"
)
TIME_OF_WEEK = f"(?:gps|gnss)?_?(?:{_OF_WEEK})"
_CLOCKS = _any_of(
    "boot sys(?:tem)? device sensor host log(?:ger)? utc gps gnss rx recv",
    "local mono(?:tonic)? elapsed offset",
)
# Names of times, for tables without a more usual name
CLOCK = _any_of(
    "received boot date cts (?:esp_)?timer up_?time ticks? sample_?time_?fine",
    "time_?(?:startup|imu|gps|gnss|fix|utc|boot)",
    f"elapsed tod sod {TIME_OF_WEEK} (?:time|sec|secs|seconds)_of_(?:the_)?day",
    "datenum t_?(?:imu|gps|gnss|acc|gyro?|truth|ref|gt) (?:imu|gps|gnss|fix|truth)_?t",
    f"(?:(?:{_CLOCKS})_?){{1,2}}(?:time|clock|stamp)",
)
STAMP = "(?:.*_)?header_(?:time_?)?stamp"  # ROS header stamps, in tables converted from bags
WEEK = "(?:gps|gnss)?_?(?:week|wnc?|weeks)(?:_?(?:no|num|number))?"

_ACCELERATION = _any_of(
    "a acc accl accel acceleration accelerometer accelerometer_acceleration",
    "lin(?:ear)?_?acc(?:el|eleration)? specific_force f f_?b a_rs_s linear",
)
_RATE = _any_of(
    "g w pqr gyr gyro gyroscope gyro_rotation gyroscope_gyro_?uncalibrated omega",
    "ang(?:ular)?_?vel(?:ocity)? ang(?:ular)?_?rate rot rotation_?rate rate w_?b w_rs_s angular",
    "(?:velocidade?|velocita|vitesse)_(?:ang[uo]lai?re?|d[ei]_rota(?:tion|zione|cion|cao))",
)
_STD = "(?:std|stdev|std_?dev|sigma|sd)"  # survey-grade receivers log these in m, also for latitude and longitude
TURNS = {"roll": "gx", "pitch": "gy", "yaw": "gz"}
NAMES: tuple[tuple[str, str], ...] = (
    ("t", TIME),
    *((f"a{i}", f"(?:{_ACCELERATION})_?{i}") for i in "xyz"),
    *((f"g{i}", f"(?:{_RATE})_?{i}") for i in "xyz"),
    *((axis, f"{turn}_?rate") for turn, axis in TURNS.items()),
    ("lat", "(?:gps|gnss)?(?:lat|latitude)|gps_coord_x|(?:pos_)?lla_x"),
    ("lon", "(?:gps|gnss)?(?:lon|lng|long|longitude)|gps_coord_y|(?:pos_)?lla_y"),
    (
        "ns",
        "n_s|ns_indicator|indicator_ns|(?:lat|latitude)_(?:dir(?:ection)?|hemi(?:sphere)?|ref|ns|n_s)|north_south",
    ),
    (
        "ew",
        "e_?w|ew_indicator|indicator_ew|(?:lon|lng|longitude)_(?:dir(?:ection)?|hemi(?:sphere)?|ref|ew|e_w)|east_west",
    ),
    ("alt", "alt|altitude|height|elevation|ele|(?:pos_)?lla_z"),
    ("x", "x|ecef_?x|x_ecef|east|easting|e|pe|pos(?:ition)?_?[xe]|utm_?(?:x|e|east|easting)|x_utm"),
    ("y", "y|ecef_?y|y_ecef|north|northing|n|pn|pos(?:ition)?_?[yn]|utm_?(?:y|n|north|northing)|y_utm"),
    ("z", "z|ecef_?z|z_ecef"),
    ("q", "w|qw|q_w"),
    ("vx", "vx|ve|v_?east|east_?vel(?:ocity)?|vel(?:ocity)?_?e(?:ast)?"),
    ("vy", "vy|vn|v_?north|north_?vel(?:ocity)?|vel(?:ocity)?_?n(?:orth)?"),
    ("std_x", f"std_?x|sigma_?x|std_?e(?:ast)?|sd_?e|std_?lon|(?:lon(?:gitude)?|east(?:ing)?)_?{_STD}"),
    ("std_y", f"std_?y|sigma_?y|std_?n(?:orth)?|sd_?n|std_?lat|(?:lat(?:itude)?|north(?:ing)?)_?{_STD}"),
    ("std_heading", f"std_?(?:heading|yaw|hdg)|(?:heading|yaw|hdg)_?(?:{_STD}|acc(?:uracy)?)|acc_?heading"),
    (
        "wheel_speed",
        "(?:wheels?|vehicle|car|can|odo(?:meter)?)_?(?:speed|velocity)|speed_?(?:can|wheels?)|odometer",
    ),
    ("speed", "(?:ground_?)?speed|sog|spd|velocity|vel|v"),
    ("course", "course"),
    ("bearing", "bearing|track|heading|cog"),
    ("theta", "theta|yaw"),
)
# Units that may mean something else before an axis: g the gyro or gravity, mG a magnetic field
_AMBIGUOUS = ("g", "mg", "ug", "gal", "mgal")
_AXES = ("ax", "ay", "az", "gx", "gy", "gz")
_PLACES = ("lat", "lon", "alt", "ns", "ew")
_TOTAL = {"gfx", "gfy", "gfz"}  # specific force in g, in logs of Physics Toolbox
# Names that have a meaning only together: of Arduino sketches for an MPU-6050, of rates, and of TUM's poses
_MPU = {f"{s}{i}": f"{name}_{i}" for s, name in (("ac", "acc"), ("gy", "gyro")) for i in "xyz"}
_PQR, _POSE = {"p": "gyro_x", "q": "gyro_y", "r": "gyro_z"}, {"tx": "x", "ty": "y", "tz": "z", "qw": "qw"}
# Dimension, column and names. A name has this meaning only with a unit of the dimension: "x_acc" may be an accuracy.
# Names of angles and speeds also have their meaning without a unit, in a table with latitude and longitude.
_STATED: tuple[tuple[UnitDimension, str, str], ...] = (
    ("time", "t", "temps"),
    *(("acceleration", f"a{i}", f"{i}_?acc(?:el(?:eration)?)?|accsmooth_{i}") for i in "xyz"),
    *(("acceleration", f"a{i}", f"n_?{i}") for i in "xyz"),
    *(("rate", f"g{i}", letter) for i, letter in zip("xyz", "pqr", strict=True)),
    *(("rate", f"g{i}", f"{i}_?gyro|{i}_rate_of_rotation|gyroadc_{i}|as_?{i}") for i in "xyz"),
    ("angle", "lat", "breite"),
    ("angle", "lon", "lange|laenge"),
    ("angle", "bearing", "kurs|richtung|fahrtrichtung|cap|direction|rumbo|direccion|rotta|direzione|koers"),
    ("speed", "speed", "geschwindigkeit|vitesse|velocidade?|velocita|snelheid"),
)
_SHORT = r"(?:field|data|msg|imu\d?)_(?=[agw][xyz](?:_|$))"
# Prefixes of message tables and of loggers
_CHIPS = r"(?:adis|adxl|bmi|bmx|bno|icm|iim|lis|lsm|mpu)\d*_(?=[ag]_?[xyz]$)|measurement_(?=[xyz]$)"
_PREFIXES = re.compile(
    _any_of(
        r"(?:field|data|msg|unit|imu\d?|gps\d?|gnss\d?|fix|location|position|pos_lla|pos)_(?=...)",
        r"(?:gps|gnss)\d?_(?=[pv]?[xyzenu]$) (?:pose_){1,2}position_(?=[xyz]$) calibrated_(?=acc|gyr)",
        _SHORT,
        _CHIPS,
    )
)
_FIXES = r"gps\d?|gnss\d?|fix|position|location"
# Words of a shared prefix that do not change the meaning of a name; others may mark an estimate or another quantity
_CONTAINERS = rf"car|vehicle|imu\d?|data|fields?|msg|sensors?|log|logger|\d{{1,3}}|{_FIXES}"
# Fields of MAVLink with their units in the protocol; RAW_IMU contains counts
_MAVLINK = {
    f"scaled_imu{n}_{i}{name}": (f"{name}_{i}", unit)
    for n in ("", 2, 3)
    for i in "xyz"
    for name, unit in (("acc", "mg"), ("gyro", "mrad/s"))
} | {f"gps_raw_int_{name}": (name, "") for name in ("lat", "lon", "fix_type")}
# German, French, Spanish, Portuguese, Italian, Dutch and Polish words, without accents
_TRANSLATED = {
    word: name
    for name, words in {
        "time": "zeit uhrzeit zeitpunkt heure tiempo hora tempo ora tijd czas",
        "timestamp": "zeitstempel horodatage",
        "date": "datum fecha",
        "acceleration": "beschleunigung beschl aceleracion aceleracao accelerazione versnelling przyspieszenie",
        "accelerometer": "beschleunigungssensor accelerometre acelerometro accelerometro akcelerometr",
        "gyroscope": "gyroskop giroscopio giroscopo gyroscoop zyroskop",
        "rate": "drehrate winkelgeschwindigkeit drehgeschwindigkeit",
        "yawrate": "gierrate giergeschwindigkeit",
        "rollrate": "wankrate wankgeschwindigkeit",
        "pitchrate": "nickrate nickgeschwindigkeit",
        "yaw": "gieren lacet imbardata guinada",
        "roll": "wanken roulis rollio balanceo",
        "pitch": "nicken tangage beccheggio cabeceo",
        "longitudinal": "langs laengs longitudinale",
        "lateral": "quer laterale transversal transversale",
        "vertical": "vertikal verticale verticaal",
        "longitudinal_acceleration": "langsbeschleunigung laengsbeschleunigung langsbeschl laengsbeschl",
        "lateral_acceleration": "querbeschleunigung querbeschl",
        "vertical_acceleration": "vertikalbeschleunigung hochbeschleunigung vertikalbeschl",
        "latitude": "breitengrad latitud latitudine breedtegraad",
        "longitude": "langengrad laengengrad longitud longitudine lengtegraad",
        "height": "hohe hoehe hauteur altura altezza quota hoogte",
    }.items()
    for word in words.split()
}


@dataclass(frozen=True)
class Name:
    column: str
    plain: str  # in lower case, without the unit
    unit: Unit | None = None
    weak: bool = False  # True if names of another family take precedence

    @property
    def meaning(self) -> str | None:
        """The column of a drive that the name means, or None. Roll, pitch and yaw per second are rates."""
        if self.unit is not None and self.unit.dimension == "rate" and self.plain in TURNS:
            return TURNS[self.plain]
        return _stated(self.plain, self.unit) or meaning_of_plain(self.plain)

    @property
    def words(self) -> tuple[str, ...]:
        return tuple(plain_words(self.column))

    def is_one(self, pattern: str) -> bool:
        return re.fullmatch(pattern, self.plain) is not None


def plain_words(text: str) -> list[str]:
    """Split a name into words in lower case, translated to English."""
    marked = unicodedata.normalize("NFD", text[:LONGEST_NAME].lower())
    # an accent on a single letter marks a derivative or an estimate
    marked = re.sub(r"(?<![a-z\u0300-\u036f])([a-z])[\u0300-\u036f]+(?![a-z\u0300-\u036f])", r"\1dot", marked)
    bare = re.sub("[\u0300-\u036f]", "", marked)
    words: list[str] = re.findall(r"[a-z0-9]+", bare)
    return [_TRANSLATED.get(word, word) for word in words]


def split_words(text: str) -> list[str]:
    """Split a name into words like `plain_words`, and also at the capitals of CamelCase."""
    return plain_words(_with_underscores(text))


def _with_underscores(text: str) -> str:
    return re.sub("(?<=[a-z])(?=[A-Z])|(?<=GPS|GNS)(?=[A-Z][a-z])", "_", text)


def _stated(plain: str, unit: Unit | None) -> str | None:
    dimension = None if unit is None else unit.dimension
    return next((w for d, w, pattern in _STATED if d == dimension and re.fullmatch(pattern, plain)), None)


@lru_cache(4096)  # an import calls this about 25 times for each name
def meaning_of_plain(plain: str) -> str | None:
    """Find the column of a drive that a name means, also with the prefix of a logger or the ".data" of a message."""
    bare = re.sub(r"_(?:data|value|cal(?:ib(?:rated)?)?)$", "", plain)
    for name in dict.fromkeys((plain, bare, _PREFIXES.sub("", bare, count=1))):
        for what, pattern in NAMES:
            if re.fullmatch(pattern, name):
                return what
        if name == plain and re.fullmatch(CLOCK, plain):
            return None
    return None


def is_time(plain: str) -> bool:
    return meaning_of_plain(plain) == "t" or re.fullmatch(CLOCK, plain) is not None


def read_names(columns: Sequence[str]) -> list[Name]:
    """Interpret the names of a table's columns, without a shared prefix as in "Car.ax" and "vehicle/imu/ax".

    A prefix that names a receiver is not removed from the names of accelerations and rates. Any other prefix is removed
    only from these names and, in a table with an IMU, from those of positions in degrees, since a table of estimates
    has no accelerations.
    """
    pairs = zip(min(columns, default=""), max(columns, default=""), strict=False)
    shared = "".join(a for a, _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
    prefix = re.sub(r"[A-Za-z0-9]*$", "", shared) if len(columns) > 1 else ""
    words = plain_words(prefix)
    prefix = prefix if all(re.fullmatch(_CONTAINERS, word) for word in words) else ""
    fixes = any(re.fullmatch(_FIXES, word) for word in words)
    if not prefix:
        return _one_sensor([read_name(column) for column in columns])
    bares = [replace(read_name(column[len(prefix) :]), column=column) for column in columns]
    meanings = [bare.meaning for bare in bares]
    placed = {"ax", "ay", "gz", "lon"} <= {*meanings} and meanings.count("lat") == 1
    names: list[Name] = []
    for column, bare in zip(columns, bares, strict=True):
        whole = read_name(column)
        fits = bare.meaning in (None, "t") or fixes != (bare.meaning in _AXES)
        fits |= placed and bare.meaning in _PLACES
        names.append(bare if whole.meaning is None and fits else whole)
    return _one_sensor(names)


def _one_sensor(names: list[Name]) -> list[Name]:
    """If several groups of columns may be the specific force or the rates, keep one group for each.

    Interpret the names in `_TOTAL` (Physics Toolbox), `_MPU`, `_PQR` and `_POSE`.
    """
    plains = {n.plain for n in names}
    forces = {n.plain for n in names if n.meaning in _AXES[:3] and not _family(n)}
    if plains >= _TOTAL and forces <= {*_AXES[:3]}:  # ax, ay, az are then without gravity
        g = parse_unit("g")
        kept = [n if n.plain not in forces else replace(n, plain="") for n in names]
        names = [Name(n.column, f"acc_{n.plain[-1]}", n.unit or g) if n.plain in _TOTAL else n for n in kept]
    there = {n.meaning for n in names}
    for together, others in ((_MPU, _AXES), (_PQR, _AXES[3:]), (_POSE, ("x", "y"))):
        if plains >= together.keys() and there.isdisjoint(others):
            names = [replace(n, plain=together.get(n.plain, n.plain)) for n in names]
    # roll_rate and pitch_rate may be derivatives of the attitude, so a gyro's names take precedence
    turns = {n.meaning for n in names if not n.is_one("(?:roll|pitch)_?rate")}
    names = [
        replace(n, plain="") if n.is_one("(?:roll|pitch)_?rate") and n.meaning in turns else n for n in names
    ]
    for stem in {n.plain[:-1] for n in names if n.meaning == "gy" and n.plain.endswith("_y")}:
        if {f"{stem}r", f"{stem}p"} <= plains and plains.isdisjoint(
            {f"{stem}x", f"{stem}z"}
        ):  # roll, pitch, yaw
            turned = {f"{stem}{letter}": f"{stem}{axis}" for letter, axis in zip("rpy", "xyz", strict=True)}
            names = [replace(n, plain=turned.get(n.plain, n.plain)) for n in names]
    # a complete IMU goes before the accelerations or the yaw rate of another source
    known = {n.meaning for n in names if not _family(n)}
    for imu in sorted({n.words[:1] for n in names if re.fullmatch(r"imu\d?_ax", n.plain)}):
        own = {n.meaning for n in names if n.words[:1] == imu}
        if own >= {*_AXES} and not known >= {*_AXES}:
            names = [
                n if n.words[:1] == imu or n.meaning not in _AXES else replace(n, plain="") for n in names
            ]
            break
    stated = {n.column: _meaning_in_table(n) for n in names if n.meaning is None and n.unit is None}
    known = {n.meaning for n in names} | {*stated.values()}
    if known >= {"lat", "lon"}:  # the values of a course and of a speed are compared with the positions
        names = [replace(n, plain=stated.get(n.column) or n.plain) for n in names]
    for axes in (_AXES[:3], _AXES[3:]):
        families = [_family(n) if n.meaning in axes else None for n in names]
        first = min((f for f in families if f is not None), key=bool, default=None)
        names = [
            n if f in (None, first) else replace(n, plain="") for n, f in zip(names, families, strict=True)
        ]
    return names


def _meaning_in_table(name: Name) -> str | None:
    found = (_stated(name.plain, Unit("", dimension, 1.0)) for dimension in ("angle", "speed"))
    return next(filter(None, found), None)


def _family(name: Name) -> str:
    """Return the name without its axis if another group of names takes precedence, otherwise ""."""
    stated = not name.plain.endswith("rate") and _stated(name.plain, name.unit)
    weak = re.match(_SHORT, name.plain) or stated or name.plain.startswith("lin")  # may be without gravity
    weak = weak or (name.words[-2:-1] == ("g",) and name.meaning in _AXES[:3])  # may be gravity itself
    weak = weak or name.weak
    return re.sub("^[xyz]|[xyz]$", "", re.sub("^[pqr]$", "pqr", name.plain)) if weak else ""


def read_name(column: str) -> Name:
    """Separate the name of a column from its unit: "Acceleration x (m/s^2)", "gyro_z_dps", "time since start in ms".

    An unrecognized name is interpreted again with its words split at capitals: "gyroRotationX(rad/s)".
    """
    text = re.sub(r"_duplicated_\d+$", "", column.strip())
    name, split = _read(column, text), _with_underscores(text)
    if name.meaning is not None or split == text:
        return name
    again = _read(column, split)
    timed = is_time(again.plain) and again.plain != "t"  # tMin may be a temperature
    # a last letter after a split is not a unit: LatG, LatD
    stated = timed or again.unit is None or split[-1] in ")]" or len(again.unit.text) > 3
    stated = stated or (again.unit is not None and again.unit.text == "e7")
    return again if (timed or again.meaning is not None) and stated else name


def _read(column: str, text: str) -> Name:
    if len(text) > LONGEST_NAME:
        return Name(column, "")
    if element := re.fullmatch(r"gyro_rad\[([012])\]", text):  # PX4's name of rates in rad/s
        return Name(column, f"gyro_{'xyz'[int(element[1])]}", parse_unit("rad/s"))
    if element := re.fullmatch(r"([^\[\]]{1,100})\[([012])\]", text):
        words = plain_words(re.sub(r"\.v$", "", element[1]))
        return _with_unit(column, words, "xyz"[int(element[2])])
    if axis := re.fullmatch(r"(.{1,100}?)\s*[(\[]([xyzXYZ])[)\]]", text):  # Torque's G(x) is an acceleration
        words = plain_words(axis[1])
        total = words == ["g"]
        return (
            Name(column, f"acc_{axis[2].lower()}", parse_unit("g"))
            if total
            else _with_unit(column, words, axis[2].lower())
        )
    if text and text[-1] in ")]":
        begin = text.rfind("(" if text[-1] == ")" else "[")
        if begin > 0:
            inner = re.sub(r"\[([012])\]\s*$", lambda m: f" {'xyz'[int(m[1])]}", text[:begin])
            return Name(column, "_".join(plain_words(inner)), parse_unit(text[begin + 1 : -1]))
    words = plain_words(text)
    plain = "_".join(words)
    if plain in _MAVLINK:
        return Name(column, _MAVLINK[plain][0], parse_unit(_MAVLINK[plain][1]))
    if stated := re.fullmatch(r"(?i)(.{1,100}?)[\W_]in[\W_](.+)", text):
        unit, after = parse_unit(stated[2]), plain_words(stated[2])
        unit = unit if unit is None or unit.known else unit_of(after)
        if unit is None or unit.known or len(after) == 1:
            return Name(column, "_".join(plain_words(stated[1])), unit)
    if plain in PARTS_OF_SECONDS:
        return Name(column, plain, parse_unit(plain))
    if meaning_of_plain(plain) is not None:
        return Name(column, plain)
    if words[-1:] and words[-1] in "xyz":  # gyro_dps_x
        name = _with_unit(column, words[:-1], words[-1])
        axes = _AXES[:3] if name.unit and name.unit.text == "g" else _AXES
        if name.unit and name.unit.dimension in ("acceleration", "rate", "angle") and name.meaning in axes:
            return name
    name = _with_unit(column, words)
    return name if name.unit or name.meaning else _after_unit(column, words) or name


def _after_unit(column: str, words: list[str]) -> Name | None:
    """Read a name that begins with the unit of an axis: mps2_x, dps_gyro_z; otherwise return None."""
    for count in (3, 2, 1):
        unit = unit_of(words[:count]) if len(words) > count else None
        letter = {"acceleration": "a", "rate": "g"}.get((unit and unit.dimension) or "")
        plain = "_".join(words[count:])
        bare = plain in {*"xyz"}
        if unit is None or letter is None or (bare and unit.text.lower() in _AMBIGUOUS):
            continue
        plain = f"{letter}{plain}" if bare else plain
        if meaning_of_plain(plain) in {f"{letter}{i}" for i in "xyz"}:
            return Name(column, plain, unit, weak=True)
    return None


def _with_unit(column: str, words: list[str], axis: str = "") -> Name:
    """Split a unit from the end of a column's words. Without a unit there, the name keeps all words."""
    for count in (3, 2, 1):
        unit = unit_of(words[-count:]) if len(words) > count else None
        rest = "_".join([*words[:-count], *axis])
        known = words and not axis and ({*words[-1:]} & {*COUNTS} - {"raw"} or re.match("dd?dm", words[-1]))
        timed = not axis and (is_time(rest) or re.fullmatch(STAMP, rest))
        named = timed or meaning_of_plain(rest) or _stated(rest, unit)
        if unit is not None and (unit.known or known) and named:
            return Name(column, rest, unit)
    return Name(column, "_".join([*words, *axis]))


def unit_of(words: list[str]) -> Unit | None:
    """Return the unit in the last words of a name: ["deg", "s"], ["m", "s", "2"], ["dps"]."""
    first, *rest = [word for word in words if word != "per"] or [""]
    if words[:1] == ["per"]:
        return None
    return parse_unit(f"{first}/{''.join(rest)}" if rest else first)
