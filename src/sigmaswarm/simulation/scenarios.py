"""Simulate one drive (journey, sensors and truth), or many drives in threads.

Seed, maneuver, environment, run and the sensor's name determine the random numbers of a sensor. A change of one sensor
does not change the data of the others. The compiled code releases the interpreter's lock.
"""

import math
import os
import zlib
from collections import deque
from collections.abc import Callable, Container, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive, Truth
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.simulation.dynamics import STEP, Vehicle
from sigmaswarm.simulation.environments import ENVIRONMENTS, Environment, find_vehicle, lookup
from sigmaswarm.simulation.gps import (
    GPS_GRADES,
    HEADING_GRADES,
    GpsGrade,
    HeadingGrade,
    degrade,
    measure_gps,
    with_heading,
)
from sigmaswarm.simulation.maneuvers import MANEUVERS, achieved_figures, drive_maneuver
from sigmaswarm.simulation.motion import (
    HEIGHT,
    ROAD_PITCH,
    ROAD_ROLL,
    TERRAINS,
    LeverArm,
    Motion,
    Terrain,
    add_slopes,
    build_road_profile,
    motion_at,
    sample,
    vibrate,
)
from sigmaswarm.simulation.sensors import (
    IMU_GRADES,
    ODOMETER_GRADES,
    ImuGrade,
    OdometerGrade,
    measure_imu,
    measure_odometer,
)


@dataclass(frozen=True)
class Scenario:
    """Checked configuration of a simulated drive; `simulate` describes the fields."""

    maneuver: str = "urban"
    environment: str | Environment = "clear"
    seed: int = 0
    run: int = 0
    imu: str | ImuGrade = "icm-20602"
    gps: str | GpsGrade = "ublox-m8"
    vehicle: str | Vehicle = "model3"
    imu_rate: float = 100.0
    gps_rate: float = 5.0
    jitter: float = 0.0
    duration: float | None = None
    warm_up: bool = True
    imu_place: LeverArm = (0.2, 0.0, 0.1)  # center console
    vibration: float = 0.0
    gnss_degradation: bool = False
    terrain: str | Terrain = "flat"
    odometer: str | OdometerGrade | None = None
    heading: str | HeadingGrade | None = None

    def __post_init__(self) -> None:
        for what in ("imu_rate", "gps_rate"):
            if not 0 < (rate := getattr(self, what)) <= 1 / STEP:
                raise InputError(
                    f"{what} is {rate:g} Hz; choose more than 0 and at most 1000 Hz, the rate of the simulated motion"
                )
        for what in ("jitter", "vibration"):
            if not 0 <= (value := getattr(self, what)) < math.inf:
                raise InputError(f"{what} is {value:g}; choose 0 or more")
        check_duration(self.maneuver, self.duration)
        if self.seed < 0 or self.run < 0:
            raise InputError(f"seed is {self.seed} and run is {self.run}; choose 0 or more for both")


def simulate(maneuver: str = "urban", environment: str | Environment = "clear", **options: Any) -> Drive:
    """Simulate one drive.

    Parameters
    ----------
    maneuver : str
        "cruise", "turns", "accelerate", "brake", "outages" or "urban".
    environment : str or Environment
        "clear", "night", "rain", "fog" or "slippery".
    seed, run : int
        Seed, and number of the run; both 0 by default. Different runs have different random numbers. Equal arguments
        give the same drive.
    imu, gps : str or ImuGrade, GpsGrade
        Names in `IMU_GRADES` and `GPS_GRADES`, or records; "icm-20602" and "ublox-m8" by default.
    vehicle : str or Vehicle
        "model3" (pedals of the real car, the default) or "model3-carla".
    imu_rate, gps_rate : float
        Sampling rates (Hz), at most 1000; 100 and 5 by default.
    jitter : float
        Standard deviation of the random errors of the sample times, s; 0 by default. Each error is limited to 0.4 times
        the interval.
    duration : float, optional
        Duration of "urban", s; 180 by default.
    warm_up : bool
        Begin with at least 30 m at 5 m/s or more, so that a filter can align (the default). If False, the drive begins
        with the maneuver itself, in motion.
    imu_place : tuple of float
        Position of the IMU, m forward, left and up from the center of gravity; (0.2, 0, 0.1) by default. The truth
        refers to this point.
    vibration : float
        Level of the vibration while driving, 0 by default as in CARLA. 1 is the level in two recordings of real cars,
        whose noise is much larger than the values in data sheets.
    gnss_degradation : bool
        Multiply the errors of the receiver by the environment's factor, which is **an assumption, not a measurement**.
    terrain : str or Terrain
        "flat" (the default), "rolling" or "hilly". Slopes of the road change attitude and IMU data. The
        horizontal position of the truth differs from that on a flat road by only millimeters.
    odometer : str or OdometerGrade, optional
        "pulses", "can" or "ideal" (`ODOMETER_GRADES`); no odometer by default.
    heading : str or HeadingGrade, optional
        Heading of each fix: "dual-antenna" or "ideal" (`HEADING_GRADES`); no heading by default.

    Returns
    -------
    Drive
        Drive with truth at the IMU's nominal times. The metadata contain noise parameters of the sensors, and target
        values and achieved values of the maneuver.

    Raises
    ------
    InputError
        For an unknown name or an invalid value.
    """
    return _drive(Scenario(maneuver, environment, **options))


