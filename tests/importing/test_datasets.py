"""KITTI raw, NCLT, comma2k19 and RTKLIB's solutions, written as their documents describe them."""

from pathlib import Path

import numpy as np
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

from importing.logs import EPOCH, ORIGIN, a_drive, assert_close, imported
from sigmaswarm import clip, read_drive
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.geodesy import enu_to_geodetic, wrap_angle
from sigmaswarm.importing.readers.nclt import ORIGIN as NCLT_ORIGIN
from sigmaswarm.importing.recipe import Recipe
from support import DRIVES, needs_shared

DRIVE = a_drive()
G = 9.80665


def places(drive: Drive, origin: tuple[float, float, float]) -> np.ndarray:
    """The truth in degrees, (3, n)."""
    level = np.zeros(len(drive.truth))
    return enu_to_geodetic(np.column_stack([drive.truth.x, drive.truth.y, level]), origin).T


def write_kitti(folder: Path, drive: Drive = DRIVE) -> Path:
    """Texts of 30 numbers, as dataformat.txt lists them."""
    data = folder / "2011_09_26_drive_0101_extract" / "oxts" / "data"
    data.mkdir(parents=True)
    imu, truth = drive.imu, drive.truth
    lat, lon, alt = places(drive, ORIGIN)
    zero = np.zeros(len(imu))
    forward = np.hypot(truth.vx, truth.vy)
    yaw = wrap_angle(truth.theta)
    rows = np.column_stack(
        [
            *(lat, lon, alt, zero, zero, yaw, truth.vy, truth.vx, forward, zero, zero),
            *(imu.ax, imu.ay, imu.az, zero, zero, zero, imu.gx, imu.gy, imu.gz, zero, zero, zero),
            *(zero + 0.05, zero + 0.02, zero + 4, zero + 9, zero + 6, zero + 6, zero + 6),
        ]
    )
    assert rows.shape[1] == 30
    for i, row in enumerate(rows):
        (data / f"{i:010d}.txt").write_text(" ".join(repr(float(v)) for v in row) + "\n")
    ns = np.round(imu.time * 1e9).astype("timedelta64[ns]") + np.datetime64(EPOCH, "s")
    (data.parent / "timestamps.txt").write_text("\n".join(str(t).replace("T", " ") for t in ns) + "\n")
    return data.parents[1]


def test_kitti(tmp_path: Path):
    path = write_kitti(tmp_path)
    got = imported(path, recipe=Recipe(origin=ORIGIN)).drive
    assert_close(got.imu, DRIVE.imu, "time", 1e-9)
    assert_close(got.imu, DRIVE.imu, "ax ay az gx gy gz", 0)
    assert_close(got.truth, DRIVE.truth, "x y vx vy", 1e-8)
    np.testing.assert_allclose(wrap_angle(got.truth.theta - DRIVE.truth.theta), 0, atol=1e-12)
    made = imported(path / "oxts", recipe=Recipe(origin=ORIGIN, gps_from_truth=(5.0, 1.0))).drive
    assert made.frame == "enu" and "synthetic" in made.metadata["gps"]
    error = made.gps.x - np.interp(made.gps.time, DRIVE.truth.time, DRIVE.truth.x)
    assert len(made.gps) == 30 and 0.7 < np.std(error) < 1.3


def test_the_recipe_in_the_document_advances_the_rates(tmp_path: Path):
    page = (Path(__file__).parents[2] / "docs" / "importing.md").read_text()
    (tmp_path / "r.toml").write_text(page.split("```toml")[1].split("```")[0])
    got = imported(write_kitti(tmp_path), recipe=Recipe.load(tmp_path / "r.toml")).drive
    inside = DRIVE.imu.time <= DRIVE.imu.time[-1] - 0.06 + 1e-9
    np.testing.assert_array_equal(got.imu.ax, DRIVE.imu.ax[inside])
    np.testing.assert_allclose(got.imu.gz, DRIVE.imu.gz[6:], atol=1e-6)


