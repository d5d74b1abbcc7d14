"""The design of a study: its drives in conditions, a split for each trial, and the list of its tunings."""

import hashlib
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.overlap import landmarks, overlap_of
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import drive_folders, read_drive
from sigmaswarm.drives.split import split_drives
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study.config import ALL, TUNED_METHODS, ProtocolName, StudyConfig
from sigmaswarm.simulation.conditions import simulate_many


@dataclass(frozen=True, eq=False)
class Design:
    """The drives of a study and how they are used.

    Attributes
    ----------
    drives : tuple of Drive
        Each with truth and a name of its own.
    conditions : tuple of (maneuver, environment)
        Of each drive.
    strata : tuple of str
        Of each drive: the group within which it is split.
    config : StudyConfig
    """

    drives: tuple[Drive, ...]
    conditions: tuple[tuple[str, str], ...]
    strata: tuple[str, ...]
    config: StudyConfig

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups that get filters of their own: the conditions, or all drives together."""
        return tuple(dict.fromkeys(self.strata)) if self.config.per_condition else (ALL,)

    @cached_property
    def prepared(self) -> tuple[PreparedDrive, ...]:
        """The drives made ready for filters, each once; as recorded, for the paper knows of no other rule."""
        return tuple(PreparedDrive(drive, as_recorded=True) for drive in self.drives)

    def members(self, group: str) -> list[int]:
        """Indices of a group's drives."""
        return [i for i, stratum in enumerate(self.strata) if group in (ALL, stratum)]

    def group_of(self, drive: int) -> str:
        """The group whose filter stands for a drive, given by its index."""
        return self.strata[drive] if self.config.per_condition else ALL

    def split(self, trial: int) -> tuple[list[int], list[int]]:
        """Indices of a trial's training and test drives: each condition split by itself."""
        train: list[int] = []
        for stratum in dict.fromkeys(self.strata):
            own = self.members(stratum)
            key = (trial, zlib.crc32(stratum.encode()))
            rng = np.random.default_rng(np.random.SeedSequence(self.config.seed, spawn_key=key))
            chosen, _ = split_drives([self.drives[i] for i in own], self.config.train_fraction, rng=rng)
            names = {drive.name for drive in chosen}
            train += [i for i in own if self.drives[i].name in names]
        return sorted(train), sorted(set(range(len(self.drives))) - set(train))

    @property
    def tasks(self) -> Iterator["Task"]:
        """All tunings of the study, in the order of their trials."""
        for trial in range(self.config.trials):
            for method, (_, _, protocols) in TUNED_METHODS.items():
                for protocol in protocols:
                    for group in self.groups:
                        yield Task(protocol, method, group, trial)

    def fingerprint(self) -> str:
        """A hash of all drives' names and numbers."""
        each = (f"{drive.name} {fingerprint(drive)}\n" for drive in self.drives)
        return hashlib.sha256("".join(each).encode()).hexdigest()


@dataclass(frozen=True)
class Task:
    """One tuning: a method under a protocol, for a group of conditions, in a trial."""

    protocol: ProtocolName
    method: str
    group: str
    trial: int

    @property
    def folder(self) -> str:
        """Where the tunings of all trials of this kind are kept."""
        return kind(self.protocol, self.method, self.group)


def kind(protocol: str, method: str, group: str) -> str:
    """A name for the tunings of a method under a protocol for a group, and for their files."""
    return f"{protocol}-{method}" + ("" if group == ALL else f"-{group}")


def make_design(config: StudyConfig, executor: Executor | None = None) -> Design:
    """Simulate or read a study's drives.

    Raises
    ------
    InputError
        If the drives are too few, lack truth, or can't be read or made.
    """
    if config.drives:
        drives = [read_drive(path) for given in config.drives for path in drive_folders(Path(given))]
    else:
        drives = list(
            simulate_many(
                config.maneuvers,
                config.environments,
                config.runs,
                executor=executor,
                imu=config.imu,
                gps=config.gps,
                seed=config.seed,
            )
        )
    _check(drives, config)
    if config.drives:  # of those that are simulated no two are the same
        _check_apart(drives)
    conditions = tuple(_condition(drive) for drive in drives)
    strata = tuple("-".join(condition) for condition in conditions)
    lonely = [name for name in dict.fromkeys(strata) if strata.count(name) < 2]
    if lonely and config.per_condition:
        raise InputError(f"{lonely[0]}: has one drive, which can't be split; leave per_condition out")
    # Where a condition has one drive only, conditions can't be split by themselves.
    return Design(tuple(drives), conditions, (ALL,) * len(drives) if lonely else strata, config)


def _check_apart(drives: Sequence[Drive]) -> None:
    """Refuse drives that share a part: it would be in training and test drives."""
    marks = [landmarks(drive) for drive in drives]
    for i, one in enumerate(marks):
        if found := overlap_of(one, marks[:i]):
            raise InputError(
                f"{one.name}: {found.seconds:.0f} s of it are in {', '.join(found.of)}, too; a study trains on some "
                "drives and tests on others: leave one of them out"
            )


def _condition(drive: Drive) -> tuple[str, str]:
    scenario = drive.metadata.get("scenario", {})
    named = scenario if isinstance(scenario, dict) else {}
    return str(named.get("maneuver", ALL)), str(named.get("environment", ALL))


def _check(drives: Sequence[Drive], config: StudyConfig) -> None:
    if len(drives) < 2:
        raise InputError(f"a study needs at least 2 drives to split, not {len(drives)}; give more")
    names: set[str] = set()
    for drive in drives:
        if drive.truth is None:
            raise InputError(
                f"{drive.name}: has no truth, which a study scores against; "
                "tune on it with `sigmaswarm tune --objective innovation-nll`"
            )
        if drive.name in names:
            raise InputError(
                f"{drive.name}: two drives have this name; rename a folder, or set name in its drive.toml"
            )
        names.add(drive.name)
    if not config.drives and config.runs < 2 and config.per_condition:
        raise InputError("runs = 1: a condition of one drive can't be split; choose 2 or more")
