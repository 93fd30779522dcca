"""Types of hidden effects and how their values are drawn."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import independent as ind
import numpy as np

from hidden_effects.physics import Hidden, Values
from rx90b_flex.effects import Coordinates, Effect, Motion, Sites, catalogue

Drawn = Callable[[np.random.Generator], dict[str, Any]]
LAG_S = 1e-3  # damping over stiffness of a drive


@dataclass(frozen=True)
class Kind:
    """How values of an effect type are drawn: what scales with the strength, and the shapes.

    `start` is a size to begin the search for the strength with; `most` the largest that is believable.
    """

    sizes: Drawn
    shapes: Drawn = lambda rng: {}
    on: str = "joint"
    start: float = 1.0
    most: float = np.inf
    absent: tuple[str, ...] = ()  # what the robot does not have where this is hidden
    known_links: bool = False
    rests: bool = False  # shows at rest alone
    finish: Callable[[dict[str, Any]], dict[str, Any]] = dict
    not_with: tuple[str, ...] = ()  # forms of dry friction that have it of themselves
    law: Callable[[ind.Motion, int, Values], ind.Array] | None = None  # where `physics` has none


def _phase(rng: np.random.Generator) -> float:
    return float(rng.uniform(-np.pi, np.pi))


def one(*names: str) -> Drawn:
    return lambda rng: dict.fromkeys(names, 1.0)


def either(name: str) -> Drawn:
    return lambda rng: {name: float(rng.choice([-1.0, 1.0]))}


def sine(**ranges: tuple[float, float]) -> Drawn:
    return lambda rng: {name: float(rng.uniform(*r)) for name, r in ranges.items()} | {"phase": _phase(rng)}


def uniform(**ranges: tuple[float, float]) -> Drawn:
    return lambda rng: {name: float(rng.uniform(*r)) for name, r in ranges.items()}


def _tilt(rng: np.random.Generator) -> dict[str, Any]:
    angle = _phase(rng)
    return {"angle_x": float(np.cos(angle)), "angle_y": float(np.sin(angle))}


def _dahl(p: dict[str, Any]) -> dict[str, Any]:
    return {"torque": p["torque"], "stiffness": p["torque"] / p["deflection"]}


def _maxwell(p: dict[str, Any]) -> dict[str, Any]:
    return {"torques": p["torques"], "stiffnesses": (np.array(p["torques"]) / p["deflections"]).tolist()}


def _compliant(p: dict[str, Any]) -> dict[str, Any]:
    return {"stiffness": 1.0 / p["compliance"], "damping": LAG_S / p["compliance"]}


def _gain(p: dict[str, Any]) -> dict[str, Any]:
    return {"gain": 1.0 + p["more"]}


STUDIED: Mapping[str, Kind] = {
    "drive_inertia": Kind(one("inertia")),
    "torque_offset": Kind(either("torque")),
    "coulomb_friction": Kind(one("torque"), absent=("coulomb_friction",)),
    "viscous_friction": Kind(one("coefficient"), absent=("viscous_friction",)),
    "viscous_power_friction": Kind(one("coefficient"), uniform(power=(0.35, 0.65)), absent=("viscous_friction",)),
    "stribeck_friction": Kind(one("torque"), uniform(velocity=(0.08, 0.3), power=(0.8, 2.0))),
    "asymmetric_friction": Kind(either("coefficient")),
    "load_friction": Kind(one("coefficient"), start=0.05, most=0.3),
    "friction_drift": Kind(one("coefficient"), uniform(time_constant=(3.0, 10.0))),
    "presliding_friction": Kind(one("torque"), uniform(deflection=(0.01, 0.05)), finish=_dahl),
    "joint_spring": Kind(one("stiffness"), uniform(rest_angle=(-0.5, 0.5))),
    "gravity_spring": Kind(
        lambda rng: {"stiffness": 1.0, "prestress": float(rng.uniform(0.0, 0.2))},
        uniform(far=(0.3, 0.5), near=(0.1, 0.25), angle=(-2.0, 2.0)),
        start=100.0,
    ),
    "base_tilt": Kind(_tilt, on="robot", start=0.02, most=0.1),
    "payload": Kind(
        one("mass"), lambda rng: {"centre": rng.uniform(-0.15, 0.15, 3).tolist()}, on="frame", known_links=True
    ),
    "joint_coupling": Kind(
        lambda rng: {"inertia": 0.1 * rng.uniform(0.5, 1.0), "viscous": rng.uniform(0.5, 1.0), "coulomb": 1.0},
        on="pair",
    ),
    "gear_ripple": Kind(one("amplitude"), sine(order=(8.0, 40.0))),
    "transmission_error": Kind(one("amplitude"), sine(order=(6.0, 30.0)), start=1e-3, most=0.02),
    "backlash": Kind(one("gap"), start=1e-3, most=0.02),
    "drive_flexibility": Kind(one("compliance"), start=1e-5, finish=_compliant),
    "motor_saturation": Kind(one("coefficient"), start=1e-6),
    "torque_delay": Kind(one("delay"), on="robot or joint", start=3e-3, most=0.03),
    "resolver_error": Kind(one("amplitude"), sine(order=(4.0, 40.0)), start=3e-4, most=0.02),
    "line_interference": Kind(one("amplitude"), sine(frequency_hz=(4.0, 13.0))),
    "held_friction": Kind(one("torque"), rests=True, not_with=("maxwell",)),
    "load_viscous_friction": Kind(one("coefficient"), start=0.05),
    "drive_efficiency": Kind(
        lambda rng: {"motoring": 1.0, "backdriving": float(rng.uniform(0.2, 0.6))}, start=0.05, most=0.3
    ),
    "maxwell_slip_friction": Kind(
        lambda rng: {"torques": [0.6, 0.4]},
        lambda rng: {"deflections": [float(rng.uniform(3e-3, 6e-3)), float(rng.uniform(0.02, 0.06))]},
        finish=_maxwell,
    ),
    "position_friction": Kind(one("amplitude"), sine(order=(1.0, 12.0))),
    "cable_torque": Kind(
        lambda rng: {"coefficients": [float(rng.choice([-1.0, 1.0])), float(rng.uniform(-0.5, 0.5))]}, on="ordered pair"
    ),
    "torque_gain": Kind(lambda rng: {"more": float(rng.choice([-1.0, 1.0]))}, start=0.05, most=0.5, known_links=True, finish=_gain),
}  # fmt: skip
OUTSIDE = ("contact", "angle_dependent_friction", "slipping_encoder")
OUTSIDE_KINDS: Mapping[str, Kind] = {
    "contact": Kind(one("stiffness"), uniform(quantile=(0.6, 0.8)), on="frame", start=100.0),
    "angle_dependent_friction": Kind(one("coefficient"), on="ordered pair"),
    "slipping_encoder": Kind(one("slip"), start=3e-4, most=0.1),
}
# why types of the catalogue are not hidden in this study
ELSEWHERE = {
    "breakaway_friction": "periodic motion has no first move; in `tests/test_breakaway.py`",
    "joint_flexibility": "in `closing_the_loop_over_frequency.py`",
    "base_flexibility": "in `closing_the_loop_over_frequency.py`",
    "stiffness_hardening": "beside a declared flexible drive; in the tests of deflecting drives",
    "friction_curve": "a last resort: no law of its own to hide",
    "angle_curve": "a last resort: no law of its own to hide",
}


def by_its_own_law(cls: type[Effect]) -> Kind | None:
    """How a type is hidden that this study has no law of: by the package's own; None where it is no torque of one joint's motion."""
    stated = any(p.kind == "given" for p in cls.parameters().values())
    more = (
        cls.traits.needs_load
        or cls.traits.needs_model
        or cls.traits.remembers
        or cls.traits.needs
        or cls.traits.virtual
    )
    if (
        cls.traits.on != "joint"
        or not cls.traits.in_dynamics
        or stated
        or more
        or not cls.everywhere(Sites(("joint",), "tip"))
    ):
        return None
    named = {kind: [n for n, p in cls.parameters().items() if p.kind == kind] for kind in ("linear", "shape")}
    starts = {n: p.start for n, p in cls.parameters().items() if p.kind == "shape"}

    def law(m: ind.Motion, j: int, values: Values) -> ind.Array:
        names = [f"joint_{i + 1}" for i in range(m.q.shape[1])]
        seen = Motion(Coordinates(tuple(f"{n}:drive" for n in names)), m.q, m.v, m.a, m.time, lambda _: None)
        return np.asarray(cls(joint=names[j], **values).force(seen)[:, j])

    return Kind(one(*named["linear"]), lambda rng: starts, law=law) if named["linear"] else None


OTHERS = {name: by_its_own_law(cls) for name, cls in catalogue().items() if name not in {**STUDIED, **ELSEWHERE}}
KINDS: Mapping[str, Kind] = {**STUDIED, **{name: kind for name, kind in OTHERS.items() if kind is not None}}
ELSEWHERE |= {name: "this study has no law of it" for name, kind in OTHERS.items() if kind is None}


def places(kind: Kind, joints: int, rng: np.random.Generator) -> list[tuple[int, ...]]:
    """Where an effect may be hidden, in drawn order."""
    if kind.on in ("robot", "frame"):
        return [()]
    if kind.on in ("pair", "ordered pair"):
        choose = itertools.combinations if kind.on == "pair" else itertools.permutations
        pairs = list(choose(range(joints), 2))
        return [pairs[i] for i in rng.permutation(len(pairs))]
    single: list[tuple[int, ...]] = [(int(j),) for j in rng.permutation(joints)]
    return [(), *single] if kind.on == "robot or joint" and rng.random() < 0.5 else single


def drawn(name: str, kind: Kind, place: tuple[int, ...], rng: np.random.Generator) -> Hidden:
    return Hidden(name, place, kind.sizes(rng), kind.shapes(rng), kind.finish, kind.law)
