"""The filters in textbook form, in NumPy: slow, general, and easy to check. They do not import `compiled/`."""

from sigmaswarm.filters.textbook.kalman import (
    ExtendedKalmanFilter,
    NotPositiveDefiniteError,
    SigmaPoints,
    UnscentedKalmanFilter,
)

__all__ = ["ExtendedKalmanFilter", "NotPositiveDefiniteError", "SigmaPoints", "UnscentedKalmanFilter"]
