"""Penalties of effects that have one, as a precision of their coefficients, and how strong they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array

# Strengths that are tried, of what makes a penalty weigh as much as the data: from none that shows to all that it can do.
STRENGTHS = np.geomspace(1e-8, 1e5, 27)


def prior_precision(effects: Sequence[Effect]) -> Array:
    """Inverse covariance of the coefficients of effects before the data, (p, p), (coefficient's unit)^-2; zero without penalties."""
    parts = []
    for effect in effects:
        k = len(effect.coefficients)
        parts.append(np.zeros((k, k)) if effect.penalty is None else effect.penalty.precision)
    # SciPy's `block_diag` takes longer than most fits of one step
    out = np.zeros((sum(len(part) for part in parts),) * 2)
    at = 0
    for part in parts:
        out[at : at + len(part), at : at + len(part)] = part
        at += len(part)
    return out


def smoothed(effect: Effect, own: Array, held_out: Callable[[Effect], float]) -> Effect:
    """With the strength of its penalty that predicts best what is held out.

    Parameters
    ----------
    effect : Effect
        One that has a penalty.
    own : array, shape (k, k)
        Weighted Gram matrix of its columns.
    held_out : callable
        Weighted squared error with an effect on what was held out.
    """
    size = 0.0 if effect.penalty is None else float(np.trace(effect.penalty.roughness))
    if size <= 0.0:
        return effect
    tried = [effect.penalised(float(x * np.trace(own) / size)) for x in STRENGTHS]
    return min(tried, key=held_out)


def parameters_used(gram: Array, precision: Array) -> float:
    """How many parameters coefficients come to under a precision: the trace of ``(gram + precision)^-1 gram``, (k, k) each."""
    if not precision.any():
        return float(len(gram))
    return float(np.trace(np.linalg.pinv(gram + precision, rcond=1e-12, hermitian=True) @ gram))
