"""Times in two columns, counters that overflow, clocks that restart, rounded stamps, days, dates."""

import datetime
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from importing.logs import EPOCH, a_drive, assert_close, imported
from sigmaswarm.errors import InputError
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.timeline import spread_stamps, unwrap
from support import quickly, several, some

DRIVE = a_drive(12.0)
IMU, GPS = DRIVE.imu, DRIVE.gps
Cells = Callable[[float], str]


def write(
    folder: Path, head: str, cells: Cells, gps_head: str | None = None, gps_cells: Cells | None = None
) -> None:
    """The drive's two tables with times of a form."""
    rows = zip(IMU.time.tolist(), IMU.ax, IMU.ay, IMU.az, IMU.gz, strict=True)
    (folder / "imu.csv").write_text(
        "\n".join([f"{head},ax,ay,az,gz", *(f"{cells(t)},{a},{b},{c},{g}" for t, a, b, c, g in rows)])
    )
    rows = zip(GPS.time.tolist(), GPS.lat.tolist(), GPS.lon.tolist(), strict=True)
    told = gps_cells or cells
    (folder / "gps.csv").write_text(
        "\n".join([f"{gps_head or head},lat,lon", *(f"{told(t)},{a!r},{b!r}" for t, a, b in rows)])
    )


def apart(folder: Path, **options) -> float:
    """The largest error of a time, s, from the IMU's first sample on, of IMU and fixes."""
    drive = imported(folder, **options).drive
    assert len(drive.imu) == len(IMU)
    imu, gps = (t - drive.imu.time[0] for t in (drive.imu.time, drive.gps.time))
    known = GPS.time[len(GPS) - len(gps) :] - IMU.time[0]
    return float(max(np.abs(imu - (IMU.time - IMU.time[0])).max(), np.abs(gps - known).max()))


def maps_in(message: str) -> list[str]:
    """The options that a message proposes."""
    return re.findall(r'"((?:imu|gps)\.[^"]+)"', message)


def split(scale: int, begin: int = EPOCH) -> Cells:
    def cells(t: float) -> str:
        ticks = round(t * scale) + begin * scale
        return f"{ticks // scale},{ticks % scale}"

    return cells


def exact_week(t: float) -> str:
    ticks = round((2311 * 604800 - 5 + t) * 1000)
    return f"{ticks // 604800000},{ticks % 604800000 / 1000:.3f}"


def words(ticks: float, start: float, *, signed: bool = False) -> Callable[[float], str]:
    def of(t: float) -> str:
        high, low = divmod(round((start + t) * ticks), 2**32)
        return f"{high},{low - 2**32 if signed and low >= 2**31 else low}"

    return of


TWO_COLUMNS: dict[str, tuple[str, Cells]] = {
    "seconds, nanoseconds": ("seconds,nanoseconds", split(10**9)),
    "sec, nsec": ("sec,nsec", split(10**9)),
    "since the start": ("secs,nsecs", split(10**9, 58426)),
    "stamp.sec, stamp.nanosec": ("stamp.sec,stamp.nanosec", split(10**9)),
    "tv_sec, tv_usec": ("tv_sec,tv_usec", split(10**6)),
    "s, and ms of the second": ("time_s,time_ms", split(10**3)),
    "header before the time of receipt": (
        "time,header.stamp.secs,header.stamp.nsecs",
        lambda t: f"{EPOCH + t + 0.3 * (t * 7 % 1):.6f},{split(10**9)(t)}",
    ),
    "a header's stamp in one column": (
        "%time,field.header.stamp",
        lambda t: f"{EPOCH * 10**9},{round(t * 1e9) + EPOCH * 10**9}",
    ),
    "two words of us": ("time_hi,time_lo", words(1e6, EPOCH)),
    "two words of ns": ("timestamp_high,timestamp_low", words(1e9, EPOCH)),
    "two words of us since boot": ("ts_msb,ts_lsb", words(1e6, 4290)),
    "two words, signed": ("t_upper,t_lower", words(1e6, 4290, signed=True)),
    "week and time of week, s": ("gps_week,tow", exact_week),
    "week and time of week, ms": (
        "week,iTOW",
        lambda t: (
            f"{round((2311 * 604800 - 5 + t) * 1e3) // 604800000},"
            f"{round((2311 * 604800 - 5 + t) * 1e3) % 604800000}"
        ),
    ),
    "WN and TOW [ms]": (
        "GPS WN,TOW [ms]",
        lambda t: (
            f"{round((2311 * 604800 - 5 + t) * 1e3) // 604800000},"
            f"{round((2311 * 604800 - 5 + t) * 1e3) % 604800000}"
        ),
    ),
    "date and time": (
        "Date,Time",
        lambda t: datetime.datetime.fromtimestamp(EPOCH + t, datetime.UTC).strftime("%Y-%m-%d,%H:%M:%S.%f"),
    ),
    "day and time of day": (
        "date,utc_time",
        lambda t: datetime.datetime.fromtimestamp(EPOCH + t, datetime.UTC).strftime("%d.%m.%Y,%H:%M:%S.%f"),
    ),
}


@pytest.mark.parametrize("form", some(TWO_COLUMNS))
def test_two_columns_are_one_time(tmp_path: Path, form: str):
    write(tmp_path, *TWO_COLUMNS[form])
    assert apart(tmp_path) < (1.1e-3 if "ms" in form or "week" in form else 2e-6)


