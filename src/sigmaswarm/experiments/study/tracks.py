"""Tracks of the filters of the best trial on a few of its test drives."""

from collections.abc import Mapping
from functools import partial

from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.config import ALL, MAIN, ProtocolName
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.scores import manual
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_imu_only
from sigmaswarm.scoring.targets import tracking_replay
from sigmaswarm.scoring.tracks import Picture, Tracker, Tracks

MANUAL = ("ukf-datasheet", "ukf-defaults")
FOLLOWED: tuple[tuple[ProtocolName, str], ...] = (
    ("honest", MAIN),
    ("paper", MAIN),
    ("honest", "pso-ekf"),
    ("honest", "pso-planar8"),
)
"""Tuned filters with saved tracks, in series such as ``honest-pso-ukf``."""
MOST_DRIVES = 10
MOST_POINTS = 700  # largest number of points of a series, to limit the size of the page


def follow(
    design: Design, parameters: Mapping[Task, FilterParameters], trial: int
) -> tuple[list[Tracks], Picture]:
    """Record tracks on some test drives of a trial, and the data of the figures on the first drive."""
    tracks: list[Tracks] = []
    pictures: list[Picture] = []
    for i in shown_drives(design, trial):
        tuned = {f"{p}-{m}": parameters[Task(p, m, design.group_of(i), trial)] for p, m in FOLLOWED}
        ((found, picture),) = design.of_each(partial(_followed, tuned=tuned, drawn=not pictures), [i])
        tracks.append(found)
        pictures += [picture] if picture else []
    return tracks, pictures[0]


def _followed(
    ready: PreparedDrive, tuned: Mapping[str, FilterParameters], *, drawn: bool
) -> tuple[Tracks, Picture | None]:
    name = ready.drive.name
    replay, tracker = tracking_replay(ready), Tracker(ready, MOST_POINTS, picture=drawn)
    by_hand = {method: manual(method, ready.drive) for method in MANUAL}
    for series, one in {**tuned, **by_hand}.items():
        tracker.record(series, replay, one)
    tracker.keep_estimate("imu_only", run_imu_only(ready))
    return tracker.tracks(name), tracker.picture(name) if drawn else None


def shown_drives(design: Design, trial: int) -> list[int]:
    """Choose test drives of a trial: one of each condition, or of each maneuver if there are many conditions.

    The chosen drives are from different parts of the lists of drives, so that environments differ. A drive with turns
    is first. Without conditions, the first test drives are chosen.
    """
    _, test = design.split(trial)
    named = {i: design.conditions[i] for i in test}
    if len(set(named.values())) > MOST_DRIVES:
        named = {i: (maneuver, ALL) for i, (maneuver, _) in named.items()}
    groups = list(dict.fromkeys(named.values()))[:MOST_DRIVES]
    if len(groups) == 1:
        return test[:MOST_DRIVES]
    members = [[i for i in test if named[i] == group] for group in groups]
    chosen = [own[k * len(own) // len(groups)] for k, own in enumerate(members)]
    return sorted(chosen, key=lambda i: design.conditions[i][0] != "turns")
