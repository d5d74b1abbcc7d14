"""A proposed --map: from names, corrected by the doctor's evidence, and never applied automatically."""

import re
import shlex
import subprocess
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import city_drive
from sigmaswarm import import_log
from sigmaswarm.drives.drive import Drive, Gps, Imu
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.importing.convert import import_drive
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.proposal import Proposal
from sigmaswarm.importing.proposal_check import CHECKED_TIME, _busiest_part, check_proposal
from sigmaswarm.importing.source import TableChoice
from sigmaswarm.importing.word_meanings import Meaning, meaning_of, propose_columns
from sigmaswarm.simulation.scenarios import simulate
from support import diagonal, quickly, some

START = 1_700_000_000
G = 9.80665
DRIVE = city_drive()


def write_log(folder: Path, drive: Drive = DRIVE, *, clockwise: float = -1.0, right: float = -1.0) -> Path:
    """As a company's logger has it: stamps in us, g, deg/s clockwise, and the fixes in a table of their own."""
    imu, gps = drive.imu, drive.gps
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), (50.0, 8.0, 100.0)).T
    folder.mkdir()
    stamp = [np.round((START + time) * 1e6).astype(np.int64) for time in (imu.time, gps.time)]
    columns = {"stamp_us": stamp[0], "acc_fwd_g": imu.ax / G, "acc_right_g": right * imu.ay / G}
    columns |= {"yaw_rate_dps_cw": clockwise * np.degrees(imu.gz)}
    pl.DataFrame(columns).write_csv(folder / "imu.csv")
    fixes = {"stamp_us": stamp[1], "lat_deg": lat, "lon_deg": lon, "hacc_m": np.full(len(gps), 1.414)}
    pl.DataFrame(fixes).write_csv(folder / "fixes.csv")
    return folder


@pytest.mark.parametrize("together", some([True, False]))
def test_what_is_proposed_makes_the_drive_that_was_logged(tmp_path: Path, together: bool):
    folder = write_log(tmp_path / "log")
    asked = Request(folder) if together else Request(folder / "imu.csv", gps=folder / "fixes.csv")
    seen = inspect_request(asked)
    assert not seen.recipe.roles.get("imu")  # nothing of it is done
    table, entries = seen.proposal.split("--map ")
    assert table == ("--imu-table imu.csv " if together else "")
    maps = shlex.split(entries)
    assert maps == [
        "imu.t=stamp_us*1e-6",
        "ax=acc_fwd_g*9.80665",
        "ay=-acc_right_g*9.80665",
        "gz=-radians(yaw_rate_dps_cw)",
        "std_x=hacc_m/sqrt(2)",
    ]
    assert seen.evidence == (
        "the mapping follows from the columns' names and values, and was checked with the motion of the fixes: signs, "
        "axes and units agree"
    )
    choice = TableChoice({"imu": "imu.csv"}) if together else TableChoice()
    drive = import_drive(replace(asked, maps=maps, choice=choice), "again").drive
    for name in ("ax", "ay", "gz"):
        np.testing.assert_allclose(getattr(drive.imu, name), getattr(DRIVE.imu, name), rtol=1e-9, atol=1e-12)
    assert drive.gps.std_x == pytest.approx(np.full(len(drive.gps), 1.0), abs=1e-3)


