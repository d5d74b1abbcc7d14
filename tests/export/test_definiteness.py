"""The C filter sets ``failed`` if and only if its covariance is no longer positive semidefinite."""

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exported import build
from filter_cases import OPTIONS, WEIGHED, parameters
from support import quickly, several

MAIN = """
#include <stdio.h>
#include <stdlib.h>
#include "ins_gps.h"
static InsGps filter;
static InsGpsState state;
int main(int argc, char **argv)
{
    ins_gps_real mean[5] = {0, 0, 8, 0, 0}, covariance[25];
    double value;
    if (argc != 3) return 1;
    const int samples = atoi(argv[1]), fixes = atoi(argv[2]);
    for (int i = 0; i < 25; i++) {
        if (scanf("%lf", &value) != 1) return 1;
        covariance[i] = (ins_gps_real)value;
    }
    ins_gps_init(&filter, 0.0, mean, covariance, NULL);
    for (int i = 1; i <= samples; i++) {
        if (fixes && i % 20 == 0) (void)ins_gps_update(&filter, 0.01 * i - 0.004, 0.08 * i, 0.5, NULL STD);
        (void)ins_gps_predict(&filter, 0.01 * i, IMU);
    }
    ins_gps_state(&filter, &state);
    printf("%d\\n", state.failed);
    for (int i = 0; i < INS_GPS_STATES; i++)
        for (int j = 0; j < INS_GPS_STATES; j++) printf("%.17g\\n", (double)state.covariance[i][j]);
    return 0;
}
"""
CASES = {
    "planar5": parameters("planar5", nominal_interval=0.01, **OPTIONS["latency"]),
    "planar8": parameters("planar8", nominal_interval=0.01, **OPTIONS["all"]),
    "tilted12": parameters("tilted12", nominal_interval=0.01, **WEIGHED["both"]),
}
SOUND = np.diag([1.0, 1.0, 0.5, 0.5, 0.01])


def run(
    folder: Path, name: str, covariance: np.ndarray, *flags: str, samples: int = 200, fixes: int = 1, **more
) -> tuple[bool, float]:
    """Return whether the filter sets ``failed``, and the smallest eigenvalue of its correlations."""
    p = replace(CASES[name], **more)
    std = ", (const ins_gps_real[2]){1, 1}" if p.accuracy_scale is not None else ""
    imu = "0.3, -0.2, 9.81, 0.01, -0.02, 0.1" if name == "tilted12" else "0.3, -0.2, 0.1"
    folder.mkdir(exist_ok=True)
    program = build(folder, p, *flags, "-w", main=MAIN.replace(" STD", std).replace("IMU", imu))
    told = " ".join(map(str, covariance.ravel()))
    done = subprocess.run(
        [program, str(samples), str(fixes)], input=told, capture_output=True, text=True, check=True
    )
    failed, *numbers = map(float, done.stdout.split())
    p_end = np.array(numbers).reshape(p.n_states, p.n_states)
    if not (np.isfinite(p_end).all() and (np.diag(p_end) > 0).all()):
        return bool(failed), -np.inf
    std_end = np.sqrt(np.diag(p_end))
    return bool(failed), float(np.linalg.eigvalsh(p_end / np.outer(std_end, std_end))[0])


@pytest.mark.parametrize("flags", [(), ("-DINS_GPS_FLOAT",)], ids=["double", "float"])
@pytest.mark.parametrize("name", quickly([(n,) for n in CASES], lambda name: name == "tilted12"))
def test_a_sound_filter_has_not_failed(name: str, flags: tuple[str, ...], tmp_path: Path):
    failed, least = run(tmp_path, name, SOUND, *flags, samples=1000)
    assert not failed
    assert least > -1e-3


@pytest.mark.parametrize(
    ("fixes", "flags"),
    several([(0, ()), (0, ("-DINS_GPS_FLOAT",)), (1, ()), (1, ("-DINS_GPS_FLOAT",))], 3),
)
@pytest.mark.parametrize(
    ("i", "j", "covariance"), quickly([(0, 2, 1.5), (1, 4, -0.3), (2, 3, 0.9)], lambda i, *_: i == 0)
)
def test_an_indefinite_covariance_is_detected(
    i: int, j: int, covariance: float, fixes: int, flags: tuple[str, ...], tmp_path: Path
):
    hostile = SOUND.copy()
    hostile[i, j] = hostile[j, i] = covariance
    for name in CASES:
        failed, _ = run(tmp_path / name, name, hostile, *flags, samples=35, fixes=fixes)
        assert failed, name


@pytest.mark.parametrize(
    "more",
    quickly(
        [
            ({"latency": 1e9},),
            ({"latency": 1e5, "measurement_noise": (1e-12, 1e-12)},),
            ({"measurement_noise": (1e-300, 1e-300)},),
            ({"measurement_noise": (1e250, 1e-250)},),
            ({"process_noise": (1e200, 1e-200, 1e200, 1e-200, 1e100)},),
        ],
        lambda more: len(more) == 2 or "process_noise" in more,
    ),
    ids=str,
)
def test_with_extreme_parameters_an_indefinite_covariance_is_always_reported(more: dict, tmp_path: Path):
    failed, least = run(tmp_path, "planar5", SOUND, samples=400, **more)
    assert failed or least > -1e-6
