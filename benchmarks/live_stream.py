"""Run the live filter for a day: 8.64 million IMU samples at 100 Hz, fixes at 5 Hz, every tenth fix late.

    python benchmarks/live_stream.py --hours 24
    python benchmarks/live_stream.py --hours 24 --swarm

In each minute, a car accelerates to 10 m/s on a circle, brakes, and stands for 10 s. The filter is planar8 with all
options for cars, which needs the most memory. Prints the processor time, the memory of the process over time, and the
position errors.
"""

import argparse
import os
import resource
import time
from pathlib import Path

import numpy as np

from sigmaswarm import FilterParameters, InitialState, LiveFilter, LiveFilterBank

RATE, FIXES_EVERY = 100, 20
MINUTE = 60 * RATE
RADIUS, SPEED = 50.0, 10.0  # m, m/s
LATE = 0.2  # s
PARAMETERS = FilterParameters(
    0.5, 2.0, 0.0, (1e-5, 1e-5, 1e-4, 1e-4, 1e-8, 1e-10, 1e-10, 1e-12), (1.0, 1.0), "planar8",
    lateral_noise=0.1, standstill_noise=1e-3, gate=16.0,
)  # fmt: skip


def minute() -> tuple[np.ndarray, np.ndarray]:
    """Return ax, ay and yaw rate of one minute (6000, 3), and the driven distance after each sample (6000,), m."""
    edges = np.arange(MINUTE + 1) / RATE
    speed = np.interp(edges, [0.0, 10.0, 40.0, 50.0, 60.0], [0.0, SPEED, SPEED, 0.0, 0.0])
    middle = (speed[1:] + speed[:-1]) / 2
    imu = np.column_stack([np.diff(speed) * RATE, middle**2 / RADIUS, middle / RADIUS])
    return imu, np.cumsum(middle) / RATE


def resident() -> float:
    """Return the memory of the process, MB: the current memory or, if the system does not report it, the peak."""
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def stream(filter: LiveFilter, minutes: int, rng: np.random.Generator):
    """Feed the filter, and yield the position error (m) and memory (MB) after each minute."""
    imu, driven = minute()
    for m in range(minutes):
        angle = (m * driven[-1] + driven) / RADIUS
        where = RADIUS * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
        fixes = (where + rng.standard_normal(where.shape))[::FIXES_EVERY].tolist()
        samples = (imu + rng.standard_normal(imu.shape) * (0.02, 0.02, 0.001) + (0.05, -0.03, 0.002)).tolist()
        late = None
        for k, sample in enumerate(samples):
            t = (m * MINUTE + k + 1) / RATE
            if k % FIXES_EVERY == 0:
                fix = t, fixes[k // FIXES_EVERY]
                if k // FIXES_EVERY % 10 == 0:
                    late = fix
                else:
                    filter.update(*fix)
            filter.predict(t, sample)
            if late and t >= late[0] + LATE:
                filter.update(*late)
                late = None
        yield float(np.hypot(*(filter.state.mean[:2] - where[-1]))), resident()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--swarm", action="store_true", help="sixteen filters and their searches")
    options = parser.parse_args()
    minutes = round(60 * options.hours)
    initial = InitialState(np.zeros(5), np.diag([1.0, 1.0, 0.1, 0.1, 0.01]), 0.0)
    kind = LiveFilterBank if options.swarm else LiveFilter
    filter = kind(PARAMETERS, initial, nominal_interval=1 / RATE)
    began, errors, memory = time.process_time(), [], []
    for error, megabytes in stream(filter, minutes, np.random.default_rng(0)):
        errors.append(error)
        memory.append(megabytes)
        if len(errors) in (1, 10, minutes) or len(errors) % 360 == 0:
            spent = time.process_time() - began
            print(
                f"{len(errors) / 60:6.2f} h: {spent:7.1f} s, {megabytes:.1f} MB, error {error:.2f} m",
                flush=True,
            )
    print(
        f"{minutes * MINUTE:,} samples, {minutes * MINUTE // FIXES_EVERY:,} fixes, "
        f"{filter.too_late} of them too late: {time.process_time() - began:.0f} s of processor time; "
        f"memory {memory[min(9, minutes - 1)]:.1f} MB after ten minutes, {memory[-1]:.1f} MB at the end; "
        f"position error {np.median(errors):.2f} m in the median, {max(errors):.2f} m at most; "
        f"the filter {'failed' if filter.state.failed else 'is sound'}"
    )


if __name__ == "__main__":
    main()