@pytest.mark.parametrize("rates", some(["turn rate [deg/s]", "yaw_rate_dps_cw"]))
def test_an_imu_of_two_tables(tmp_path: Path, rates: str):
    """Odd names in both, and both with a time of the same name; the proposal is pasted."""
    folder = write_log(tmp_path / "log")
    log = pl.read_csv(folder / "imu.csv")
    (folder / "imu.csv").unlink()
    turned = {"yaw_rate_ccw": DRIVE.imu.gz, "turn rate [deg/s]": np.degrees(DRIVE.imu.gz)}
    log.select("stamp_us", "acc_fwd_g", "acc_right_g").write_csv(folder / "box_a.csv")
    gyro = log.select("stamp_us", pl.Series(rates, turned.get(rates, log["yaw_rate_dps_cw"])))
    gyro.write_csv(folder / "box_b.csv")
    seen = inspect_request(Request(folder))
    assert seen.works and "signs, axes and units agree" in seen.evidence
    maps = shlex.split(seen.proposal.removeprefix("--map "))
    drive = import_drive(Request(folder, maps=maps), "again").drive
    for name in ("ax", "ay", "gz"):
        np.testing.assert_allclose(getattr(drive.imu, name), getattr(DRIVE.imu, name), rtol=1e-9, atol=1e-12)
    # A name that both tables have does not show whose it is.
    for table in ("box_a.csv", "box_b.csv"):
        pl.read_csv(folder / table).rename({rates: "yaw_rate"}, strict=False).with_columns(
            yaw_rate=pl.lit(0.1)
        ).write_csv(folder / table)
    assert "box_b.csv" not in inspect_request(Request(folder)).proposal


def test_names_that_lie_about_signs_are_corrected_by_how_the_fixes_move(tmp_path: Path):
    folder = write_log(tmp_path / "log", clockwise=1.0, right=1.0)
    seen = inspect_request(Request(folder / "imu.csv", gps=folder / "fixes.csv"))
    maps = shlex.split(seen.proposal.removeprefix("--map "))
    assert maps[2:4] == ["ay=acc_right_g*9.80665", "gz=radians(yaw_rate_dps_cw)"]
    assert "corrected with the motion of the fixes: signs, axes and units agree" in seen.evidence


FULL = simulate("urban", duration=90.0, imu_rate=50.0, run=1, gps="white-1m", terrain="hilly", vibration=1.0)
ROLL, PITCH, YAW = (np.degrees(rate) for rate in (FULL.imu.gx, FULL.imu.gy, FULL.imu.gz))
THIRD_AXES = {
    "acc_up_g": FULL.imu.az / G,
    "roll_rate_dps": ROLL,
    "pitch_rate_dps": PITCH,
    "yaw_rate_ccw_dps": YAW,
}
MISNAMED = {
    "az's sign": {"acc_up_g": None, "acc_down_g": FULL.imu.az / G},
    "az's unit": {"acc_up_g": None, "acc_up": FULL.imu.az / G},
    "gx's and gy's signs": {"roll_rate_dps": -ROLL, "pitch_rate_dps": -PITCH},
    "gx and gy exchanged": {"roll_rate_dps": PITCH, "pitch_rate_dps": ROLL},
    "unit of the rates": {
        **dict.fromkeys(("roll_rate_dps", "pitch_rate_dps", "yaw_rate_ccw_dps")),
        **{"roll_rate": ROLL, "pitch_rate": PITCH, "yaw_rate_ccw": YAW},
    },
    "rates in rpm": {
        **dict.fromkeys(("roll_rate_dps", "pitch_rate_dps", "yaw_rate_ccw_dps")),
        **{"roll_rate": ROLL / 6, "pitch_rate": PITCH / 6, "yaw_rate_ccw": YAW / 6},
    },
}
VALUES_SHOW = ("az's unit", "unit of the rates")


@pytest.mark.parametrize(
    ("fault",), quickly(((name,) for name in MISNAMED), lambda fault: "exchanged" in fault)
)
def test_what_is_wrong_with_the_third_axes_is_corrected_too(tmp_path: Path, fault: str):
    """The doctor only warns of most of it: planar filters do not feel it."""
    folder = write_log(tmp_path / "log", FULL)
    columns = {name: values for name, values in (THIRD_AXES | MISNAMED[fault]).items() if values is not None}
    log = pl.read_csv(folder / "imu.csv").drop("yaw_rate_dps_cw")
    log.with_columns(**columns).write_csv(folder / "imu.csv")
    asked = Request(folder / "imu.csv", gps=folder / "fixes.csv")
    seen = inspect_request(asked)
    how = "checked" if fault in VALUES_SHOW else "corrected"
    assert f"{how} with the motion of the fixes: signs, axes and units agree" in seen.evidence
    got = import_drive(replace(asked, maps=shlex.split(seen.proposal.removeprefix("--map "))), "again").drive
    for name in ("ax", "ay", "az", "gx", "gy", "gz"):
        np.testing.assert_allclose(
            getattr(got.imu, name), getattr(FULL.imu, name), rtol=1e-9, atol=1e-12, err_msg=name
        )


