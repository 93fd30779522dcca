"""The robot that an identified model is: what can be simulated and saved."""

from __future__ import annotations

from collections.abc import Sequence

from rx90b_flex.export import with_link_parameters
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.physical import possible_coefficients, with_coefficients
from rx90b_flex.robot import Robot


def identified_robot(source: Robot, model: Identification, joints: Sequence[str]) -> Robot:
    """A declared robot with the values and effects of a model identified on some of its joints; see `closed_loop_robot`."""
    values = with_possible_values(model)
    effects = values.in_tree
    # what bends and has no value, if none was found
    known = {e.label for e in (*source.over_time().effects, *effects)}
    flexible = [e for e in source.effects if e.label not in known]
    if not model.links_fitted:
        held = [e for e in source.effects if e not in flexible and not set(e.joints) <= set(joints)]
        return source.with_effects([*flexible, *held, *effects])
    return with_link_parameters(model.regression.robot, values.link_parameters).with_effects([*flexible, *effects])


def with_possible_values(model: Identification) -> Identification:
    """The same model with the values that are written: of bodies that can exist, and of effects within their bounds.

    What the fit left over, its covariance and its columns stay those of the fitted values. Known links are kept as they
    were given.
    """
    theta, _ = possible_coefficients(model)
    return with_coefficients(model, theta)
