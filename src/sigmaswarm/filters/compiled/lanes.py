"""Common parts of all kernels: compiler flags, and trigonometric functions that vectorize.

Arrays are (row, lane), with one parameter set per lane, so each loop over lanes becomes vector instructions. All rows
of a run are in one local array, so the compiler knows that different rows do not overlap. Failures need no branch: in a
lane that fails, numbers become NaN or row OK becomes 0; the other lanes do not change.
"""

import math

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from sigmaswarm.filters.compiled.unroll import Kernel
from sigmaswarm.filters.compiled.vectors import put_loops

OPTIONS = {"error_model": "numpy", "nogil": True}
"""Compiler flags of functions that call kernels. Only operations in loops over lanes may be reordered."""


def kernel(function, **known):
    """Return a function as a `Kernel`, with keyword-only parameters bound to ``known`` and vectorized loops over lanes.

    The first parameter of the function is the array of rows ``w``. A function with the lane ``l`` as a parameter may
    return a value.
    """
    return Kernel(function, None if config.DISABLE_JIT else put_loops, **known)


_FLUSH_SUBNORMALS = 0x8040  # bits of an x86 control register that replace subnormal numbers by 0


@intrinsic
def _exchange_control(typing_context, control):
    """Set the floating-point control register, or, if ``control`` is -1, only its bits `_FLUSH_SUBNORMALS`.

    Return the old value of the register. Precise measurements reduce covariances to subnormal numbers, and an operation
    with these takes a hundred cycles. The function has no effect on processors other than x86.
    """

    def generate(context, builder, signature, arguments):
        if "x86" not in builder.module.triple:
            return arguments[0]
        word, pointer = ir.IntType(32), ir.IntType(8).as_pointer()
        memory = builder.alloca(word)

        def access(name):
            function = builder.module.declare_intrinsic(name, (), ir.FunctionType(ir.VoidType(), [pointer]))
            builder.call(function, [builder.bitcast(memory, pointer)])

        access("llvm.x86.sse.stmxcsr")
        old, new = builder.load(memory), builder.trunc(arguments[0], word)
        added = builder.or_(old, word(_FLUSH_SUBNORMALS))
        builder.store(builder.select(builder.icmp_signed("<", new, word(0)), added, new), memory)
        access("llvm.x86.sse.ldmxcsr")
        return builder.zext(old, ir.IntType(64))

    return types.int64(types.int64), generate


exchange_control = (lambda control: control) if config.DISABLE_JIT else _exchange_control


def _series(z):
    """Return (sin(r) / r - 1) / z and cos(r) for an angle r in [-pi/4, pi/4], with z = r^2.

    The minimax polynomials are those of fdlibm (k_sin.c, k_cos.c). Their terms are grouped in pairs, which the
    processor can compute in parallel.
    """
    zz = z * z
    s1 = -1.66666666666666324348e-01 + z * 8.33333333332248946124e-03
    s2 = -1.98412698298579493134e-04 + z * 2.75573137070700676789e-06
    s3 = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    c1 = 4.16666666666666019037e-02 + z * -1.38888888888741095749e-03
    c2 = 2.48015872894767294178e-05 + z * -2.75573143513906633035e-07
    c3 = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
    return s1 + zz * (s2 + zz * s3), (1.0 - 0.5 * z) + zz * (c1 + zz * (c2 + zz * c3))


FAR = (math.pi / 4) ** 2  # largest squared angle for `sinc_cos`
TINY = 1e-100  # added to divisors that may be 0; too small to change other divisors


def sinc_cos(z):
    """Return sin(r) / r and cos(r) for an angle r in [-pi/4, pi/4], from z = r^2 alone."""
    s, cos = _series(z)
    return 1.0 + z * s, cos


def _near(x, n):
    """Return the sine and cosine of x - n pi/2, which is in [-pi/4, pi/4].

    The rounding of n pi/2 adds an error of at most 2.4e-16 n.
    """
    r = x - n * (math.pi / 2)
    z = r * r
    s, cos = _series(z)
    return r + r * z * s, cos


def sincos(x):
    n = np.floor(x * (2 / math.pi) + 0.5)
    sin, cos = _near(x, n)
    quadrant = n - 4.0 * np.floor(n * 0.25)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    s = cos if odd else sin
    c = sin if odd else cos
    s = -s if quadrant >= 2.0 else s
    c = -c if (quadrant == 1.0) | (quadrant == 2.0) else c
    return s, c


def spread_of(quarter_gamma, variance):
    """Return d/4, sin(d) / d and sin(d/2)^2 / 4 for the offset d = gamma sigma of an angle.

    See `planar5`.
    """
    quarter = quarter_gamma * math.sqrt(variance) + TINY
    sin, cos = _near(quarter, np.floor(quarter * (2 / math.pi) + 0.5))
    half = sin * cos
    return quarter, half * (1.0 - 2.0 * sin * sin) / quarter, half * half


def angle_of(y, x):
    """Return the angle of the vector (x, y), in [-pi, pi], without branches or calls.

    The ratio of the smaller to the larger coordinate is reduced to [-tan(pi/8), tan(pi/8)]. The rational approximation
    comes from Cephes (S. Moshier, atan.c), with an error of one or two units in the last place.
    """
    ax, ay = abs(x), abs(y)
    large = ax if ax > ay else ay
    small = ay if ax > ay else ax
    far = small > 0.41421356237309503 * large
    t = (small - large if far else small) / ((small + large if far else large) + 1e-300)
    z = t * t
    p = (-8.750608600031904122785e-1 * z - 1.615753718733365076637e1) * z - 7.500855792314704667340e1
    p = (p * z - 1.228866684490136173410e2) * z - 6.485021904942025371773e1
    q = ((z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2) * z + 4.328810604912902668951e2
    q = (q * z + 4.853903996359136964868e2) * z + 1.945506571482613964425e2
    angle = t + t * (z * p / q) + (0.25 * math.pi if far else 0.0)
    angle = 0.5 * math.pi - angle if ay > ax else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
