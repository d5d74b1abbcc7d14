"""A first fix far from the others is a serious finding; a later far fix is a warning."""

from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm import diagnose, simulate
from support import quickly


@pytest.mark.parametrize(
    ("place", "meters", "severity"),
    quickly(
        [
            (0, -3e5, "serious"),
            (0, 5e6, "serious"),
            (0, 5e3, "serious"),
            (9, 5e3, "warning"),
            (0, 400, "warning"),
        ],
        lambda place, meters, _: abs(meters) in (3e5, 5e3),
    ),
)
def test_a_far_first_fix(place: int, meters: float, severity: str) -> None:
    drive = simulate("urban", duration=60.0, gps="white-1m")
    x = np.array(drive.gps.x)
    x[place] += meters
    (found,) = (
        f for f in diagnose(replace(drive, gps=replace(drive.gps, x=x))).findings if f.code == "gps-outliers"
    )
    assert found.severity == severity
