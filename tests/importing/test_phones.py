"""Sensor Logger, phyphox and GnssLogger, written as their documents describe them: a phone that lies flat."""

import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import EPOCH, a_drive, assert_close, imported
from sigmaswarm.errors import InputError
from support import diagonal

DRIVE = a_drive()
IMU, GPS = DRIVE.imu, DRIVE.gps
BEARING = np.degrees(np.pi / 2 - GPS.course) % 360
R68 = 1.515
PHONE = {"x": -IMU.ay, "y": IMU.ax, "z": IMU.az}
"""Specific force in the phone's axes: x to the right, y forward."""
ROTATION = {"x": -IMU.gy, "y": IMU.gx, "z": IMU.gz}


def ns(time: np.ndarray) -> np.ndarray:
    return np.round(time * 1e9).astype(np.int64) + EPOCH * 10**9


def zipped(folder: Path) -> Path:
    return Path(shutil.make_archive(str(folder), "zip", folder))


def sensor_logger(folder: Path, system: str) -> Path:
    folder.mkdir()
    gravity = {"x": 0 * IMU.ax + 0.1, "y": 0 * IMU.ax - 0.2, "z": 0 * IMU.ax + 9.7}
    sign = -1 if system == "ios" else 1

    def save(name: str, time: np.ndarray, columns: dict[str, np.ndarray]) -> None:
        table = {"time": ns(time), "seconds_elapsed": time, **columns}
        pl.DataFrame(table).write_csv(folder / f"{name}.csv")

    if system == "android":
        save("TotalAcceleration", IMU.time, PHONE)
    save("Accelerometer", IMU.time, {i: sign * (PHONE[i] - gravity[i]) for i in "xyz"})
    save("Gravity", IMU.time, {i: sign * gravity[i] for i in "xyz"})
    save("Gyroscope", IMU.time, ROTATION)
    accuracy = GPS.std_x * R68
    place = {"latitude": GPS.lat, "longitude": GPS.lon, "altitude": GPS.alt, "horizontalAccuracy": accuracy}
    save("Location", GPS.time, {**place, "speed": GPS.speed, "bearing": BEARING})
    (folder / "Metadata.csv").write_text("version,platform\n3," + system + "\n")
    return folder


@pytest.mark.parametrize(("system", "form"), diagonal(["android", "ios"], ["folder", "zip"]))
def test_sensor_logger(tmp_path: Path, system: str, form: str):
    folder = sensor_logger(tmp_path / "export", system)
    got = imported(zipped(folder) if form == "zip" else folder).drive
    assert_close(got.imu, IMU, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, GPS, "time lat lon alt std_x speed course", 1e-9)


@pytest.mark.parametrize("form", ["folder", "zip"])
@pytest.mark.parametrize("content", ["", "\n\n"])
def test_an_empty_table_of_an_export_is_named(tmp_path: Path, form: str, content: str):
    folder = sensor_logger(tmp_path / "export", "android")
    (folder / "Location.csv").write_text(content)
    with pytest.raises(InputError, match=r"Location\.csv is empty; copy it again$"):
        imported(zipped(folder) if form == "zip" else folder)


def test_invalid_speeds_are_left_out(tmp_path: Path):
    folder = sensor_logger(tmp_path / "export", "android")
    table = pl.read_csv(folder / "Location.csv")
    table.with_columns(speed=pl.lit(-1.0), bearing=pl.lit(-1.0)).write_csv(folder / "Location.csv")
    got = imported(folder).drive
    assert got.gps.speed is None and len(got.gps) == len(GPS)


@pytest.mark.parametrize(
    ("missing", "left_out"),
    [
        (["horizontalAccuracy"], ["std_x", "std_y"]),
        (["speed"], ["speed"]),
        (["bearing"], ["course"]),
        (["altitude"], ["alt"]),
        (
            ["horizontalAccuracy", "speed", "bearing", "altitude"],
            ["std_x", "std_y", "speed", "course", "alt"],
        ),
    ],
)
@pytest.mark.parametrize("system", ["android", "ios"])
def test_an_export_without_optional_columns(tmp_path: Path, system: str, missing: list, left_out: list):
    folder = sensor_logger(tmp_path / "export", system)
    table = pl.read_csv(folder / "Location.csv")
    table.drop(missing).write_csv(folder / "Location.csv")
    got = imported(folder).drive.gps
    assert {name for name in ("alt", "std_x", "std_y", "speed", "course") if getattr(got, name) is None} == {
        *left_out
    }
    assert_close(got, GPS, "time lat lon", 1e-9)


