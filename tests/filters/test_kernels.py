"""Properties of the compiled kernel: its sine, its vector instructions, and the independence of lanes."""

import pickle
import platform
import re
import shutil
import subprocess
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracles.box import box_table
from sigmaswarm.drives import events
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.filters.compiled import lanes, layout, run
from sigmaswarm.filters.compiled.layout import R
from sigmaswarm.filters.compiled.memory import CACHE_LINE, new_rows
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, KernelSums, run_passes
from sigmaswarm.scoring.batch import BatchScorer, PassOptions
from sigmaswarm.scoring.targets import tracking_pass
from sigmaswarm.tuning.batch import run_batch
from support import make_drive

EPS = np.finfo(float).eps
FOLDER = Path(run.__file__).parent
compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled, or it takes minutes")


@cache
def short_pass() -> FilterPass:
    drive = make_drive(duration=12, jitter=0.3, seed=3)
    return tracking_pass(prepare_drive(drive))


@cache
def many_sets() -> tuple[FilterParameters, ...]:
    table = box_table(40 + 32, seed=11)[32:]
    return tuple(FilterParameters(*map(float, row[:3]), tuple(row[3:8]), tuple(row[8:])) for row in table)


@cache
def all_sums() -> np.ndarray:
    return as_bits(run_passes([short_pass()], many_sets()))


PLANAR8 = FilterParameters(0.5, 2.0, 1.0, (1e-4,) * 5 + (1e-9,) * 3, (1.0, 1.0), "planar8")


def as_bits(sums: KernelSums) -> np.ndarray:
    """Return the sums of one run as an array (sets, sums)."""
    return np.column_stack([*sums.numbers[:, 0], sums.failed[0].astype(float)])


# --- The sine ----------------------------------------------------------------------------------------------


def angles() -> np.ndarray:
    rng = np.random.default_rng(5)
    edges = np.pi / 4 * np.arange(-40, 41)
    size = 10.0 ** rng.uniform(-300, 5, 5000)
    near_zeros = np.pi / 2 * rng.integers(-60_000, 60_000, 2000)
    all_of = [edges, np.nextafter(edges, 9e9), np.nextafter(edges, -9e9), size, -size, near_zeros,
              rng.uniform(-1e5, 1e5, 10_000), rng.uniform(-4, 4, 10_000), [0.0]]  # fmt: skip
    return np.concatenate(all_of)


def test_sincos_is_as_accurate_as_a_library():
    x = angles()
    ours = np.array([lanes.sincos(value) for value in x]).T
    true = np.array([np.sin(x.astype(np.longdouble)), np.cos(x.astype(np.longdouble))])
    assert np.all(
        np.abs(ours - true) < 3e-16 + 0.75 * EPS * np.abs(x)
    )  # three quarters of the angle's last digit
    # Small values keep their relative accuracy, since the closed form uses sin(d/2)^2 at alpha = 1e-3.
    small = np.abs(x) < 0.7
    assert np.max(np.abs(ours[0] - true[0])[small] / np.maximum(np.abs(true[0][small]), 1e-290)) < 2 * EPS


@compiled
def test_sincos_inside_the_kernel_is_accurate_to_the_angle_s_last_digit():
    # Compiled code uses fused multiply-add, which reduces the error to half of the angle's last digit.
    # One step of 1 s from rest, with negligible covariance, turns the acceleration (1, 0) into (cos, sin).
    headings = np.resize(angles()[np.abs(angles()) < 1e5], 16 * 1200)
    velocity = [
        velocity_after([[1.0, 0.0, 0.0]], chunk)  # ax, ay, gz
        for chunk in headings.reshape(-1, layout.LANES)
    ]
    x = headings.astype(np.longdouble)
    error = np.concatenate(velocity, axis=1) - np.array([np.cos(x), np.sin(x)])
    assert np.all(np.abs(error) < 3e-16 + 0.5 * EPS * np.abs(headings))


