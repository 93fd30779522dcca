"""What models of other orders say of a mode: whether it is found again, and how far it moves.

A model is chosen by the data, and the choice may be wrong: modes that the data do not part, terms that stand badly for what lies
above the band. Its own covariance does not know of that. Standard deviations here are of all models that were tried, weighted by
Akaike's criterion (Burnham and Anderson, Model selection and multimodel inference, 2002, equation 4.9).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray

if TYPE_CHECKING:
    from rx90b_flex.identify.transfer_function import CandidateModel

UNCERTAIN = 0.1  # standard deviation over frequency from which a mode or an antiresonance does not count
SAME_HZ, SAME_DAMPING = 0.01, 0.1  # relative: a mode this near is the same, or one within
SIGMAS = 3.0  # standard deviations
APART = 0.1  # relative, or within SIGMAS: further away another model's frequency is another mode's
LEAST_WEIGHT = 1e-4  # of a model, relative to the best, that is not left aside
BELOW, ABOVE = 1, 2  # orders around the chosen one at which a mode has to be found again

Values = tuple[Array, Array]  # with standard deviations


def model_weights(models: Sequence[CandidateModel], unit: float, inflation: float) -> Array:
    """Weights of models that add up to 1, by Akaike's criterion, ``exp(-cost / (unit inflation) - parameters)``, shape (models,).

    `unit` is the cost of one complex number of noise. A model with a mode on a bound weighs nothing unless all have one.
    """
    value = np.array([one.cost / (unit * inflation) + one.parameters for one in models])
    bound = np.array([one.bound for one in models])
    value[bound] = value[bound] if bound.all() else np.inf
    weights = np.exp(value.min() - value)
    weights[weights < LEAST_WEIGHT] = 0.0
    return np.asarray(weights / weights.sum())


def nearest(hz: Array, std: Array, others: Sequence[Values]) -> NDArray[np.intp]:
    """Place of each frequency in each other model, -1 where it has none near it, shape (models, m)."""
    out = np.full((len(others), len(hz)), -1)
    for row, (found, found_std) in zip(out, others, strict=True):
        usable = np.flatnonzero(np.isfinite(found_std))
        if len(usable):
            off = np.abs(found[usable] - hz[:, None])
            at = off.argmin(axis=1)
            near = off[np.arange(len(hz)), at] <= np.maximum(APART * hz, SIGMAS * std)
            row[near] = usable[at[near]]
    return out


def spread(
    value: Array, std: Array, others: Sequence[Values], weights: Sequence[float], places: NDArray[np.intp] | None = None
) -> Array:
    """Standard deviations of a model's values, with what other models say of them, shape (m,).

    The root of the weighted mean of ``std_k^2 + (value_k - value)^2`` over the models k that have the value, at `places` of
    theirs (nearest in value where not given); the model's own where none has it.
    """
    at = nearest(value, std, others) if places is None else places
    mass, square = np.zeros(len(value)), np.zeros(len(value))
    for (found, found_std), weight, place in zip(others, weights, at, strict=True):
        has = place >= 0
        mass[has] += weight
        square[has] += weight * (found_std[place[has]] ** 2 + (found[place[has]] - value[has]) ** 2)
    known = mass > 0.0
    return np.where(known, np.sqrt(np.divide(square, mass, out=np.zeros_like(mass), where=known)), std)


def found_again(hz: float, std: float, damping: float, damping_std: float, other: CandidateModel) -> bool:
    """Whether another model has this mode: to 1 % in frequency and 10 % in damping, or to three standard deviations."""
    near = np.abs(other.resonances_hz - hz) <= max(SAME_HZ * hz, SIGMAS * std)
    alike = np.abs(other.model.damping_ratio - damping) <= max(SAME_DAMPING * damping, SIGMAS * damping_std)
    return bool(np.any(near & alike))


def refusals(
    own: tuple[Array, Array, Array, Array], worth: Array, candidates: Sequence[CandidateModel]
) -> tuple[str, ...]:
    """Why each mode of a model does not count, empty where it does.

    Parameters
    ----------
    own : arrays, shape (m,)
        Frequencies, Hz, standard deviations, damping ratios, standard deviations.
    worth : array, shape (m,)
        What the cost rises by without the mode, over what a mode has to save.
    candidates : the best model of each order.
    """
    at = [one.modes for one in candidates].index(len(worth))
    around = [*candidates[max(at - BELOW, 0) : at], *candidates[at + 1 : at + 1 + ABOVE]]
    out = []
    for hz, std, damping, damping_std, pays in zip(*own, worth, strict=True):
        held = [found_again(hz, std, damping, damping_std, one) for one in around]
        if std > UNCERTAIN * hz:
            out.append(_uncertain(hz, std))
        elif pays < 1.0:
            out.append("the fit is as good without it")
        elif 2 * sum(held) < len(held):
            lost = [str(one.modes) for one, there in zip(around, held, strict=True) if not there]
            out.append(f"not found again by the fits of {' and '.join(lost)} modes")
        else:
            out.append("")
    return tuple(out)


def stable(place: int, candidates: Sequence[CandidateModel]) -> NDArray[np.bool_]:
    """Which modes of a candidate are known well enough and found again at the next higher order (of the highest: the next lower)."""
    one = candidates[place]
    rest = candidates[place + 1 : place + 2] or candidates[max(place - 1, 0) : place]
    return np.array(
        [
            std <= UNCERTAIN * hz and all(found_again(hz, std, z, z_std, other) for other in rest)
            for hz, std, z, z_std in zip(*one.modes_told(), strict=True)
        ],
        bool,
    )


def zero_refusals(zeros: ComplexArray, std: Array, poles: ComplexArray, refused: Sequence[str]) -> tuple[str, ...]:
    """Why each zero does not count: too uncertain, or it is that nearest to a pole that does not, which it all but cancels."""
    hz = np.abs(zeros) / (2 * np.pi)
    out = [_uncertain(f, s) if s > UNCERTAIN * f else "" for f, s in zip(hz, std, strict=True)]
    free = np.ones(len(zeros), bool)
    for pole, why in zip(poles, refused, strict=True):
        if why and free.any():
            beside = int(np.argmin(np.where(free, np.abs(zeros - pole), np.inf)))
            free[beside] = False
            out[beside] = out[beside] or f"beside the mode at {abs(pole) / (2 * np.pi):.1f} Hz, which does not count"
    return tuple(out)


def _uncertain(hz: float, std: float) -> str:
    return f"{hz:.1f} ± {std:.2g} Hz: its standard deviation is {100 * std / hz:.0f} % of it"