def phyphox(folder: Path, separator: str = ",") -> Path:
    (folder / "meta").mkdir(parents=True)
    start = IMU.time[0]

    def save(name: str, time: np.ndarray, columns: dict[str, np.ndarray]) -> None:
        table = pl.DataFrame({"Time (s)": time - start, **columns})
        table.write_csv(folder / f"{name}.csv", separator=separator, quote_style="non_numeric")

    save("Accelerometer", IMU.time, {f"Acceleration {i} (m/s^2)": PHONE[i] for i in "xyz"})
    save("Gyroscope", IMU.time, {f"Gyroscope {i} (rad/s)": ROTATION[i] for i in "xyz"})
    place = {
        "Latitude (°)": GPS.lat,
        "Longitude (°)": GPS.lon,
        "Height (m)": GPS.alt,
        "Velocity (m/s)": GPS.speed,
    }
    more = {
        "Direction (°)": BEARING,
        "Horizontal Accuracy (m)": GPS.std_x * R68,
        "Vertical Accuracy (m)": GPS.std_x,
    }
    save("Location", GPS.time, place | more)
    (folder / "meta" / "time.csv").write_text('"event","experiment time","system time"\n"START",0,1.7E9\n')
    return folder


@pytest.mark.parametrize(("separator", "form"), diagonal([",", ";", "\t"], ["folder", "zip"]))
def test_phyphox(tmp_path: Path, separator: str, form: str):
    folder = phyphox(tmp_path / "export", separator)
    got = imported(zipped(folder) if form == "zip" else folder).drive
    assert_close(got.imu, IMU, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, GPS, "time lat lon alt std_x speed course", 1e-9)


LANGUAGES = {
    "German": "Beschleunigungssensor Gyroskop Standort Zeit Beschleunigung Breitengrad Längengrad Höhe",
    "French": "Accéléromètre Gyroscope Position Temps Accélération Latitude Longitude Hauteur",
    "Polish": "Akcelerometr Żyroskop Położenie Czas Przyspieszenie Szerokość Długość Wysokość",
}


@pytest.mark.parametrize(("language", "form"), diagonal(LANGUAGES, ["folder", "zip"]))
def test_phyphox_in_other_languages(tmp_path: Path, language: str, form: str):
    """Tables are found by their units; the linear acceleration, whose name comes first, is not taken."""
    accelerometer, gyroscope, place, time, *words = LANGUAGES[language].split()
    folder = phyphox(tmp_path / "export", ";")
    (folder / "meta" / "device.csv").write_text('"property","value"\n')
    names = {"Accelerometer": accelerometer, "Gyroscope": gyroscope, "Location": place}
    english = ("Acceleration", "Latitude", "Longitude", "Height")
    for name, other in names.items():
        text = (folder / f"{name}.csv").read_text("utf-8").replace("Time (s)", f"{time} (s)")
        for word, translated in zip(english, words, strict=True):
            text = text.replace(word, translated)
        text = text.replace("Velocity", "v").replace("Direction", "d").replace("Horizontal Accuracy", "h")
        head, *rows = text.replace("Gyroscope x", "Gyro x").replace(".", ",").split("\n")
        (folder / f"{name}.csv").unlink()
        (folder / f"{other}.csv").write_text("\n".join([head, *rows]), "utf-8")
    tilt = "\n".join([f"{time} (s);N (°);R (°)", "0;10,5;5,5", "1;10,5;5,5", ""])
    (folder / "B.csv").write_text(tilt, "utf-8")  # it comes before the location
    linear = [f"{t!r};{x!r};{x!r};0.1".replace(".", ",") for t, x in enumerate(PHONE["x"].tolist())]
    head = f"{time} (s);{words[0]} x (m/s^2);{words[0]} y (m/s^2);{words[0]} z (m/s^2)"
    (folder / "A.csv").write_text("\n".join([head, *linear]), "utf-8")
    got = imported(zipped(folder) if form == "zip" else folder).drive
    assert_close(got.imu, IMU, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, GPS, "time lat lon alt std_x speed course", 1e-9)


def test_phyphox_with_other_units_and_tables_of_another_logger(tmp_path: Path):
    folder = phyphox(tmp_path / "export")
    for name, old, new in (("Accelerometer", "m/s^2", "ms^-2"), ("Location", "°", "deg")):
        text = (folder / f"{name}.csv").read_text("utf-8")
        (folder / f"{name}.csv").write_text(text.replace(old, new), "utf-8")
    got = imported(folder).drive
    assert_close(got.imu, IMU, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, GPS, "time lat lon alt std_x speed course", 1e-9)
    other = tmp_path / "other"
    (other / "meta").mkdir(parents=True)
    for name in ("time", "device"):
        (other / "meta" / f"{name}.csv").write_text("a,b\n1,2\n")
    pl.DataFrame(
        {"t": IMU.time, **{a: getattr(IMU, a) for a in ("ax", "ay", "az", "gx", "gy", "gz")}}
    ).write_csv(other / "imu.csv")
    pl.DataFrame({"t": GPS.time, "lat": GPS.lat, "lon": GPS.lon}).write_csv(other / "gps.csv")
    assert_close(imported(other).drive.imu, IMU, "time ax gz", 1e-9)