@needs_shared
def test_kitti_as_it_was_converted_before(tmp_path: Path):
    """A real drive, written back as OXTS texts, gives the same IMU and truth, gaps and jitter included."""
    with pytest.warns(SigmaswarmWarning, match="gap"):
        real = clip(read_drive(DRIVES / "kitti-09-26-0022"), 5.0, 25.0)
    got = imported(write_kitti(tmp_path, real), recipe=Recipe(origin=ORIGIN)).drive
    np.testing.assert_allclose(np.diff(got.imu.time), np.diff(real.imu.time), atol=2e-9)
    assert_close(got.imu, real.imu, "ax ay az gx gy gz", 0)
    assert_close(got.truth, real.truth, "x y vx vy", 1e-7)


def write_nclt(folder: Path) -> Path:
    """Headerless files: body z down, truth north and east, latitude in radians, times in us."""
    imu, gps, truth = DRIVE.imu, DRIVE.gps, DRIVE.truth

    def us(time: np.ndarray) -> np.ndarray:
        return np.round(time * 1e6).astype(np.int64) + EPOCH * 10**6

    def save(name: str, time: np.ndarray, *columns: np.ndarray) -> None:
        rows = zip(us(time), *columns, strict=True)
        text = "\n".join(",".join([str(row[0]), *(repr(float(v)) for v in row[1:])]) for row in rows)
        (folder / name).write_text(text + "\n")

    zero = np.zeros(len(imu))
    save("ms25.csv", imu.time, zero, zero, zero, imu.ax, -imu.ay, -imu.az, imu.gx, -imu.gy, -imu.gz)
    mode, lat, lon = np.full(len(gps), 3.0), np.radians(gps.lat), np.radians(gps.lon)
    save("gps.csv", gps.time, mode, mode, lat, lon, gps.alt, 0 * mode, 0 * mode)
    flat = np.zeros(len(truth))
    heading = np.pi / 2 - truth.theta  # clockwise from north
    save("groundtruth_2012-01-08.csv", truth.time, truth.y, truth.x, flat, flat, flat, heading)
    return folder


def test_nclt(tmp_path: Path):
    got = imported(write_nclt(tmp_path)).drive
    assert_close(got.imu, DRIVE.imu, "time ax ay az gx gy gz", 1e-6)
    assert_close(got.gps, DRIVE.gps, "time lat lon alt", 1e-6)
    assert_close(got.truth, DRIVE.truth, "x y theta", 1e-9)
    assert got.origin == NCLT_ORIGIN
    for name in ("vx", "vy"):  # differences of positions
        np.testing.assert_allclose(
            getattr(got.truth, name)[1:-1], getattr(DRIVE.truth, name)[1:-1], atol=0.01
        )


def write_comma(folder: Path) -> Path:
    """NumPy arrays: IMU forward, right, down at two clocks' times, poses in ECEF by pymap3d and scipy."""
    imu, gps, truth = DRIVE.imu, DRIVE.gps, DRIVE.truth
    boot = 3000.0

    def save(name: str, time: np.ndarray, values: np.ndarray) -> None:
        (folder / "processed_log" / name).mkdir(parents=True)
        for file, array in (("t", time + boot), ("value", values)):
            with (folder / "processed_log" / name / file).open("wb") as stream:  # no suffix
                np.save(stream, array)

    save("IMU/accelerometer", imu.time, np.column_stack([imu.ax, -imu.ay, -imu.az]))
    between = (imu.time[1:] + imu.time[:-1]) / 2
    rates = [np.interp(between, imu.time, column) for column in (imu.gx, -imu.gy, -imu.gz)]
    save("IMU/gyro", between, np.column_stack(rates))
    bearing = np.degrees(np.pi / 2 - gps.course) % 360
    utc = gps.time + EPOCH
    save(
        "GNSS/live_gnss_ublox",
        gps.time,
        np.column_stack([gps.lat, gps.lon, gps.speed, utc, gps.alt, bearing]),
    )
    save("CAN/speed", truth.time, np.hypot(truth.vx, truth.vy)[:, np.newaxis])
    (folder / "global_pose").mkdir()
    lat, lon, alt = places(DRIVE, ORIGIN)
    ecef = np.column_stack(pymap3d.geodetic2ecef(lat, lon, alt))
    velocity = np.column_stack(pymap3d.enu2uvw(truth.vx, truth.vy, 0 * truth.vx, *ORIGIN[:2]))
    to_ecef = np.column_stack([pymap3d.enu2uvw(*axis, *ORIGIN[:2]) for axis in np.eye(3)])
    c, s = np.cos(truth.theta), np.sin(truth.theta)
    device = np.array(
        [[c, s, 0 * c], [s, -c, 0 * c], [0 * c, 0 * c, 0 * c - 1]]
    )  # forward, right, down in ENU
    quaternion = Rotation.from_matrix(to_ecef @ np.moveaxis(device, 2, 0)).as_quat()[:, [3, 0, 1, 2]]
    arrays = {
        "times": truth.time + boot,
        "positions": ecef,
        "velocities": velocity,
        "orientations": quaternion,
    }
    for name, array in arrays.items():
        with (folder / "global_pose" / f"frame_{name}").open("wb") as stream:
            np.save(stream, array)
    return folder


