"""Design of a study: drives and their conditions, training and test drives of each trial, and all tuning runs."""

import hashlib
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from sigmaswarm.datasets.cluster import Cluster, Source
from sigmaswarm.datasets.dataset import Dataset, LocalDataset
from sigmaswarm.datasets.remote import RemoteDataset, remote_datasets
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.overlap import Landmarks, landmarks, overlap_of
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import Location, all_drive_locations, read_drive
from sigmaswarm.drives.sensors import LogProperties, log_properties
from sigmaswarm.drives.split import split_drives
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study.config import (
    ALL,
    BAYESIAN_METHOD,
    BO_EVALUATIONS,
    METHODS,
    PROTOCOLS,
    ProtocolName,
    StudyConfig,
)
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.batch import BatchScorer, PassOptions
from sigmaswarm.scoring.remote import AnyBatchScorer, RemoteBatchScorer, map_prepared
from sigmaswarm.simulation.scenarios import simulate_many, simulated_source
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.defaults import default_filter_options, objective_for
from sigmaswarm.tuning.search import MIN_RACED_DRIVES, Trial

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")
# IMUs for tests with other sensors. The study uses the first one that is not its own IMU.
OTHER_IMU = ("mpu-6050", "icm-20602")
HOME_CAR, OTHER_CAR = "model3", "model3-carla"


@dataclass(frozen=True)
class Task:
    """One tuning: a method under a protocol, for a group of conditions, in a trial."""

    protocol: ProtocolName
    method: str
    group: str
    trial: int

    @property
    def variant(self) -> tuple[ProtocolName, str]:
        return self.protocol, self.method

    @property
    def folder(self) -> str:
        return tuning_name(self.protocol, self.method, self.group)


Trials = Mapping[Task, Trial]
Filters = Mapping[Task, FilterParameters]


def tuning_name(protocol: str, method: str, group: str) -> str:
    return f"{protocol}-{method}" + ("" if group == ALL else f"-{group}")