def test_week_and_time_of_week_are_utc(tmp_path: Path):
    write(tmp_path, "week,tow", exact_week, "t", lambda t: f"{2311 * 604800 - 5 + t + 315964800 - 18:.3f}")
    assert apart(tmp_path) < 1e-3


NAMED: dict[str, tuple[str, Cells]] = {
    "micros": ("micros", lambda t: str(round((t + 3) * 1e6))),
    "millis": ("millis", lambda t: str(round((t + 3) * 1e3))),
    "time since start in ms": ("time since start in ms", lambda t: str(round(t * 1e3))),
    "Time since start (us)": ("Time since start (us)", lambda t: str(round(t * 1e6))),
    "TimeUS": ("TimeUS", lambda t: str(round((t + 3) * 1e6))),
    "usec": ("usec", lambda t: str(round((t + 3) * 1e6))),
    "msec since boot": ("msec since boot", lambda t: str(round((t + 3) * 1e3))),
    "seconds_elapsed": ("seconds_elapsed", repr),
    "time [min]": ("time [min]", lambda t: repr(t / 60)),
    "time (h)": ("time (h)", lambda t: repr(t / 3600)),
    "t_days": ("time_days", lambda t: repr(t / 86400)),
    "t_imu": ("t_imu", repr),
    "ticks since year 1": ("t", lambda t: str(621_355_968_000_000_000 + round((EPOCH + t) * 1e7))),
    "ticks since 1601": ("t", lambda t: str(116_444_736_000_000_000 + round((EPOCH + t) * 1e7))),
    "elapsed": ("elapsed", lambda t: f"0:00:{t:09.6f}"),
    "utc_time": ("utc_time", repr),
    "an index of pandas": (
        "",
        lambda t: datetime.datetime.fromtimestamp(EPOCH + t, datetime.UTC).isoformat(timespec="microseconds"),
    ),
    "an index in s": ("", lambda t: f"{EPOCH + t:.4f}"),
    "ticks and a time": ("Tick#,offsetTime", lambda t: f"{round(4.5e6 * t)},{t:.4f}"),
    "datenum": ("datenum", lambda t: f"{719529 + (EPOCH + t) / 86400:.12f}"),
}


@pytest.mark.parametrize("form", some(NAMED))
def test_names_of_times(tmp_path: Path, form: str):
    write(tmp_path, *NAMED[form])
    assert apart(tmp_path) < 1.1e-3


@pytest.mark.parametrize(
    ("name", "scale", "period"),
    [
        ("micros", 1e6, 2**32),
        ("millis", 1e3, 2**32),
        ("t_ms", 1e3, 2**31),
        ("timestamp_ms", 1e3, 2**32),
        ("millis", 1e3, 2**16),
        ("t_us", 1e6, 2**32),
        ("tow_ms", 1e3, 604_800_000),
        ("GPS_SecondsOfWeek", 1, 604_800),
        ("time_of_day", 1, 86400),
    ],
)
@pytest.mark.parametrize("before", quickly([(4.0,), (11.0,)], lambda before: before == 4.0))
def test_counters_that_wrap_go_on(tmp_path: Path, name: str, scale: float, period: int, before: float):
    write(tmp_path, name, lambda t: f"{(round(t * scale, 6) - before * scale) % period:.10g}")
    assert apart(tmp_path) < 1.1e-3
    assert any("unwrapped" in note for note in imported(tmp_path).notes)


@pytest.mark.parametrize("start", [0, 1_700_000_000 * 10**9])
@pytest.mark.parametrize("later", [359, 369, 380])
def test_two_rows_that_changed_places_are_no_counter_that_wraps(start: int, later: int):
    """A fall of 3.5 to 3.7 s is near the period of a 32-bit counter of nanoseconds, 4.3 s."""
    time = start + 10_000_000 * np.arange(400)
    time[[15, later]] = time[[later, 15]]
    found, period, said = unwrap(time)
    assert not said and not period
    np.testing.assert_array_equal(found, time)


DAYS: dict[str, Cells] = {
    "spreadsheet": lambda t: f"{45406.96 + t / 86400:.11f}",
    "datenum": lambda t: f"{739367.5 + t / 86400:.12f}",
    "share of a day": lambda t: f"{0.4 + t / 86400:.12f}",
    "share of a day before noon": lambda t: f"{0.49999 + t / 86400:.9f}",
    "share of a day in the evening": lambda t: f"{0.9 + t / 86400:.11f}",
    "spreadsheet over midnight": lambda t: f"{45407 - 5 / 86400 + t / 86400:.11f}",
}


@pytest.mark.parametrize("form", DAYS)
def test_days(tmp_path: Path, form: str):
    write(tmp_path, "time", DAYS[form])
    assert apart(tmp_path) < 1e-4
    assert any("days" in note for note in imported(tmp_path).notes)


@pytest.mark.parametrize("decimals", [5, 6, 7])
def test_rounded_days_are_spread_evenly(tmp_path: Path, decimals: int):
    """Steps of the last decimal are 0.864 s, 0.0864 s and 0.00864 s."""
    write(tmp_path, "time", lambda t: f"{45406.96296 + t / 86400:.{decimals}f}")
    got = imported(tmp_path)
    errors = np.append(got.drive.imu.time - IMU.time, got.drive.gps.time - GPS.time[-len(got.drive.gps) :])
    assert np.ptp(errors) < 0.15 * 86400 / 10**decimals + 0.009
    assert any("times in days are rounded to" in note for note in got.notes)