def test_warnings_that_are_left_are_named(tmp_path: Path):
    folder, imu = write_log(tmp_path / "log", FULL), FULL.imu
    fixes = pl.read_csv(folder / "fixes.csv").with_columns(hacc_m=pl.lit(30.0))
    fixes.write_csv(folder / "fixes.csv")
    seen = inspect_request(Request(folder / "imu.csv", gps=folder / "fixes.csv"))
    assert seen.evidence.endswith("signs, axes and units agree; the doctor also warns of gps-noise")
    up = pl.Series(imu.az * 0.5)  # neither in g nor in m/s2
    pl.read_csv(folder / "imu.csv").with_columns(acc_up_m_s2=up).write_csv(folder / "imu.csv")
    seen = inspect_request(Request(folder / "imu.csv", gps=folder / "fixes.csv"))
    assert seen.evidence.endswith("; the doctor still finds accelerometer-up, gps-noise")


def test_what_can_not_be_made_is_called_unchecked(tmp_path: Path):
    folder = write_log(tmp_path / "log")
    pl.read_csv(folder / "fixes.csv").with_columns(pl.col("stamp_us") + 10**12).write_csv(folder / "late.csv")
    seen = inspect_request(Request(folder / "imu.csv", gps=folder / "late.csv"))
    assert "gz=-radians(yaw_rate_dps_cw)" in seen.proposal
    assert "from the columns' names and values alone and could not be checked: " in seen.evidence