def test_comma2k19(tmp_path: Path):
    got = imported(write_comma(tmp_path), recipe=Recipe(origin=ORIGIN)).drive
    inside = DRIVE.imu.select(slice(1, -1))
    assert len(got.imu) == len(inside)
    assert_close(got.imu, inside, "ax ay az", 1e-9)
    assert_close(got.imu, inside, "gz", 1e-4)  # interpolated between the gyro's own times
    np.testing.assert_allclose(got.imu.time - 3000.0, inside.time, atol=1e-9)
    assert_close(got.gps, DRIVE.gps, "lat lon alt speed course", 1e-9)
    assert got.odometer is not None and DRIVE.truth is not None
    np.testing.assert_allclose(got.odometer.time - 3000.0, DRIVE.truth.time, atol=1e-9)
    np.testing.assert_array_equal(got.odometer.speed, np.hypot(DRIVE.truth.vx, DRIVE.truth.vy))
    assert_close(got.truth, DRIVE.truth, "x y", 1e-6)
    assert_close(
        got.truth, DRIVE.truth, "vx vy", 1e-4
    )  # the axes at the first pose are not those at the origin
    np.testing.assert_allclose(wrap_angle(got.truth.theta - DRIVE.truth.theta), 0, atol=1e-5)


def write_pos(path: Path, form: str = "dates") -> Path:
    """A solution as RTKLIB prints it, in GPS time, which is 18 s ahead of UTC."""
    gps = DRIVE.gps
    lines = ["% program   : RTKLIB ver.2.4.2", "% pos mode  : kinematic", "%"]
    velocity = "   vn(m/s)   ve(m/s)   vu(m/s)" if form == "dates" else ""
    lines.append(
        f"%  {'UTC ' if form == 'utc' else 'GPST'}    latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)"
        f"   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio{velocity}"
    )
    ahead = 0 if form == "utc" else 18
    for i in range(len(gps)):
        ms = round(gps.time[i] * 1e3) + (EPOCH + ahead) * 1000
        date = str(np.datetime64(ms, "ms")).replace("-", "/").replace("T", " ")
        if form == "week":
            since = ms - 315964800000
            date = f"{since // 604800000} {since % 604800000 / 1000:.3f}"
        cells = (
            f"{gps.lat[i]:.9f} {gps.lon[i]:.9f} {gps.alt[i]:.4f} 1 12 {gps.std_y[i]:.4f} {gps.std_x[i]:.4f}"
        )
        cells += " 0.02 0 0 0 0.4 12.3"
        if velocity:
            east, north = gps.speed[i] * np.cos(gps.course[i]), gps.speed[i] * np.sin(gps.course[i])
            cells += f" {north:.5f} {east:.5f} 0.0"
        lines.append(f"{date} {cells}")
    path.write_text("\n".join(lines) + "\n")
    return path


