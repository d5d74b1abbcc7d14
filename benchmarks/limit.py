"""Compare the speed of planar5's kernel with the peak of the processor: counted operations, measured peak and time.

    python benchmarks/limit.py

Operations are counted by running the Python code of the kernel with numbers that count operations. The peak is measured
with vectors as wide as the kernel's lanes, in LLVM's assembly language: independent chains of multiply-adds, of
divisions, and of square roots.
"""

import ctypes
import math
import operator
import os
import subprocess
import sys
import time
from collections import Counter
from types import SimpleNamespace
from typing import ClassVar

import llvmlite.binding as llvm
import numpy as np

from sigmaswarm import baseline, simulate
from sigmaswarm.drives import events
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.filters.compiled import lanes, layout, measurements, planar5, run
from sigmaswarm.filters.compiled.layout import R
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.passes import start_passes
from sigmaswarm.scoring.targets import tracking_pass

FLOPS = ("add", "mul", "div", "sqrt")
CHAINS, ROUNDS, TURNS = 8, 200_000, 7


# --- Counted -----------------------------------------------------------------------------------------------


class Counting:
    """A number that counts the operations on it."""

    done: ClassVar[Counter] = Counter()

    def __init__(self, value: float) -> None:
        self.value = value

    def __float__(self) -> float:
        return float(self.value)

    def __neg__(self) -> "Counting":  # not counted: part of the next operation
        return Counting(-self.value)

    def __floor__(self) -> "Counting":
        return self._do("floor", math.floor, self)

    @classmethod
    def _do(cls, name, function, *values):
        cls.done[name] += 1
        result = function(*map(float, values))
        return result if isinstance(result, bool) else Counting(result)


def _operator(name, function):
    setattr(Counting, f"__{function.__name__}__", lambda a, b: Counting._do(name, function, a, b))
    setattr(Counting, f"__r{function.__name__}__", lambda a, b: Counting._do(name, function, b, a))


for counted, function in (("add", operator.add), ("add", operator.sub), ("mul", operator.mul)):
    _operator(counted, function)
_operator("div", operator.truediv)
for function in (operator.lt, operator.le, operator.gt, operator.ge, operator.eq):
    _operator("compare", function)