@pytest.mark.parametrize(
    ("name", "meaning"),
    [
        ("accel_forward_mps2", ("imu", "ax", "accel_forward_mps2")),
        ("AccLeft[mg]", ("imu", "ay", "`AccLeft[mg]`*0.00980665")),
        ("acc_lat_g", ("imu", "ay", "acc_lat_g*9.80665")),
        ("acc_down_g", ("imu", "az", "-acc_down_g*9.80665")),
        ("gyro_z_deg_s", ("imu", "gz", "radians(gyro_z_deg_s)")),
        ("yawRate_ccw_rad_s", ("imu", "gz", "yawRate_ccw_rad_s")),
        ("roll_rate_dps", ("imu", "gx", "radians(roll_rate_dps)")),
        ("YGYRO", ("imu", "gy", "YGYRO")),
        ("A_lon (milli-g)", ("imu", "ax", "`A_lon (milli-g)`*0.00980665")),
        ("acc längs [mg]", ("imu", "ax", "`acc längs [mg]`*0.00980665")),
        ("Gierrate [°/s]", ("imu", "gz", "radians(`Gierrate [°/s]`)")),
        ("Beschleunigung vertikal [m/s²]", ("imu", "az", "`Beschleunigung vertikal [m/s²]`")),
        ("Querbeschleunigung", ("imu", "ay", "Querbeschleunigung")),
        ("Wankrate [°/s]", ("imu", "gx", "radians(`Wankrate [°/s]`)")),
        ("accélération longitudinale", ("imu", "ax", "`accélération longitudinale`")),
        ("velocidad de cabeceo [deg/s]", ("imu", "gy", "radians(`velocidad de cabeceo [deg/s]`)")),
        ("velocità di imbardata [deg/s]", ("imu", "gz", "radians(`velocità di imbardata [deg/s]`)")),
        ("Nicken [°]", None),
        ("attitude_yaw(radians)", None),
        ("Yaw [deg]", None),
        ("Yaw [deg/s]", ("imu", "gz", "radians(`Yaw [deg/s]`)")),
        ("GPS(0):Long", ("gps", "lon", "`GPS(0):Long`")),
        ("long term fuel trim", None),
        ("wheel front left [rpm]", None),
        ("lon offset [m]", None),
        (
            "gyro_z_deg",
            ("imu", "gz", "radians(gyro_z_deg)"),
        ),  # a rate; the turns of the fixes confirm the unit
        ("accel forward [km/h]", None),
        ("yaw rate [m]", None),
        ("ZACCL", ("imu", "az", "ZACCL")),
        ("Länge", ("gps", "lon", "Länge")),
        ("Breite", ("gps", "lat", "Breite")),
        ("gnss_lat", ("gps", "lat", "gnss_lat")),
        ("lng_deg", ("gps", "lon", "lng_deg")),
        ("horizontal_accuracy_mm", ("gps", "std_x", "horizontal_accuracy_mm*1e-3/1.515")),
        ("horizontalAccuracy", ("gps", "std_x", "horizontalAccuracy/1.515")),
        ("Accuracy (m)", ("gps", "std_x", "`Accuracy (m)`/1.515")),
        ("locationHorizontalAccuracy(m)", ("gps", "std_x", "`locationHorizontalAccuracy(m)`/1.515")),
        ("temperature_c", None),
        ("gps_std_cm", ("gps", "std_x", "gps_std_cm*1e-2/sqrt(2)")),
        ("hAcc", ("gps", "std_x", "hAcc/sqrt(2)")),
        ("h_acc_m", ("gps", "std_x", "h_acc_m/sqrt(2)")),
        ("h_acc_x_m_s2", ("imu", "ax", "h_acc_x_m_s2")),
        ("speed_accuracy", None),
        ("vel_std_m_s", None),
        ("bearing_accuracy_deg", None),
        ("course_std", None),
        ("altitude_accuracy_m", None),
        ("yaw_std_deg", None),
        ("gyro_z_std", None),
        ("pos_accuracy_rad", None),
        ("accel_x_sigma_g", None),
        ("battery_rate", None),
    ],
)
def test_names_are_read_word_by_word(name: str, meaning: tuple[str, str, str] | None):
    assert meaning_of(name) == (None if meaning is None else Meaning(*meaning))


