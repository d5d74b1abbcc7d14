"""Consistency of the ideal IMU and the true path: integrating the IMU samples gives the path."""

import numpy as np
import pytest

from sigmaswarm.simulation.dynamics import GRAVITY, STEP
from sigmaswarm.simulation.environments import ENVIRONMENTS, MODEL_3
from sigmaswarm.simulation.maneuvers import MANEUVERS, drive_maneuver
from sigmaswarm.simulation.motion import TERRAINS, add_slopes, build_road_profile, motion_at, sample

PLACE = (0.8, -0.4, 0.3)  # off center in every direction, so that each term matters


def integrate(values, start):
    return start + np.concatenate(
        [np.zeros((1, 3)), np.cumsum((values[1:] + values[:-1]) / 2 * STEP, axis=0)]
    )


@pytest.fixture(
    scope="module",
    params=[*((name, "flat") for name in MANEUVERS), ("urban", "hilly"), ("brake", "rolling")],
    ids="-".join,
)
def motion(request):
    maneuver, terrain = request.param
    rng = np.random.default_rng(3)
    journey = drive_maneuver(
        maneuver, ENVIRONMENTS["rain"], MODEL_3, rng, 60.0 if maneuver == "urban" else None
    )
    record = journey.record
    if terrain != "flat":
        record = add_slopes(record, build_road_profile(journey.path[:, 3], TERRAINS[terrain], rng), MODEL_3)
    return motion_at(record, MODEL_3, PLACE)


def test_integrating_the_specific_force_with_the_true_attitude_gives_the_path(motion):
    acceleration = np.einsum("nij,nj->ni", motion.rotation, motion.specific_force) - [0.0, 0.0, GRAVITY]
    position = integrate(integrate(acceleration, motion.velocity[0]), motion.position[0])
    length = np.linalg.norm(np.diff(motion.position, axis=0), axis=1).sum()
    error = np.linalg.norm(position - motion.position, axis=1).max()
    print(f"{error:.4f} m of {length:.0f} m: {error / length:.5%}")
    assert error < 1e-5 * length


def test_angular_rate_is_the_change_of_the_attitude(motion):
    """R(t + h) = R(t) (I + [w] h + ...), at the middle of each step."""
    rate = (motion.angular_rate[1:] + motion.angular_rate[:-1]) / 2
    change = np.einsum("nji,njk->nik", motion.rotation[:-1], motion.rotation[1:])
    turned = np.column_stack(
        [
            change[:, 2, 1] - change[:, 1, 2],
            change[:, 0, 2] - change[:, 2, 0],
            change[:, 1, 0] - change[:, 0, 1],
        ]
    )
    np.testing.assert_allclose(turned / 2 / STEP, rate, atol=2e-4)


def test_sampling_between_milliseconds_is_linear():
    record = np.arange(10.0)[:, None] * np.ones(20)
    np.testing.assert_allclose(sample(record, np.array([0.0, 0.0005, 0.009]))[:, 0], [0.0, 0.5, 9.0])
