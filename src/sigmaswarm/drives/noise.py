"""What fixes say of their own noise."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def white_noise(position: NDArray[np.complexfloating[Any, Any]]) -> float:
    """The noise of fixes from one to the next, m per axis; 0 of fewer than four.

    Robust, of third differences, which remove the motion. Errors that last longer than some fixes are not in it.

    Parameters
    ----------
    position : ndarray of complex, shape (n,)
        East + i north, m, of fixes at even times.
    """
    third = np.diff(position, n=3)
    spread = np.concatenate([third.real, third.imag])
    return float(np.median(np.abs(spread)) / 0.6745 / np.sqrt(20.0)) if len(third) else 0.0