@compiled
@pytest.mark.parametrize("turn", [0.5, -0.78, 0.79, 2.0, -3.5, 40.0])
def test_a_heading_is_correct_after_turns_of_any_size(turn: float):
    headings = np.linspace(-3.0, 3.0, layout.LANES)
    velocity = velocity_after([[0.0, 0.0, turn], [0.0, 0.0, 0.25], [1.0, 0.0, 0.0]], headings)
    x = headings + turn + 0.25
    np.testing.assert_allclose(velocity, [np.cos(x), np.sin(x)], rtol=0, atol=1e-14)


def velocity_after(driving: list[list[float]], headings: np.ndarray) -> np.ndarray:
    """Return the velocity (2, lanes) after steps of 1 s from rest, with negligible covariance."""
    rows = np.zeros((layout.N_KEPT, layout.LANES))
    rows[[R.XX, R.YY, R.UU, R.VV, R.TT]] = 1e-40
    rows[layout.CONSTANT_ROWS] = 1.0
    rows[layout.Q0 : layout.Q0 + len(layout.MEAN)] = 0.0
    rows[R.T] = headings
    n = len(driving)
    run.run_lanes(
        "planar5",
        (
            np.tile([1.0, 1.0, 0.0], (n, 1)),  # dt, Q's scale, gap
            np.arange(n, dtype=np.int32),
            np.array(driving),
            np.full(n, events.IMU, dtype=np.uint16),
            np.empty((0, 8)),
            np.empty((0, 3)),
            np.zeros(3),
            run.NO_TARGETS,
            np.zeros(n, dtype=np.int32),
        ),
        rows,
        run.new_cursor(),
        n,
        run.NO_RECORD,
        run.NO_INNOVATIONS,
    )
    return rows[[R.U, R.V]]


@compiled
def test_a_cached_kernel_is_not_unrolled_again():
    run_passes([short_pass()], [many_sets()[0]])  # compile and cache the kernel
    kernel = run.run_kernel("planar5")
    if kernel._cache.cache_path is None:
        pytest.skip("no folder for machine code")

    def unwanted():
        raise AssertionError("written out")

    again = run._kernel_of("planar5", unwanted, layout.state_rows("planar5"), "planar5")
    again.compile(kernel.signatures[0])
    assert sum(again.stats.cache_hits.values()) == 1


# --- The machine code --------------------------------------------------------------------------------------


def object_code(kernel: Any, signature: Any) -> bytes:
    """Return the machine code in the cache, or empty bytes."""
    if kernel._cache.cache_path is None:
        return b""
    kept = kernel._cache._cache_file.load(kernel._cache._index_key(signature, kernel.targetctx.codegen()))
    (_, _, (code, _)), *_ = pickle.loads(kept[1])
    return code


@cache
def machine_code(model: ModelName) -> str:
    """Return a kernel's instructions. Numba can't disassemble cached code; without objdump, the kernel is compiled."""
    kernel = run.run_kernel(model)
    signature = kernel.signatures[0]
    code = object_code(kernel, signature)
    if not code or not shutil.which("objdump"):
        options = {name: value for name, value in kernel.targetoptions.items() if name != "nopython"}
        kernel._cache.load_overload("", kernel.targetctx)  # unroll the kernel if necessary
        fresh = numba.njit(**options)(kernel.py_func)
        fresh.compile(signature)
        return fresh.inspect_asm(signature)
    with tempfile.NamedTemporaryFile(suffix=".o") as file:
        file.write(code)
        file.flush()
        read = ["objdump", "--disassemble", "--no-show-raw-insn", file.name]
        return subprocess.run(read, capture_output=True, text=True, check=True).stdout


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86 instructions")
@compiled
@pytest.mark.parametrize("parameters", [many_sets()[0], PLANAR8], ids=["planar5", "planar8"])
def test_loops_over_lanes_are_vector_instructions(parameters: FilterParameters):
    run_passes([short_pass()], [parameters])  # compile the kernel
    instructions = Counter(re.findall(r"\s(v?f?n?m?[a-z]+\d*[ps]d)\s", machine_code(parameters.model)))
    for operation in ("mul", "madd", "sqrt", "div"):  # madd: fused instructions such as vfmadd231pd
        packed, scalar = (
            sum(n for name, n in instructions.items() if operation in name and name.endswith(kind))
            for kind in ("pd", "sd")
        )
        if operation == "madd" and packed + scalar == 0:
            continue  # a processor without fused instructions
        # The few scalar instructions compute values such as dt^2/2 once per step.
        assert packed > 0, operation
        assert packed >= 8 * scalar, f"{operation}: {packed} packed, {scalar} scalar"


