"""An effect type of another package, tried before anything uses it: what it declares, and its law at a few points."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.law import ONWARD
from rx90b_flex.effects.law_effect import LawEffect
from rx90b_flex.effects.motion import Array
from rx90b_flex.effects.parameters import Parameter

# angles, rates and loads with nothing in common; the first is at rest, where laws must have values but may bend sharply
ANGLES = np.array([0.0, 0.713, -1.127, 0.291, -0.387, 1.611, -0.173, 0.937])
RATES = np.array([0.0, 0.317, 0.871, 1.933, -0.229, -0.683, -1.419, 2.711])
LOADS = np.array([0.0, 41.7, -23.9, 87.1, 11.3, -63.7, 5.9, -31.1])
TIME_S = 1.37
STEP = 1e-6
SAME = 1e-6  # of the largest value, two ways to work out a torque
STRAIGHT = 1e-3  # the same of a slope, by differences
ODD = 2  # points with a wrong slope, for one may sit on a corner


def why_not(cls: type[Effect]) -> str:
    """What is wrong with an effect type that lacks no method; empty: nothing that shows here."""
    loose = [name for name, value in vars(cls).items() if isinstance(value, dataclasses.Field)]
    if loose:
        return (
            f"{cls.__name__} is no dataclass, {loose[0]} no parameter; expected @dataclass(frozen=True, kw_only=True)"
        )
    for name, parameter in cls.parameters().items():
        if not isinstance(parameter.unit, str):
            return f"{cls.__name__}: the unit of {name} is {parameter.unit!r}; expected a text"
    if not issubclass(cls, LawEffect):
        return ""
    every = cls.parameters().values()
    if not every:
        return f"{cls.__name__} declares no parameter; expected a field made by linear(unit)"
    simple = (cls.law_shape, cls.law_parameters) == (LawEffect.law_shape, LawEffect.law_parameters)
    if not simple or any(p.size == 0 or p.kind == "derived" for p in every):
        return ""  # what the law reads is the motion's, or its class's, to say
    with np.errstate(all="ignore"):
        try:
            return _what_is_odd(cls(joint="joint"))
        except Exception as error:
            words = " ".join(str(error).split())
            return (
                f"{cls.__name__}.law ends with {type(error).__name__}: {words}; expected plain arithmetic that takes "
                "numbers and arrays alike and writes torque and slopes to out"
            )


def _what_is_odd(effect: LawEffect) -> str:
    law, coefficients = f"{type(effect).__name__}.law", list(effect.coefficient_parameters)
    values = 1.0 + 0.7 * np.arange(len(coefficients))
    whole = _written(effect, values)
    if not np.isfinite(whole).all():
        what, at = np.argwhere(~np.isfinite(whole))[0]
        return (
            f"{law} writes {whole[what, at]} to out[{what}] at x = {ANGLES[at]}, rate = {RATES[at]}; expected a number"
        )
    units = np.array([_written(effect, unit)[0] for unit in np.eye(len(values))])
    size = np.abs(whole[0]).max() or 1.0
    twice = _written(effect, 2.0 * values)[0]
    if max(np.abs(values @ units - whole[0]).max(), np.abs(twice - 2.0 * whole[0]).max()) > SAME * size:
        return f"{law}: its torque is not linear in {', '.join(coefficients)}; expected coefficients, or shape(...) for what is none"
    if effect.law_remembers:  # its slopes are those of a step, as it sees them
        return ""
    slopes = ["angle x", "rate", *(["load"] if effect.traits.needs_load else [])]
    for i, words in enumerate(slopes):
        step = STEP * np.eye(3)[i]
        slope = (_written(effect, values, step) - _written(effect, values, -step))[0] / (2.0 * STEP)
        off = np.abs(slope - whole[i + 1]) > STRAIGHT * max(size, np.abs(slope).max())
        if np.count_nonzero(off[1:]) >= ODD:
            at = 1 + int(off[1:].argmax())
            return (
                f"{law}: out[{i + 1}], the slope of its torque by the {words}, is {whole[i + 1, at]:.4g} at x = {ANGLES[at]}, "
                f"rate = {RATES[at]}; expected {slope[at]:.4g}"
            )
    return ""


def _written(effect: LawEffect, coefficients: Any, step: Any = (0.0, 0.0, 0.0)) -> Array:
    """What a law writes at the points, moved by a step of angle, rate and load."""
    shape = [_usual(p) for p in effect.shape_parameters.values()]
    before = [ANGLES - 1e-3, *np.zeros((effect.law_remembers, len(ANGLES)))] if effect.law_remembers else []
    load = LOADS + step[2] if effect.traits.needs_load else 0.0
    out = np.zeros((ONWARD + effect.law_remembers, len(ANGLES)))
    effect.law(ANGLES + step[0], RATES + step[1], [*coefficients, *shape, TIME_S, load, *before], out)
    return out


def _usual(parameter: Parameter) -> float:
    if np.isfinite(parameter.start):
        return parameter.start
    bounds = [x for x in (parameter.lower, parameter.upper) if np.isfinite(x)] or [0.0]
    return float(np.mean(bounds)) if len(bounds) == 2 else bounds[0] + 1.0
