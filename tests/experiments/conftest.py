"""Studies that end sooner: they time one live filter in place of four, and draw fewer resamples."""

from collections.abc import Iterator

import pytest

from sigmaswarm.experiments import statistics
from sigmaswarm.experiments.study import timings


@pytest.fixture(scope="module")
def quick_study() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timings, "LIVE", {"UKF": timings.LIVE["UKF"]})
        patch.setattr(statistics, "RESAMPLES", 200)
        yield