def count() -> None:
    """Print the operations per lane of a prediction and of a fix; needs NUMBA_DISABLE_JIT=1."""
    update = measurements.measurement_kernels(MODELS["planar5"])["update_fix"]
    counting = SimpleNamespace(sqrt=lambda x: Counting._do("sqrt", math.sqrt, x), log=math.log, pi=math.pi)
    # each generated function has its own names
    for names in (planar5.predict_planar5.written.names, update.written.names, vars(lanes)):
        names.update({name: counting for name, value in names.items() if value is math})
    rows = np.array(
        [[Counting(0.1) for _ in range(layout.LANES)] for _ in range(layout.N_ROWS)], dtype=object
    )
    for row in (R.XX, R.YY, R.UU, R.VV, R.TT, R.FORGETTING):
        rows[row] = [Counting(1.0) for _ in range(layout.LANES)]
    rows[[R.FADING, R.FUZZY]] = Counting(-1.0)
    rows[R.DOF] = Counting(0.0)
    for name, step in (
        ("predict", lambda: planar5.predict_planar5(rows, (0.01, 1.0, 0.0, 1.0, 0.1, 0.1))),
        ("fix", lambda: update(rows, (1.0, 2.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)),
    ):
        Counting.done.clear()
        step()
        print(name, *(f"{key}={value / layout.LANES:.0f}" for key, value in sorted(Counting.done.items())))


# --- Measured ----------------------------------------------------------------------------------------------


def kernel_call(fixes: bool = True):
    """Return a call of `run_lanes` over ten minutes with equal filters in all lanes, its steps, and its lanes."""
    drive = simulate("urban", duration=600.0, seed=1)
    drive_pass = tracking_pass(prepare_drive(drive))
    steps, sample, driving, flags, *others, ends = drive_pass.arrays(frozenset())
    if not fixes:
        flags, ends = flags & ~np.uint16(events.FIX), np.zeros_like(ends)
    arrays = (steps, sample, driving, flags, *others, ends)
    n_lanes = layout.most_lanes("planar5")
    rows = start_passes([drive_pass], KernelArray((baseline(drive),) * n_lanes))[0]

    def call():
        run.run_lanes(
            "planar5",
            arrays,
            rows.copy(),
            run.new_cursor(),
            len(steps),
            run.NO_RECORD,
            run.NO_INNOVATIONS,
        )

    return call, len(steps), n_lanes


def fastest(function) -> float:
    times = []
    for _ in range(TURNS):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def nanoseconds_per_vector(operation: str) -> float:
    """Return the time of one operation on LANES numbers, ns, among many independent operations."""
    v = f"<{layout.LANES} x double>"
    line = {
        "fma": f"call {v} @llvm.fma.v{layout.LANES}f64({v} %x#, {v} %b, {v} %b)",
        "sqrt": f"call {v} @llvm.sqrt.v{layout.LANES}f64({v} %x#)",
        "div": f"fdiv {v} %b, %x#",
    }[operation]
    each = [
        (f"%x{i} = phi {v} [%b, %entry], [%y{i}, %loop]", f"%y{i} = " + line.replace("#", str(i)))
        for i in range(CHAINS)
    ]
    stores = "\n".join(f"store volatile {v} %y{i}, ptr %p, align 8" for i in range(CHAINS))
    module = llvm.parse_assembly(f"""
        declare {v} @llvm.fma.v{layout.LANES}f64({v}, {v}, {v})
        declare {v} @llvm.sqrt.v{layout.LANES}f64({v})
        define void @chains(i64 %n, ptr %p) {{
        entry:
            %b = load {v}, ptr %p, align 8
            br label %loop
        loop:
            %k = phi i64 [%n, %entry], [%less, %loop]
            {chr(10).join(phi for phi, _ in each)}
            {chr(10).join(step for _, step in each)}
            %less = sub i64 %k, 1
            %done = icmp eq i64 %less, 0
            br i1 %done, label %end, label %loop
        end:
            {stores}
            ret void
        }}""")
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3
    )
    engine = llvm.create_mcjit_compiler(module, target)
    engine.finalize_object()
    call = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_void_p)(engine.get_function_address("chains"))
    numbers = np.full(layout.LANES + 8, 0.999)
    return fastest(lambda: call(ROUNDS, numbers.ctypes.data)) / ROUNDS / CHAINS * 1e9


def main() -> None:
    if "--count" in sys.argv:
        count()
        return
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    counted = subprocess.run(
        [sys.executable, __file__, "--count"], env=environment, check=True, capture_output=True, text=True
    ).stdout
    print(counted, end="")
    peak = {name: nanoseconds_per_vector(name) for name in ("fma", "div", "sqrt")}
    print(
        f"ns per operation on {layout.LANES} lanes: "
        + ", ".join(f"{name} {ns:.3f}" for name, ns in peak.items())
    )
    print(f"peak {2 * layout.LANES / peak['fma']:.1f} GFLOP/s")
    operations = dict(pair.split("=") for pair in counted.splitlines()[0].split()[1:])
    flops = sum(int(operations[name]) for name in FLOPS)
    for label, fixes in (("predict alone", False), ("with fixes and scores", True)):
        call, n_steps, n_lanes = kernel_call(fixes)
        call()
        ns = fastest(call) / n_steps * 1e9
        rate = flops * n_lanes / ns
        print(
            f"{label}: {ns:.1f} ns a step of {n_lanes} lanes, {ns / n_lanes:.2f} ns a lane"
            + (
                ""
                if fixes
                else f"; {rate:.1f} GFLOP/s, {rate * peak['fma'] / layout.LANES / 2:.0%} of the peak"
            )
        )


if __name__ == "__main__":
    main()
