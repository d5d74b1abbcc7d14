"""The record of a study: all that its folder says of it, to be written and read again."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import BaseModel, Field

from sigmaswarm.experiments.study.record import Results
from sigmaswarm.experiments.study.spread import Spread, read_spreads
from sigmaswarm.records import load_record
from sigmaswarm.scoring.tracks import Tracks, load_tracks

LiveTimes = Mapping[str, Mapping[str, float]]
"""ms of a live filter's calls, by filter: predict_ms, predict_and_update_ms."""
RivalTimes = Mapping[str, Mapping[str, float]]
"""By variant, as honest-pso-ukf: training_s, processor seconds of a trial, and sample_us, of an IMU sample."""


class _Timings(BaseModel):
    live_filter: dict[str, dict[str, float]] = Field(default_factory=dict[str, dict[str, float]])
    rivals: dict[str, dict[str, float]] = Field(default_factory=dict[str, dict[str, float]])


class _Asked(BaseModel):
    versions: dict[str, str]


@dataclass(frozen=True, eq=False)
class StudyRecord:
    """What a study found.

    Attributes
    ----------
    results : Results
        results.json.
    spreads : list of Spread
        Of scores.csv.
    live : mapping of filter to mapping of call to ms
        Of timings.json; empty where they were not taken.
    rival_times : mapping of variant to mapping of what to figure
        Of timings.json; empty where there are no rivals.
    tracks : list of Tracks
        tracks.npz; empty where there are none.
    versions : mapping of str to str
        Of the software, as its tunings keep them.
    """

    results: Results
    spreads: list[Spread]
    live: LiveTimes = field(default_factory=dict[str, dict[str, float]])
    rival_times: RivalTimes = field(default_factory=dict[str, dict[str, float]])
    tracks: list[Tracks] = field(default_factory=list[Tracks])
    versions: Mapping[str, str] = field(default_factory=dict[str, str])

    @classmethod
    def read(cls, folder: Path) -> "StudyRecord":
        """Read the folder of a study.

        Raises
        ------
        InputError
            If a file in it is missing or damaged.
        """
        timings, tracks = folder / "timings.json", folder / "tracks.npz"
        times = load_record(_Timings, timings) if timings.exists() else _Timings()
        configs = sorted(folder.glob("trials/*/config.json"))
        return cls(
            load_record(Results, folder / "results.json"),
            read_spreads(folder),
            times.live_filter,
            times.rivals,
            load_tracks(tracks) if tracks.exists() else [],
            load_record(_Asked, configs[0]).versions if configs else {},
        )
