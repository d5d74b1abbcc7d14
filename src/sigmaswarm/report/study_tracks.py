"""Tracks of a study: a few drives that its best trial held back, by the filters that this trial tuned."""

from pathlib import Path

from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.tracks import save_tracks, tracks_of
from sigmaswarm.study.config import ProtocolName
from sigmaswarm.study.design import ALL, Design
from sigmaswarm.study.run import Study
from sigmaswarm.study.scores import manual

MANUAL = ("ukf-datasheet", "ukf-defaults")
TUNED: tuple[tuple[ProtocolName, str], ...] = (
    ("honest", "pso-ukf"),
    ("paper", "pso-ukf"),
    ("honest", "pso-ekf"),
    ("honest", "pso-planar8"),
)
"""Protocol and method of the filters whose tracks are kept; a series is called by both, ``honest-pso-ukf``."""
MOST_DRIVES = 10
MOST_POINTS = 700
"""Of a series: with more, the tracks would be most of the page."""


def save_study_tracks(study: Study, folder: Path) -> Path:
    """Write tracks.npz, which `sigmaswarm report` shows, into the folder of a study."""
    drives = study.design.drives
    tracks = [
        tracks_of(drives[i], _filters(study, i), drives[i].name, MOST_POINTS)
        for i in shown_drives(study.design, study.shown_trial)
    ]
    return save_tracks(tracks, folder / "tracks.npz")


def shown_drives(design: Design, trial: int) -> list[int]:
    """Indices of drives that a trial held back: one of each condition, or of each maneuver where these are many.

    Each maneuver's comes from another part of its drives, so that environments differ, too; one that turns comes first.
    Of drives that name no condition the first ones are taken.
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


def _filters(study: Study, drive: int) -> dict[str, FilterParameters]:
    """By series. All of one trial, which has not seen the drive; the best of others may have."""
    by_hand = {method: manual(method, study.design.drives[drive]) for method in MANUAL}
    return {f"{p}-{m}": study.drawn(p, m, drive) for p, m in TUNED} | by_hand
