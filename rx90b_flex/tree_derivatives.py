"""Derivatives of a tree's torques for links that no body need have, as fitted ones are.

Pinocchio adds bodies up from the tips to the base, and divides by their common mass. Least squares may give links whose masses
add up to zero or less, though what they ask for is right. Point masses at the joints make the sums positive; what these ask for is
taken off again, for torques are linear in the links' parameters.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from rx90b_flex.effects.motion import Array, Motion

# Of what bodies would weigh if all were positive, that they weigh together where nothing is put on them.
LEAST_PART = 1e-3


def of_torques(model: pin.Model, motion: Motion) -> tuple[Array, Array, Array]:
    """Derivatives of inverse dynamics by q, v and a along a motion, each (N, n, n)."""

    def asked(model: pin.Model) -> Array:
        data = model.createData()
        out = np.empty((3, len(motion), model.nv, model.nv))
        for k, (q, v, a) in enumerate(zip(motion.q, motion.v, motion.a, strict=True)):
            out[:, k] = pin.computeRNEADerivatives(model, data, q, v, a)
        return out

    by_q, by_v, by_a = _linear_in_links(asked, model)
    upper = np.triu(np.ones((model.nv, model.nv), bool))  # pinocchio fills this half of the mass matrix
    return by_q, by_v, np.where(upper, by_a, by_a.transpose(0, 2, 1))


def of_gravity(model: pin.Model, poses: Array) -> Array:
    """Derivatives of the torque of gravity by q in poses (N, nq), each (n, n)."""

    def asked(model: pin.Model) -> Array:
        data = model.createData()
        return np.array([pin.computeGeneralizedGravityDerivatives(model, data, q) for q in poses])

    return _linear_in_links(asked, model)


def _linear_in_links(asked: Callable[[pin.Model], Array], model: pin.Model) -> Array:
    masses = np.array([body.mass for body in model.inertias])
    if _smallest_part(model, masses) >= LEAST_PART:
        return asked(model)
    heavy, more, size = model.copy(), model.copy(), float(np.abs(masses).sum())
    for joint in range(1, model.njoints):
        put_on = pin.Inertia(max(size - masses[joint], 0.0), np.zeros(3), np.zeros((3, 3)))
        whole = model.inertias[joint].toDynamicParameters() + put_on.toDynamicParameters()
        heavy.inertias[joint], more.inertias[joint] = pin.Inertia.FromDynamicParameters(whole), put_on
    return asked(heavy) - asked(more)


def _smallest_part(model: pin.Model, masses: Array) -> float:
    """Masses (joints,) added up from the tips to the base, over the sums of their sizes: the smallest on the way."""
    sums, sizes, smallest = masses.copy(), np.abs(masses), 1.0
    for joint in range(model.njoints - 1, 0, -1):
        parent = model.parents[joint]
        if parent > 0 and sizes[parent] + sizes[joint] > 0.0:
            sums[parent] += sums[joint]
            sizes[parent] += sizes[joint]
            smallest = min(smallest, float(sums[parent] / sizes[parent]))
    return smallest
