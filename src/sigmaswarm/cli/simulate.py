"""`sigmaswarm simulate`."""

from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import sigmaswarm
from sigmaswarm.cli.common import cluster_at, print_result
from sigmaswarm.cli.options import AT_LEAST_1, FIELDS, MORE, Cluster, Json, Seed, Workers
from sigmaswarm.cli.terminal import progress_bar
from sigmaswarm.errors import InputError
from sigmaswarm.wording import count_of

if TYPE_CHECKING:
    from distributed import Client

    from sigmaswarm import Drive

JITTER = 0.002  # s, standard deviation of the errors of the sample times with --jitter


@dataclass(frozen=True, kw_only=True)
class SimulateOptions:
    """Options of `sigmaswarm simulate`.

    Attributes
    ----------
    out
        Folder for the drive folders. It must not contain drives, except with --resume.
    maneuver
        cruise, turns, accelerate, brake, outages: the maneuvers of the paper, all by default. urban: mixed driving.
    environment
        clear, night, rain, fog, slippery; all by default. Clear, night and fog have the same friction.
    runs
        Number of drives of each maneuver in each environment.
    imu
        IMU: ideal, mpu-6050, icm-20602, adis16465, adis16405, adis16488, gnss-ins-sim-low, gnss-ins-sim-mid,
        gnss-ins-sim-high or carla.
    gps
        Receiver: ideal, ublox-m8 (errors correlated over a minute), white-1m, gnss-ins-sim, f9p-rtk or carla.
    vehicle
        Car: model3, or model3-carla with CARLA's pedals and weak brakes.
    seed
        Seed of the routes and the noise.
    duration
        Duration of urban drives, at least 30 s; 180 s by default.
    jitter
        Add jitter with a standard deviation of 2 ms to the times of the samples.
    vibration
        Add vibration of road and engine to the IMU, as strong as in recordings of two real cars.
    gnss_degradation
        Degrade the fixes in bad weather. The degradation is an assumption, not based on measurements.
    terrain
        Terrain: flat, rolling or hilly. Hills and banked roads tilt the car.
    odometer
        Wheel-speed sensor: pulses (coarse, 50 Hz), can (fine, 83 Hz) or ideal. None by default.
    heading
        Heading of each fix from the receiver: dual-antenna (standard deviation 0.4 deg) or ideal. None by default.
    resume
        Keep existing drives and simulate the missing drives.
    """

    out: Path
    maneuver: list[str] | None = None
    environment: list[str] | None = None
    runs: Annotated[int, AT_LEAST_1] = 20
    imu: str = "icm-20602"
    gps: str = "ublox-m8"
    vehicle: Annotated[str, MORE] = "model3"
    seed: Seed = 0
    duration: float | None = None
    jitter: Annotated[bool, MORE] = False
    vibration: bool = False
    gnss_degradation: Annotated[bool, MORE] = False
    terrain: Annotated[str, MORE] = "flat"
    odometer: str | None = None
    heading: str | None = None
    workers: Annotated[Workers, MORE] = None
    cluster: Annotated[Cluster, MORE] = None
    resume: bool = False
    json: Json = False


