"""The filters as textbooks have them, in NumPy: slow, general, and easy to check.

`ukf`, `ekf` and `adaptive` know no model; `car` and `custom` put them together for cars and for a user's own model, and
`loop` takes either over its steps. Nothing here knows of `compiled/`.
"""

from sigmaswarm.filters.textbook.ekf import ExtendedKalmanFilter
from sigmaswarm.filters.textbook.ukf import NotPositiveDefiniteError, SigmaPoints, UnscentedKalmanFilter

__all__ = ["ExtendedKalmanFilter", "NotPositiveDefiniteError", "SigmaPoints", "UnscentedKalmanFilter"]
