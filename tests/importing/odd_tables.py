"""Write a known drive as unusual tables by a seed: dialects, units, dates, clocks and names of loggers."""

import datetime
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic, geodetic_to_enu, wrap_angle
from sigmaswarm.importing.convert import import_drive
from sigmaswarm.importing.opening import Request

G = 9.80665
AXES = ("x", "y", "z")
Columns = dict[str, np.ndarray]

ACCELERATION = {
    "m/s^2": 1.0,
    "m s^-2": 1.0,
    "g": G,
    "mg": G / 1e3,
    "ug": G / 1e6,
    "ft/s^2": 0.3048,
    "cm/s2": 0.01,
    "mm/s^2": 1e-3,
    "Gal": 0.01,
    "parsec/s2": 3e16,
    "LSB": G / 16384,
}
RATE = {
    "rad/s": 1.0,
    "rad s^-1": 1.0,
    "deg/s": np.pi / 180,
    "°/s": np.pi / 180,
    "dps": np.pi / 180,
    "mrad/s": 1e-3,
    "mdps": np.pi / 180e3,
    "deg/h": np.pi / 648e3,
    "rpm": np.pi / 30,
    "rev/s": 2 * np.pi,
    "deg/min": np.pi / 10800,
    "counts": np.pi / 180 / 131,
}
LENGTH = {"m": 1.0, "km": 1e3, "ft": 0.3048, "mm": 1e-3, "cm": 0.01, "mi": 1609.344, "furlong": 201.168}
SPEED = {
    "m/s": 1.0,
    "km/h": 1 / 3.6,
    "knots": 1852 / 3600,
    "mph": 0.44704,
    "cm/s": 0.01,
    "ft/s": 0.3048,
    "mm/s": 1e-3,
    "kph": 1 / 3.6,
    "warp": 3e8,
}
UNKNOWN = ("parsec/s2", "LSB", "counts", "furlong", "warp")
ANGLE = {"deg": np.pi / 180, "°": np.pi / 180, "rad": 1.0}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "days": 86400.0}
SUFFIXES = {
    "m/s^2": "m_s2",
    "ft/s^2": "ft_s2",
    "deg/s": "deg_s",
    "rad/s": "rad_s",
    "km/h": "kmh",
    "m/s": "mps",
    "°": "deg",
    "mrad/s": "mrad_s",
    "deg/h": "deg_h",
    "cm/s": "cm_s",
    "°/s": "dps",
}

ACC_NAMES = (
    "a{}",
    "acc_{}",
    "Acc {}",
    "accel_{}",
    "linear_acceleration.{}",
    "field.linear_acceleration.{}",
    "a_RS_S_{}",
)
GYRO_NAMES = (
    "g{}",
    "gyro_{}",
    "Gyro {}",
    "omega_{}",
    "angular_velocity.{}",
    "field.angular_velocity.{}",
    "w_RS_S_{}",
)
DATES = (
    "%Y-%m-%d %H:%M:%S.%f",
    "%Y-%m-%dT%H:%M:%S.%fZ",
    "%d-%b-%Y %H:%M:%S.%f",
    "%Y/%m/%d %H:%M:%S.%f",
    "%d.%m.%Y %H:%M:%S.%f",
    "%m/%d/%Y %H:%M:%S.%f",
    "%d/%m/%Y %H:%M:%S.%f",
    "%H:%M:%S.%f",
    "%Y-%m-%dT%H:%M:%S.%f+02:00",
    "%m/%d/%Y %I:%M:%S.%f %p",
)


@dataclass
class Case:
    """What was written, and what is right: columns of the IMU, the fixes and the truth, times from the IMU's first."""

    source: Path
    imu: Columns
    gps: Columns
    truth: Columns | None
    map_arguments: list[str] = field(default_factory=list)
    resolution: float = 2e-3
    part: int | None = None