@pytest.mark.parametrize("decimals", [5, 6])
@pytest.mark.parametrize("rate", [1.0, 2.0, 10.0, 100.0])
def test_rounded_days_of_an_uneven_rate_are_refused_with_their_error(rate: float, decimals: int):
    def stamps(time: np.ndarray) -> np.ndarray:
        return np.round(
            np.round((45406.5 + time / 86400) * 10**decimals) * 864 * 10 ** (11 - decimals)
        ).astype(np.int64)

    time = np.arange(round(300 * rate)) / rate
    spread, said = spread_stamps(stamps(time), "gps", "gps.csv")
    rounding = 86400 / 10**decimals
    if rounding > 0.2 / rate:
        assert said.startswith(f"the times in days are rounded to {rounding:.3g} s; rows are spread evenly")
        assert np.ptp(spread / 1e9 - time) < 0.3 * rounding
    uneven = np.cumsum(np.random.default_rng(1).exponential(1 / rate, len(time)))
    if 1 / rate < 2 * rounding and rate <= 2:
        with pytest.raises(InputError, match=r"gps.csv: the times in days are rounded to .* more decimals"):
            spread_stamps(np.unique(stamps(uneven)), "gps", "gps.csv")


@pytest.mark.parametrize(("scale", "begin"), [(3600.0, 0.0), (86400.0, 0.0), (86400.0, 1 - 5 / 86400)])
def test_a_unit_that_can_not_be_known_is_refused_and_the_remedy_helps(
    tmp_path: Path, scale: float, begin: float
):
    write(tmp_path, "time", lambda t: f"{(begin + t / scale) % 1:.14f}")
    with pytest.raises(InputError, match="too short for seconds") as caught:
        imported(tmp_path)
    time = re.search(r'--map "imu\.t=([^"]+)\*86400"', str(caught.value))[1]
    assert apart(tmp_path, time=f"{time}*{scale:g}") < 1e-4


@pytest.mark.parametrize("time", ["t*1e-6", "t - 5 + 0*ax", "where(t > 3, t*1e-6, t*1e-6)"])
def test_stated_times_pass_the_same_check(tmp_path: Path, time: str):
    write(tmp_path, "t", lambda t: repr(t))
    if "1e-6" in time:
        with pytest.raises(InputError, match="rows of the imu would be"):
            imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", time=time)
    else:
        imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", time=time, maps=["gps.t=t-5"])


DATES = (
    "%d-%b-%Y %H:%M:%S.%f",
    "%d-%b-%y %H:%M:%S.%f",
    "%d.%m.%y %H:%M:%S.%f",
    "%Y/%m/%d %H:%M:%S.%f",
    "%d.%m.%Y %H:%M:%S.%f",
    "%d/%m/%Y %H:%M:%S.%f",
    "%m/%d/%Y %I:%M:%S.%f %p",
    "%Y-%m-%dT%H:%M:%S.%fZ",
    "%Y-%m-%d %H:%M:%S.%f+02:00",
    "%H:%M:%S.%f",
    "%Y%m%d %H%M%S.%f",
    "%Y-%m-%d_%H-%M-%S.%f",
    "%Y-%m-%d %I:%M:%S.%f %p",
    "%I:%M:%S.%f %p",
)


@pytest.mark.parametrize(("begin", "form"), [(EPOCH, "%Y%m%d%H%M%S%f"), (EPOCH + 86_390, "%Y%m%d%H%M%S%f")])
def test_whole_numbers_with_the_digits_of_a_date(tmp_path: Path, begin: int, form: str):
    """Milliseconds since 1970 and the next day; 20231114221320123 is neither."""

    def cells(t: float) -> str:
        return datetime.datetime.fromtimestamp(begin + t + 1e-5, datetime.UTC).strftime(form)[:-3]

    write(tmp_path, "timestamp", cells)
    assert apart(tmp_path) < 1.1e-3 and imported(tmp_path).drive.metadata["time_origin_s"] == begin


@pytest.mark.parametrize("form", some(DATES, 4))
def test_dates(tmp_path: Path, form: str):
    write(
        tmp_path,
        "Timestamp",
        lambda t: datetime.datetime.fromtimestamp(EPOCH + t, datetime.UTC).strftime(form),
    )
    assert apart(tmp_path) < 2e-6


def at(t: float, form: str, begin: int = EPOCH) -> str:
    """A time of the drive, in the form of `strftime`."""
    return datetime.datetime.fromtimestamp(begin + round(t, 6), datetime.UTC).strftime(form)


BEFORE_A_MINUTE = 1_700_002_794
"""s, six seconds before a full minute: the drive lasts 12 s."""


@pytest.mark.parametrize("head", ["utc", "time", "date,time"])
def test_digits_of_hours_minutes_and_seconds_are_no_seconds(tmp_path: Path, head: str):
    day = "141123," if "," in head else ""
    write(tmp_path, head, lambda t: day + at(t, "%H%M%S.%f", BEFORE_A_MINUTE))
    assert apart(tmp_path) < 2e-6
    assert any("(hhmmss) and are converted" in note for note in imported(tmp_path).notes)


