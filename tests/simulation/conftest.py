"""Tests of the simulation itself."""

import pytest


@pytest.fixture(autouse=True)
def simulate_every_time(simulated_anew: None) -> None:
    """Disable the cache of simulated drives."""