def test_a_shell_runs_nothing_of_a_log_s_header(tmp_path: Path):
    """What is proposed is pasted: by `sh` as by `shlex` it comes back as it is."""
    names = ["Acc Fwd (g)", "acc left $(touch dollar)", "acc up `touch tick` m s2", "yaw rate 'cw' \"dps\""]
    said = propose_columns({"imu.csv; touch semicolon": names}, "imu", {})
    assert said is not None
    table, columns = said
    assert list(columns) == ["ax", "ay", "az", "gz"]
    made = Proposal({"imu": table}, {"imu": columns})
    expected = ["--imu-table", table, "--map", *made.maps]
    assert shlex.split(made.options) == expected
    shell = ["sh", "-c", f"printf '%s\\n' {made.options}"]
    printed = subprocess.run(shell, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert printed.splitlines() == expected
    assert not list(tmp_path.iterdir())


MAPS = ("ax=acc_fwd_g*g", "ay=-acc_right_g*g", "gz=-radians(yaw_rate_dps_cw)")


@pytest.mark.parametrize("time", some(["stamp_us", "stamp_us*1e-3", "stamp_us/1000", "stamp_us*1e-9"], 4))
def test_a_time_in_another_unit_names_the_unit_and_the_cure(tmp_path: Path, time: str):
    folder = write_log(tmp_path / "log")
    asked = Request(folder / "imu.csv", gps=folder / "fixes.csv", maps=MAPS, time=time)
    with pytest.raises(InputError) as caught:
        import_drive(asked, "monday")
    assert f"with {time} in s, rows of the imu would be" in str(caught.value)
    assert ', and in us 0.02 s apart; write --time "stamp_us*1e-6"' in str(caught.value)
    drive = import_drive(replace(asked, time="stamp_us*1e-6"), "monday").drive
    assert (
        import_drive(replace(asked, time=None), "monday").drive.imu.time.tolist() == drive.imu.time.tolist()
    )
    wrong = replace(asked, time=None, maps=(*MAPS, "gps.t=stamp_us*1e-3"))
    with pytest.raises(
        InputError, match=r"rows of the gps would be .* s apart, and in us 0\.2 s apart; write --map gps\.t="
    ):
        import_drive(wrong, "monday")


@pytest.mark.parametrize("value", [1e16, -1e77, 1e155, 1e200, -1e308])
@pytest.mark.parametrize("name", ["ax", "gz"])
def test_a_look_at_absurd_numbers_does_not_overflow(name: str, value: float):
    values = getattr(DRIVE.imu, name).copy()
    values[::3] = value
    spoiled = replace(DRIVE, imu=replace(DRIVE.imu, **{name: values}))
    proposal = Proposal({}, {})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same, evidence, works = check_proposal(proposal, lambda _: spoiled)
    assert same is proposal and not works
    assert f"could not be checked: {name} has numbers beyond 1e+07" in evidence


UNITS = {  # factors of accelerations, rates, latitude and longitude
    "g, deg/s": (1 / G, 180 / np.pi, 1.0),
    "ft/s2": (1 / 0.3048, 1.0, 1.0),
    "radians": (1.0, 1.0, np.pi / 180),
    "counts": (16384 / G, 180 / np.pi * 131, 1.0),
}


@pytest.mark.parametrize("unit", some(UNITS))
def test_a_proposal_reads_units_by_the_values(tmp_path: Path, unit: str):
    """The columns were proposed unchanged, although the same message stated the unit."""
    force, rate, degrees = UNITS[unit]
    imu, gps, digits = DRIVE.imu, DRIVE.gps, 0 if unit == "counts" else 6
    places = np.column_stack([gps.x, gps.y, 0 * gps.x])
    lat, lon, _ = degrees * enu_to_geodetic(places, (50.0, 8.0, 100.0)).T
    forces = {"fwd acc": imu.ax, "left acc": imu.ay, "up acc": imu.az}
    rates = {"roll gyro": imu.gx, "pitch gyro": imu.gy, "yaw gyro": imu.gz}
    columns = {"t": imu.time, **{n: np.round(v * force, digits) for n, v in forces.items()}}
    columns |= {n: np.round(v * rate, digits) for n, v in rates.items()}
    (tmp_path / "log").mkdir()
    pl.DataFrame(columns).write_csv(tmp_path / "log" / "imu.csv")
    pl.DataFrame({"t": gps.time, "rx latitude": lat, "rx longitude": lon}).write_csv(
        tmp_path / "log" / "gps.csv"
    )
    seen = inspect_request(Request(tmp_path / "log"))
    assert seen.works and seen.evidence.endswith("signs, axes and units agree")
    drive = import_log(tmp_path / "log", **seen.settings)
    for name in ("ax", "az", "gz"):
        np.testing.assert_allclose(getattr(drive.imu, name), getattr(imu, name), atol=2e-3)
    np.testing.assert_allclose(np.ptp(drive.gps.x), np.ptp(gps.x), rtol=0.01)


@pytest.mark.parametrize("head", ["Time (fortnights)", "ts [parsecs]"])
def test_the_remedy_for_a_time_that_imu_and_fixes_share_works_when_typed(tmp_path: Path, head: str):
    imu, gps = DRIVE.imu, DRIVE.gps
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), (50.0, 8.0, 100.0)).T
    columns = {head: imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}
    columns |= {name: np.interp(imu.time, gps.time, v) for name, v in (("lat", lat), ("lon", lon))}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    with pytest.raises(InputError) as caught:
        import_drive(Request(tmp_path / "log.csv"), "log")
    maps = re.findall(r'--map "([^"]+)"', str(caught.value))
    assert maps == [f"{role}.t=`{head}`*1.0" for role in ("imu", "gps")]
    assert len(import_drive(Request(tmp_path / "log.csv", maps=maps), "log").drive.imu) == len(imu)