def known_drive(rng: np.random.Generator) -> tuple[Columns, Columns, Columns]:
    """IMU, fixes and truth of a vehicle that accelerates, turns left and right, and brakes."""
    duration, hz = float(rng.integers(20, 40)), int(rng.choice([20, 25, 50]))
    t = np.arange(int(duration * hz)) / hz
    v = 6 + 3 * np.sin(2 * np.pi * t / 15)
    gz = 0.5 * np.sin(2 * np.pi * t / 11 + rng.uniform(0, 6))
    theta = rng.uniform(-3, 3) + np.cumsum(gz) / hz
    east, north = np.cumsum(v * np.cos(theta)) / hz, np.cumsum(v * np.sin(theta)) / hz
    noise = 0.05 * rng.standard_normal((6, len(t)))
    imu = {"t": t, "ax": np.gradient(v, t) + noise[0], "ay": v * gz + noise[1], "az": 9.81 + noise[2]}
    imu |= {"gx": 0.1 * noise[3], "gy": 0.1 * noise[4], "gz": gz + 0.1 * noise[5]}
    every = hz // int(rng.choice([1, 5] if hz % 5 == 0 else [1]))
    k = slice(None, None, every)
    place = (rng.uniform(-60, 60), rng.uniform(-179, 179), rng.uniform(0, 900))
    geo = enu_to_geodetic(np.column_stack([east, north, 0 * t]), place)
    gps = {"t": t[k], "lat": geo[k, 0], "lon": geo[k, 1], "alt": geo[k, 2], "x": east[k], "y": north[k]}
    gps |= {"speed": v[k], "course": np.asarray(wrap_angle(theta[k]))}
    truth = {"t": t, "x": east, "y": north, "vx": v * np.cos(theta), "vy": v * np.sin(theta)}
    truth |= {"theta": np.asarray(wrap_angle(theta)), "lat": geo[:, 0], "lon": geo[:, 1]}
    return imu, gps, truth


@dataclass
class Sheet:
    """A table being made: the cells of each column as text, and its name and unit."""

    names: list[str] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    cells: list[list[str]] = field(default_factory=list)

    def add(self, name: str, values: list[str], unit: str = "") -> None:
        self.names.append(name)
        self.units.append(unit)
        self.cells.append(values)


