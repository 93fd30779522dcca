"""The nearest inertial parameters that bodies can have, see `rx90b_flex.bodies`, and effects within their bounds.

Source: P. M. Wensing, S. Kim, J.-J. E. Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", IEEE Robotics and Automation Letters 3(1), 2018.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from scipy import linalg, sparse, stats

from rx90b_flex.bodies import as_bodies, inconsistencies, pseudo_inertia
from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.normal_equations import RANK_TOLERANCE, column_scale
from rx90b_flex.robot import Robot

AT_BOUND = 1e-4  # of its move: a coefficient that was moved to its bound lies so near to it

# Size of a body whose prior has no mass, when no other body tells one: kg, m.
DEFAULT_SIZE = (1.0, 0.1)
# Smallest length, m, by which a body is scaled: a point mass at the joint has none of its own.
SMALLEST_LENGTH = 1e-3
# standard deviation of what is known best over that of what is known least, at the least: as it is, then as a solver can take it
SUREST = (0.0, 1e-7, 1e-5)
TOLERANCES = (1e-11, 1e-9, 1e-7)  # of the solver, absolute and relative: the first that it reaches
SOLVED = {"Solved": "optimal", "AlmostSolved": "optimal_inaccurate"}


def information_root(information: Array) -> Array:
    """F, shape (rank, p), with F'F = information up to rounding; what the data does not determine is dropped.

    The same rule as in the least squares: columns are first scaled to length one, since their units differ.
    """
    scale = column_scale(np.diag(information))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = values > RANK_TOLERANCE**2 * max(values[-1], 1e-300)
    root: Array = np.sqrt(values[kept])[:, None] * vectors[:, kept].T * scale
    return root


# ---- repair -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ConsistentParameters:
    """Physically consistent parameters near an estimate.

    Attributes
    ----------
    parameters : array, shape (10 * bodies,)
    error_increase : float
        Weighted squared error above that of the estimate, ``(x - estimate)' information (x - estimate)``. With
        weights of one over the variance its unit is a squared standard deviation.
    rank : int
        Number of parameter combinations that the data determines.
    status : str
        Of the solver; ``consistent`` if none was needed.
    """

    parameters: Array
    error_increase: float
    rank: int
    status: str

    @property
    def p_value(self) -> float:
        """Probability that noise alone puts an estimate this far from the true parameters, or farther.

        Chi-squared with `rank` degrees of freedom; holds if `information` is the inverse of the estimate's covariance.
        Small (below 0.05): the data contradicts every possible body, so the model lacks something else.
        """
        return float(stats.chi2.sf(self.error_increase, self.rank)) if self.rank else 1.0


def consistent_parameters(
    estimate: Array,
    information: Array,
    prior: Array,
    *,
    lower: Array | None = None,
    pull: float = 1e-2,
    margin: float = 1e-6,
) -> ConsistentParameters:
    """Physically consistent parameters nearest to a least-squares estimate.

    Minimises ``(x - estimate)' information (x - estimate) + pull * sum over bodies of norm(P - P_prior)^2`` over all x
    whose pseudo-inertias P have no scaled eigenvalue below `margin`, by Clarabel. The norm is Frobenius',
    after scaling each body by its mass m and its radius l about the joint: ``P -> D P D``, D = diag(1/l, 1/l, 1/l, 1)
    / sqrt(m), so it counts relative deviations from the prior.

    A determined combination moves by at most sqrt(pull) / 2 of its standard deviations for each unit (100 %) of its
    deviation from the prior, however badly the data determines it: pull * t / (1 + pull * t^2) is largest at
    t = 1 / sqrt(pull), t its relative standard deviation. Where the data says nothing, x goes to the prior.

    With `lower`, other parameters follow those of the bodies: they are moved along, not below their bounds, and pulled to
    their priors in units of the larger one of prior and estimate.

    Parameters
    ----------
    estimate : array, shape (10 * bodies,)
        Unconstrained optimum; what it holds in undetermined directions does not matter.
    information : array, shape (10 * bodies, 10 * bodies)
        Weighted Gram matrix over link parameters only, or the inverse of the estimate's covariance. May be singular.
    prior : array, shape (10 * bodies,)
        CAD values; need not be consistent, and a body may have no mass.
    lower : array, shape (r,), optional
        Smallest values of the last r parameters, which belong to no body; -inf for none. Estimate, information and prior
        then hold ``10 * bodies + r`` parameters each.
    pull : float
        Weight of the prior, above zero.
    margin : float
        Smallest eigenvalue allowed for scaled pseudo-inertias. A solid body has 1e-3 to 1.

    Raises
    ------
    ValueError
        Shapes do not fit, or the solver finds no solution.
    """
    prior, estimate = np.asarray(prior, dtype=float), np.asarray(estimate, dtype=float)
    information = np.asarray(information, dtype=float)
    least = np.zeros(0) if lower is None else np.asarray(lower, dtype=float)
    links = np.size(prior) - len(least)
    _check_problem(estimate, information, prior, links, pull, margin)
    unit = np.maximum(np.abs(prior[links:]), np.abs(estimate[links:]))
    unit[unit == 0] = 1.0
    scaled_prior, from_scaled = _scaled(prior, links, unit)
    root = information_root(information)
    step, spread = _whitened(root @ from_scaled, root @ (estimate - prior), pull)
    free, status = scaled_prior + step, "consistent"
    lowest = np.linalg.eigvalsh(_symmetric(free[:links]))[:, 0]
    if (lowest < margin).any() or (free[links:] < least / unit).any():
        free, status = _project(free, spread, margin, least / unit)
    parameters = from_scaled @ free
    parameters[links:] = np.maximum(parameters[links:], least)  # where the solver was a rounding below
    increase = float(np.sum((root @ (parameters - estimate)) ** 2))
    return ConsistentParameters(parameters, increase, len(root), status)


def _check_problem(estimate: Array, information: Array, prior: Array, links: int, pull: float, margin: float) -> None:
    """Refuse what does not fit together or is not finite."""
    if estimate.shape != prior.shape:
        raise ValueError(f"estimate has shape {estimate.shape}; expected {prior.shape}, as the prior")
    as_bodies(prior[:links], links // 10, "prior")
    as_bodies(estimate[:links], links // 10, "estimate")
    if not np.isfinite(np.r_[estimate[links:], prior[links:]]).all():
        raise ValueError(f"estimate or prior of the last {len(prior) - links} parameters is not finite")
    if information.shape != (len(prior),) * 2 or not np.isfinite(information).all():
        raise ValueError(f"information has shape {information.shape}; expected {(len(prior),) * 2}, all finite")
    if not (pull > 0 and margin > 0):
        raise ValueError(f"pull is {pull!r} and margin {margin!r}; expected positive numbers")


def _scaled(prior: Array, links: int, unit: Array) -> tuple[Array, Array]:
    """The prior in scaled coordinates u, and the matrix that leads back from them.

    In u a body's ten numbers are the entries of D P D, and their norm is its Frobenius norm; the rest is in its `unit`.
    """
    bodies = as_bodies(prior[:links], links // 10, "prior")
    to_scaled = [_scaled_coordinates(mass, length) for mass, length in _sizes(bodies)]
    inverses = [np.linalg.inv(block) for block in to_scaled]
    scaled_bodies = [block @ body for block, body in zip(to_scaled, bodies, strict=True)]
    back = linalg.block_diag(*inverses, np.diag(unit))[: len(prior)]
    return np.concatenate([*scaled_bodies, prior[links:] / unit]), back


def _whitened(root: Array, target: Array, pull: float) -> tuple[Array, Array]:
    """Where ``|root u - target|^2 + pull |u|^2`` is smallest, and a matrix S with which it is ``|z|^2`` and a constant.

    Away from there by ``S z``: in z all directions weigh the same, though the information spans many decades. The singular value
    decomposition keeps the digits that a Cholesky factor of the sum would lose.
    """
    left, values, right = np.linalg.svd(root, full_matrices=True)
    padded, along = np.zeros((2, len(right)))
    padded[: len(values)] = values
    along[: len(values)] = (left.T @ target)[: len(values)]
    return right.T @ (padded / (padded**2 + pull) * along), right.T / np.sqrt(padded**2 + pull)


def possible_coefficients(model: Identification) -> tuple[Array, tuple[str, ...]]:
    """Coefficients of a robot that can exist and be loaded, and the names of those held at their bounds.

    What is moved takes the others with it, so that the error grows least.
    """
    links = model.link_parameters if model.links_fitted else np.zeros(0)
    lower = np.array([p.lower for e in model.effects for p in e.coefficient_parameters.values()])
    names = [name for name, _ in model.regression.robot.bodies] if model.links_fitted else []
    theta = model.theta
    if inconsistencies(links, names) or (theta[len(links) :] < lower).any():
        declared = model.regression.robot
        known = np.concatenate([np.zeros(0), *(_declared(declared, e).coefficients for e in model.effects)])
        rest = np.where(np.isnan(known), theta[len(links) :], known)
        prior = np.r_[declared.link_parameters[: len(links)], rest]
        theta = consistent_parameters(theta, model.information, prior, lower=lower).parameters
    rest, before = theta[len(links) :], model.theta[len(links) :]
    held = (before < lower) & (rest - lower <= AT_BOUND * np.abs(lower - before))
    rest = np.where(held, lower, rest)  # the solver ends a little above
    labels = model.coefficient_names[len(links) :]
    moved = with_coefficients(model, np.r_[theta[: len(links)], rest])
    values = moved.theta if np.array_equal(moved.theta, model.theta) else gains_again(moved)
    return values, tuple(label for label, h in zip(labels, held, strict=True) if h)


def gains_again(model: Identification) -> Array:
    """Coefficients in which each torque gain is the one that fits the torque of the others best.

    A gain multiplies what the other coefficients say: where these were moved far, what it is moved by beside them is wrong in
    second order.
    """
    theta = model.theta.copy()
    motors = model.regression.motors
    seen = motors.with_model(model.link_parameters, model.effects)
    for i, effect in enumerate(model.effects):
        if effect.traits.multiplies:
            at = motors.joints.index(effect.joints[0])
            said, torque = seen.columns(effect)[:, at, 0], seen.torque[:, at]
            if seen.carried_torque is not None:
                torque = torque + seen.carried_torque[:, at]
            if said @ torque > 0:
                theta[model.first_column(i)] = said @ torque / (said @ said) - 1.0
    return theta


def with_coefficients(model: Identification, theta: Array) -> Identification:
    """The same model with other coefficients, such as possible ones; covariance and residual stay those of the fit."""
    links = len(model.link_parameters) if model.links_fitted else 0
    effects = model.with_rest(theta[links:] - model.theta[links:])
    kept = theta[:links] if model.links_fitted else model.link_parameters
    return dataclasses.replace(model, effects=effects, link_parameters=kept, theta=theta)


def _declared(robot: Robot, effect: Effect) -> Effect:
    """The effect as the robot declares it; as it is where it does not."""
    same = [e for e in robot.effects if type(e) is type(effect) and e.place == effect.place]
    return same[0] if same else effect


def _project(free: Array, spread: Array, margin: float, least: Array) -> tuple[Array, str]:
    """Minimise |z| so that the bodies in ``free + spread z`` are consistent and the rest is not below `least`.

    Returns that and the solver's status. Where a model is so far from any robot that the solver fails, what is known best counts
    as known less well.
    """
    status, smallest = "", 0.0
    for surest in SUREST:
        at, status, smallest = _solved(free, spread if surest == 0.0 else _at_least(spread, surest), margin, least)
        # an inaccurate end is good enough if the bodies are consistent: what is lost is a little of the optimum
        if status in SOLVED and smallest >= 0.5 * margin:
            return at, SOLVED[status]
    raise ValueError(
        f"no physically consistent parameters found: the solver says {status!r}, an eigenvalue is {smallest:.3g}"
    )


def _at_least(spread: Array, surest: float) -> Array:
    """With no singular value below that part of the largest one."""
    left, values, right = np.linalg.svd(spread)
    return np.asarray((left * np.maximum(values, surest * values[0])) @ right)


def _solved(free: Array, spread: Array, margin: float, least: Array) -> tuple[Array, str, float]:
    """Where the solver ends, its status, and the smallest eigenvalue of a scaled pseudo-inertia there."""
    # A feasible point, each body on its own, bounds |z|; in that unit the solver's tolerances mean something.
    links = len(free) - len(least)
    values, vectors = np.linalg.eigh(_symmetric(free[:links]))
    clipped = _entries((vectors * np.maximum(values, margin)[:, None, :]) @ vectors.transpose(0, 2, 1))
    clipped = np.r_[clipped, np.maximum(free[links:], least)]
    unit = float(np.linalg.norm(np.linalg.solve(spread, clipped - free)))
    bounded = links + np.flatnonzero(np.isfinite(least))
    rows = np.concatenate([bounded, *(10 * b + _BY_COLUMNS for b in range(links // 10))]).astype(int)
    lowest = np.r_[least[bounded - links], np.tile(1.01 * margin * _entries(np.eye(4)[None])[_BY_COLUMNS], links // 10)]
    problem = (
        sparse.eye_array(len(free), format="csc"),
        np.zeros(len(free)),
        sparse.csc_array(-unit * spread[rows]),
        free[rows] - lowest,
        [clarabel.NonnegativeConeT(len(bounded)), *(clarabel.PSDTriangleConeT(4) for _ in range(links // 10))],
    )
    for tolerance in TOLERANCES:
        solved = clarabel.DefaultSolver(*problem, _settings(tolerance)).solve()
        status, scaled = str(solved.status), free + spread @ (unit * np.asarray(solved.x))
        smallest = float(np.linalg.eigvalsh(_symmetric(scaled[:links]))[:, 0].min(initial=np.inf))
        if status == "Solved" and smallest >= 0.5 * margin:
            break
    return scaled, status, smallest


def _settings(tolerance: float) -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    return settings


def _sizes(prior: Array) -> list[tuple[float, float]]:
    """Mass (kg) and radius about the joint (m) by which each body is scaled."""
    some = prior[:, 0] > 0
    sizes = np.tile(DEFAULT_SIZE, (len(prior), 1))
    if some.any():
        mass, second_moment = prior[some, 0], 0.5 * prior[some, 4:7].sum(axis=1)  # trace of Sigma
        own = np.column_stack([mass, np.maximum(np.sqrt(np.maximum(second_moment, 0.0) / mass), SMALLEST_LENGTH)])
        sizes[some], sizes[~some] = own, np.median(own, axis=0)
    return [(float(mass), float(length)) for mass, length in sizes]


def _scaled_coordinates(mass: float, length: float) -> Array:
    """Matrix from ten parameters to the entries of their scaled pseudo-inertia, shape (10, 10)."""
    d = np.array([1 / length, 1 / length, 1 / length, 1.0]) / np.sqrt(mass)
    return np.asarray(_entries(pseudo_inertia(np.eye(10)) * np.outer(d, d)).reshape(10, 10).T)


# Upper triangle of a symmetric 4 x 4 matrix as ten coordinates; off the diagonal times sqrt(2), so that the norm of
# the coordinates is the matrix's Frobenius norm. `_UNPACK` (16, 10) is the way back; `_BY_COLUMNS` is the solver's order.
_ROWS, _COLUMNS = np.triu_indices(4)
_WEIGHTS = np.where(_ROWS == _COLUMNS, 1.0, np.sqrt(2.0))
_BY_COLUMNS = np.lexsort((_ROWS, _COLUMNS))
_UNPACK = np.zeros((16, 10))
_UNPACK[4 * _ROWS + _COLUMNS, np.arange(10)] = 1 / _WEIGHTS
_UNPACK[4 * _COLUMNS + _ROWS, np.arange(10)] = 1 / _WEIGHTS


def _entries(matrices: Array) -> Array:
    """Coordinates of symmetric matrices, (k, 4, 4) -> (10 * k,)."""
    return np.ravel(matrices[:, _ROWS, _COLUMNS] * _WEIGHTS)


def _symmetric(coordinates: Array) -> Array:
    """Inverse of `_entries`, (10 * k,) -> (k, 4, 4)."""
    return np.asarray((coordinates.reshape(-1, 10) @ _UNPACK.T).reshape(-1, 4, 4))
