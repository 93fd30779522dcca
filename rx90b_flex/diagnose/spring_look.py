"""Whether torques show a spring on a joint beside the weight of its links: a gas spring, a balancer, a hose."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre
from scipy import stats

from rx90b_flex.diagnose.trial import SIGNIFICANCE
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.coloured import residual_spectrum, scatter, widening
from rx90b_flex.identify.least_squares import CORRELATION_S, Identification

DEGREE = 4  # of the smooth curve of the joint's angle that stands for a spring of any geometry
WEIGHTY = 0.1  # part of a joint's torque from which gravity is worth a balancer
UNIQUE = 1.0e-4  # part of a curve's square that the model leaves for it to be told at all


def spring_words(model: Identification, joint: str) -> str:
    """A sentence on a spring between a joint and the link before it; empty where gravity does not load the joint.

    A spring is a smooth curve of the joint's angle. What of it the fitted links' weight (cosine and sine of the same angle) can be
    as well, torques cannot tell from it; the rest is tested against the coloured residual.
    """
    regression = model.regression
    place, column = regression.joints.index(joint), regression.robot.layout.index(joint)
    torque = regression.torque[:, place]
    down = np.array([0.0, 0.0, -1.0])
    weight = np.concatenate([s.sampled.on_tree.gravity_torque(down)[:, column] for s in regression.segments])
    if np.abs(weight).max() < WEIGHTY * np.sqrt((torque**2).mean()):
        return ""
    angle = np.concatenate([s.sampled.q[:, column] for s in regression.segments])
    span = float(np.ptp(angle))
    curve = np.zeros((len(angle), len(regression.rows), DEGREE))
    shape = legendre.legvander(2.0 * (angle - angle.min()) / max(span, 1e-12) - 1.0, DEGREE)[:, 1:]
    curve[:, regression.rows == column] = shape[:, None]
    apart, own = _apart(model, curve)
    weights = model.solution.sigma**-2.0
    left = np.einsum("j,njk,njl->kl", weights, apart, apart)
    inverse = np.linalg.pinv(left, rcond=UNIQUE, hermitian=True)
    theta = inverse @ np.einsum("j,njk,nj->k", weights, apart, model.residual)
    # the colour of what is left with the spring in the model: without, a spring would pass for noise
    longest = int(CORRELATION_S * regression.segments[0].rate_hz)
    rest = model.residual - apart @ theta
    spectra = [residual_spectrum(r, regression.spans, np.zeros(1), longest) for r in rest.T]
    covariance = widening(spectra) * inverse @ scatter(apart, weights, spectra, regression.spans) @ inverse
    rank = int(np.linalg.matrix_rank(inverse, hermitian=True))
    p_value = float(stats.chi2.sf(theta @ np.linalg.pinv(covariance, hermitian=True) @ theta, max(rank, 1)))
    shared = 100.0 * (1.0 - float(np.trace(left)) / max(own, 1e-300))
    over = (
        f"over the {span:.2g} rad that {joint} moved, {shared:.0f} % of what a spring there does, the weight of fitted links does "
        "as well"
    )
    if p_value < SIGNIFICANCE:
        size = float(np.sqrt(((apart[:, place] @ theta) ** 2).mean()))
        return f"A spring on {joint}, such as a gas spring: {over}; of the rest {size:.3g} N m stand out (p = {p_value:.1g})."
    return f"A spring on {joint}, such as a gas spring, is not shown: {over}, and of the rest nothing stands out (p = {p_value:.2g})."


def _apart(model: Identification, columns: Array) -> tuple[Array, float]:
    """What of columns (N, joints, k) the model's own do not explain, and their weighted square before."""
    weights = model.solution.sigma**-2.0
    known = model.columns
    with_model = np.einsum("j,njp,njk->pk", weights, known, columns)
    own = float(np.einsum("j,njk->", weights, columns**2))
    return columns - known @ (model.solution.inverse @ with_model), own