@pytest.mark.skipif(
    not llvm.get_host_cpu_features().get("avx512f"), reason="this processor has no wide vectors"
)
@compiled
@pytest.mark.parametrize("parameters", [many_sets()[0], PLANAR8], ids=["planar5", "planar8"])
def test_vectors_are_as_wide_as_those_of_the_processor(parameters: FilterParameters):
    run_passes([short_pass()], [parameters])
    registers = Counter(re.findall(r"\s(?:v\w+pd)\s.*?(zmm|ymm|xmm)", machine_code(parameters.model)))
    assert registers["zmm"] > 8 * (registers["ymm"] + registers["xmm"])


# --- Independence of lanes -----------------------------------------------------------------------------------


@compiled
@given(order=st.lists(st.integers(0, 39), min_size=1, max_size=50))
def test_a_result_does_not_depend_on_the_lane_or_the_other_sets(order: list[int]):
    sums = as_bits(run_passes([short_pass()], [many_sets()[i] for i in order]))
    assert sums.tobytes() == all_sums()[order].tobytes()


@compiled
@pytest.mark.parametrize("threads", [1, 2, 4])
def test_threads_change_no_bit(threads: int):
    drives = [make_drive(duration=40, jitter=0.3, seed=seed) for seed in (3, 4)]
    replayer = BatchScorer.prepare(drives, PassOptions(outages=True, forecasts=True))
    alone = replayer.scores(many_sets())
    with ThreadPoolExecutor(threads) as pool:
        together = replayer.scores(many_sets(), pool)
        batch = run_batch(drives, many_sets(), objective="truth-pose", executor=pool)
    assert alone.numbers.tobytes() == together.numbers.tobytes()
    assert np.isfinite(alone.numbers).all(axis=(1, 2)).sum() == 11  # a batch computes no quantiles
    assert np.isnan(alone.numbers).all(axis=(1, 2)).sum() == len(alone.numbers) - 11
    assert batch.costs.tobytes() == run_batch(drives, many_sets(), objective="truth-pose").costs.tobytes()


@compiled
def test_other_filter_types_in_the_batch_change_no_bit():
    # An update skips what no lane uses, such as the fading of a strong tracking filter.
    sets = many_sets()[:12]
    kinds = ("ukf", "adaptive-ukf", "strong-tracking-ukf", "ekf", "fuzzy-ukf")
    mixed = [replace(p, kind=kinds[i % 5], forgetting=0.9) for i, p in enumerate(sets)]
    together = as_bits(run_passes([short_pass()], mixed))
    alone = np.vstack([as_bits(run_passes([short_pass()], [p])) for p in mixed])
    assert together.tobytes() == alone.tobytes()
    plain = as_bits(run_passes([short_pass()], sets))
    for i in (1, 2, 3, 4):  # each filter type has an effect
        assert np.any(plain[i::5] != together[i::5]), kinds[i]


@compiled
def test_the_rows_start_at_a_cache_line():
    address = numba.njit(lambda: new_rows(16).ctypes.data)
    assert address() % CACHE_LINE == 0


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.py")), ids=lambda file: file.stem)
def test_the_cache_of_a_kernel_depends_on_every_module_that_it_uses(file: Path):
    used = set(
        re.findall(r"^from (sigmaswarm\.(?:drives|filters)\.\w+) import", file.read_text(), re.MULTILINE)
    )
    hashed = {module.__name__ for module in run._ELSEWHERE}
    assert used - {"sigmaswarm.filters.compiled"} <= hashed