def test_an_unnamed_clock_is_the_time_of_mapped_columns_and_of_the_fixes(tmp_path: Path):
    imu, gps = DRIVE.imu, DRIVE.gps
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), (50.0, 8.0, 100.0)).T
    columns = {"clk": imu.time, "foo": imu.ax, "bar": imu.ay, "baz": imu.gz}
    columns |= {name: np.interp(imu.time, gps.time, v) for name, v in (("lat", lat), ("lon", lon))}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    maps = ["imu.ax=foo", "imu.ay=bar", "imu.gz=baz"]
    seen = inspect_request(Request(tmp_path / "log.csv", maps=maps))
    assert seen.settings["maps"] == {"imu.t": "clk", "gps.t": "clk"}


DT = float(np.median(np.diff(DRIVE.imu.time)))
ORDERS = {
    "t acc gyro": ("t ax ay az gx gy gz", 1.0, 1.0),
    "row t gyro acc, with a magnetometer": ("row t gx gy gz ax ay az mx my mz", 1.0, 1.0),
    "increments": ("t gx gy gz ax ay az", DT, DT),
    "increments with a week": ("week t ax ay az gx gy gz", DT, DT),
    "t acc gyro lat lon, in g": ("t ax ay az gx gy gz lat lon", 1 / G, 1.0),
    "quaternion before gyro and acc in counts": (
        "t qx qy qz qw gx gy gz ax ay az",
        8192 / G,
        131 * 180 / np.pi,
    ),
}


@pytest.mark.parametrize("order", some(ORDERS, 3))
def test_columns_without_names_are_recognized_by_their_values(tmp_path: Path, order: str):
    names, force, rate = ORDERS[order]
    imu, gps = DRIVE.imu, DRIVE.gps
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), (50.0, 8.0, 100.0)).T
    last = np.clip(np.searchsorted(gps.time, imu.time, side="right") - 1, 0, None)
    fixes = lat[last], lon[last]
    tilt = 0.02 * np.sin(imu.time)
    columns = {"row": np.arange(len(imu)), "t": imu.time, "lat": fixes[0], "lon": fixes[1]}
    columns["week"] = np.full(len(imu), 2315)
    columns |= {name: force * getattr(imu, name) for name in ("ax", "ay", "az")}
    columns |= {name: rate * getattr(imu, name) for name in ("gx", "gy", "gz")}
    if rate > 1:
        columns |= {name: np.round(columns[name]) for name in ("ax", "ay", "az", "gx", "gy", "gz")}
    columns |= {"qx": tilt, "qy": tilt, "qz": np.sin(tilt), "qw": np.cos(tilt)}
    columns |= {"mx": 20 + tilt, "my": 3 - tilt, "mz": -43 + 0 * tilt}
    pl.DataFrame([columns[name] for name in names.split()]).write_csv(
        tmp_path / "imu.csv", include_header=False
    )
    week = {"week": np.full(len(gps), 2315), "tow": gps.time} if "week" in names else {"t": gps.time}
    pl.DataFrame({**week, "lat": lat, "lon": lon}).write_csv(tmp_path / "gps.csv")
    asked = Request(tmp_path / "imu.csv", gps=None if "lat" in names else tmp_path / "gps.csv")
    seen = inspect_request(asked)
    assert seen.works and seen.evidence.endswith("signs, axes and units agree")
    drive = import_log(asked.source, gps=asked.gps, say=[].append, **seen.settings)
    for name in ("ax", "az", "gz"):
        np.testing.assert_allclose(getattr(drive.imu, name), getattr(imu, name), atol=2e-3)
    np.testing.assert_allclose(np.ptp(drive.gps.x), np.ptp(gps.x), rtol=0.01)