@pytest.mark.parametrize("one", ["imu", "gps"])
def test_digits_within_a_minute_are_mapped_where_the_others_cross_one(tmp_path: Path, one: str):
    """The table that does not cross a minute is shorter: its digits count like seconds."""
    write(tmp_path, "utc", lambda t: at(t, "%H%M%S.%f", BEFORE_A_MINUTE))
    file = tmp_path / f"{one}.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([head, *rows[: len(rows) // 2 - 5]]))
    with pytest.raises(
        InputError, match=r"convert both to one clock; if the times of .* are digits"
    ) as caught:
        imported(tmp_path)
    drive = imported(tmp_path, maps=maps_in(str(caught.value))).drive
    begin = BEFORE_A_MINUTE % 86400
    np.testing.assert_allclose(drive.imu.time[:100], begin + IMU.time[:100], atol=2e-6)
    np.testing.assert_allclose(drive.gps.time[:10], begin + GPS.time[-len(GPS) :][:10], atol=2e-6)


@pytest.mark.parametrize("begin", [43_170.5, 115_972.0, 250_000.0, 115_912.0])
def test_other_clocks_apart_get_the_remedy_of_an_offset(tmp_path: Path, begin: float):
    """Seconds that are no digits, and digits that would not overlap with the others either."""
    write(tmp_path, "t", lambda t: repr(t + 7000), gps_cells=lambda t: repr(t + begin))
    with pytest.raises(
        InputError, match=r"convert both to one clock: .*--gps-offset \S+ if both logs began at the same time"
    ):
        imported(tmp_path)


@pytest.mark.parametrize("heads", [("t", "t"), ("log_time", "log_time"), ("utc", "time")])
def test_numbers_with_two_guessed_units_are_one_clock(tmp_path: Path, heads: tuple[str, str]):
    """Hundredths of a second: steps of 4 look like ms of an IMU, steps of 10 like seconds of fixes."""
    write(tmp_path, heads[0], lambda t: f"{round(t * 100) * 4}", heads[1], lambda t: f"{round(t * 50)}")
    with pytest.raises(
        InputError, match=r"overlap, so they have the same unit, but .* have different factors; write"
    ) as caught:
        imported(tmp_path)
    options = str(caught.value).split("write --map ")[1].split(", or ")
    (maps,) = (maps_in(o) for o in options if "for 25 Hz and 10 Hz" in o)
    drive = imported(tmp_path, maps=maps).drive
    np.testing.assert_allclose(drive.imu.time, IMU.time * 4, atol=4e-2)
    np.testing.assert_allclose(drive.gps.time, GPS.time / 2, atol=1e-2)


UNITS_APART: dict[str, tuple[Cells, Cells]] = {
    "IMU in ms": (lambda t: f"{t * 1e3:.3f}", lambda t: f"{t:.6f}"),
    "fixes in ms": (lambda t: f"{t:.6f}", lambda t: f"{t * 1e3:.3f}"),
    "both in ms": (lambda t: f"{t * 1e3:.3f}", lambda t: f"{t * 1e3:.3f}"),
    "ms and ns": (lambda t: f"{t * 1e9:.0f}", lambda t: f"{t * 1e3:.3f}"),
}


@pytest.mark.parametrize("case", UNITS_APART)
def test_units_that_fit_are_not_refused(tmp_path: Path, case: str):
    imu, gps = UNITS_APART[case]
    write(tmp_path, "t", imu, gps_cells=gps)
    assert apart(tmp_path) < 2e-6


def test_two_clocks_that_began_apart_get_the_remedy_of_an_offset(tmp_path: Path):
    write(tmp_path, "t", lambda t: f"{t * 1e3 + 5e7:.3f}", gps_cells=lambda t: repr(t))
    with pytest.raises(
        InputError, match=r"convert both to one clock: .*--gps-offset \S+ if both logs began at the same time"
    ):
        imported(tmp_path)


@pytest.mark.parametrize("pause", some([40.0, 45.0, 3040.0], 3))
@pytest.mark.parametrize("begin", [54.0, 115_950.0, 115_852.0])
def test_a_pause_of_seconds_is_no_minute(tmp_path: Path, pause: float, begin: float):
    write(tmp_path, "t", lambda t: repr(begin + t + (pause if t > 7 else 0.0)))
    got = imported(tmp_path).drive.imu.time
    np.testing.assert_allclose(got, begin + IMU.time + np.where(IMU.time > 7, pause, 0.0), atol=1e-6)


@pytest.mark.parametrize("form", ["date,time", "stamp"])
def test_a_date_that_stays_at_midnight(tmp_path: Path, form: str):
    """Some loggers write the date of the first row in all rows."""
    begin = 1_700_006_400 - 6
    write(tmp_path, form, lambda t: f"2023-11-14{',' if ',' in form else ' '}{at(t, '%H:%M:%S.%f', begin)}")
    assert apart(tmp_path) < 2e-6


@pytest.mark.parametrize("form", some(["%d/%m/%Y", "%m/%d/%Y"]))
def test_of_two_dates_and_times_the_finer_one_is_taken(tmp_path: Path, form: str):
    write(
        tmp_path,
        "gps_Date,gps_Time,rtcDate,rtcTime",
        lambda t: at(t, f"{form},%H:%M:%S,") + at(t, "%m/%d/%Y,%H:%M:%S.%f"),
    )
    assert apart(tmp_path) < 2e-6


