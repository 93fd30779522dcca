"""Effects of every type of the catalogue with drawn values, for tests that hold for all of them, present and future."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from rx90b_flex.effects import Effect, Sites, catalogue
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot, load_robot

# What stands between robot and log is no part of a robot's dynamics.
TYPES = tuple(name for name, cls in catalogue().items() if cls.traits.in_dynamics)
ALL_TYPES = tuple(catalogue())
ROBOTS = ("rx90b", "example-robot-data:ur10")


@cache
def tree(source: str) -> Robot:
    """A robot without effects."""
    return load_robot(source).with_effects([])


def draw_effect(kind: str, robot: Robot, rng: np.random.Generator) -> tuple[Effect, ...]:
    """One effect of a type at a drawn place of a robot, and the effects that it needs there."""
    cls = catalogue()[kind]
    sites = Sites(robot.joints, robot.tip_frame)
    # a type that no search can try has no places of its own: then any joint
    places = [e for e in cls.everywhere(sites) if type(e) is cls]
    if not places:
        places = [cls()] if cls.traits.on == "robot" else [cls(joint=j) for j in robot.joints]  # type: ignore[call-arg]
    effect = places[rng.integers(len(places))]
    needed = [catalogue()[name](joint=effect.joints[0]) for name in cls.traits.needs]  # type: ignore[call-arg]
    return (*(_with_values(e, rng) for e in needed), _with_values(effect, rng))


def _with_values(effect: Effect, rng: np.random.Generator) -> Effect:
    given = {
        name: tuple(rng.uniform(-0.5, 0.5, parameter.size) if parameter.size else np.sort(rng.uniform(-2.0, 2.0, 5)))
        for name, parameter in effect.parameters().items()
        if parameter.kind == "given"
    }
    effect = dataclasses.replace(effect, **given)
    starts = np.repeat([p.start for p in effect.parameters().values() if p.kind == "shape"], _shape_sizes(effect))
    if len(starts) < len(effect.shape):  # a shape of the type's own making
        starts = np.array([np.sqrt(p.lower * p.upper) for p in effect.shape_parameters.values()])
    if len(starts):
        effect = effect.with_shape(starts * rng.uniform(0.6, 1.5, len(starts)))
    return effect.with_coefficients(rng.uniform(0.5, 2.0, len(effect.coefficients)))


def _shape_sizes(effect: Effect) -> list[int]:
    return [p.size for p in effect.parameters().values() if p.kind == "shape"]


def with_drawn_effects(robot: Robot, kinds: list[str], rng: np.random.Generator) -> Robot:
    """A robot with drawn effects; a second one of a type in one place only where the type allows it."""
    effects: list[Effect] = []
    for kind in kinds:
        for new in draw_effect(kind, robot, rng):
            if new.traits.repeats or not any(type(e) is type(new) and e.place == new.place for e in effects):
                effects.append(new)
    return robot.with_effects(effects)


def draw_state(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Coordinates, velocities away from reversal, and accelerations; each (n,)."""
    n = robot.model.nv
    v = rng.uniform(0.2, 1.0, n) * rng.choice([-1.0, 1.0], n)
    return rng.uniform(-1.0, 1.0, n), v, rng.uniform(-3.0, 3.0, n)
