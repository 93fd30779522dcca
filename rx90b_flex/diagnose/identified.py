"""The robot that an identified model is: what can be simulated and saved."""

from __future__ import annotations

from collections.abc import Sequence

from rx90b_flex.export import with_link_parameters
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.physical import possible_coefficients
from rx90b_flex.robot import Robot


def identified_robot(source: Robot, model: Identification, joints: Sequence[str]) -> Robot:
    """A declared robot with the values and effects of a model identified on some of its joints; see `closed_loop_robot`."""
    flexible = [e for e in source.effects if e.on_rigid_tree() is None]
    if not model.links_fitted:
        held = [e for e in source.effects if e not in flexible and not set(e.joints) <= set(joints)]
        return source.with_effects([*flexible, *held, *(e.in_tree() for e in model.effects)])
    links = len(model.link_parameters)
    theta, _ = possible_coefficients(model)
    effects = model.with_rest(theta[links:] - model.theta[links:])
    return with_link_parameters(model.regression.robot, theta[:links]).with_effects(
        [*flexible, *(e.in_tree() for e in effects)]
    )