@pytest.mark.parametrize(
    ("head", "form"),
    several(
        [
            ("local_date,utc_date,utc_time", "2001-01-01,%Y-%m-%d,%H:%M:%S.%f"),
            ("local_date,local_time,utc_date,utc_time", "2001-01-01,%H:%M:%S.%f,%Y-%m-%d,%H:%M:%S.%f"),
            ("session_date,date,time", "2001-01-01,%Y-%m-%d,%H:%M:%S.%f"),
            ("timestamp,time,last_update", "%Y-%m-%d %H:%M:%S.%f,01:%M:%S.%f,2001-01-01"),
            ("timestamp,time,update", "%Y-%m-%d %H:%M:%S.%f,%H:%M:%S.%f,yes"),
            ("timestamp,time,weekday", "%Y-%m-%d %H:%M:%S.%f,%H:%M:%S.%f,%a"),
            ("timestamp,time,day", "%Y-%m-%d %H:%M:%S.%f,%H:%M:%S.%f,%a"),
            ("log_date,log_time", "%Y-%m-%d,%H:%M:%S.%f"),
        ]
    ),
)
def test_a_date_is_that_of_its_time(tmp_path: Path, head: str, form: str):
    begin = BEFORE_A_MINUTE
    write(tmp_path, head, lambda t: at(t, form, begin), "t", lambda t: repr(begin + t))
    assert apart(tmp_path) < 2e-6


@pytest.mark.parametrize(
    ("cells", "first"),
    [
        (
            lambda t: f"{'' if t < 4 else '1:00:'}{(56 + t) % 60:09.6f}" if t >= 4 else f"59:{56 + t:09.6f}",
            "59:56",
        ),
        (lambda t: f"{at(t, '%H:%M:%S')}:{round(t * 1e3) % 1000}", ":0'"),
        (
            lambda t: at(t, f"%m/%d/%Y %I:%M:%S.%f{' %p' if round(t * 100) % 7 else ''}"),
            "11/14/2023 10:13:20",
        ),
        (lambda t: at(t, "%d/%m/2023 %H:%M:%S" if t else "13/03/2023 %H:%M:%S", 1_717_459_200), "may be two"),
    ],
)
def test_times_in_two_formats_are_refused(tmp_path: Path, cells: Cells, first: str):
    """Rows of another format than most were once left out without a question."""
    write(tmp_path, "t", cells)
    with pytest.raises(
        InputError, match=f"{first}.*(?:has a format different from that|different days)"
    ) as caught:
        imported(tmp_path)
    found = dict(remedy.split(".t=", 1) for remedy in reversed(maps_in(str(caught.value))))
    maps = [f"{role}.t={text}" for role, text in found.items()]
    assert 0.6 * len(IMU) < len(imported(tmp_path, maps=maps).drive.imu) <= len(IMU)


@pytest.mark.parametrize(
    ("cells", "said", "time"),
    [
        (lambda t: str(round(t * 2e4)), "no unit of time fits steps of 200", None),
        (lambda t: repr(t / 60), "steps of 0.00017 are too short for seconds", "t*60"),
        (lambda t: f"{t:.2f} beats", "'0.00 beats' is not a date of a known format", None),
        (
            lambda t: at(t, "%d=%m=%Y %H:%M:%S.%f"),
            "is not a date of a known format",
            "utc(t, '%d=%m=%Y %H:%M:%S%.f')",
        ),
    ],
)
def test_a_time_that_may_be_anything_is_refused_and_the_remedy_helps(tmp_path: Path, cells, said: str, time):
    write(tmp_path, "t", cells)
    with pytest.raises(InputError, match=re.escape(said)):
        imported(tmp_path)
    if time is not None:
        assert apart(tmp_path, time=time) < 2e-6


def test_a_broken_date_costs_its_row_only(tmp_path: Path):
    write(tmp_path, "t", lambda t: "1#:3" if t == 0.05 else at(t, "%d.%m.%Y %H:%M:%S.%f"))
    assert len(imported(tmp_path).drive.imu) == len(IMU) - 1


def test_rows_that_all_have_one_time_are_refused_and_the_remedy_helps(tmp_path: Path):
    write(tmp_path, "t", lambda t: "1.70000E+09", "t", repr)
    with pytest.raises(InputError, match="all 1201 rows have the same time") as caught:
        imported(tmp_path)
    assert "all 1201 rows have the same time" in " ".join(inspect_request(Request(tmp_path)).notes)
    remedy = re.search(r'--map "([^"]+)"', str(caught.value))[1]
    assert apart(tmp_path, maps=[remedy]) < 1e-9


@pytest.mark.parametrize(
    ("name", "first"),
    [("Date (DMY)", "%d/%m/%Y"), ("date (MM/DD/YYYY)", "%m/%d/%Y"), ("Date [dd/mm/yy]", "%d/%m/%y")],
)
def test_the_name_of_a_column_states_the_order_of_day_and_month(tmp_path: Path, name: str, first: str):
    begin = 1_717_459_200  # 4 June 2024
    form = f"{first} %H:%M:%S.%f"
    write(tmp_path, name, lambda t: datetime.datetime.fromtimestamp(begin + t, datetime.UTC).strftime(form))
    assert imported(tmp_path).drive.metadata["time_origin_s"] == begin


