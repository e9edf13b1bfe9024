"""Sine and cosine of a heading at once, by arithmetic alone, so that a loop over headings becomes vector instructions.

The angle less the nearest multiple of pi/2 goes into the polynomials of fdlibm (Sun Microsystems, 1993) for sine and cosine
between -pi/4 and pi/4. That pi/2 is a rounded number moves the angle by 4e-17 of itself, less than its own rounding.
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba.core import types

from ssmr._jit import built_in, jit

_PER_QUARTER = 0.6366197723675814  # 2 / pi
_QUARTER = 0.5 * math.pi
_SHIFT = 1.5 * 2.0**52  # a number plus this has its nearest whole number in its last bits
_SINE: tuple[float, ...] = (
    -1.66666666666666307295e-1,
    8.33333333332211858878e-3,
    -1.98412698295895385996e-4,
    2.75573136213857245213e-6,
)
_SINE += (-2.50507477628578072866e-8, 1.58962301576546568060e-10)
_COSINE: tuple[float, ...] = (
    4.16666666666665929218e-2,
    -1.38888888888730564116e-3,
    2.48015872888517045348e-5,
    -2.75573141792967388112e-7,
)
_COSINE += (2.08757008419747316778e-9, -1.13585365213876817300e-11)


@built_in
def fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once where the processor can (which all of its loops then do alike), else twice."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        double = ir.DoubleType()
        function = builder.module.declare_intrinsic("llvm.fmuladd", [double], ir.FunctionType(double, [double] * 3))
        return builder.call(function, arguments)

    return types.float64(types.float64, types.float64, types.float64), build


@built_in
def _bits(typing: Any, x: Any) -> Any:
    """Return the 64 bits of a number as a whole number."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), build


@jit
def sine_cosine(angle: float) -> tuple[float, float]:
    """Return sine and cosine of an angle [rad].

    Each is within 2e-16 of that of an angle that lies less than one rounding away from the one given. Beyond 1e15 rad, where
    a rounding is as large as the angle's direction, the numbers mean nothing.
    """
    shifted = fused(angle, _PER_QUARTER, _SHIFT)
    n = shifted - _SHIFT
    r = fused(-n, _QUARTER, angle)
    z = r * r
    s, c = _SINE[5], _COSINE[5]
    s, c = fused(s, z, _SINE[4]), fused(c, z, _COSINE[4])
    s, c = fused(s, z, _SINE[3]), fused(c, z, _COSINE[3])
    s, c = fused(s, z, _SINE[2]), fused(c, z, _COSINE[2])
    s, c = fused(s, z, _SINE[1]), fused(c, z, _COSINE[1])
    s, c = fused(s, z, _SINE[0]), fused(c, z, _COSINE[0])
    s, c = fused(r * z, s, r), fused(z * z, c, fused(-0.5, z, 1.0))
    quadrant = _bits(shifted)
    odd = (quadrant & 1) != 0
    sine, cosine = c if odd else s, s if odd else c
    return -sine if (quadrant & 2) != 0 else sine, -cosine if ((quadrant + 1) & 2) != 0 else cosine
