"""sigmaswarm tunes the Kalman filter that fuses a vehicle's IMU and GPS.

Data flow
---------
A `Drive` is read, recorded or simulated. Filters run over drives, and scores measure the errors of the filters. An
objective converts scores to a cost, and an optimizer searches for the parameters with the lowest cost. The result is a
`Tuning`.

Conventions
-----------
- Values are in SI units and radians. Degrees are used in text, for latitude and longitude, for mounting angles, and for
  values whose names end in ``deg``.
- Local frame: east-north-up; x east, y north. Heading ``theta`` counter-clockwise from east, in (-pi, pi].
- Body frame: x forward, y left, z up (REP-103). The IMU measures specific force and angular rate in this frame.
- Attitude of models with roll and pitch: R = Rz(theta) Ry(pitch) Rx(roll) rotates body axes into local axes. ``roll``
  is positive with the left side up, and ``pitch`` with the nose down.
- Time: float64 seconds, strictly increasing within a sensor; each sensor has its own times and rate.
- State of ``planar5``: x, y (m), vx, vy (m/s), theta (rad); other models have additional states after these.
  ``process_noise`` is the diagonal of Q: the variances added per nominal IMU step. ``measurement_noise`` is the
  diagonal of R.
- Filters never use truth. The error is estimate - truth. Costs are minimized; the cost of a failed filter is ``inf``.

Symbols: x, P state mean and covariance; Q, R process and measurement noise covariance; alpha, beta, kappa sigma-point
scaling (Merwe); z, nu, S, K measurement, innovation, innovation covariance, gain; C = Cov(x, z); F, H Jacobians of
process and measurement; n number of states; w, c1, c2 inertia, cognitive and social acceleration of a particle swarm. A
minus or plus after a symbol (P-, P+): before and after the update.

In docstrings and options, "the paper" is Malabo and Gerardo, "Adaptive Tuning of the Unscented Kalman Filter Using
Particle Swarm Optimization for Inertial-GPS Sensor Fusion Systems".
"""

import ast
import warnings
from functools import cache
from importlib import import_module
from pkgutil import get_data
from typing import TYPE_CHECKING, Any

from sigmaswarm.versions import __version__ as __version__

