"""Measure grade and bank of real roads, from which the parameters of the simulator's terrains are taken.

    python benchmarks/road_slopes.py ../shared/drives

The specific force minus the true acceleration is the component of gravity along each axis. Minus the effect of the
suspension (3 and 4 deg/g, as in the simulator's car), this gives grade and bank of the road. Both are averaged over 10
m of the path, at speeds above 3 m/s. Their means are subtracted, since a tilted mounting has the same effect.
`correlation` is the distance at which the autocorrelation falls below 2/e, the value of a second-order Gauss-Markov
process at its correlation length.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from sigmaswarm import Drive, read_drive
from sigmaswarm.simulation.dynamics import GRAVITY
from sigmaswarm.simulation.environments import MODEL_3

SPACING = 2.0  # m
AVERAGED = 10.0  # m
SLOWEST = 3.0  # m/s
AT_LENGTH = 2 / np.e


def main() -> None:
    folder = Path(sys.argv[1])
    print(
        "| drive | km | grade: std, % | largest, % | correlation, m | bank: std, % | largest, % | correlation, m |"
    )
    print("|---" * 8 + "|")
    for name in sorted(path.name for path in folder.iterdir() if (path / "truth.csv").exists()):
        drive = read_drive(folder / name)
        if drive.imu.az is not None:
            way, grade, bank = slopes(drive)
            cells = [
                f"{100 * np.std(v):.1f} | {100 * np.abs(v).max():.1f} | {length(way, v):.0f}"
                for v in (grade, bank)
            ]
            print(f"| {name} | {way[-1] / 1000:.1f} | {cells[0]} | {cells[1]} |", flush=True)


def slopes(drive: Drive) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return equidistant distances along the path (m), and grade and bank at these; slow parts are omitted."""
    imu, truth = drive.imu, drive.truth
    assert truth is not None
    time = imu.time[(imu.time > truth.time[0] + 1) & (imu.time < truth.time[-1] - 1)]
    second = max(round(1 / float(np.median(np.diff(time)))), 1)

    def smooth(values: np.ndarray) -> np.ndarray:
        return uniform_filter1d(values, second)

    def seen(times: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.interp(time, times, values)

    vx, vy = (seen(truth.time, v) for v in (truth.vx, truth.vy))
    theta = seen(truth.time, np.unwrap(truth.theta))
    east, north = np.gradient(smooth(vx), time), np.gradient(smooth(vy), time)
    ax = np.cos(theta) * east + np.sin(theta) * north
    ay = np.cos(theta) * north - np.sin(theta) * east
    grade = (smooth(seen(imu.time, imu.ax)) - ax) / GRAVITY - MODEL_3.pitch_gain * ax
    bank = (smooth(seen(imu.time, imu.ay)) - ay) / GRAVITY - MODEL_3.roll_gain * ay
    speed = np.hypot(vx, vy)
    moving = speed > SLOWEST
    way = np.cumsum(np.where(moving, speed, 0.0) * np.gradient(time))
    at = np.arange(way[0], way[-1], SPACING)
    rows = [
        uniform_filter1d(np.interp(at, way[moving], v[moving]), round(AVERAGED / SPACING))
        for v in (grade, bank)
    ]
    return at - at[0], rows[0] - rows[0].mean(), rows[1] - rows[1].mean()


def length(way: np.ndarray, values: np.ndarray) -> float:
    """Return the distance (m) at which the autocorrelation falls below `AT_LENGTH`."""
    of = np.correlate(values, values, "full")[len(values) - 1 :] / np.arange(len(values), 0, -1)
    return float(way[np.argmax(of < AT_LENGTH * of[0])])


if __name__ == "__main__":
    main()
