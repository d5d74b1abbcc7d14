"""The target of each maneuver; no drive leaves the road or the friction circle."""

from itertools import product

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sigmaswarm.simulation.dynamics import AX, AY, FRICTION_USE, GRAVITY, X, Y
from sigmaswarm.simulation.environments import ENVIRONMENTS, MODEL_3, MODEL_3_CARLA
from sigmaswarm.simulation.maneuvers import MANEUVERS, drive_maneuver, time_between
from sigmaswarm.simulation.scenarios import simulate
from support import quickly


def achieved(maneuver, environment, run=0, **options):
    return simulate(maneuver, environment, run=run, **options).metadata["achieved"]


ROADS, WHERE = list(MANEUVERS), ["clear", "rain", "slippery"]


@pytest.mark.parametrize(
    ("maneuver", "environment", "seed"),
    quickly(
        product(ROADS, WHERE, range(3)),
        lambda maneuver, environment, seed: ROADS.index(maneuver) % 3 == WHERE.index(environment) == seed,
    ),
)
def test_friction_is_sufficient_and_the_driver_stays_in_the_lane(maneuver, environment, seed):
    where = ENVIRONMENTS[environment]
    duration = 90.0 if maneuver == "urban" else None
    journey = drive_maneuver(maneuver, where, MODEL_3, np.random.default_rng(seed), duration)
    record = journey.record
    assert record[:, FRICTION_USE].max() <= 1.0 + 1e-9
    assert np.hypot(record[:, AX], record[:, AY]).max() <= 1.02 * where.friction * GRAVITY
    assert cKDTree(journey.path[:, :2]).query(record[::100, [X, Y]])[0].max() < 1.0


@pytest.mark.parametrize("environment", ["clear", "rain", "slippery"])
def test_cruise_covers_500_m_at_a_constant_speed(environment):
    found = achieved("cruise", environment)
    assert found["distance_m"] == pytest.approx(500.0, abs=3.0)
    assert found["peak_lateral_ms2"] < 0.5


@pytest.mark.parametrize("environment", ["clear", "rain", "slippery"])
@pytest.mark.parametrize("run", [0, 1])
def test_turns_are_90_degrees_to_both_sides(environment, run):
    found = achieved("turns", environment, run)
    assert found["left_deg"] == pytest.approx(90.0, abs=3.0)
    assert found["right_deg"] == pytest.approx(-90.0, abs=3.0)
    if environment != "slippery":
        assert found["peak_lateral_ms2"] == pytest.approx(4.0, rel=0.10)


@pytest.mark.parametrize(
    ("environment", "low", "high"), [("clear", 4.8, 5.1), ("rain", 4.8, 5.1), ("slippery", 6.8, 8.0)]
)
def test_zero_to_sixty_takes_the_requested_time_or_the_least_that_friction_allows(environment, low, high):
    """With all-wheel drive and friction 0.25, at least 6.8 s are necessary."""
    assert low < achieved("accelerate", environment)["time_s"] < high


@pytest.mark.parametrize(
    ("environment", "low", "high"), [("clear", 1.8, 2.0), ("rain", 2.17, 2.5), ("slippery", 5.6, 6.5)]
)
def test_fifty_to_zero_takes_the_requested_time_or_the_least_that_friction_allows(environment, low, high):
    """50 km/h divided by friction x g: 2.18 s in rain, 5.66 s on snow."""
    assert low < achieved("brake", environment)["time_s"] < high


def test_carlas_stock_brakes_take_longer_than_in_the_paper():
    assert achieved("brake", "clear", vehicle=MODEL_3_CARLA)["time_s"] == pytest.approx(2.66, abs=0.25)


def test_outages_last_3_to_5_seconds_and_begin_after_alignment():
    for run in range(5):
        drive = simulate("outages", run=run)
        windows = drive.metadata["scenario"]["outages"]
        assert len(windows) == 2
        for begin, end in windows:
            assert 3.0 <= end - begin <= 5.0
            assert begin > 15.0 and end < drive.duration
            assert not ((drive.gps.time >= begin) & (drive.gps.time < end)).any()
        assert windows[1][0] - windows[0][1] > 5.0


def test_urban_drives_are_mixed_and_have_the_requested_duration():
    drive = simulate("urban", duration=240.0)
    truth = drive.truth
    assert drive.duration == pytest.approx(240.0, abs=0.02)
    speed = np.hypot(truth.vx, truth.vy)
    assert 0.03 < (speed < 0.1).mean() < 0.4
    assert speed.max() > 40 / 3.6
    assert np.ptp(np.unwrap(truth.theta)) > np.pi / 2


def test_stopwatch():
    speed = np.concatenate([np.linspace(0, 20, 4001), np.linspace(20, 0, 2001)])
    assert time_between(speed, 0.001, 10.0, rising=True) == pytest.approx(2.0, abs=0.002)
    assert time_between(speed, 0.001, 10.0, rising=False) == pytest.approx(1.0, abs=0.002)
    assert np.isnan(time_between(speed, 0.0, 30.0, rising=True))
    assert np.isnan(time_between(speed, 0.0, 30.0, rising=False))
