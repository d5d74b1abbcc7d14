"""Parameters at the limits of the range of numbers: exports contain them exactly, or one line states the reason."""

import ast
import math
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from exported import STRICT, export_filter, needs_gcc, tuned, write
from sigmaswarm.errors import InputError
from sigmaswarm.exports.names import DESCRIPTIONS
from support import some

P = tuned("planar5", "ukf", 0.01)
SEVENTEEN = 0.12345678901234568
EXPORTABLE: list[dict[str, Any]] = [
    {"process_noise": (1e-300,) * 5},
    {"process_noise": (1e300, 5e-324, 1e-7, SEVENTEEN, 3)},
    {"measurement_noise": (1e-300, 1e300)},
    {"measurement_noise": (1, 2)},
    {"alpha": 1e-150},
    {"alpha": 1, "beta": 2, "kappa": 0},
    {"beta": -1e308},
    {"velocity_noise": 1e300},
    {"lateral_noise": 1e-300, "rear_axle": -1e300, "tire_slip": SEVENTEEN},
    {"standstill_noise": 5e-324},
    {"gate": 1e308},
    {"latency": -SEVENTEEN},
    {"model": "planar8", "process_noise": (1e-5,) * 8, "bias_std": (1e300, 1e-300)},
]


def numbers_in_c(folder: Path) -> list[float]:
    """Return all numbers that ins_gps.c contains as R(...)."""
    return [float(number) for number in re.findall(r"R\((-?[\d.e+-]+)\)", (folder / "ins_gps.c").read_text())]


@needs_gcc
@pytest.mark.parametrize("change", some(EXPORTABLE, 4), ids=str)
def test_c_contains_every_bit_and_compiles_unless_a_float_is_too_small(
    tmp_path: Path, change: dict[str, Any]
):
    write(tmp_path, replace(P, **change))
    stated = numbers_in_c(tmp_path)
    for name in change.keys() - {"model", "alpha", "beta", "kappa"}:
        for number in np.atleast_1d(change[name]):
            assert number in stated
    command = ["gcc", *STRICT, "-fsyntax-only", tmp_path / "ins_gps.c"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    done = subprocess.run([*command, "-DINS_GPS_FLOAT"], capture_output=True, text=True)
    with np.errstate(all="ignore"):
        fits = all(np.float32(v) == 0 if v == 0 else 1.2e-38 < abs(v) < 3.4e38 for v in stated)
    assert (done.returncode == 0) == fits
    assert ("parameters beyond the range of float" in done.stderr) == (not fits)


@pytest.mark.parametrize("change", some(EXPORTABLE, 4), ids=str)
def test_the_script_contains_the_same_numbers(tmp_path: Path, change: dict[str, Any]):
    p = replace(P, **change)
    (path,) = export_filter(p, "filterpy", tmp_path)
    stated = parameters_of(path)
    for name in ("alpha", "beta", "kappa", "process_noise", "measurement_noise", *change):
        assert stated[name] == getattr(p, name)


def parameters_of(script: Path) -> dict[str, Any]:
    body = ast.parse(script.read_text()).body
    given = next(
        n.value for n in body if isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == "PARAMETERS"
    )
    assert isinstance(given, ast.Call)
    return {str(each.arg): ast.literal_eval(each.value) for each in given.keywords}


@pytest.mark.parametrize(
    "change", [change for change in EXPORTABLE if 1e300 not in change.get("process_noise", ())], ids=str
)
def test_yaml_contains_numbers(tmp_path: Path, change: dict[str, Any]):
    (path,) = export_filter(replace(P, **change), "robot_localization", tmp_path)
    node = next(iter(yaml.safe_load(path.read_text()).values()))["ros__parameters"]
    noise = node["process_noise_covariance"]
    assert all(type(number) is float and math.isfinite(number) for number in [*noise, node["frequency"]])
    assert type(node["alpha"]) is float


@pytest.mark.parametrize(
    ("target", "change", "said"),
    [
        ("c99", {"alpha": 1e160}, r"spread of the sigma points \(alpha = 1e.160, .* not a finite number"),
        ("c99", {"alpha": 1e-200}, r"spread of the sigma points \(alpha = 1e-200"),
        (
            "c99",
            {"odometer_noise": 0.1, "odometer_scale": 1e-310},
            "1 / odometer_scale is not a finite number",
        ),
        ("c99", {"nominal_interval": 1e-300}, "nominal_interval = 1e-300 s: the C library supports at most"),
        (
            "c99",
            {"nominal_interval": 5e-324},
            "nominal_interval = .* at most 10000 Hz; correct the interval",
        ),
        ("robot_localization", {"nominal_interval": 1e-320}, "nominal_interval is not a finite number"),
        ("robot_localization", {"process_noise": (1e307,) * 5}, "process_noise / nominal_interval is not a"),
        ("robot_localization", {"measurement_noise": (1e308, 1e308)}, "sum of measurement_noise is not a"),
    ],
)
def test_values_that_a_target_can_not_represent_are_rejected_with_one_line(
    tmp_path: Path, target, change: dict[str, Any], said: str
):
    with pytest.raises(InputError, match=said) as raised:
        export_filter(replace(P, **change), target, tmp_path / "out")
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("interval", [1e-3, 1.0, 1e5, 1e308])
@pytest.mark.parametrize("target", DESCRIPTIONS)
def test_a_slow_imu_is_supported(tmp_path: Path, target, interval: float):
    written = export_filter(replace(P, nominal_interval=interval), target, tmp_path)
    assert not re.search(r"(?<![a-z_])(inf|nan)(?![a-z_])", written[0].read_text().split("def ")[0])