def gnss_logger(path: Path, old: bool = False) -> Path:
    head = [
        "# ",
        "# Header Description:",
        "# ",
        "# Raw,utcTimeMillis,TimeNanos",
        "# UncalAccel,utcTimeMillis,elapsedRealtimeNanos,UncalAccelXMps2,UncalAccelYMps2,UncalAccelZMps2,BiasXMps2",
        "# UncalGyro,utcTimeMillis,elapsedRealtimeNanos,UncalGyroXRadPerSec,UncalGyroYRadPerSec,UncalGyroZRadPerSec",
        "# Accel,utcTimeMillis,elapsedRealtimeNanos,AccelXMps2,AccelYMps2,AccelZMps2",
        "# Fix,Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,SpeedMps,AccuracyMeters,BearingDegrees,"
        + (
            "(UTC)TimeInMs"
            if old
            else "UnixTimeMillis,SpeedAccuracyMps,BearingAccuracyDegrees,elapsedRealtimeNanos"
        ),
    ]
    boot = 5_000_000_000_000
    lines: list[tuple[float, str]] = []
    for i, t in enumerate(IMU.time):
        clock = f"{round((t + EPOCH) * 1e3)},{round(t * 1e9) + boot}"
        force = ",".join(repr(float(PHONE[axis][i])) for axis in "xyz")
        rate = ",".join(repr(float(ROTATION[axis][i])) for axis in "xyz")
        lines += [(t, f"UncalAccel,{clock},{force},0.0"), (t, f"UncalGyro,{clock},{rate}")]
    for i, t in enumerate(GPS.time):
        values = (GPS.lat[i], GPS.lon[i], GPS.alt[i], GPS.speed[i], GPS.std_x[i] * R68, BEARING[i])
        cells = ",".join(repr(float(v)) for v in values) + f",{round((t + EPOCH) * 1e3)}"
        cells += "" if old else f",0.1,1.0,{round(t * 1e9) + boot}"
        lines += [
            (t, f"Fix,GPS,{cells}"),
            (t, f"Fix,NLP,1,2,3,4,5,6,{cells.split(',', 6)[-1]}"),
            (t, "Raw,1,2"),
        ]
    path.write_text("\n".join([*head, *(line for _, line in sorted(lines, key=lambda x: x[0]))]) + "\n")
    return path


@pytest.mark.parametrize("old", [False, True])
def test_gnss_logger(tmp_path: Path, old: bool):
    got = imported(gnss_logger(tmp_path / "gnss_log.txt", old))
    atol = 1e-3 if old else 1e-6  # ms of UTC, or ns since the phone's start
    for table, wanted in ((got.drive.imu, IMU), (got.drive.gps, GPS)):
        shift = 0.0 if old else 5000.0
        np.testing.assert_allclose(table.time, wanted.time + shift, atol=atol)
    assert_close(got.drive.imu, IMU, "ax ay az gx gy gz", 1e-12)
    assert_close(got.drive.gps, GPS, "lat lon alt std_x speed course", 1e-9)
    assert any(
        "Provider == 'GPS'" in note for note in got.notes
    )  # fixes of the network are not the receiver's


@pytest.mark.parametrize("kinds", [("Fix", "UncalAccel"), ("UncalAccel", "UncalGyro"), ("Fix", "UncalGyro")])
def test_of_repeated_columns_of_gnss_logger_the_first_is_reported(tmp_path: Path, kinds: tuple[str, str]):
    """The order of the header decides, not the order of a set, which depends on the hash seed."""
    for first, second in (kinds, kinds[::-1]):
        path = gnss_logger(tmp_path / "gnss_log.txt")
        text = path.read_text()
        heads = {k: next(li for li in text.splitlines() if li.startswith(f"# {k},")) for k in kinds}
        rest = "\n".join(line for line in text.splitlines() if line not in heads.values())
        doubled = "\n".join(f"{heads[kind]},{kind}Again,{kind}Again" for kind in (first, second))
        path.write_text(f"{doubled}\n{rest}")
        with pytest.raises(InputError, match=f"column '{first}Again' appears twice"):
            imported(path)


@pytest.mark.parametrize("write", [sensor_logger, phyphox])
@pytest.mark.parametrize("damage", ["cut zip", "no gyroscope", "no place", "empty table"])
def test_broken_export(tmp_path: Path, write, damage: str):
    folder = write(tmp_path / "export", *(["android"] if write is sensor_logger else []))
    if damage == "cut zip":
        path = zipped(folder)
        path.write_bytes(path.read_bytes()[:2000])
    else:
        path = folder
        if damage == "empty table":
            (folder / "Gyroscope.csv").write_text(
                (folder / "Gyroscope.csv").read_text().splitlines()[0] + "\n"
            )
        else:
            (folder / ("Gyroscope.csv" if damage == "no gyroscope" else "Location.csv")).unlink()
    with pytest.raises(InputError) as caught:
        imported(path)
    print(f"{write.__name__}, {damage}: {caught.value}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda text: text[: text.rindex("UncalGyro") + 20], "cut short"),
        (
            lambda text: "\n".join(line for line in text.splitlines() if not line.startswith("UncalGyro")),
            "no IMU",
        ),
        (lambda text: "\n".join(line for line in text.splitlines() if line[0] == "#"), "contains no lines"),
    ],
)
def test_broken_gnss_logger(tmp_path: Path, edit, said: str):
    path = gnss_logger(tmp_path / "gnss_log.txt")
    path.write_text(edit(path.read_text()))
    with pytest.raises(InputError, match=said):
        imported(path)