def simulate(*, options: Annotated[SimulateOptions, FIELDS]) -> None:
    """Simulate drives with known truth.

    The car is a Tesla Model 3. By default, the command simulates 20 drives in each of the paper's 25 conditions: five
    maneuvers in five environments. The default sensors have errors like those of real sensors. The same seed gives the
    same files.

    For example:

        sigmaswarm simulate --out drives
        sigmaswarm simulate --out town --maneuver urban --environment clear --runs 8 --gps white-1m --vibration
        sigmaswarm simulate --out wet --maneuver brake turns --environment rain slippery --imu mpu-6050 --runs 5
        sigmaswarm simulate --out hills --maneuver urban --environment clear --runs 8 --terrain hilly --vibration
    """
    from sigmaswarm.simulation import ENVIRONMENTS, PAPER_MANEUVERS
    from sigmaswarm.simulation.scenarios import Scenario, drive_name

    out, runs = options.out, options.runs
    maneuvers = list(dict.fromkeys(options.maneuver or PAPER_MANEUVERS))
    environments = list(dict.fromkeys(options.environment or ENVIRONMENTS))
    shared = {field.name for field in fields(Scenario)} - {"maneuver", "environment"}
    made_with = {name: value for name, value in vars(options).items() if name in shared}
    made_with |= {"jitter": JITTER * options.jitter, "vibration": float(options.vibration)}
    names = [drive_name(m, e, run) for m in maneuvers for e in environments for run in range(runs)]
    kept = made_with["leave_out"] = _kept(out, names, options.resume, made_with)

    def write(drive: sigmaswarm.Drive) -> Path:
        return sigmaswarm.write_drive(drive, out / drive.name)

    written = 0
    with cluster_at(options.cluster) as client, progress_bar("simulating", "drives, remaining") as show:
        made = (
            sigmaswarm.simulate_many(
                maneuvers, environments, runs, workers=options.workers, use=write, **made_with
            )
            if client is None
            else map(write, simulated_on(client, maneuvers, environments, runs, **made_with))
        )
        for written, _ in enumerate(made, 1):
            show(written, len(names) - len(kept))
    lines = [f"wrote {count_of(written, 'drive')} to {out}" + (f", kept {len(kept)}" if kept else "")]
    if len({"clear", "night", "fog"} & set(environments)) > 1:
        lines.append(
            "note: without --gnss-degradation, drives in the environments clear, night and fog differ only in their "
            "random numbers"
        )
    content = {"drives": [str(out / name) for name in names], "written": written, "kept": len(kept)}
    print_result(options.json, content, *lines, f"next: sigmaswarm plot {out / names[0]}")


def simulated_on(client: "Client", *what: Any, **options: Any) -> "Iterator[Drive]":
    """Run `simulate_many` on the workers of a Dask cluster; other workers simulate the drives of a lost worker.

    Raises
    ------
    ClusterError
        If a worker's software versions differ from the client's, or the scheduler no longer answers.
    """
    from sigmaswarm.datasets.cluster import Cluster

    cluster = Cluster(client)
    cluster.require_same_versions()
    threads = sum(cluster.workers().values())
    try:
        with client.get_executor(pure=False) as pool:
            yield from sigmaswarm.simulate_many(*what, executor=pool, ahead=2 * max(threads, 8), **options)
    except (OSError, CancelledError):
        raise cluster.lost_scheduler() from None


def _kept(out: Path, names: Iterable[str], resume: bool, made_with: Mapping[str, Any]) -> set[str]:
    """Return the names of the drives that already exist, which are kept.

    Raise `InputError` if OUT is a file, if it contains drives and ``resume`` is False, or if an existing drive was made
    with other options.
    """
    nearest = next(path for path in (out, *out.parents) if path.exists())
    if not nearest.is_dir():
        raise InputError(f"{out}: {nearest} is a file; choose another folder")
    existing = {name for name in names if (out / name).exists()}
    drives = sorted(existing | {path.parent.name for path in out.glob("*/imu.*")})
    if drives and not resume:
        raise InputError(
            f"{out}: already contains {drives[0]}; choose another folder, or keep the existing drives with --resume"
        )
    for name in sorted(existing):
        _require_made_with(out / name / "drive.toml", made_with)
    return existing


def _require_made_with(file: Path, options: Mapping[str, Any]) -> None:
    from sigmaswarm.record_files import read_content
    from sigmaswarm.simulation.maneuvers import URBAN_DURATION

    try:
        about = read_content(file)
        scenario = about["scenario"]
        made = {
            **{name: scenario[name] for name in ("seed", "vibration", "gnss_degradation")},
            **{name: about[f"{name}_noise"]["grade"] for name in ("imu", "gps")},
            "vehicle": about["vehicle"],
            "duration": about["target"].get("duration_s"),
            "jitter": scenario["jitter_s"],
            "terrain": scenario.get("terrain", "flat"),
            **{name: about.get(name, {}).get("grade") for name in ("odometer", "heading")},
        }
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{file.parent}: is not a drive that simulate wrote; choose another folder"
        ) from None
    urban = URBAN_DURATION if options["duration"] is None else options["duration"]
    wanted = {**options, "duration": None if made["duration"] is None else urban}  # of urban drives only
    for key, value in made.items():
        if value != wanted[key]:
            raise InputError(
                f"{file}: was made with {key} {value}, not {wanted[key]}; use the same options, or another folder"
            )