@dataclass(frozen=True, eq=False)
class Design:
    """The drives of a study and their use.

    ``drives`` have truth and unique names. Drives on a cluster (``remote``) are represented by `LogProperties`.
    ``conditions`` contains maneuver and environment of each drive. ``strata`` contains the stratum of each drive; each
    stratum is split into training and test drives. ``apart`` is True if all drives are test drives.
    """

    drives: tuple[Drive | LogProperties, ...]
    conditions: tuple[tuple[str, str], ...]
    strata: tuple[str, ...]
    config: StudyConfig
    remote: RemoteDataset | None = None
    apart: bool = False

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups that are tuned separately: the conditions, or all drives together."""
        return tuple(dict.fromkeys(self.strata)) if self.config.per_condition else (ALL,)

    @cached_property
    def prepared(self) -> tuple[PreparedDrive, ...]:
        """Local drives, without preprocessing, as in the paper."""
        drives = (drive for drive in self.drives if isinstance(drive, Drive))
        return tuple(PreparedDrive(drive, as_recorded=True) for drive in drives)

    def map_prepared(
        self, function: Callable[[PreparedDrive], T], drives: Sequence[int] | None = None
    ) -> list[T]:
        """Apply a module-level function to prepared local or remote drives.

        ``drives`` contains indices, by default all.
        """
        chosen = range(len(self.drives)) if drives is None else drives
        if self.remote is None:
            return [function(self.prepared[i]) for i in chosen]
        return map_prepared(self.remote.subset(chosen), function, as_recorded=True)

    def scorer(self, *, outages: bool) -> AnyBatchScorer:
        passes = PassOptions(outages=outages, outage_seed=self.config.seed, as_recorded=True)
        if self.remote is None:
            return BatchScorer.prepare(self.prepared, passes)
        return RemoteBatchScorer(self.remote, passes)

    @cached_property
    def configs(self) -> dict[tuple[ProtocolName, str], TuneConfig]:
        """Tuning configuration of each pair of protocol and method."""
        return {(protocol, name): self.tune_config(name, protocol) for protocol, name in self.config.tuned}

    def tune_config(self, method: str, protocol: str) -> TuneConfig:
        c, particles, generations = self.config, self.config.particles, self.config.generations
        options: dict[str, Any] = self._default_options
        if chosen := METHODS[method].filter:
            kind, model = chosen
            options = {"optimizer": "pso", "kind": kind, "model": model, **PROTOCOLS[protocol].model_dump()}
        if method == BAYESIAN_METHOD:
            particles = min(particles, BO_EVALUATIONS)
            generations = min(generations, BO_EVALUATIONS // particles)
            options["optimizer"] = "bo"
        return TuneConfig(
            **options,
            particles=particles,
            generations=generations,
            trials=c.trials,
            seed=c.seed,
            outage_seed=c.seed,
            racing=self._races and method != BAYESIAN_METHOD,
            as_recorded=True,
        )

    @cached_property
    def _races(self) -> bool:
        """The option ``racing``.

        By default, it is True if every tuning has at least `MIN_RACED_DRIVES` training drives.
        """
        if self.config.racing is not None:
            return self.config.racing
        train = set(self.split(0)[0])
        return min(len(train.intersection(self.members(group))) for group in self.groups) >= MIN_RACED_DRIVES

    @cached_property
    def _default_options(self) -> dict[str, Any]:
        options, _ = default_filter_options({}, self.drives)
        return {**options, "objective": objective_for(self.drives, "auto", options["model"], options["use"])}

    def members(self, group: str) -> list[int]:
        return [i for i, stratum in enumerate(self.strata) if group in (ALL, stratum)]

    def group_of(self, drive: int) -> str:
        return self.strata[drive] if self.config.per_condition else ALL

    def split(self, trial: int) -> tuple[list[int], list[int]]:
        """Return the indices of a trial's training and test drives, split within each stratum."""
        if self.apart:
            return [], list(range(len(self.drives)))
        train: list[int] = []
        for stratum in dict.fromkeys(self.strata):
            rng = self.rng(trial, stratum)
            train += split_drives(self.members(stratum), self.config.train_fraction, rng=rng)[0]
        return sorted(train), sorted(set(range(len(self.drives))) - set(train))

    def rng(self, trial: int, purpose: str) -> np.random.Generator:
        key = (trial, zlib.crc32(purpose.encode()))
        return np.random.default_rng(np.random.SeedSequence(self.config.seed, spawn_key=key))

    @property
    def tasks(self) -> Iterator[Task]:
        for trial in range(self.config.trials):
            for protocol, method in self.config.tuned:
                for group in self.groups:
                    yield Task(protocol, method, group, trial)

    def fingerprint(self) -> str:
        return hashlib.sha256("".join(self.map_prepared(_identity)).encode()).hexdigest()


def make_design(
    config: StudyConfig, executor: Executor | None = None, cluster: "Client | None" = None
) -> Design:
    """Simulate or read the drives of a study, locally or on the workers of a cluster."""
    remote: RemoteDataset | None = None
    drives: Sequence[Drive | LogProperties]
    if cluster is not None:
        (remote,), warned = remote_datasets(Cluster(cluster), [_sources(config)])
        for warning in warned:
            warnings.warn(warning, stacklevel=2)
        drives = remote.map(log_properties)
    elif config.drives:
        drives = [read_drive(location) for location in all_drive_locations(config.drives)]
    else:
        drives = _simulated(config, executor, config.runs)
    if len(drives) < 2:
        raise InputError(f"a study needs at least 2 drives to split, but has {len(drives)}; add drives")
    _require_truth(drives)
    if not config.drives and config.runs < 2 and config.per_condition:
        raise InputError(
            "runs = 1: per_condition needs 2 drives per condition; choose runs = 2 or more, or omit per_condition"
        )
    dataset: Dataset = remote or LocalDataset([d for d in drives if isinstance(d, Drive)])
    if config.drives:  # simulated drives never share a part
        _require_apart(dataset.map(landmarks))
    conditions = tuple(dataset.map(_condition_of))
    strata = tuple("-".join(condition) for condition in conditions)
    lonely = [name for name in dict.fromkeys(strata) if strata.count(name) < 2]
    if lonely and config.per_condition:
        what = f"condition {lonely[0]} has only one drive, which can't be split"
        raise InputError(f"{what}; omit per_condition")
    # If a condition has only one drive, all drives are split as one stratum.
    return Design(tuple(drives), conditions, (ALL,) * len(drives) if lonely else strata, config, remote)