@pytest.mark.parametrize("first", some(["%d/%m/%Y", "%m/%d/%Y", "%d/%m/%y", "%y/%m/%d"], 3))
def test_a_date_that_may_be_two_days_is_refused_and_the_remedy_helps(tmp_path: Path, first: str):
    begin = 1_717_459_200  # 4 June 2024
    form = f"{first} %H:%M:%S.%f"
    write(tmp_path, "time", lambda t: datetime.datetime.fromtimestamp(begin + t, datetime.UTC).strftime(form))
    with pytest.raises(InputError, match="may be two different days") as caught:
        imported(tmp_path)
    maps = [text for text in maps_in(str(caught.value)) if first in text]
    drive = imported(tmp_path, maps=maps).drive
    assert len(maps) == 2
    assert drive.metadata["time_origin_s"] == begin


@pytest.mark.parametrize(("digits", "offset"), [(0, 0.0), (0, 0.43), (1, 0.0), (1, 0.03)])
def test_coarse_stamps_are_spread_evenly(tmp_path: Path, digits: int, offset: float):
    """Whole seconds, or tenths: the drive has 100 samples a second, and the first stamp may lack some."""
    scale = 10**digits
    write(
        tmp_path,
        "t",
        lambda t: f"{np.floor((t + offset) * scale + 1e-6) / scale:.{digits}f}",
        "t",
        lambda t: repr(t + offset),
    )
    got = imported(tmp_path)
    assert len(got.drive.imu) == len(IMU)
    assert np.abs(got.drive.imu.time - IMU.time - offset).max() < 0.011
    assert any("spread evenly" in note for note in got.notes)


def test_fixes_with_coarse_stamps_are_spread_evenly(tmp_path: Path):
    write(tmp_path, "t", repr, "t", lambda t: str(int(t + 1e-6)))
    got = imported(tmp_path)
    np.testing.assert_allclose(np.diff(got.drive.gps.time), np.diff(GPS.time), atol=1e-6)
    assert np.abs(got.drive.gps.time - GPS.time).max() < 0.2


