"""The filters in textbook form, in NumPy: slow, general, and easy to check.

`ukf`, `ekf` and `adaptive` depend on no model; `car` and `custom` apply them to cars and to a user's model, and `loop`
runs either over its steps, and smooths. Nothing here imports `compiled/`.
"""

from sigmaswarm.filters.textbook.ekf import ExtendedKalmanFilter
from sigmaswarm.filters.textbook.ukf import NotPositiveDefiniteError, SigmaPoints, UnscentedKalmanFilter

__all__ = ["ExtendedKalmanFilter", "NotPositiveDefiniteError", "SigmaPoints", "UnscentedKalmanFilter"]