# Only type checkers follow these imports. At run time, `__getattr__` imports a name at its first use.
if TYPE_CHECKING:
    from sigmaswarm.api import evaluate, export, import_log, inspect_log, plot, report, run
    from sigmaswarm.doctor.agreements import Agreement as Agreement
    from sigmaswarm.doctor.agreements import agreements as agreements
    from sigmaswarm.doctor.agreements import shown_by as shown_by
    from sigmaswarm.doctor.diagnose import diagnose
    from sigmaswarm.doctor.findings import Diagnosis as Diagnosis
    from sigmaswarm.doctor.findings import Finding as Finding
    from sigmaswarm.doctor.split import split
    from sigmaswarm.doctor.split import split_time as split_time
    from sigmaswarm.drives.alignment import InitialState as InitialState
    from sigmaswarm.drives.alignment import initial_state as initial_state
    from sigmaswarm.drives.drive import Drive
    from sigmaswarm.drives.drive import Gps as Gps
    from sigmaswarm.drives.drive import Imu as Imu
    from sigmaswarm.drives.drive import Odometer as Odometer
    from sigmaswarm.drives.drive import Truth as Truth
    from sigmaswarm.drives.reader import read_drive
    from sigmaswarm.drives.split import clip as clip
    from sigmaswarm.drives.split import split_drives as split_drives
    from sigmaswarm.drives.writer import write_drive
    from sigmaswarm.errors import (
        AlignmentError,
        DriveError,
        DriveWarning,
        InputError,
        SigmaswarmError,
        SigmaswarmWarning,
    )
    from sigmaswarm.errors import TuningStopped as TuningStopped
    from sigmaswarm.experiments.compare import compare as compare
    from sigmaswarm.experiments.comparison import Comparison as Comparison
    from sigmaswarm.experiments.study.config import StudyConfig as StudyConfig
    from sigmaswarm.experiments.study.study import Study as Study
    from sigmaswarm.experiments.study.study import run_study as run_study
    from sigmaswarm.exports.trajectory import time_origin_of as time_origin_of
    from sigmaswarm.exports.trajectory import write_estimate as write_estimate
    from sigmaswarm.filters.bank.live import LiveFilterBank
    from sigmaswarm.filters.bank.run import run_bank as run_bank
    from sigmaswarm.filters.custom.live import LiveModel as LiveModel
    from sigmaswarm.filters.custom.log import Log as Log
    from sigmaswarm.filters.custom.model import Model
    from sigmaswarm.filters.custom.model import Tunable as Tunable
    from sigmaswarm.filters.custom.run import ModelEstimate as ModelEstimate
    from sigmaswarm.filters.custom.run import run_model as run_model
    from sigmaswarm.filters.custom.run import smooth_model as smooth_model
    from sigmaswarm.filters.live import LiveFilter
    from sigmaswarm.filters.parameters import FilterParameters
    from sigmaswarm.filters.presets import baseline
    from sigmaswarm.filters.presets import preset as preset
    from sigmaswarm.filters.run import Estimate
    from sigmaswarm.filters.run import Innovations as Innovations
    from sigmaswarm.filters.run import run_filter as run_filter
    from sigmaswarm.filters.run import run_innovations as run_innovations
    from sigmaswarm.filters.run import run_textbook as run_textbook
    from sigmaswarm.filters.smoothing import smooth as smooth
    from sigmaswarm.filters.textbook import ExtendedKalmanFilter as ExtendedKalmanFilter
    from sigmaswarm.filters.textbook import SigmaPoints as SigmaPoints
    from sigmaswarm.filters.textbook import UnscentedKalmanFilter as UnscentedKalmanFilter
    from sigmaswarm.importing.inspection import Inspection as Inspection
    from sigmaswarm.importing.inspection import Range as Range
    from sigmaswarm.importing.inspection import TablePreview as TablePreview
    from sigmaswarm.importing.mounting import find_mount as find_mount
    from sigmaswarm.importing.mounting import parse_mount as parse_mount
    from sigmaswarm.references import reference
    from sigmaswarm.reports.compare import comparison_table as comparison_table
    from sigmaswarm.reports.evaluation import save_evaluation as save_evaluation
    from sigmaswarm.reports.study_charts import save_study as save_study
    from sigmaswarm.reports.study_charts import study_figures as study_figures
    from sigmaswarm.reports.study_tables import study_tables as study_tables
    from sigmaswarm.scoring.consistency import Consistency as Consistency
    from sigmaswarm.scoring.consistency import consistency as consistency
    from sigmaswarm.scoring.evaluation import Evaluation
    from sigmaswarm.scoring.score import Score as Score
    from sigmaswarm.scoring.verified_repair import repair
    from sigmaswarm.simulation.scenarios import simulate
    from sigmaswarm.simulation.scenarios import simulate_many as simulate_many
    from sigmaswarm.tuning.batch import BatchResult as BatchResult
    from sigmaswarm.tuning.batch import run_batch
    from sigmaswarm.tuning.config import Option as Option
    from sigmaswarm.tuning.config import TuneConfig as TuneConfig
    from sigmaswarm.tuning.defaults import explain_tuning as explain_tuning
    from sigmaswarm.tuning.lever_arm import LeverArmEstimate as LeverArmEstimate
    from sigmaswarm.tuning.lever_arm import estimate_lever_arm as estimate_lever_arm
    from sigmaswarm.tuning.result import Tuning
    from sigmaswarm.tuning.search import Progress as Progress
    from sigmaswarm.tuning.store import saved_history as saved_history
    from sigmaswarm.tuning.store import saved_options as saved_options
    from sigmaswarm.tuning.tune import tune

# Deprecated names of version 0.3.0.
_RENAMED = {"LiveSwarm": "LiveFilterBank", "run_swarm": "run_bank", "datasheet": "baseline"}

__all__ = [
    "AlignmentError",
    "Drive",
    "DriveError",
    "DriveWarning",
    "Estimate",
    "Evaluation",
    "FilterParameters",
    "InputError",
    "LiveFilter",
    "LiveFilterBank",
    "Model",
    "SigmaswarmError",
    "SigmaswarmWarning",
    "Tuning",
    "baseline",
    "diagnose",
    "evaluate",
    "export",
    "import_log",
    "inspect_log",
    "plot",
    "read_drive",
    "reference",
    "repair",
    "report",
    "run",
    "run_batch",
    "simulate",
    "split",
    "tune",
    "write_drive",
]


@cache
def _modules() -> dict[str, str]:
    """Return the module of each name that is imported for type checkers. Only names in ``__all__`` are public."""
    source = ast.parse(get_data(__name__, "__init__.py") or b"")
    (block,) = (node for node in source.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def __getattr__(name: str) -> Any:
    """Import a name at its first use, so that `sigmaswarm --help` does not wait for Numba."""
    if name in _RENAMED:
        warnings.warn(f"sigmaswarm.{name} is now {_RENAMED[name]}", DeprecationWarning, stacklevel=2)
        return __getattr__(_RENAMED[name])
    if name not in _modules():
        raise AttributeError(f"module 'sigmaswarm' has no attribute {name!r}")
    value = getattr(import_module(_modules()[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__", "__doc__"])
