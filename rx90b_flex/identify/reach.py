"""How far off a shape parameter may be: where the squares have risen by as much as an interval's end asks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import hilbert

from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.identify.normal_equations import RANK_TOLERANCE, solve_weighted

if TYPE_CHECKING:
    from rx90b_flex.identify.least_squares import _Fit

LIMIT = 1.96  # standard deviations of an estimate's 95 % interval
DOUBLINGS = 6  # of the way to that limit along which the squares are asked for
BESIDE = 2  # steps of an effect's other shapes at each of these places


def widened(fit: _Fit, index: int, std: Array) -> Array:
    """Factors, 1 or more, of standard deviations (k,) of an effect's shapes, with which 1.96 of them reach as far as squares say.

    A link on a drive answers to its damping the more the less there is of it: how squares bend where they are smallest says
    little about how they rise. An interval ends where they have risen as much as a parabola would have (profile likelihood:
    D. M. Bates, D. G. Watts, *Nonlinear Regression Analysis and Its Applications*, 1988, chapter 6); the farther end counts.
    What another guess at how a log begins would change is added.
    """
    places = fit.shapes.places[index]
    sigma, size = fit.solution.sigma, fit.shapes.per_step(fit.shape)[places]
    bend = fit.shape_equations(sigma)[0][np.ix_(places, places)]
    white = np.diag(np.linalg.pinv(bend / np.outer(size, size), hermitian=True))
    out, begun_otherwise = np.ones(len(places)), _begun_otherwise(fit, index)[places]
    for i in np.flatnonzero((std > 0.0) & (white > 0.0)):
        way, rise = LIMIT * std[i], LIMIT**2 * std[i] ** 2 / white[i]
        beside = np.isin(np.arange(len(fit.shapes)), places) & (np.arange(len(fit.shapes)) != places[i])
        reach = max(_reach(fit, int(places[i]), beside, x, rise, sigma) for x in (way, -way))
        out[i] = np.hypot(max(1.0, reach / way), begun_otherwise[i] / std[i])
    return out


def _begun_otherwise(fit: _Fit, index: int) -> Array:
    """Change of the shapes (s,) for other guesses at what an effect held as logs begin, root mean square; to first order."""
    effect, sigma, step = fit.effects[index], fit.solution.sigma, fit.shapes.per_step(fit.shape)
    others = effect.begun_otherwise()
    if not others:
        return np.zeros(len(fit.shapes))
    now, *changed = (fit._scaled(e) @ e.coefficients for e in (effect, *others))
    gram = np.tensordot(sigma**-2.0, fit.normal.total[0], axes=1) + fit.precision
    inverse = solve_weighted(gram, np.zeros(len(gram)), np.zeros(len(gram)))[1]
    bend = np.linalg.pinv(fit.shape_equations(sigma)[0], rcond=RANK_TOLERANCE, hermitian=True)
    columns = fit.fixed.beside(fit.varied)
    shifts = []
    spans = fit.regression.spans
    swings = [np.concatenate([hilbert(x[s], axis=0) for s in spans]) for x in np.subtract(changed, now)]
    for off in (np.ascontiguousarray(part.T) for x in swings for part in (x.real, x.imag)):  # at any phase
        across = np.zeros(len(gram))
        for w, at, x, y in zip(sigma**-2.0, columns.places, columns.columns, off, strict=True):
            across[at] += w * (x.T @ y)
        left, score = off - columns.times(inverse @ across), np.zeros(len(fit.shapes))
        for j, weight in enumerate(sigma**-2.0):
            np.add.at(score, fit._by_shape.places[j], weight * (fit._by_shape.columns[j].T @ left[j]))
        shifts.append(step * (bend @ (score * step)))
    return np.asarray(np.sqrt(np.mean(np.square(shifts), axis=0)))


def _reach(fit: _Fit, place: int, beside: Mask, way: float, rise: float, sigma: Array) -> float:
    """How far off a shape is where squares, the shapes `beside` (s,) fitted again, rose by so much, or its range ends."""
    lowest, at = fit.cost(sigma), fit.shape[place]
    last = before = 0.0
    for _ in range(DOUBLINGS):
        value = float(np.clip(at + way, fit.shapes.low[place], fit.shapes.high[place]))
        moved = fit.shape.copy()
        moved[place] = value
        risen = max(fit.with_shape(moved)._stepped(BESIDE, beside).cost(sigma) - lowest, 0.0)
        far = abs(value - at)
        if not risen < rise:
            part = (np.sqrt(rise) - np.sqrt(before)) / max(np.sqrt(risen) - np.sqrt(before), 1e-300)
            return float(last + min(part, 1.0) * (far - last)) if np.isfinite(risen) else last
        if value != at + way:
            return far
        last, before, way = far, risen, 2.0 * way
    return last
