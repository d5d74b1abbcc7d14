"""The filters as textbooks have them, in NumPy: slow, general, and easy to check."""

from sigmaswarm.filters.reference.ekf import ExtendedKalmanFilter
from sigmaswarm.filters.reference.ukf import NotPositiveDefiniteError, SigmaPoints, UnscentedKalmanFilter

__all__ = ["ExtendedKalmanFilter", "NotPositiveDefiniteError", "SigmaPoints", "UnscentedKalmanFilter"]
