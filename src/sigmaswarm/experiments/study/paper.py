"""The paper's own figures, to stand beside a study's.

Malabo and Gerardo, "Adaptive Tuning of the Unscented Kalman Filter Using Particle Swarm Optimization for Inertial-GPS
Sensor Fusion Systems", Tables I to III.
"""

from typing import Any

REAL_TIME_LIMIT_MS = 10.0
"""ms an update may take."""

PAPER_RESULTS: dict[str, Any] = {
    "table_1": {
        "imu-only": {"rmse_m": 21606.59},
        "ukf": {"rmse_m": 2.80},
        "pso-ukf": {"rmse_m": 0.50, "improvement_percent": 82.14},
        "optimum": {"q": 2.00, "r": 0.10, "alpha": 0.03, "beta": 2.5, "kappa": 0.48},
    },
    "table_2": {
        "ekf": {"rmse_m": 7.45, "sd_m": 0.65, "interval_m": [7.22, 7.68]},
        "adaptive-ukf": {"rmse_m": 3.92, "sd_m": 0.38, "interval_m": [3.78, 4.06]},
        "ukf": {"rmse_m": 2.80, "sd_m": 0.41, "interval_m": [2.62, 2.98]},
        "pso-ukf": {"rmse_m": 0.50, "sd_m": 0.09, "interval_m": [0.46, 0.54]},
    },
    "table_3": {
        "ekf": {"heading_deg": 4.8, "outage_drift_m": 18.6, "update_ms": 0.65},
        "adaptive-ukf": {"heading_deg": 2.7, "outage_drift_m": 9.3, "update_ms": 1.15},
        "ukf": {"heading_deg": 2.1, "outage_drift_m": 7.5, "update_ms": 1.20},
        "pso-ukf": {"heading_deg": 0.6, "outage_drift_m": 2.0, "update_ms": 1.35},
    },
    "figure_2": {"stable_generation": 15, "stable_at_m": 1.5},
    "real_time_limit_ms": REAL_TIME_LIMIT_MS,
}
"""The split between Tables II and III is: RMSE with its spread; heading, drift and run time."""