class Writer:
    """Writes the known drive as a seed says."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.rng = np.random.default_rng(seed)
        self.folder = folder
        imu, gps, truth = known_drive(self.rng)
        self.case = Case(folder, imu, gps, truth if self.chance(0.3) else None)
        self.unit_style = self.pick(("brackets", "parentheses", "suffix", "row"))
        self.clock = self.pick_clock()
        self.epoch = float(self.rng.integers(1_600_000_000, 1_750_000_000)) if self.chance(0.7) else 0.0

    def pick(self, options):
        return options[int(self.rng.integers(len(options)))]

    def unit(self, table):
        """A unit, seldom one that nothing knows."""
        known = [u for u in table if u not in UNKNOWN]
        return self.pick(known) if self.chance(0.95) else self.unit(table)

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def note(self, text: str) -> None:
        self.case.map_arguments.append(text)

    def write(self) -> Case:
        case = self.case
        layout = self.pick(("two", "two", "two", "one", "sensors"))
        self.note(f"layout {layout}, clock {self.clock}, epoch {self.epoch:g}, units in {self.unit_style}")
        if layout == "one":
            self.save("log.csv", self.joined())
            case.source = self.folder / "log.csv"
        elif layout == "sensors":
            for name, letter in (("Accelerometer", "a"), ("Gyroscope", "g")):
                sheet = Sheet()
                self.add_time(sheet, case.imu["t"])
                self.add_axes(sheet, letter, "{}")
                self.save(f"{name}.csv", sheet)
        else:
            sheet = Sheet()
            self.add_time(sheet, case.imu["t"])
            self.add_imu(sheet)
            self.save("imu.csv", sheet)
        if layout != "one":
            sheet = Sheet()
            self.add_time(sheet, case.gps["t"])
            self.add_fixes(sheet)
            self.placeholders(sheet)
            self.save(self.pick(("gps.csv", "position.csv", "fix.csv")), sheet)
            if self.chance(0.3):
                self.magnetometer()
            if case.truth is not None:
                self.save("truth.csv", self.truth())
        else:
            case.truth = None
        return case

    def joined(self) -> Sheet:
        """One table: empty cells, or the last fix, where there is no fix."""
        sheet, fixes, imu = Sheet(), Sheet(), self.case.imu
        self.add_time(sheet, imu["t"])
        self.add_imu(sheet)
        self.add_fixes(fixes)
        last = np.searchsorted(self.case.gps["t"], imu["t"] + 1e-9) - 1
        new = np.diff(last, prepend=-1) > 0
        empty = self.pick(("", "nan", "n/a", None))
        self.note(f"no fix: {empty!r}")
        for name, unit, cells in zip(fixes.names, fixes.units, fixes.cells, strict=True):
            sheet.add(
                name, [cells[j] if new[i] or empty is None else empty for i, j in enumerate(last)], unit
            )
        return sheet

    def magnetometer(self) -> None:
        sheet, imu = Sheet(), self.case.imu
        self.add_time(sheet, imu["t"])
        for axis in AXES:
            sheet.add(axis, [f"{v:.3f}" for v in 20 + 30 * np.sin(imu["t"] / 9)])
        self.save("magnetometer.csv", sheet)

    # Units and names.

    def add_quantity(
        self, sheet: Sheet, name: str, values: np.ndarray, unit: str, scale: float, named: bool
    ) -> None:
        text = [repr(float(f"{v:.12g}")) for v in values / scale]
        if unit in ("LSB", "counts"):
            text = [str(round(v)) for v in values / scale]
        sheet.add(name, text, unit if named else "")

    def add_axes(self, sheet: Sheet, letter: str, names: str) -> None:
        table = ACCELERATION if letter == "a" else RATE
        unit = self.unit(table)
        plain = ("m/s^2", "g", "LSB") if letter == "a" else ("rad/s", "deg/s", "counts")
        named = unit not in plain or self.chance(0.5)
        self.note(f"{names} in {unit}{'' if named else ', not named'}")
        for axis in AXES:
            column = f"{letter}{axis}"
            self.add_quantity(sheet, names.format(axis), self.case.imu[column], unit, table[unit], named)

    def add_imu(self, sheet: Sheet) -> None:
        k = int(self.rng.integers(len(ACC_NAMES)))
        self.add_axes(sheet, "a", ACC_NAMES[k])
        self.add_axes(sheet, "g", GYRO_NAMES[k])

    def add_fixes(self, sheet: Sheet) -> None:
        gps = self.case.gps
        style = self.pick(
            ("deg", "deg", "deg", "named", "rad", "e7", "e7 named", "ddmm", "360", "hemisphere", "metres")
        )
        self.note(f"fixes {style}")
        names = self.pick((("lat", "lon"), ("Latitude", "Longitude"), ("latitude", "lng")))
        if style == "metres":
            unit = self.unit(LENGTH)
            named = unit != "m" or self.chance(0.5)
            self.note(f"in {unit}")
            for name, column in (("x", "x"), ("y", "y")):
                self.add_quantity(sheet, name, gps[column], unit, LENGTH[unit], named)
        else:
            unit = {"named": self.pick(("deg", "°", "degrees")), "rad": "rad", "e7 named": "degE7"}.get(
                style, ""
            )
            for name, column in zip(names, ("lat", "lon"), strict=True):
                sheet.add(name, [place_text(v, style, column) for v in gps[column]], unit)
                if style == "hemisphere":
                    letters = "NS" if column == "lat" else "EW"
                    head = {"lat": ("N/S", "lat_dir"), "lon": ("E/W", "lon_dir")}[column][names[0] == "lat"]
                    sheet.add(head, [letters[int(v < 0)] for v in gps[column]])
        if self.chance(0.4):
            unit = self.unit(SPEED)
            self.note(f"speed in {unit}")
            self.add_quantity(
                sheet, "speed", gps["speed"], unit, SPEED[unit], unit != "m/s" or self.chance(0.5)
            )
        if self.chance(0.4):
            unit, named = self.pick(tuple(ANGLE)), self.chance(0.6)
            name = self.pick(("course", "bearing", "heading", "track"))
            self.note(f"{name} in {unit} from north, named {named}")
            self.add_quantity(
                sheet, name, np.mod(np.pi / 2 - gps["course"], 2 * np.pi), unit, ANGLE[unit], named
            )

    def truth(self) -> Sheet:
        sheet, truth = Sheet(), self.case.truth
        assert truth is not None
        self.add_time(sheet, truth["t"])
        unit = self.unit(LENGTH)
        for name in ("x", "y"):
            self.add_quantity(sheet, name, truth[name], unit, LENGTH[unit], unit != "m" or self.chance(0.5))
        if self.chance(0.7):
            unit, named, north = self.pick(tuple(ANGLE)), self.chance(0.6), self.chance(0.5)
            name = self.pick(("theta", "yaw", "heading", "yaw"))
            self.note(
                f"truth's {name} in {unit}{', named' if named else ''}{', from north' if north else ''}"
            )
            angle = np.mod(np.pi / 2 - truth["theta"], 2 * np.pi) if north else truth["theta"]
            self.add_quantity(sheet, name, angle, unit, ANGLE[unit], named)
        else:
            del truth["theta"]
        return sheet

    def placeholders(self, sheet: Sheet) -> None:
        """Rows of no fix at the beginning."""
        if not self.chance(0.25):
            return
        count, cell = int(self.rng.integers(1, 4)), self.pick(("0", "0.0", "-999", "1e10", "", "n/a", "NaN"))
        at = next(i for i, n in enumerate(sheet.names) if n.lower() in ("lat", "latitude", "x"))
        mate = next(i for i, n in enumerate(sheet.names) if n.lower() in ("lon", "longitude", "lng", "y"))
        if sheet.names[at] == "x" and cell.startswith("0"):
            return  # 0, 0 is a place in metres
        self.note(f"{count} fixes of {cell!r}")
        for column in (at, mate):
            sheet.cells[column][:count] = [cell] * count
        self.case.gps = {k: v[count:] for k, v in self.case.gps.items()}

    # Times.

    def pick_clock(self) -> str:
        clocks = (
            "s",
            "ms",
            "us",
            "ns",
            "since start",
            "millis",
            "micros",
            "sec+nsec",
            "header.stamp",
            "week+tow",
            "wrap",
            "excel",
            "datenum",
            "fraction",
            "date",
            "date",
            "date+time",
            "coarse",
            "unit",
            "s",
            "us",
            "restart" if self.chance(0.3) else "s",
            "uneven" if self.chance(0.3) else "ms",
        )
        return self.pick(clocks)

    def add_time(self, sheet: Sheet, t: np.ndarray) -> None:
        case, clock = self.case, self.clock
        stamp = self.epoch + t
        if clock in ("s", "ms", "us", "ns"):
            name = self.__dict__.setdefault(
                "time_name", self.pick(("t", "time", "timestamp", "stamp", "Time"))
            )
            self.number_time(sheet, name, t, TIME[clock])
        elif clock == "since start":
            sheet.add(
                self.__dict__.setdefault(
                    "time_name", self.pick(("time since start in ms", "Time since start (ms)"))
                ),
                [str(round(v * 1e3)) for v in t + 3],
            )
        elif clock in ("millis", "micros"):
            sheet.add(clock, [str(round((v + 3) * (1e3 if clock == "millis" else 1e6))) for v in t])
        elif clock in ("sec+nsec", "header.stamp"):
            pairs = (
                ("sec", "nsec"),
                ("seconds", "nanoseconds"),
                ("secs", "nsecs"),
                ("header.stamp.secs", "header.stamp.nsecs"),
            )
            names = (
                pairs[3]
                if clock == "header.stamp"
                else self.__dict__.setdefault("time_names", self.pick(pairs))
            )
            if clock == "header.stamp":
                sheet.add("time", [f"{v + 0.4 * self.rng.random():.6f}" for v in stamp])
            ns = [round(v * 1e9) + int(self.epoch) * 10**9 for v in t]
            sheet.add(names[0], [str(n // 10**9) for n in ns])
            sheet.add(names[1], [str(n % 10**9) for n in ns])
        elif clock == "week+tow":
            start = 2300 * 604800 + 604800 - 10.0  # over a week's end
            ticks = [round((start + v) * 1e3) for v in t]
            sheet.add("gps_week", [str(n // 604800000) for n in ticks])
            sheet.add("tow_ms", [str(n % 604800000) for n in ticks])
        elif clock == "wrap":
            unit = self.__dict__.setdefault("wrap", self.pick(("us", "ms")))
            scale = 1e6 if unit == "us" else 1e3
            sheet.add(
                {"us": "micros", "ms": "millis"}[unit],
                [str(int(round(v * scale) + 2**32 - 10 * scale) % 2**32) for v in t],
            )
        elif clock in ("excel", "datenum", "fraction"):
            days = {"excel": 45406.0, "datenum": 739000.0, "fraction": 0.0}[clock] + 0.4
            sheet.add("time", [f"{days + v / 86400:.12f}" for v in t])
        elif clock in ("date", "date+time"):
            form = self.__dict__.setdefault("form", self.pick(DATES[:-1] if clock == "date+time" else DATES))
            moment = [datetime.datetime.fromtimestamp(1_714_000_000 + v, datetime.UTC) for v in t]
            if clock == "date":
                self.note(form)
                sheet.add("Timestamp", [m.strftime(form) for m in moment])
            else:
                sheet.add("Date", [m.strftime("%Y-%m-%d") for m in moment])
                sheet.add("Time", [m.strftime("%H:%M:%S.%f") for m in moment])
        elif clock == "coarse":
            sheet.add("time", [str(int(v)) for v in stamp])
        elif clock == "uneven":
            uneven = self.rng.permutation(len(t)) * 0 + np.floor(t + 0.8 * np.sin(t) ** 2)
            sheet.add("time", [str(int(v)) for v in np.maximum.accumulate(uneven)])
        elif clock == "unit":
            unit = self.__dict__.setdefault("time_unit", self.pick(tuple(TIME)))
            self.number_time(sheet, "time", t, TIME[unit])
            sheet.units[-1] = unit
        else:  # the clock restarts in the middle
            half = case.imu["t"][len(case.imu["t"]) // 2]
            sheet.add("t", [f"{v - half if v >= half else v:.6f}" for v in t])

    def number_time(self, sheet: Sheet, name: str, t: np.ndarray, scale: float) -> None:
        if scale < 1:
            sheet.add(name, [str(round(v / scale) + round(self.epoch / scale)) for v in t])
        elif scale == 1:
            sheet.add(name, [f"{v:.6f}" for v in t + self.epoch])
        else:
            sheet.add(name, [f"{v / scale:.12f}" for v in t])

    # Dialects.

    def save(self, name: str, sheet: Sheet) -> None:
        separator = self.pick((",", ",", ",", ";", "\t", "|"))
        comma = separator == ";" and self.chance(0.6)
        titles, units_row = self.titles(sheet)
        rows = [list(r) for r in zip(*sheet.cells, strict=True)]
        if comma:
            numeric = [all(is_plain(c) for c in column) for column in sheet.cells]
            rows = [[c.replace(".", ",") if n else c for c, n in zip(r, numeric, strict=True)] for r in rows]
        style = self.pick(
            (
                "plain",
                "plain",
                "plain",
                "hash",
                "above",
                "sep=",
                "other header",
                "none" if self.chance(0.2) else "plain",
            )
        )
        dressing = self.pick(("", "", "padded", "trailing", "trailing all", "quoted", "bom", "crlf"))
        self.note(
            f"{name}: {separator!r} {style} {dressing}{' decimal comma' if comma else ''}"
            f"{' units row' if units_row else ''}"
        )
        cell: Callable[[str], str] = {"padded": "{:>18}".format, "quoted": '"{}"'.format}.get(dressing, str)
        end = separator if dressing.startswith("trailing") else ""
        lines = [separator.join(map(cell, row)) + end for row in rows]
        head = separator.join(titles) + (separator if dressing == "trailing all" else "")
        if dressing == "quoted":
            head = separator.join(f'"{t}"' for t in titles)
        if style == "other header" and separator == ",":
            head = self.pick(("\t", "|")).join(titles)
        if units_row:
            lines.insert(0, separator.join(sheet.units))
        above = {
            "hash": [],
            "none": [],
            "above": ["Logger 3.1", "# recorded on Monday", ""],
            "sep=": [f"sep={separator}"],
        }
        lines = (
            above.get(style, [])
            + ([("#" if style == "hash" else "") + head] if style != "none" else [])
            + lines
        )
        text = ("\r\n" if dressing == "crlf" else "\n").join(lines) + "\n"
        (self.folder / name).write_bytes(text.encode("utf-8-sig" if dressing == "bom" else "utf-8"))

    def titles(self, sheet: Sheet) -> tuple[list[str], bool]:
        pairs = list(zip(sheet.names, sheet.units, strict=True))
        if self.unit_style == "row" and any(sheet.units):
            return sheet.names, True
        forms = {"brackets": "{} [{}]", "parentheses": "{} ({})", "suffix": "{}_{}", "row": "{} [{}]"}
        titles = []
        for name, unit in pairs:
            said = SUFFIXES.get(unit, unit) if self.unit_style == "suffix" else unit
            form = forms[self.unit_style]
            if self.unit_style == "suffix" and not said.replace("_", "").isalnum():
                form = forms["brackets"]
            titles.append(form.format(name, said) if unit else name)
        return titles, False


def is_plain(text: str) -> bool:
    """Whether a cell is a number or empty."""
    try:
        return text in ("", "nan", "n/a", "NaN") or float(text) == float(text)
    except ValueError:
        return False


def place_text(value: float, style: str, column: str) -> str:
    """A latitude or longitude as a style writes it."""
    if style in ("e7", "e7 named"):
        return str(round(value * 1e7))
    if style == "rad":
        return f"{np.radians(value):.12f}"
    if style == "ddmm":
        degrees, sign = divmod(abs(value), 1.0)[0], "-" if value < 0 else ""
        return f"{sign}{int(degrees * 100) + (abs(value) - degrees) * 60:.8f}"
    if style == "360" and column == "lon":
        return f"{value % 360:.9f}"
    if style == "hemisphere":
        return f"{abs(value):.9f}"
    return f"{value:.9f}"


def make(seed: int, folder: Path) -> Case:
    """Write the tables of a seed into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    return Writer(seed, folder).write()