def imu_csv(folder: Path) -> Path:
    """The IMU as a table beside a receiver's log."""
    imu = DRIVE.imu
    rows = zip(imu.time, imu.ax, imu.ay, imu.gz, strict=True)
    text = "\n".join(f"{t + EPOCH:.6f},{ax!r},{ay!r},{gz!r}" for t, ax, ay, gz in rows).replace(
        "np.float64", ""
    )
    path = folder / "imu.csv"
    path.write_text("t,ax,ay,gz\n" + text.replace("(", "").replace(")", "") + "\n")
    return path


@pytest.mark.parametrize("form", ["dates", "week", "utc"])
def test_rtklib_as_fixes_and_as_truth(tmp_path: Path, form: str):
    pos, imu = write_pos(tmp_path / "rtk.pos", form), imu_csv(tmp_path)
    got = imported(imu, gps=pos, truth=pos, recipe=Recipe(origin=ORIGIN)).drive
    assert_close(got.gps, DRIVE.gps, "time", 6e-4)  # printed to the ms
    assert_close(got.gps, DRIVE.gps, "lat lon", 1e-9)
    assert_close(got.gps, DRIVE.gps, "std_x std_y alt", 1e-4)
    assert_close(got.truth, DRIVE.gps, "x y", 1e-3)
    if form == "dates":
        assert_close(got.gps, DRIVE.gps, "speed course", 1e-4)
        np.testing.assert_allclose(got.truth.vx, DRIVE.gps.speed * np.cos(DRIVE.gps.course), atol=1e-4)
        np.testing.assert_allclose(got.truth.theta, DRIVE.gps.course, atol=1e-4)
    else:
        assert got.gps.speed is None


def test_truth_with_altitude_beside_fixes_without(tmp_path: Path):
    """High up, fixes without an altitude lie at sea level; truth and fixes must still agree."""
    gps = DRIVE.gps
    high = write_pos(tmp_path / "rtk.pos")
    lines = high.read_text().splitlines()
    raised = [line if line[0] == "%" else line.replace(line.split()[4], "3000.0000", 1) for line in lines]
    high.write_text("\n".join(raised) + "\n")
    cells = np.column_stack([gps.time + EPOCH, gps.lat, gps.lon]).tolist()
    rows = "\n".join(",".join(map(repr, row)) for row in cells)
    (tmp_path / "gps.csv").write_text("t,lat,lon\n" + rows + "\n")
    got = imported(imu_csv(tmp_path), gps=tmp_path / "gps.csv", truth=high).drive
    np.testing.assert_allclose(got.truth.x, got.gps.x, atol=1e-3)
    np.testing.assert_allclose(got.truth.y, got.gps.y, atol=1e-3)


@pytest.mark.parametrize(
    ("write", "damage"),
    [(w, d) for w in (write_kitti, write_nclt, write_comma) for d in ("cut", "empty", "missing")],
)
def test_broken_data_set(tmp_path: Path, write, damage: str):
    path = write(tmp_path)
    names = {
        write_kitti: "oxts/timestamps.txt",
        write_nclt: "ms25.csv",
        write_comma: "processed_log/IMU/gyro/value",
    }
    file = path / names[write]
    content = file.read_bytes()
    if damage == "missing":
        file.unlink()
    else:
        file.write_bytes(content[:500] if damage == "cut" else b"")
    with pytest.raises(InputError) as caught:
        imported(path)
    print(f"{write.__name__}, {damage}: {caught.value}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda text: text[: len(text) * 2 // 3], "numbers of the header's columns"),
        (
            lambda text: text.replace("latitude(deg) longitude(deg)", "x-ecef(m) y-ecef(m)"),
            "latitude, longitude",
        ),
        (
            lambda text: "\n".join(line for line in text.splitlines() if line[0] != "%"),
            "has no RTKLIB header",
        ),
        (
            lambda text: "\n".join(line for line in text.splitlines() if line[0] == "%") + "\n",
            "no usable row",
        ),
    ],
)
def test_broken_rtklib(tmp_path: Path, edit, said: str):
    pos = write_pos(tmp_path / "rtk.pos")
    pos.write_text(edit(pos.read_text()))
    with pytest.raises(InputError, match=said):
        imported(imu_csv(tmp_path), gps=pos)
