"""Tests of the simulation itself."""

import pytest


@pytest.fixture(autouse=True)
def simulate_every_time(simulated_anew: None) -> None:
    """Each drive is computed."""