def verdict(case: Case) -> tuple[str, str]:
    """``right``, ``refused`` or ``wrong``, and why."""
    try:
        got = import_drive(Request(case.source), "odd").drive
    except InputError as error:
        line = str(error)
        return (
            ("refused", line)
            if "\n" not in line and len(line) < 1500
            else ("wrong", f"no clear line: {line}")
        )
    faults = list(differences(got, case))
    return ("wrong", "; ".join(faults)) if faults else ("right", "")


def differences(got: Drive, case: Case):
    """What a drive that was read has otherwise than the known one."""
    imu, gps = case.imu, case.gps
    if (
        abs(len(got.imu) - len(imu["t"])) > max(2, 0.02 * len(imu["t"]))
        or len(got.gps) < 0.9 * len(gps["t"]) - 2
    ):
        yield f"{len(got.imu)} of {len(imu['t'])} samples, {len(got.gps)} of {len(gps['t'])} fixes"
        return
    tolerance = 1.01 if "coarse" in case.map_arguments[0] and False else 0.03
    start = got.imu.time[0]
    at = got.imu.time - start
    if abs(at[-1] - (imu["t"][-1] - imu["t"][0])) > tolerance:
        yield f"lasts {at[-1]:.3f} s instead of {imu['t'][-1]:.3f}"
        return
    for name in ("ax", "ay", "az", "gx", "gy", "gz"):
        values = getattr(got.imu, name)
        if values is None:
            yield f"{name} is missing"
            continue
        error = float(np.median(np.abs(values - np.interp(at, imu["t"], imu[name]))))
        if error > 0.02 * np.ptp(imu[name]) + 1e-3:
            yield f"{name} is off by {error:.3g}"
    drift = np.median(got.gps.time - start)
    expected = np.median(gps["t"])
    if abs(drift - expected) > 0.6 * (gps["t"][1] - gps["t"][0]) + 0.05:
        yield f"fixes at {drift:.3f} s instead of {expected:.3f}"
    yield from _placed(got, gps, start)
    if got.gps.speed is not None:
        error = np.median(np.abs(got.gps.speed - np.interp(got.gps.time - start, gps["t"], gps["speed"])))
        if error > 0.3:
            yield f"speed is off by {error:.3g}"
    if got.gps.course is not None:
        true = np.exp(1j * np.unwrap(gps["course"]))
        angle = np.interp(got.gps.time - start, gps["t"], np.unwrap(np.angle(true)))
        error = np.median(np.abs(wrap_angle(got.gps.course - angle)))
        if error > 0.1:
            yield f"course is off by {error:.3g}"
    if case.truth is not None and got.truth is not None:
        yield from _true(got, case.truth, start)


