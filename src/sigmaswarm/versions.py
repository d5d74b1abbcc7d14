"""The library's version, and those that a result depends on."""

__version__ = "0.3.0"


def versions() -> dict[str, str]:
    """What a result depends on, beside the data."""
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
