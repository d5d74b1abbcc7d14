"""Studies that time one live filter in place of four, which takes a second each time that a study ends."""

from collections.abc import Iterator

import pytest

from sigmaswarm.experiments.study import timings


@pytest.fixture(scope="module", autouse=True)
def one_live_filter() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timings, "LIVE", {"UKF": timings.LIVE["UKF"]})
        yield