def _placed(got: Drive, gps: Columns, start: float):
    origin = got.origin or (gps["lat"][0], gps["lon"][0], gps["alt"][0])
    if got.gps.lat is None:
        x, y = gps["x"], gps["y"]
    else:
        enu = geodetic_to_enu(gps["lat"], gps["lon"], np.full(len(gps["t"]), origin[2]), origin)
        x, y = enu[:, 0], enu[:, 1]
    now = got.gps.time - start
    error = np.median(
        np.hypot(got.gps.x - np.interp(now, gps["t"], x), got.gps.y - np.interp(now, gps["t"], y))
    )
    if error > 1.5:
        yield f"fixes are off by {error:.3g} m"


def _true(got: Drive, truth: Columns, start: float):
    now = got.truth.time - start
    x = got.truth.x - np.interp(now, truth["t"], truth["x"])
    y = got.truth.y - np.interp(now, truth["t"], truth["y"])
    if np.ptp(x) + np.ptp(y) > 1.0:
        yield f"truth is off by {np.ptp(x):.3g} m"
    if "theta" in truth:
        angle = np.interp(now, truth["t"], np.unwrap(truth["theta"]))
        error = np.median(np.abs(wrap_angle(got.truth.theta - angle)))
        if error > 0.1:
            yield f"truth's heading is off by {error:.3g}"