def bursts(count: int, lag: float, within: float) -> Cells:
    """Stamps of rows that wait for the last one of their burst."""
    times = (IMU if count == 10 else GPS).time
    step, rng = times[1] - times[0], np.random.default_rng(1)
    row = np.arange(len(times))
    late = (
        times[0]
        + (row // count * count + count - 1) * step
        + np.repeat(rng.uniform(0, lag, len(row)), count)[: len(row)]
    )
    late += row % count * within
    return dict(zip(times.tolist(), (f"{v:.6f}" for v in late), strict=True)).get


@pytest.mark.parametrize(("lag", "within"), [(0.001, 0.0003), (0.004, 0.0001), (0.0, 0.0005)])
def test_samples_and_fixes_that_arrive_in_bursts_have_the_times_of_a_constant_rate(
    tmp_path: Path, lag: float, within: float
):
    write(tmp_path, "t", bursts(10, lag, within), "t", bursts(5, lag, within))
    got = imported(tmp_path)
    assert np.abs(got.drive.imu.time - IMU.time).max() < 0.007
    assert np.abs(got.drive.gps.time - GPS.time).max() < 0.007
    assert sum("the stamps are the times of arrival" in note for note in got.notes) == 2


@pytest.mark.parametrize("later", [0.003, 0.03])
@pytest.mark.parametrize("rows", ["messages", "three messages", "antennas"])
def test_rows_just_after_a_fix_do_not_move_it(tmp_path: Path, later: float, rows: str):
    """Sentences GGA and RMC of one fix, or two antennas, have the times of their arrival."""
    write(tmp_path, "t", repr)
    lines = ["t,lat,lon"]
    for t, lat, lon in zip(GPS.time.tolist(), GPS.lat.tolist(), GPS.lon.tolist(), strict=True):
        for k in range(3 if rows == "three messages" else 2):
            lines.append(f"{t + k * later!r},{lat + 1e-6 * k * (rows == 'antennas')!r},{lon!r}")
    (tmp_path / "gps.csv").write_text("\n".join(lines))
    got = imported(tmp_path)
    times = got.drive.gps.time[:: 2 if rows == "antennas" else 1]
    np.testing.assert_allclose(times, GPS.time, atol=1e-9)
    assert not any("spread" in note for note in got.notes)


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_pairs_of_samples_keep_their_times(tmp_path: Path, share: float):
    """Of some pairs, only one sample is left."""
    second = np.arange(len(IMU)) % 2 == 1
    exact = np.where(second, np.roll(IMU.time, 1) + 0.0004, IMU.time)
    lost = second & (np.random.default_rng(4).random(len(IMU)) < share)
    write(tmp_path, "t", dict(zip(IMU.time.tolist(), map(repr, exact.tolist()), strict=True)).get, "t", repr)
    lines = (tmp_path / "imu.csv").read_text().splitlines()
    left = [line for line, gone in zip(lines[1:], lost, strict=True) if not gone]
    (tmp_path / "imu.csv").write_text("\n".join([lines[0], *left]))
    np.testing.assert_allclose(imported(tmp_path).drive.imu.time, exact[~lost], atol=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rows", [1, 2])
def test_one_or_two_rows_have_no_rate(tmp_path: Path, rows: int):
    write(tmp_path, "t", repr)
    head = (tmp_path / "gps.csv").read_text().splitlines()[: rows + 1]
    (tmp_path / "gps.csv").write_text("\n".join(head))
    with pytest.raises(InputError, match=f"{rows} fixes within the IMU's time span"):
        imported(tmp_path)
    assert spread_stamps(np.full(rows, 5), "gps", "gps.csv")[1] == ""


@pytest.mark.parametrize("lost", [0.0, 0.01, 0.03, 0.05])
@pytest.mark.parametrize(("role", "rate", "stamp"), [("gps", 5, 1.0), ("imu", 100, 0.1), ("imu", 100, 1.0)])
def test_rows_with_coarse_stamps_of_which_a_few_are_lost(role: Role, rate: int, stamp: float, lost: float):
    rng = np.random.default_rng(7)
    row = np.arange(300 * rate)
    row = row[rng.random(len(row)) >= lost]
    row = row[(row < 100.5 * rate) | (row >= 130.5 * rate)]  # and a pause
    coarse = row // round(rate * stamp) * round(stamp * 1e9)
    fine, note = spread_stamps(coarse, role, "log.csv")
    error = fine / 1e9 - row / rate
    assert np.abs(np.median(error)) < 1e-3 and np.std(error) < max(5 * lost * (stamp / rate) ** 0.5, 1e-3)
    assert "coarse" in note and ("rate is not constant" in note) == (lost > 0)


@pytest.mark.parametrize("pause", [3.0, 300.0])
def test_a_receiver_that_sleeps_has_no_bursts(tmp_path: Path, pause: float):
    times = dict(zip(GPS.time.tolist(), GPS.time + np.arange(len(GPS)) // 20 * pause, strict=True))
    write(tmp_path, "t", repr, "t", lambda t: repr(float(times[t])))
    got = imported(tmp_path).drive.gps.time
    np.testing.assert_allclose(got, [*times.values()], atol=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_samples_that_wait_for_the_next_one_keep_their_rate(tmp_path: Path, share: float):
    """A driver stamps samples when it reads them: some have the stamp of the next one."""
    waits = np.random.default_rng(2).random(len(IMU)) < share
    waits[-1] = False
    stamps = np.where(waits, np.roll(IMU.time, -1), IMU.time)
    write(tmp_path, "t", dict(zip(IMU.time.tolist(), map(repr, stamps.tolist()), strict=True)).get, "t", repr)
    assert np.abs(imported(tmp_path).drive.imu.time - IMU.time).max() < 0.0101


@pytest.mark.parametrize("begin", [0.0, 0.3, 0.95])
def test_whole_seconds_of_fixes_once_per_second(tmp_path: Path, begin: float):
    """Because of jitter, some seconds have two fixes and some have none."""
    times = np.arange(200) + begin
    jitter = np.random.default_rng(3).uniform(-0.1, 0.1, len(times))
    at = np.arange(0, 201, 0.01)
    for name, t, columns in (("imu", at, "ax,ay,gz"), ("gps", np.floor(times + jitter), "x,y")):
        cells = [
            f"{v:.2f}," + (f"{np.sin(v)},0,0.01" if name == "imu" else f"{5 * times[k]},0")
            for k, v in enumerate(t)
        ]
        (tmp_path / f"{name}.csv").write_text("\n".join([f"t,{columns}", *cells]))
    got = imported(tmp_path).drive.gps
    late = got.time - got.x / 5
    assert len(got) == 200 and np.ptp(late) < 0.05 and -0.95 < np.median(late) < 0.15


@pytest.mark.parametrize("between", ["held", "empty"])
def test_rows_of_the_imu_show_the_time_of_a_fix_between_whole_seconds(tmp_path: Path, between: str):
    rows = ["t,ax,ay,gz,lat,lon"]
    fixes = np.searchsorted(GPS.time, IMU.time + 1e-9, side="right") - 1
    for k, (t, i) in enumerate(zip(IMU.time.tolist(), fixes.tolist(), strict=True)):
        shown = i >= 0 and (between == "held" or k == 0 or fixes[k - 1] != i)
        place = f"{float(GPS.lat[i])!r},{float(GPS.lon[i])!r}" if shown else ","
        rows.append(f"{int(t + 1e-6)},{IMU.ax[k]},{IMU.ay[k]},{IMU.gz[k]},{place}")
    (tmp_path / "log.csv").write_text("\n".join(rows))
    got = imported(tmp_path / "log.csv")
    np.testing.assert_allclose(got.drive.imu.time, IMU.time, atol=1e-3)
    np.testing.assert_allclose(got.drive.gps.time, GPS.time, atol=0.011)
    assert any("gps: log.csv: the stamps are coarse; rows are spread" in note for note in got.notes)


@pytest.mark.parametrize("more", ["", "std"])
@pytest.mark.parametrize("jitter", [0.0, 0.004])
def test_a_stamp_that_is_held_until_the_next_fix_keeps_its_time(tmp_path: Path, jitter: float, more: str):
    stamps = np.round(GPS.time + np.abs(np.random.default_rng(6).normal(0, jitter, len(GPS))), 3)
    rows = ["t,ax,ay,gz,gps_time,lat,lon,std_x,std_y"]
    fixes = np.searchsorted(stamps, IMU.time + 1e-9, side="right") - 1
    for k, i in enumerate(fixes.tolist()):
        place = f"{float(stamps[i])!r},{float(GPS.lat[i])!r},{float(GPS.lon[i])!r}" if i >= 0 else ",,"
        std = 1 + 0.1 * np.sin(k) if more else 1.0
        rows.append(f"{float(IMU.time[k])!r},{IMU.ax[k]},{IMU.ay[k]},{IMU.gz[k]},{place},{std},{std}")
    (tmp_path / "log.csv").write_text("\n".join(rows))
    got = imported(tmp_path / "log.csv", maps=["gps.t=gps_time"])
    np.testing.assert_allclose(got.drive.gps.time, stamps, atol=1e-9)
    assert not any("spread" in note for note in got.notes)


@pytest.mark.parametrize(
    "uneven",
    [lambda t: int(t + 0.9 * np.sin(1.7 * int(t)) ** 2), lambda t: int(t**1.3), lambda t: int(t**0.8)],
)
def test_coarse_stamps_of_an_uneven_count_are_refused_and_the_remedy_helps(
    tmp_path: Path, uneven: Callable[[float], int]
):
    stamps = np.maximum.accumulate([uneven(t) for t in IMU.time])
    at = dict(zip(IMU.time.tolist(), stamps.tolist(), strict=True))
    write(tmp_path, "t", lambda t: str(at[t]), "t", repr)
    with pytest.raises(
        InputError, match=r"\d+ of \d+ rows \(9\d%\) repeat the previous time.*too coarse"
    ) as caught:
        imported(tmp_path)
    assert "row/" in str(caught.value)
    assert apart(tmp_path, maps=["imu.t=row/100"]) < 1e-9


@pytest.mark.parametrize("form", ["{}", "{:.0f}.5"])
def test_a_remedy_for_one_of_several_tables_names_its_role(tmp_path: Path, form: str):
    """--time applies to every table of a folder, but gps.csv has no column `beat_time`."""
    write(tmp_path, "beat_time", lambda t: form.format(round(t * 100)), "t", repr)
    said = " ".join(inspect_request(Request(tmp_path)).notes)
    assert "--time" not in said and '--map "imu.t=' in said


@pytest.mark.parametrize("begins", some([(0.0, 0.0), (0.0, 2.0), (0.0, 5.5), (9.0, 0.0)], 3))
def test_a_clock_that_starts_anew_is_two_recordings(tmp_path: Path, begins: tuple[float, float]):
    write(tmp_path, "t", lambda t: f"{t + begins[0] if t < 7 else t - 7 + begins[1]:.6f}")
    with pytest.raises(
        InputError, match=r"the clock restarts at row 701: 2 recordings .* --part 1 to --part 2"
    ):
        imported(tmp_path)
    first, second = (imported(tmp_path, part=k) for k in (1, 2))
    assert len(first.drive.imu) == 700 and len(second.drive.imu) == len(IMU) - 700
    assert_close(first.drive.imu, IMU.select(slice(0, 700)), "ax gz", 1e-12)
    assert_close(second.drive.imu, IMU.select(slice(700, None)), "ax gz", 1e-12)
    assert len(first.drive.gps) + len(second.drive.gps) == len(GPS)
    with pytest.raises(InputError, match="there is no recording 3; choose --part 1"):
        imported(tmp_path, part=3)


def test_fixes_whose_clock_does_not_start_anew_get_the_remedy_of_an_offset(tmp_path: Path):
    write(tmp_path, "t", lambda t: f"{t if t < 7 else t - 7:.6f}", "t", repr)
    (said,) = (note for note in imported(tmp_path, part=2).notes if "--gps-offset" in note)
    assert float(re.search(r"--gps-offset (-[\d.]+)", said)[1]) == pytest.approx(-7, abs=0.02)
    assert not any("--gps-offset" in note for note in imported(tmp_path, part=1).notes)


@pytest.mark.parametrize("beats", [repr, lambda t: str(round(t * 1e9) % 2**32)])
def test_the_remedy_of_an_unknown_time_names_the_column_that_increases(tmp_path: Path, beats: Cells):
    write(tmp_path, "n,beats", lambda t: f"{7 - t % 2},{beats(t)}", "t", repr)
    with pytest.raises(InputError, match="no column is recognized as the time") as caught:
        imported(tmp_path)
    assert apart(tmp_path, maps=maps_in(str(caught.value))[:1]) < 2e-9


@pytest.mark.parametrize("order", ["reversed", "random"])
def test_rows_in_no_order_are_sorted(tmp_path: Path, order: str):
    write(tmp_path, "t", repr)
    for name in ("imu.csv", "gps.csv"):
        head, *rows = (tmp_path / name).read_text().split("\n")
        rows = rows[::-1] if order == "reversed" else np.random.default_rng(1).permutation(rows).tolist()
        (tmp_path / name).write_text("\n".join([head, *rows]))
    assert apart(tmp_path) < 1e-9


def test_rows_in_another_order_are_one_recording(tmp_path: Path):
    write(tmp_path, "t", repr)
    lines = (tmp_path / "imu.csv").read_text().split("\n")
    (tmp_path / "imu.csv").write_text("\n".join([lines[0], *lines[601:], *lines[1:601]]))
    got = imported(tmp_path)
    assert_close(got.drive.imu, IMU, "time ax gz", 1e-12)
    assert any("the time decreases at 1 row;" in note for note in got.notes)