def _drive(s: Scenario) -> Drive:
    where, ground = lookup(s.environment, ENVIRONMENTS, "environment"), lookup(s.terrain, TERRAINS, "terrain")
    imu, gps = lookup(s.imu, IMU_GRADES, "IMU grade"), lookup(s.gps, GPS_GRADES, "GPS grade")
    wheels = s.odometer and lookup(s.odometer, ODOMETER_GRADES, "odometer")
    vehicle, car = find_vehicle(s.vehicle)
    if s.gnss_degradation:
        gps = degrade(gps, where.gnss_noise_factor)

    def stream(sensor: str) -> np.random.Generator:
        names = (zlib.crc32(name.encode()) for name in (s.maneuver, where.name, sensor))
        return np.random.default_rng(np.random.SeedSequence([s.seed, s.run, *names]))

    journey = drive_maneuver(s.maneuver, where, car, stream("driver"), s.duration, s.warm_up)
    record, slopes = journey.record, {}  # no keys on a flat road, as in files of early versions
    if ground != TERRAINS["flat"]:
        record = add_slopes(record, build_road_profile(journey.path[:, 3], ground, stream("road")), car)
        slopes = {"terrain": ground.name} | _slope_figures(record)

    def motion(times: Array, position: Array) -> Motion:
        return motion_at(sample(record, times), car, position)

    end, position = (len(record) - 1) * STEP, np.array(s.imu_place)
    nominal = _times(end, s.imu_rate)
    # CARLA's ticks have no jitter.
    ticks = nominal if imu.carla else _times(end, s.imu_rate, s.jitter, stream("imu clock"))
    stamps = _times(end, s.gps_rate, s.jitter, stream("gps clock"))
    stamps = stamps[stamps >= gps.latency]
    true, measured = motion(nominal, position), motion(stamps - gps.latency, position + gps.lever_arm)
    at_imu = true if ticks is nominal else motion(ticks, position)
    if s.vibration > 0:
        at_imu = vibrate(at_imu, s.imu_rate, s.vibration, stream("vibration"))
    fixes = measure_gps(stamps, measured, gps, stream("gps"), journey.outages)
    odometer, about = None, dict[str, Any]()
    if s.heading:
        two = lookup(s.heading, HEADING_GRADES, "heading")
        fixes = with_heading(fixes, stamps, measured.yaw, two, stream("heading"))
        about["heading"] = {"grade": two.name, "mounting_rad": two.mounting}
    if wheels:
        odometer, scale = measure_odometer(record, car, wheels, stream("odometer"))
        about["odometer"] = {"grade": wheels.name, "scale": round(scale, 6)}
    x, y, vx, vy = np.hstack([true.position[:, :2], true.velocity[:, :2]]).T
    return Drive(
        name=drive_name(s.maneuver, where.name, s.run),
        imu=measure_imu(ticks, at_imu, imu, stream("imu")),
        gps=fixes,
        truth=Truth(nominal, x, y, vx, vy, true.yaw),
        metadata={
            "source": "sigmaswarm simulator",
            "vehicle": vehicle,
            **_noise_figures(imu, gps),
            **about,
            **_setup_figures(s, where, car, slopes | {"outages": [list(w) for w in journey.outages]}),
            "target": journey.maneuver.target,
            "achieved": achieved_figures(s.maneuver, journey, fixes.time),
        },
        odometer=odometer,
    )


def drive_name(maneuver: str, environment: str, run: int) -> str:
    return f"{maneuver}-{environment}-{run:02d}"


def check_duration(maneuver: str, duration: float | None) -> None:
    if duration is None:
        return
    if maneuver != "urban":
        raise InputError(
            f"duration is {duration:g} s for {maneuver!r}; only 'urban' takes a duration; omit it"
        )
    if not 30 <= duration < math.inf:
        raise InputError(f"duration is {duration:g} s; choose 30 s or more")


def _times(end: float, rate: float, jitter: float = 0.0, rng: np.random.Generator | None = None) -> Array:
    """Return strictly increasing sample times from 0 to `end`, s."""
    times = np.arange(int(end * rate + 1e-6) + 1) / rate
    if rng is None or jitter == 0:
        return times
    late = np.clip(jitter * rng.standard_normal(len(times)), -0.4 / rate, 0.4 / rate)
    return np.clip(times + late, 0.0, end)


def _setup_figures(s: Scenario, where: Environment, car: Vehicle, more: dict[str, Any]) -> dict[str, Any]:
    forward, left, up = s.imu_place
    return {
        "scenario": {
            "maneuver": s.maneuver,
            "environment": where.name,
            "physics": where.physics,
            "friction": where.friction,
            **{
                name: getattr(s, name) for name in ("seed", "run", "warm_up", "vibration", "gnss_degradation")
            },
            "imu_rate_hz": s.imu_rate,
            "gps_rate_hz": s.gps_rate,
            "jitter_s": s.jitter,
            **more,
        },
        "imu_place": {
            "ahead_of_center_m": forward,
            "ahead_of_rear_axle_m": round(car.rear + forward, 6),
            "left_m": left,
            "above_center_m": up,
        },
    }


