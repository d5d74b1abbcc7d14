"""sigmaswarm tunes the Kalman filter that fuses a vehicle's IMU and GPS.

The road of the data
--------------------
A `Drive` is read, recorded or simulated; filters run over it; scores say how wrong they were; an objective
turns scores into a cost; a swarm searches the parameters with the lowest cost; a `Tuning` holds what it found.

Conventions
-----------
- SI units and radians inside; degrees only where a person reads or a file's column says so.
- Local frame: east-north-up; x east, y north. Heading ``theta`` counter-clockwise from east, in (-pi, pi].
- Body frame: x forward, y left, z up (REP-103). The IMU gives specific force and angular rate in it.
- Attitude, where it is more than a heading: R = Rz(theta) Ry(pitch) Rx(roll) turns body into local axes, so that
  ``roll`` is positive left side up and ``pitch`` nose down.
- Time: float64 seconds, strictly increasing within a sensor; sensors keep their own clocks and rates.
- State of ``planar5``: x, y (m), vx, vy (m/s), theta (rad). ``process_noise`` is the diagonal of Q, the variance
  added per nominal IMU step; ``measurement_noise`` the diagonal of R. Other models have more states behind these.
- A filter never sees truth. error = estimate - truth. Costs: lower wins, a failed filter costs ``inf``.

Symbols: x, P state mean and covariance; Q, R process and measurement noise covariance; alpha, beta, kappa sigma-point
scaling (Merwe); z, nu, S, K measurement, innovation, its covariance, gain; w, c1, c2 inertia, cognitive and
social acceleration of the swarm.
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from sigmaswarm.versions import __version__ as __version__

if TYPE_CHECKING:
    from sigmaswarm.doctor.diagnose import diagnose
    from sigmaswarm.doctor.findings import Diagnosis, Finding
    from sigmaswarm.doctor.repairs import repair
    from sigmaswarm.drives.alignment import InitialState, initial_state
    from sigmaswarm.drives.drive import Drive, Gps, Imu, Odometer, Truth
    from sigmaswarm.drives.reader import read_drive
    from sigmaswarm.drives.split import clip, split_drives, split_time
    from sigmaswarm.drives.writer import write_drive
    from sigmaswarm.errors import (
        AlignmentError,
        DriveError,
        DriveWarning,
        InputError,
        SigmaswarmError,
        SigmaswarmWarning,
    )
    from sigmaswarm.experiments.compare import compare
    from sigmaswarm.experiments.comparison import Comparison
    from sigmaswarm.experiments.study.config import StudyConfig
    from sigmaswarm.experiments.study.study import Study, run_study
    from sigmaswarm.filters.bank.live import LiveFilterBank
    from sigmaswarm.filters.bank.run import run_bank
    from sigmaswarm.filters.custom.log import Log
    from sigmaswarm.filters.custom.model import Model, Tunable
    from sigmaswarm.filters.custom.run import ModelEstimate, run_model, smooth_model
    from sigmaswarm.filters.live import LiveFilter
    from sigmaswarm.filters.parameters import FilterParameters
    from sigmaswarm.filters.presets import baseline, preset
    from sigmaswarm.filters.run import Estimate, Innovations, run_filter, run_innovations, run_textbook
    from sigmaswarm.filters.smoothing import smooth
    from sigmaswarm.filters.textbook import ExtendedKalmanFilter, SigmaPoints, UnscentedKalmanFilter
    from sigmaswarm.references.reference import reference
    from sigmaswarm.reports.compare import comparison_table
    from sigmaswarm.reports.study import save_study, study_figures, study_tables
    from sigmaswarm.scoring.consistency import Consistency, consistency
    from sigmaswarm.scoring.evaluation import Evaluation, evaluate
    from sigmaswarm.scoring.score import Score
    from sigmaswarm.simulation.conditions import simulate_many
    from sigmaswarm.simulation.scenarios import simulate
    from sigmaswarm.tuning.batch import BatchResult, run_batch
    from sigmaswarm.tuning.config import TuneConfig
    from sigmaswarm.tuning.result import Tuning
    from sigmaswarm.tuning.tune import tune

_HOMES = {
    "doctor.diagnose": ("diagnose",),
    "doctor.findings": ("Diagnosis", "Finding"),
    "doctor.repairs": ("repair",),
    "drives.alignment": ("InitialState", "initial_state"),
    "drives.drive": ("Drive", "Gps", "Imu", "Odometer", "Truth"),
    "drives.reader": ("read_drive",),
    "drives.split": ("clip", "split_drives", "split_time"),
    "drives.writer": ("write_drive",),
    "errors": (
        "AlignmentError",
        "DriveError",
        "DriveWarning",
        "InputError",
        "SigmaswarmError",
        "SigmaswarmWarning",
    ),
    "experiments.comparison": ("Comparison",),
    "experiments.compare": ("compare",),
    "experiments.study.config": ("StudyConfig",),
    "experiments.study.study": ("Study", "run_study"),
    "filters.custom.log": ("Log",),
    "filters.custom.model": ("Model", "Tunable"),
    "filters.custom.run": ("ModelEstimate", "run_model", "smooth_model"),
    "filters.parameters": ("FilterParameters",),
    "filters.presets": ("baseline", "preset"),
    "filters.live": ("LiveFilter",),
    "filters.textbook": ("ExtendedKalmanFilter", "SigmaPoints", "UnscentedKalmanFilter"),
    "filters.run": ("Estimate", "Innovations", "run_filter", "run_innovations", "run_textbook"),
    "filters.smoothing": ("smooth",),
    "filters.bank.live": ("LiveFilterBank",),
    "filters.bank.run": ("run_bank",),
    "references.reference": ("reference",),
    "reports.compare": ("comparison_table",),
    "reports.study": ("save_study", "study_figures", "study_tables"),
    "scoring.consistency": ("Consistency", "consistency"),
    "scoring.evaluation": ("Evaluation", "evaluate"),
    "scoring.score": ("Score",),
    "simulation.conditions": ("simulate_many",),
    "simulation.scenarios": ("simulate",),
    "tuning.batch": ("BatchResult", "run_batch"),
    "tuning.config": ("TuneConfig",),
    "tuning.result": ("Tuning",),
    "tuning.tune": ("tune",),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}
_RENAMED = {"LiveSwarm": "LiveFilterBank", "run_swarm": "run_bank", "datasheet": "baseline"}
"""Names of 0.3.0, kept for one release."""

__all__ = [
    "AlignmentError",
    "BatchResult",
    "Comparison",
    "Consistency",
    "Diagnosis",
    "Drive",
    "DriveError",
    "DriveWarning",
    "Estimate",
    "Evaluation",
    "ExtendedKalmanFilter",
    "FilterParameters",
    "Finding",
    "Gps",
    "Imu",
    "InitialState",
    "Innovations",
    "InputError",
    "LiveFilter",
    "LiveFilterBank",
    "Log",
    "Model",
    "ModelEstimate",
    "Odometer",
    "Score",
    "SigmaPoints",
    "SigmaswarmError",
    "SigmaswarmWarning",
    "Study",
    "StudyConfig",
    "Truth",
    "Tunable",
    "TuneConfig",
    "Tuning",
    "UnscentedKalmanFilter",
    "baseline",
    "clip",
    "compare",
    "comparison_table",
    "consistency",
    "diagnose",
    "evaluate",
    "initial_state",
    "preset",
    "read_drive",
    "reference",
    "repair",
    "run_bank",
    "run_batch",
    "run_filter",
    "run_innovations",
    "run_model",
    "run_study",
    "run_textbook",
    "save_study",
    "simulate",
    "simulate_many",
    "smooth",
    "smooth_model",
    "split_drives",
    "split_time",
    "study_figures",
    "study_tables",
    "tune",
    "write_drive",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: `sigmaswarm --help` must not wait for Numba."""
    if name in _RENAMED:
        warnings.warn(f"sigmaswarm.{name} is now {_RENAMED[name]}", DeprecationWarning, stacklevel=2)
        return __getattr__(_RENAMED[name])
    if name not in _HOME_OF:
        raise AttributeError(f"module 'sigmaswarm' has no attribute {name!r}")
    value = getattr(import_module(f"sigmaswarm.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
