"""Descriptions of models: the code that reads them agrees with them, and supports a larger model."""

import importlib
from dataclasses import replace
from itertools import pairwise
from typing import get_args

import numpy as np
import pytest

from filter_cases import equipped, parameters
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.filters.compiled import layout
from sigmaswarm.filters.compiled.layout import R
from sigmaswarm.filters.constants import STANDSTILL_RATE_NOISE
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.models import GYRO_BIAS, MODELS, THETA
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.packing import unpack_states
from sigmaswarm.filters.parameters import densities, units
from sigmaswarm.filters.starts import start_of
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.tuning.space import search_space

EACH_MODEL = pytest.mark.parametrize("name", MODELS)
DRIVEN = [name for name, model in MODELS.items() if not model.measures_imu]
EACH_DRIVEN = pytest.mark.parametrize("name", DRIVEN)
"""Models with the IMU as input; test_robot_localization.py tests the other model."""


def test_every_model_has_a_name_a_kernel_and_its_states_first():
    assert get_args(ModelName) == tuple(MODELS)
    for small, large in pairwise(DRIVEN):
        assert MODELS[large].names[: len(MODELS[small].names)] == MODELS[small].names
    for model in MODELS.values():
        assert model.names[THETA] == "theta"
        assert not model.gyro_axes or model.names[GYRO_BIAS] == "gyro_bias_z"
        assert len(model.process(np.zeros(len(model.states)), 0.1, np.zeros(len(model.imu)))) == len(
            model.states
        )


def test_rows_have_the_numbers_of_their_names_without_gaps():
    assert sorted(R) == list(range(layout.N_ROWS))
    assert len(set(layout.NAMES)) == layout.N_ROWS
    n = len(layout.MEAN)
    for j in range(n):
        for i in range(j + 1):
            name = layout.MEAN[i] + layout.MEAN[j]
            assert getattr(R, name) == layout.P0 + j * (j + 1) // 2 + i
    assert [getattr(R, f"Q_{letter}") for letter in layout.MEAN] == list(range(layout.Q0, layout.Q0 + n))


@EACH_DRIVEN
def test_constants_are_in_the_rows_of_their_names(name: str):
    kind = MODELS[name].filter_types[min(2, len(MODELS[name].filter_types) - 1)]
    p = parameters(name, gate=7.0, latency=0.125, velocity_noise=0.3, lateral_noise=0.4, rear_axle=1.25,
                   tire_slip=0.004, standstill_noise=0.6, odometer_noise=0.7, odometer_scale=0.5, odometer_latency=0.2,
                   kind=kind, forgetting=0.875)  # fmt: skip
    rows = KernelArray((p,)).start([initial_state(equipped())], [0.01])[0, :, 0]
    n, second = p.n_states, 0.0 if kind == "ekf" else 1.0
    wanted = {"RX": 0.25, "RY": 0.36, "GATE": 7.0, "LATENCY": 0.125, "R_VELOCITY": 0.3, "R_LATERAL": 0.4,
              "R_ODOMETER": 0.7, "ODOMETER_SCALE": 2.0, "ODOMETER_LATENCY": 0.2,
              "REAR_AXLE": 1.25, "TIRE_SLIP": 0.004,
              "R_STANDSTILL": 0.6, "R_RATE": STANDSTILL_RATE_NOISE, "FADING": -1.0,
              "FORGETTING": 0.875 if kind == "adaptive-ukf" else 1.0, "SECOND": second,
              "QUARTER_GAMMA": second * np.sqrt(0.25 * (n + 1)) / 4, "SHORTENS": -second * 8 / (0.25 * (n + 1)),
              "SPREAD": 0.25 * n + 2.0, "OK": 1.0, "DET": 1.0, "RECENT": -1.0}  # fmt: skip
    assert {row: rows[getattr(R, row)] for row in wanted} == wanted
    assert tuple(rows[layout.Q0 : layout.Q0 + n]) == p.process_noise


@EACH_DRIVEN
def test_all_forms_start_from_the_same_state(name: str):
    seen, p = initial_state(equipped()), parameters(name, bias_std=(0.2, 0.004))
    initial = replace(seen, gyro=None, tilt=None)
    mean, covariance = start_of(initial, p)
    assert mean[:5].tolist() == initial.mean.tolist()
    tilt, gyro = np.radians(3.0) ** 2, 0.004**2
    assert (
        np.diag(covariance)[5:].tolist() == [0.2**2, 0.2**2, gyro, tilt, tilt, gyro, gyro][: p.n_states - 5]
    )
    rows = KernelArray((p,)).start([initial], [0.01])[0]
    means, covariances = unpack_states(rows[layout.state_rows(p.model)], p.model)
    off = 1e-15 if MODELS[name].tilts else 0.0  # an attitude is converted to a quaternion and back
    assert np.max(np.abs(means - mean)) <= off
    assert all(c.tolist() == covariance.tolist() for c in covariances)
    mean, covariance = start_of(seen, p)
    rows = KernelArray((p,)).start([seen], [0.01])[0]
    means, covariances = unpack_states(rows[layout.state_rows(p.model)], p.model)
    np.testing.assert_allclose(means, np.tile(mean, (len(means), 1)), atol=1e-15)
    np.testing.assert_allclose(covariances[0], covariance, atol=1e-18, rtol=1e-13)
    assert (p.n_states > 5) == (mean[:5].tolist() != initial.mean.tolist())


@EACH_MODEL
def test_units_densities_and_bounds_follow_the_states(name: str):
    p, states = parameters(name, nominal_interval=0.01), MODELS[name].states
    said = units(p)
    assert said["states"] == [s.name for s in states]
    assert said["process_noise"][2] == "m2/s2 per nominal IMU step"
    assert [text.split()[1] for text in densities(p).values()] == [f"{s.unit}/sqrt(s)" for s in states]
    space = search_space(name, "log10", kind=MODELS[name].filter_types[0])
    entries = sum(d.entries for d in space.dimensions if d.field == "process_noise")
    assert entries == len(states)


def test_the_textbook_does_not_import_the_compiled_filter():
    parts = ("car", "loop", "kalman", "manifold", "adaptive")
    for part in (*(f"textbook.{part}" for part in parts), "custom.textbook"):
        module = importlib.import_module(f"sigmaswarm.filters.{part}")
        homes = {getattr(value, "__module__", "") or "" for value in vars(module).values()}
        assert not [home for home in homes if ".compiled" in home or home.endswith("packing")], part
    assert TextbookCar.__module__.startswith("sigmaswarm.filters.textbook")