def _slope_figures(record: Array) -> dict[str, float]:
    grade, bank = (np.tan(record[:, i]) for i in (ROAD_PITCH, ROAD_ROLL))
    figures = {
        "grade_std_percent": 100 * np.std(grade),
        "peak_grade_percent": 100 * np.abs(grade).max(),
        "peak_bank_percent": 100 * np.abs(bank).max(),
        "climb_m": np.ptp(record[:, HEIGHT]),
    }
    return {name: round(float(value), 2) for name, value in figures.items()}


def _noise_figures(imu: ImuGrade, gps: GpsGrade) -> dict[str, Any]:
    """Return data-sheet values under the keys that filters read, and all other values in tables."""
    sensors = {"accel": imu.accel, "gyro": imu.gyro}
    figures = {f"{name}_noise_density": triad.noise_density for name, triad in sensors.items()}
    figures["gps_std_m"] = gps.std

    def errors(*kinds: str) -> dict[str, float]:
        return {f"{name}_{kind}": getattr(triad, kind) for kind in kinds for name, triad in sensors.items()}

    return {
        **{key: value for key, value in figures.items() if value > 0},  # ideal sensors lack these values
        **({"gps_lever_arm_m": list(gps.lever_arm)} if any(gps.lever_arm) else {}),
        "imu_noise": {
            "grade": imu.name,
            **errors("bias_std"),
            "bias_time_s": imu.bias_time,
            **errors("turn_on", "scale", "misalignment"),
        },
        "gps_noise": {
            "grade": gps.name,
            "white_std_m": gps.white_std,
            "correlated_std_m": gps.markov_std,
            "correlation_time_s": gps.markov_time,
            "loss": gps.loss,
            "latency_s": gps.latency,
            "lever_arm_m": list(gps.lever_arm),
            **({} if gps.velocity_std is None else {"velocity_std_ms": gps.velocity_std}),
        },
    }


PAPER_MANEUVERS = tuple(name for name in MANEUVERS if name != "urban")


def simulated_source(*what: Any, **options: Any) -> tuple[Drive, list[SigmaswarmWarning]]:
    return simulate(*what, **options), []


def simulate_many(
    maneuvers: Sequence[str] = PAPER_MANEUVERS,
    environments: Sequence[str] = tuple(ENVIRONMENTS),
    runs: int = 20,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    use: Callable[[Drive], Any] | None = None,
    ahead: int = 16,
    leave_out: Container[str] = (),
    **options: Any,
) -> Iterator[Any]:
    """Simulate every maneuver in every environment `runs` times, in threads.

    Parameters
    ----------
    maneuvers, environments : sequence of str
        Names; by default the paper's 25 conditions.
    runs : int
        Number of drives of each condition.
    executor : concurrent.futures.Executor, optional
        Executor of the simulations; by default a pool of threads.
    workers : int, optional
        Number of threads of the pool; by default one per core.
    use : callable, optional
        Function that is called with each drive in the thread of its simulation, for example to write the drive. The
        result of the function is yielded instead of the drive.
    ahead : int
        Largest number of drives that are simulated in advance. If it is less than ``workers``, some threads are idle.
    leave_out : container of str
        Names of drives to skip, for example after an interruption.
    **options
        Options of `simulate`. ``duration`` applies to "urban" only.

    Yields
    ------
    Drive, or the result of `use`
        The order is maneuver, environment, run, for any number of workers. A drive is yielded as soon as it and all
        earlier drives are ready.

    Raises
    ------
    InputError
        If an argument is invalid, as in `simulate`. The error is raised when the first drive is requested.
    """
    duration = options.pop("duration", None)
    _check_conditions(maneuvers, environments, runs, duration)

    def simulate_one(maneuver: str, environment: str, run: int) -> Any:
        seconds = duration if maneuver == "urban" else None
        drive = simulate(maneuver, environment, run=run, duration=seconds, **options)
        return drive if use is None else use(drive)

    names = ((m, e, r) for m in maneuvers for e in environments for r in range(runs))
    pool = executor if executor is not None else ThreadPoolExecutor(workers or os.cpu_count())
    waiting: deque[Future[Any]] = deque()  # at most `ahead` drives, which bounds memory
    try:
        for name in names:
            if drive_name(*name) not in leave_out:
                waiting.append(pool.submit(simulate_one, *name))
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        for future in waiting:
            yield future.result()
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)


def _check_conditions(
    maneuvers: Sequence[str], environments: Sequence[str], runs: int, duration: float | None
) -> None:
    for maneuver in maneuvers:
        lookup(maneuver, MANEUVERS, "maneuver")
    for environment in environments:
        lookup(environment, ENVIRONMENTS, "environment")
    if runs < 1:
        raise InputError(f"runs is {runs}; choose 1 or more")
    check_duration("urban" if "urban" in maneuvers else maneuvers[0], duration)
