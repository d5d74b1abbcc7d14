"""What a training leaves: a folder with the filter, what was learned, and how; no pickle in it.

tuning.toml, seen.npz   the filter, as its tuning has left them
learned.toml            which network, its settings, and what it learned from
weights.npz             its numbers
learned_seen.npz        what the training drives are recognized by
timings.json            what the training took: the one file that differs from run to run
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomli_w
from pydantic import BaseModel, Field

from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.drives.overlap import Landmarks, load_landmarks
from sigmaswarm.errors import InputError
from sigmaswarm.files import read_arrays, whole_file, write_whole
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.replay import Replay
from sigmaswarm.learned import outage_lstm
from sigmaswarm.learned.cells import n_weights
from sigmaswarm.learned.noise_gru import NoiseGru, NoiseRun
from sigmaswarm.learned.outage_lstm import OutageLstm, OutageRun
from sigmaswarm.records import load_record

LEARNED_FILE, WEIGHTS_FILE, LEARNED_SEEN = "learned.toml", "weights.npz", "learned_seen.npz"


class NetworkRecord(BaseModel):
    """``[network]`` of learned.toml: all of a network but its weights."""

    units: int
    window: float
    learning_rate: float
    axes: list[str] = Field(default_factory=list)
    inflation: float | None = None
    """None: infinite."""
    unsure: float = 1.0
    numbers: int


class TrainingRecord(BaseModel):
    """``[training]`` of learned.toml."""

    seed: int
    search: int
    driven_s: float
    labelled_s: float = 0.0
    """Of driving whose truth was looked at: none."""
    epochs: int
    loss_before: float
    loss: float
    """On what was held back."""
    held_back: str


class LearnedRecord(BaseModel):
    """learned.toml."""

    kind: str
    network: NetworkRecord
    training: TrainingRecord
    versions: dict[str, str] = Field(default_factory=dict)
    data: list[DriveRecord] = Field(default_factory=list[DriveRecord])


@dataclass(frozen=True, eq=False)
class Learned:
    """A trained network, and how it came about.

    Attributes
    ----------
    record : LearnedRecord
    weights : mapping of str to ndarray
    """

    record: LearnedRecord
    weights: Mapping[str, Array]

    @property
    def kind(self) -> str:
        """Its name: outage-lstm or noise-gru."""
        return self.record.kind

    def run(
        self, replay: Replay, parameters: FilterParameters, *, recover: bool = False
    ) -> "OutageRun | NoiseRun":
        """The filter over a replay, with what was learned."""
        net = self.record.network
        if self.kind == outage_lstm.NAME:
            inflation = np.inf if net.inflation is None else net.inflation
            network = OutageLstm(tuple(net.axes), net.window, self.weights, inflation, net.unsure)
            return OutageRun(replay, parameters, network, recover=recover)
        return NoiseRun(replay, parameters, NoiseGru(self.weights), recover=recover)

    def save(self, folder: Path) -> list[Path]:
        """Write learned.toml and weights.npz; their paths."""
        paths = [folder / WEIGHTS_FILE, folder / LEARNED_FILE]
        with whole_file(paths[0]) as file:
            np.savez(file, allow_pickle=False, **dict(sorted(self.weights.items())))
        write_whole(paths[1], tomli_w.dumps(self.record.model_dump(mode="json", exclude_none=True)))
        return paths


def seen_in(folder: Path) -> list[Landmarks]:
    """What the drives are recognized by that a folder's network learned from; empty where there is none."""
    return [] if not folder.is_dir() else load_landmarks(folder / LEARNED_SEEN) or []


def load_learned(folder: Path) -> Learned | None:
    """What a folder holds beside a filter; None where it is no training's.

    Raises
    ------
    InputError
        If a file is damaged.
    """
    folder = folder if folder.is_dir() else folder.parent
    file, weights = folder / LEARNED_FILE, folder / WEIGHTS_FILE
    if not file.exists():
        return None
    record = load_record(LearnedRecord, file)
    try:
        arrays = {name: np.asarray(array, np.float64) for name, array in read_arrays(weights).items()}
        if n_weights(arrays) != record.network.numbers:
            raise ValueError
    except Exception:  # a damaged archive raises BadZipFile, EOFError, zlib.error, ValueError, KeyError ...
        raise InputError(f"{weights}: not readable; repeat the command that made the folder") from None
    return Learned(record, arrays)
