"""Hills: the road has the specified slopes, which are the only difference in the data of an ideal IMU."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sigmaswarm.simulation import TERRAINS, Terrain, simulate
from sigmaswarm.simulation.dynamics import GRAVITY, PITCH, RECORDED, ROLL, STEP, VX, VY, YAW
from sigmaswarm.simulation.environments import ENVIRONMENTS, MODEL_3
from sigmaswarm.simulation.maneuvers import drive_maneuver
from sigmaswarm.simulation.motion import (
    HEIGHT,
    ROAD_PITCH,
    ROAD_ROLL,
    _swing,
    add_slopes,
    build_road_profile,
    motion_at,
)
from sigmaswarm.simulation.planning import SPACING

STRAIGHT = np.zeros(round(60_000 / SPACING))
HILLS = [name for name in TERRAINS if name != "flat"]


@pytest.fixture(scope="module")
def hills():
    """Return a record on a flat road, and the same drive on a hilly road."""
    rng = np.random.default_rng(5)
    journey = drive_maneuver("urban", ENVIRONMENTS["clear"], MODEL_3, rng, 60.0)
    road = build_road_profile(journey.path[:, 3], TERRAINS["hilly"], rng)
    return journey.record, add_slopes(journey.record, road, MODEL_3)


def correlation(values, lag):
    centred = values - values.mean()
    return np.mean(centred[lag:] * centred[:-lag]) / np.mean(centred**2)


@pytest.mark.parametrize("name", HILLS)
def test_slopes_have_the_spread_limits_and_correlation_of_the_terrain(name):
    terrain = TERRAINS[name]
    road = build_road_profile(STRAIGHT, terrain, np.random.default_rng(1))
    at = np.arange(0.0, 60_000.0, 2.0)
    grade, bank = -np.tan(road.pitch(at)), np.tan(road.roll(at)) / np.cos(road.pitch(at))
    assert np.std(grade) == pytest.approx(terrain.grade_std, rel=0.15)  # including the effect of the limit
    assert np.std(bank) == pytest.approx(terrain.bank_std, rel=0.15)
    assert np.mean(bank) == pytest.approx(terrain.crossfall, abs=0.002)
    assert np.abs(grade).max() < 1.001 * terrain.grade_limit
    assert np.abs(bank - terrain.crossfall).max() < 1.001 * terrain.bank_limit
    for values, length in ((grade, terrain.grade_length), (bank, terrain.bank_length)):
        assert correlation(values, round(length / 2)) == pytest.approx(2 / np.e, abs=0.04)


def test_a_terrain_without_limits_has_the_specified_slopes():
    road = build_road_profile(
        STRAIGHT, Terrain("mine", grade_std=0.05, bank_std=0.02), np.random.default_rng(1)
    )
    at = np.arange(0.0, 60_000.0, 2.0)
    grade, bank = -np.tan(road.pitch(at)), np.tan(road.roll(at)) / np.cos(road.pitch(at))
    assert np.std(grade) == pytest.approx(0.05, rel=0.15)
    assert np.std(bank) == pytest.approx(0.02, rel=0.15)
    # A limit far above the slopes has no effect.
    limited = Terrain("mine", grade_std=0.05, bank_std=0.02, grade_limit=100.0, bank_limit=100.0)
    np.testing.assert_array_equal(
        road.pitch(at), build_road_profile(STRAIGHT, limited, np.random.default_rng(1)).pitch(at)
    )


def test_the_slopes_and_not_the_name_determine_if_a_terrain_is_flat():
    flat, named, hilly = (
        simulate("brake", terrain=terrain)
        for terrain in ("flat", TERRAINS["flat"], Terrain("flat", grade_std=0.05))
    )
    assert "terrain" not in flat.metadata["scenario"]
    np.testing.assert_array_equal(flat.imu.ax, named.imu.ax)
    assert hilly.metadata["scenario"]["grade_std_percent"] > 0.5
    assert np.std(hilly.imu.ax - flat.imu.ax) > 0.05


def test_bends_are_banked_inwards_and_intersections_hardly():
    terrain = Terrain("bends", superelevation=0.06)
    for radius, share in ((120.0, 1.0), (-120.0, -1.0), (10.0, 0.17)):
        road = build_road_profile(np.full(5000, 1 / radius), terrain, np.random.default_rng(0))
        # In a left bend, the left side is lower.
        assert np.tan(road.roll(250.0)) == pytest.approx(-0.06 * share, abs=5e-4)
        assert road.pitch(250.0) == 0


def test_the_specific_force_of_a_standing_car_is_gravity_in_the_body_frame(hills):
    flat, tilted = hills
    motion = motion_at(tilted, MODEL_3, (0.0, 0.0, 0.0))
    still = np.flatnonzero(np.hypot(flat[:, VX], flat[:, VY]) < 1e-9)[:500]
    assert len(still)
    assert np.abs(tilted[still[0], [ROAD_PITCH, ROAD_ROLL]]).max() > 0.01
    expected = np.einsum("nji,j->ni", motion.rotation[still], [0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(motion.specific_force[still], expected, atol=1e-6)
    # Uphill, gravity has a forward component; with the left side up, a component to the left. The body leans downhill.
    uphill, left_up = -tilted[still, ROAD_PITCH], tilted[still, ROAD_ROLL]
    assert (np.sign(motion.specific_force[still, 0]) == np.sign(uphill)).all()
    assert (np.sign(motion.specific_force[still, 1]) == np.sign(left_up)).all()
    np.testing.assert_allclose(tilted[still, PITCH], GRAVITY * np.sin(uphill), atol=1e-6)
    np.testing.assert_allclose(tilted[still, ROLL], GRAVITY * np.sin(left_up) * np.cos(uphill), atol=1e-6)


def test_integrating_the_angular_rate_gives_the_attitude_of_road_and_suspension(hills):
    _, tilted = hills
    motion = motion_at(tilted, MODEL_3, (0.2, 0.0, 0.1))
    middle = (motion.angular_rate[1:] + motion.angular_rate[:-1]) / 2
    steps = Rotation.from_rotvec(middle * STEP)
    while len(steps) > 1:  # multiply neighbors until one rotation is left
        odd = len(steps) % 2
        pairs = steps[: len(steps) - odd]
        steps = Rotation.concatenate([pairs[::2] * pairs[1::2], *([steps[-1:]] if odd else [])])
    yaw, pitch, roll = (Rotation.from_matrix(motion.rotation[0]) * steps[0]).as_euler("ZYX")
    assert np.angle(np.exp(1j * (yaw - tilted[-1, YAW]))) == pytest.approx(0, abs=1e-5)
    suspension = -MODEL_3.pitch_gain * tilted[-1, PITCH], MODEL_3.roll_gain * tilted[-1, ROLL]
    assert pitch == pytest.approx(tilted[-1, ROAD_PITCH] + suspension[0], abs=1e-5)
    assert roll == pytest.approx(tilted[-1, ROAD_ROLL] + suspension[1], abs=1e-5)


def test_the_velocity_is_parallel_to_the_road_and_the_height_is_its_integral(hills):
    flat, tilted = hills
    road = Rotation.from_euler("ZYX", tilted[:, [YAW, ROAD_PITCH, ROAD_ROLL]]).as_matrix()
    velocity = motion_at(tilted, MODEL_3, (0.0, 0.0, 0.0)).velocity
    np.testing.assert_allclose(np.einsum("ni,ni->n", road[:, :, 2], velocity), 0, atol=1e-12)
    for of in (first + k for first in (HEIGHT, ROAD_PITCH, ROAD_ROLL) for k in (0, 1)):
        middle = (tilted[1:, of + 1] + tilted[:-1, of + 1]) / 2
        summed = tilted[0, of] + np.cumsum(middle) * STEP
        np.testing.assert_allclose(summed, tilted[1:, of], atol=2e-5)
    assert np.ptp(tilted[:, HEIGHT]) > 1.0
    # The horizontal motion is that on the flat road.
    untouched = [i for i in range(RECORDED) if i not in range(ROLL, PITCH + 2) and i not in (15, 16)]
    np.testing.assert_array_equal(tilted[:, untouched], flat[:, untouched])


def test_the_suspension_agrees_with_an_independent_integrator():
    frequency, damping = MODEL_3.pitch_frequency, MODEL_3.pitch_damping
    time = np.arange(2000) * STEP
    target = 0.5 + np.sin(2 * np.pi * 1.2 * time)

    def rates(t, state):
        wanted = 0.5 + np.sin(2 * np.pi * 1.2 * t)
        return [state[1], frequency**2 * (wanted - state[0]) - 2 * damping * frequency * state[1]]

    oracle = solve_ivp(rates, (0, time[-1]), [target[0], 0.0], t_eval=time, rtol=1e-10, atol=1e-12).y
    found = _swing(target, frequency, damping)
    np.testing.assert_allclose(found[:, :2], oracle.T, rtol=2e-5, atol=1e-4)
    np.testing.assert_allclose(np.gradient(found[:, 1], STEP)[1:-1], found[1:-1, 2], atol=2e-3)


def test_hills_do_not_change_the_horizontal_path_and_the_noise_of_the_fixes():
    options = {"imu": "ideal", "duration": 30.0, "imu_place": (0.0, 0.0, 0.0)}
    flat, hilly = simulate("urban", **options), simulate("urban", terrain="hilly", **options)
    for column in ("time", "x", "y", "vx", "vy", "theta"):
        np.testing.assert_array_equal(getattr(flat.truth, column), getattr(hilly.truth, column))
    np.testing.assert_array_equal(flat.gps.x, hilly.gps.x)
    assert np.std(hilly.imu.ax - flat.imu.ax) > 0.05  # m/s2, due to gravity
    assert hilly.metadata["scenario"]["terrain"] == "hilly"
    assert hilly.metadata["scenario"]["climb_m"] > 1.0
    assert "terrain" not in flat.metadata["scenario"]
