"""The filters in textbook form, in NumPy: slow, general, and easy to check.

`ukf`, `ekf` and `adaptive` do not depend on a model. `car` and `custom` apply them to cars and to a user's model.
`loop` runs a filter over its steps and smooths. No module in this package imports `compiled/`.
"""

from sigmaswarm.filters.textbook.ekf import ExtendedKalmanFilter
from sigmaswarm.filters.textbook.ukf import NotPositiveDefiniteError, SigmaPoints, UnscentedKalmanFilter

__all__ = ["ExtendedKalmanFilter", "NotPositiveDefiniteError", "SigmaPoints", "UnscentedKalmanFilter"]
