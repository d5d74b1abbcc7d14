"""The folder of a training run. It contains no pickles, which could execute code.

tuning.toml, seen.npz   files of the filter, from its tuning
learned.toml            type of network, settings, and training data
weights.npz             weights of the network
learned_seen.npz        landmarks to recognize the training drives
timings.json            processor time of the training run; the only file that differs between two runs
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tomli_w
from pydantic import BaseModel, Field

from sigmaswarm.arrays import Array
from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.drives.overlap import Landmarks, load_landmarks
from sigmaswarm.errors import InputError
from sigmaswarm.files import atomic_file, read_arrays, write_atomically
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.learned import outage_lstm
from sigmaswarm.learned.fitting import n_weights, new_weights
from sigmaswarm.learned.noise_gru import FEATURES, NoiseRun
from sigmaswarm.learned.outage_lstm import OutageLstm, OutageRun
from sigmaswarm.record_files import load_record

LEARNED_FILE, WEIGHTS_FILE, LEARNED_SEEN = "learned.toml", "weights.npz", "learned_seen.npz"


class NetworkRecord(BaseModel):
    """``[network]`` of learned.toml."""

    units: int = Field(gt=0, le=1000)
    window: float = Field(gt=0.0, allow_inf_nan=False)
    learning_rate: float
    axes: list[str] = Field(default_factory=list)
    inflation: float | None = None  # factor of the forecasts' variances; None: infinite
    unsure: float = 1.0  # factor on the velocity's Q in outages
    numbers: int  # number of weights


class TrainingRecord(BaseModel):
    """``[training]`` of learned.toml."""

    seed: int
    search: int
    driven_s: float
    labelled_s: float = 0.0  # always 0: training does not use truth
    epochs: int
    loss_before: float
    loss: float  # on the validation data
    held_back: str


class LearnedRecord(BaseModel):
    """learned.toml."""

    kind: Literal["outage-lstm", "noise-gru"]
    network: NetworkRecord
    training: TrainingRecord
    versions: dict[str, str] = Field(default_factory=dict)
    data: list[DriveRecord] = Field(default_factory=list[DriveRecord])


@dataclass(frozen=True, eq=False)
class LearnedNetwork:
    """A trained network: its record in learned.toml, and its weights."""

    record: LearnedRecord
    weights: Mapping[str, Array]

    @property
    def kind(self) -> str:
        return self.record.kind

    def run(
        self, drive_pass: FilterPass, parameters: FilterParameters, *, recover: bool = False
    ) -> "OutageRun | NoiseRun":
        net = self.record.network
        if self.kind == outage_lstm.NAME:
            inflation = np.inf if net.inflation is None else net.inflation
            network = OutageLstm(tuple(net.axes), net.window, self.weights, inflation, net.unsure)
            return OutageRun(drive_pass, parameters, network, recover=recover)
        return NoiseRun(drive_pass, parameters, self.weights, recover=recover)

    def save(self, folder: Path) -> list[Path]:
        paths = [folder / WEIGHTS_FILE, folder / LEARNED_FILE]
        with atomic_file(paths[0]) as file:
            np.savez(file, allow_pickle=False, **dict(sorted(self.weights.items())))
        write_atomically(paths[1], tomli_w.dumps(self.record.model_dump(mode="json", exclude_none=True)))
        return paths


def training_landmarks(folder: Path) -> list[Landmarks]:
    """Return the landmarks of the training drives of the network in a folder; an empty list if the file is missing."""
    return [] if not folder.is_dir() else load_landmarks(folder / LEARNED_SEEN) or []


def load_learned(folder: Path) -> LearnedNetwork | None:
    """Read the network of a folder. Return None if it contains no network. Raises `InputError` if a file is damaged."""
    folder = folder if folder.is_dir() else folder.parent
    file, weights = folder / LEARNED_FILE, folder / WEIGHTS_FILE
    if not file.exists():
        return None
    record = load_record(LearnedRecord, file)
    try:
        arrays = {name: np.asarray(array, np.float64) for name, array in read_arrays(weights).items()}
    except Exception:  # a damaged archive raises BadZipFile, EOFError, zlib.error, ValueError, KeyError ...
        raise InputError(f"{weights}: is not readable; repeat the command that made the folder") from None
    if n_weights(arrays) != record.network.numbers or not _fits(record, arrays):
        raise InputError(f"{weights}: does not match {file.name}; repeat the command that made the folder")
    return LearnedNetwork(record, arrays)


def _fits(record: LearnedRecord, weights: Mapping[str, Array]) -> bool:
    units, rng = record.network.units, np.random.default_rng(0)
    if record.kind == outage_lstm.NAME:
        features = np.zeros((1, 1, 2 * len(record.network.axes)))
        wanted = outage_lstm.new_network(rng, (), 1.0, units, features, np.zeros((1, 2))).weights
    else:
        wanted = new_weights(rng, 3, FEATURES, units, 2)
    shapes = all(name in weights and weights[name].shape == array.shape for name, array in wanted.items())
    return shapes and all(np.isfinite(array).all() for array in weights.values())
