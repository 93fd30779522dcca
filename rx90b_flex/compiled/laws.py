"""Torques by scalar laws: combinations of the coordinates, each with a linear part and a compiled function."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.core.ccallback import CFunc
from numba.extending import intrinsic, overload

from rx90b_flex.compiled.compile import Array, Integers, LawCache, inlined
from rx90b_flex.compiled.scratch import Scratch
from rx90b_flex.compiled.vectors import Vector, lane_of, with_lane

_NUMBERS = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
LAW_SIGNATURE = types.void(types.float64, types.float64, _NUMBERS, _NUMBERS)


@cache
def compiled_law(function: Callable[..., None]) -> Any:
    """A law of an effect as a C function; its `address` is good as long as the process lives."""
    law: Any = CFunc(function, (LAW_SIGNATURE.args, LAW_SIGNATURE.return_type), {}, {"error_model": "numpy"})
    law._cache = LawCache(function)  # type: ignore[no-untyped-call]
    law.compile()
    return law


class Laws(NamedTuple):
    """Torques that depend on one combination of the coordinates, x = sum of weight * q: linear part and compiled
    law.
    """

    place: Integers  # (m, w) coordinates of the combination
    weight: Array  # (m, w) zero where there are fewer
    inertia: Array  # (m,) per d2x/dt2
    damping: Array  # (m,) per dx/dt
    stiffness: Array  # (m,) per x
    width: Integers  # (m,) how many coordinates there are
    address: Integers  # (m,) of the compiled law, 0 where there is none
    stores: Integers  # (m,) whether the law stores energy instead of dissipating it
    parameters: Array  # (m, p) of the law
    out: Array  # (3,) what a law writes
    wanted: Integers  # (2,) lanes of a vector whose laws are asked, and whether they are asked for chords to standstill


@intrinsic
def _call_address(typing_context: Any, address: Any, x: Any, rate: Any, parameters: Any, out: Any) -> Any:
    """Call a compiled law ``void(double, double, double *, double *)`` by its address."""
    signature = types.void(types.int64, types.float64, types.float64, types.int64, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double = ir.DoubleType()
        pointer = double.as_pointer()
        function = ir.FunctionType(ir.VoidType(), [double, double, pointer, pointer])
        where = builder.inttoptr(args[0], function.as_pointer())
        builder.call(where, [args[1], args[2], builder.inttoptr(args[3], pointer), builder.inttoptr(args[4], pointer)])
        return context.get_dummy_value()

    return signature, generate


_call: Any = _call_address


@inlined
def combine(laws: Laws, m: int, x: Array) -> Any:
    """The combination of x that law m depends on."""
    total = 0.0
    for w in range(laws.width[m]):
        total += laws.weight[m, w] * x[laws.place[m, w]]
    return total


@inlined
def scatter(laws: Laws, m: int, torque: Any, out: Array) -> None:
    """Add the torque of law m to the coordinates that it depends on."""
    for w in range(laws.width[m]):
        out[laws.place[m, w]] += laws.weight[m, w] * torque


@inlined
def call_law(address: int, x: float, rate: float, parameters: Array, out: Array) -> None:
    """Let a compiled law write to `out`."""
    _call(address, x, rate, parameters.ctypes.data, out.ctypes.data)


@inlined
def ask(laws: Laws, m: int, x: float, rate: float) -> tuple[float, float, float]:
    """Torque of law m and its slopes by x and rate."""
    call_law(laws.address[m], x, rate, laws.parameters[m], laws.out)
    return laws.out[0], laws.out[1], laws.out[2]


def ask_law(laws: Any, m: Any, x: Any, rate: Any) -> Any:
    """Torque of the compiled law m and its slopes by x and rate; compiled code only."""
    raise NotImplementedError


@overload(ask_law)
def _ask_law(laws: Any, m: Any, x: Any, rate: Any) -> Any:
    if isinstance(x, Vector):

        def lanes(laws: Any, m: Any, x: Any, rate: Any) -> Any:
            force, slope, rate_slope = 0.0 * x, 0.0 * x, 0.0 * x
            for lane in range(laws.wanted[0]):
                a, b, c = ask(laws, m, lane_of(x, lane), lane_of(rate, lane))
                force = with_lane(force, lane, a)
                slope, rate_slope = with_lane(slope, lane, b), with_lane(rate_slope, lane, c)
            return force, slope, rate_slope

        return lanes

    def number(laws: Any, m: Any, x: Any, rate: Any) -> Any:
        return ask(laws, m, x, rate)

    return number


@inlined
def _chord(laws: Laws, m: int, x: float, rate: float, force: float, slope: float) -> float:
    rest, _, _ = ask(laws, m, x, 0.0)
    chord = (force - rest) / rate
    return chord if chord > slope else slope


def chord_law(laws: Any, m: Any, x: Any, rate: Any, force: Any, slope: Any) -> Any:
    """Slope of the compiled law m by rate, or that of its chord to standstill where this is steeper; compiled code only."""
    raise NotImplementedError


@overload(chord_law)
def _chord_law(laws: Any, m: Any, x: Any, rate: Any, force: Any, slope: Any) -> Any:
    if isinstance(x, Vector):

        def lanes(laws: Any, m: Any, x: Any, rate: Any, force: Any, slope: Any) -> Any:
            for lane in range(laws.wanted[0]):
                own = _chord(laws, m, lane_of(x, lane), lane_of(rate, lane), lane_of(force, lane), lane_of(slope, lane))
                slope = with_lane(slope, lane, own)
            return slope

        return lanes

    def number(laws: Any, m: Any, x: Any, rate: Any, force: Any, slope: Any) -> Any:
        return _chord(laws, m, x, rate, force, slope)

    return number


@inlined
def law_forces(
    laws: Laws, s: Scratch, q: Array, v: Array, a: Array, torques: Array, by_x: Array, by_rate: Array, out: Array
) -> Any:
    """Add the laws' generalised forces to `out`; each law's torque and slopes to the other arrays.

    Returns the power that they dissipate, W.
    """
    lost = 0.0
    for m in range(len(laws.inertia)):
        x, rate = combine(laws, m, q), combine(laws, m, v)
        torque = laws.stiffness[m] * x + laws.damping[m] * rate + laws.inertia[m] * combine(laws, m, a)
        by_x[m], by_rate[m] = laws.stiffness[m], laws.damping[m]
        lost += laws.damping[m] * rate * rate
        if laws.address[m] != 0:
            force, slope, rate_slope = ask_law(laws, m, x, rate)
            torque += force
            by_x[m] += slope
            if laws.wanted[1] and not laws.stores[m]:
                rate_slope = chord_law(laws, m, x, rate, force, rate_slope)
            by_rate[m] += rate_slope
            if not laws.stores[m]:
                lost += force * rate
        torques[m] = torque
        scatter(laws, m, torque, out)
    return lost


@inlined
def add_laws_to_system(laws: Laws, s: Scratch, by_rate: float, by_x: float, system: Array) -> None:
    """Add inertia + by_rate * D + by_x * K of the laws to the upper triangle of `system`."""
    for m in range(len(laws.inertia)):
        value = laws.inertia[m] + by_rate * s.by_rate[m] + by_x * s.by_x[m]
        for w in range(laws.width[m]):
            for u in range(laws.width[m]):
                r, c = laws.place[m, w], laws.place[m, u]
                weight = laws.weight[m, w] * laws.weight[m, u]
                if r <= c:
                    system[r, c] += weight * value
