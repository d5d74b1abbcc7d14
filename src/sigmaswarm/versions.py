"""The library's version, and the versions that a result depends on."""

__version__ = "0.3.0"


def versions() -> dict[str, str]:
    """Return the versions of the software that a result depends on."""
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