def designs_elsewhere(home: Design, executor: Executor | None = None) -> dict[str, Design]:
    """Read or simulate test drives with other sensors or another car. Return designs by description."""
    c = home.config
    if not c.rivals or (c.drives and not c.elsewhere):
        return {}
    if c.elsewhere:
        drives_by_place = {
            "as given": [read_drive(location) for location in all_drive_locations(c.elsewhere)]
        }
        own = [drive for drive in home.drives if isinstance(drive, Drive)]
        _require_apart([landmarks(drive) for drive in (*own, *drives_by_place["as given"])])
    else:
        imu = next(name for name in OTHER_IMU if name != c.imu)
        runs, seed = min(c.runs, 2), c.seed + 1  # other roads
        drives_by_place = {
            f"IMU {imu} for {c.imu}": _simulated(c, executor, runs, seed=seed, imu=imu),
            f"car {OTHER_CAR} for {HOME_CAR}": _simulated(c, executor, runs, seed=seed, vehicle=OTHER_CAR),
        }
    designs: dict[str, Design] = {}
    for place, drives in drives_by_place.items():
        _require_truth(drives)
        conditions = tuple(map(_condition_of, drives))
        strata = tuple(map("-".join, conditions))
        designs[place] = Design(tuple(drives), conditions, strata, c, apart=True)
    return designs


def _sources(config: StudyConfig) -> Sequence[Location | Source]:
    if config.drives:
        return all_drive_locations(config.drives)
    names = product(config.maneuvers, config.environments, range(config.runs))
    return [partial(simulated_source, m, e, run=run, **config.simulated) for m, e, run in names]


def _simulated(config: StudyConfig, executor: Executor | None, runs: int, **other: Any) -> list[Drive]:
    options = {**config.simulated, **other}
    return list(simulate_many(config.maneuvers, config.environments, runs, executor=executor, **options))


def _identity(ready: PreparedDrive) -> str:
    return f"{ready.drive.name} {fingerprint(ready.drive)}\n"


def _condition_of(drive: Drive) -> tuple[str, str]:
    scenario = drive.metadata.get("scenario", {})
    named = scenario if isinstance(scenario, dict) else {}
    return str(named.get("maneuver", ALL)), str(named.get("environment", ALL))


def _require_apart(marks: Sequence[Landmarks]) -> None:
    """Raise `InputError` if drives have a common part, which a training drive and a test drive could both contain."""
    for i, one in enumerate(marks):
        if overlap := overlap_of(one, marks[:i]):
            raise InputError(
                f"{one.name}: {overlap.seconds:.0f} s of this drive are also in {', '.join(overlap.of)}; omit this "
                "drive, since a study trains on some drives and tests on others"
            )


def _require_truth(drives: Sequence[Drive | LogProperties]) -> None:
    names: set[str] = set()
    for drive in drives:
        if not drive.truth:
            raise InputError(
                f"{drive.name}: has no truth, which a study needs for its scores; "
                "tune on it with `sigmaswarm tune --objective innovation-nll`"
            )
        if drive.name in names:
            raise InputError(
                f"{drive.name}: two drives have this name; rename a folder, or set name in its drive.toml"
            )
        names.add(drive.name)
