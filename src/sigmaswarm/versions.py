"""The version of the library, and the versions of software that affect results."""

__version__ = "0.4.0"
SAME_RESULTS = {"0.3.0", "0.4.0"}  # versions with identical results: each can resume a run of another


def versions() -> dict[str, str]:
    import platform

    import numba
    import numpy as np
    import scipy

    return {
        "sigmaswarm": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "scipy": scipy.__version__,
    }


def same_results(one: dict[str, str], other: dict[str, str]) -> bool:
    """Return True if the software versions of two results compute identical numbers."""
    if {one.get("sigmaswarm"), other.get("sigmaswarm")} <= SAME_RESULTS:
        one = {**one, "sigmaswarm": other["sigmaswarm"]}
    return one == other