@pytest.mark.parametrize(
    ("rates", "scale", "gravity", "together"),
    diagonal(
        [
            (("wx", "wy", "wz"), 1.0, 1.0),
            (("gyro_x", "gyro_y", "gyro_z"), np.degrees(1.0), 1.0),
            (("p", "q", "r"), 1.0, 1 / G),
            (("gx [deg/s]", "gy [deg/s]", "gz [deg/s]"), np.degrees(1.0), 1.0),
        ],
        [True, False],
    ),
)
@pytest.mark.filterwarnings("ignore::sigmaswarm.errors.SigmaswarmWarning")  # notes of the import
def test_x_y_z_next_to_rates_are_proposed_as_accelerations(
    tmp_path: Path, rates: tuple[str, str, str], scale: float, gravity: float, together: bool
):
    imu, gps = DRIVE.imu, DRIVE.gps
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), (50.0, 8.0, 100.0)).T
    noise = 0.02 * np.random.default_rng(1).standard_normal((3, len(imu)))
    forces = dict(zip("XYZ", gravity * (np.array([imu.ax, imu.ay, 0 * imu.ax + G]) + noise), strict=True))
    turns = zip(rates, (scale * noise[0] / 10, scale * noise[1] / 10, scale * imu.gz), strict=True)
    log = {"time": imu.time, **forces, **dict(turns)}
    if together:
        last = np.searchsorted(gps.time, imu.time, side="right") - 1
        log |= {name: np.where(last < 0, np.nan, v[last]) for name, v in (("lat", lat), ("lon", lon))}
    else:
        pl.DataFrame({"time": gps.time, "lat": lat, "lon": lon}).write_csv(tmp_path / "gps.csv")
    pl.DataFrame(log).write_csv(tmp_path / "imu.csv")
    asked = Request(tmp_path)
    with pytest.raises(InputError, match="--show"):
        import_drive(asked, "log")
    seen = inspect_request(asked)
    assert seen.works and "signs, axes and units agree" in seen.evidence
    drive = import_log(tmp_path, **seen.settings)
    np.testing.assert_allclose(drive.imu.ax, imu.ax + noise[0], atol=1e-9)
    np.testing.assert_allclose(drive.imu.gz, imu.gz, atol=1e-9)


def test_rates_of_an_unknown_unit_are_not_imported(tmp_path: Path):
    """Without turns, the log does not show the scale of raw counts."""
    drive = simulate("accelerate", run=1, imu_rate=50.0, gps="white-1m", imu="icm-20602")
    imu, gps, per = drive.imu, drive.gps, 131 * 180 / np.pi
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), (50.0, 8.0, 100.0)).T
    columns = {"t": imu.time, "fwd acc": imu.ax, "left acc": imu.ay, "up acc": imu.az}
    rates = {"roll gyro": imu.gx, "pitch gyro": imu.gy, "yaw gyro": imu.gz}
    columns |= {name: np.round(v * per) for name, v in rates.items()}
    pl.DataFrame(columns).write_csv(tmp_path / "imu.csv")
    pl.DataFrame({"t": gps.time, "lat": lat, "lon": lon}).write_csv(tmp_path / "gps.csv")
    seen = inspect_request(Request(tmp_path / "imu.csv", gps=tmp_path / "gps.csv"))
    assert not seen.works and "the doctor still finds gyro-unit" in seen.evidence


def test_the_checked_part_of_a_long_log_lies_within_the_imu():
    """The car is fastest after the end of the IMU's samples."""
    imu, fixes = np.arange(0.0, 1500.0, 0.5), np.arange(0.0, 5000.0)
    zeros = np.zeros(len(imu))
    speed = np.where(fixes > 2000, 30.0, np.where(fixes > 500, 5.0, 1.0))
    drive = Drive("long", Imu(imu, zeros, zeros, zeros), Gps(fixes, np.cumsum(speed), 0 * fixes))
    part = _busiest_part(drive)
    assert part.duration == pytest.approx(CHECKED_TIME, abs=2)
    assert part.imu.time[0] >= 500
