"""Tests of the simulation itself."""

import pytest


@pytest.fixture(autouse=True)
def anew(simulated_anew: None) -> None:
    """Each drive is computed."""
