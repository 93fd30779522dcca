"""A robot with a hidden effect: recordings that the package makes itself, to close the loop on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rx90b_flex.effects import Effect, Motion, Sites, catalogue, close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.excitation import harmonic_motion
from rx90b_flex.export import save_robot
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Recording, write_campaign

ROBOT = "rx90b_rigid"
SAMPLE_RATE_HZ = 200.0
PERIOD_S = 10.0
CUTOFF_HZ = 20.0
LINES = 8  # harmonics of the excitation
SPEED = 0.75  # largest velocity of the excitation over the joint's limit
TORQUE_NOISE = 0.015  # of a joint's root mean square torque, as logged
POSITION_NOISE = 2e-6  # rad, resolver
STRENGTH = (5.0, 10.0)  # hidden torque over noise after the low-pass, both root mean square

NOTHING = "none"
HIDDEN = (  # drawn from where nobody says what to hide
    "asymmetric_friction",
    "coulomb_friction",
    "drive_inertia",
    "gear_ripple",
    "joint_coupling",
    "joint_spring",
    "load_friction",
    "stribeck_friction",
    "torque_offset",
    "viscous_friction",
    "viscous_power_friction",
)


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A declared robot, the true one, and recordings of the true one.

    Attributes
    ----------
    declared, true : Robot
    hidden : Effect or None
        What the declared robot lacks.
    recordings : tuple of Recording
    """

    declared: Robot
    true: Robot
    hidden: Effect | None
    recordings: tuple[Recording, ...]

    def write(self, folder: Path) -> Path:
        """Write the declared robot and the recordings as a campaign; returns the campaign file."""
        save_robot(self.declared, folder, "declared.toml", allow_inconsistent=True)
        return write_campaign(folder, "declared.toml", self.recordings, cutoff_hz=CUTOFF_HZ, file_format="csv.gz")


def make_demonstration(seed: int, hidden: str | None = None) -> Demonstration:
    """Draw a hidden effect and make recordings of a robot that has it.

    The motion is prescribed (a sum of harmonics that every joint follows exactly), the torque is the inverse dynamics
    of the true robot, and both are logged with noise.

    Parameters
    ----------
    seed : int
        Of the effect, its place and values, the excitation and the noise.
    hidden : str, optional
        Effect type, or ``none``; drawn where not given.

    Raises
    ------
    ValueError
        An effect type that the demonstration does not make.
    """
    rng = np.random.default_rng(seed)
    check_hidden(hidden)
    kind = str(rng.choice(HIDDEN)) if hidden is None else hidden
    base = load_robot(ROBOT)
    motions = [_drawn(base, rng) for _ in range(3)]
    declared, true, effect = base, base, None
    if kind != NOTHING:
        declared, true, effect = _hide(base, kind, motions[:2], rng)
    roles = ("identification", "identification", "validation")
    recordings = [
        _recorded(angles, true, f"run_{i}", role, rng)
        for i, (angles, role) in enumerate(zip(motions, roles, strict=True), start=1)
    ]
    return Demonstration(declared, true, effect, tuple(recordings))


def hideable() -> tuple[str, ...]:
    """Effect types that the demonstration can hide: torques on joints that follow from the motion alone, and that a search tries."""
    sites = Sites(("a", "b"), "tip")
    return tuple(name for name, cls in catalogue().items() if name in HIDDEN or _can_hide(cls, sites))


def _can_hide(cls: type[Effect], sites: Sites) -> bool:
    more = (
        cls.traits.needs_load
        or cls.traits.needs_model
        or cls.traits.remembers
        or cls.traits.needs
        or not cls.traits.repeats_with_motion
    )
    stated = any(p.kind == "given" for p in cls.parameters().values())
    plain = cls.traits.in_dynamics and not (more or stated or cls.traits.virtual or cls.traits.last_resort)
    return plain and cls.traits.on in ("joint", "joints") and bool(cls.everywhere(sites))


def check_hidden(hidden: str | None) -> None:
    """Refuse an effect type that the demonstration does not make, with the nearest one that it does."""
    if hidden is None or hidden == NOTHING or hidden in hideable():
        return
    if hidden in catalogue():
        raise ValueError(f"--hidden: {hidden!r} is none of what the demonstration hides: {', '.join(hideable())}")
    raise ValueError(f"--hidden: unknown effect type {hidden!r}; {close_match(hidden, (*hideable(), NOTHING))}")


Angles = tuple[Array, Array, Array]  # q, v and a of two periods of one motion, each (N, joints)


def _drawn(robot: Robot, rng: np.random.Generator) -> Angles:
    """Random harmonics, each joint within its limits of position and speed."""
    time = np.arange(round(2 * PERIOD_S * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    return harmonic_motion(robot.tree, time, rng, period_s=PERIOD_S, lines=LINES, speed=SPEED)


def _recorded(angles: Angles, robot: Robot, name: str, role: str, rng: np.random.Generator) -> Recording:
    """The log of a motion by a robot, with noise."""
    q, torque = angles[0], robot.inverse_dynamics(*angles)
    noise = TORQUE_NOISE * np.sqrt((torque**2).mean(axis=0))
    return Recording(
        name=name,
        role=role,  # type: ignore[arg-type]
        time=np.arange(len(q)) / SAMPLE_RATE_HZ,
        sample_rate_hz=SAMPLE_RATE_HZ,
        joints=robot.joints,
        position=q + POSITION_NOISE * rng.normal(size=q.shape),
        torque=torque + noise * rng.normal(size=torque.shape),
        period_s=PERIOD_S,
    )


def _hide(base: Robot, kind: str, motions: Sequence[Angles], rng: np.random.Generator) -> tuple[Robot, Robot, Effect]:
    """Declared robot, true robot and the effect that makes the difference."""
    motion = base.motion(*map(np.concatenate, zip(*motions, strict=True)))
    cls = catalogue()[kind]
    joint = str(rng.choice(base.joints))
    at = int(rng.integers(len(base.joints) - 1))
    pair = base.joints[at : at + 2]
    effect = cls(joint_pair=pair) if cls.traits.on == "joints" else cls(joint=joint)  # type: ignore[call-arg]
    # declared on every joint: the declared robot lacks it on this one
    declared = [e for e in base.effects if not (e.place == effect.place and e.type_name() == kind)]
    drawn = _with_values(effect, base, declared, motion, rng)
    kept = [e for e in declared if not (e.place == drawn.place and e.type_name() in drawn.traits.replaces)]
    return base.with_effects(declared), base.with_effects([*kept, drawn]), drawn


def _with_values(
    effect: Effect, base: Robot, declared: Sequence[Effect], motion: Motion, rng: np.random.Generator
) -> Effect:
    """Values that an engineer would find plausible, of a size that stands out of the noise."""
    torque = base.inverse_dynamics(motion.q, motion.v, motion.a)
    shapes: dict[str, Callable[[], list[float]]] = {
        "gear_ripple": lambda: [float(rng.integers(6, 41))],
        "stribeck_friction": lambda: [float(rng.uniform(0.05, 0.3)), float(rng.uniform(0.8, 1.6))],
        "viscous_power_friction": lambda: [float(rng.uniform(0.4, 0.65))],
    }
    if effect.type_name() in shapes:
        own = shapes[effect.type_name()]()
        # a turn-over, declared last, is the joint's: as sharp as that of its other friction
        effect = effect.with_shape([*own, *[np.nan] * (len(effect.shape) - len(own))])
    elif effect.type_name() not in HIDDEN and len(effect.shape):
        starts = effect.shape_search(motion).starts
        shared = np.array([p.shared for p in effect.shape_parameters.values()])
        effect = effect.with_shape(np.where(shared, np.nan, starts[rng.integers(len(starts))]))
    mix: dict[str, Callable[[], Array]] = {
        "gear_ripple": lambda: rng.normal(size=2),
        "joint_coupling": lambda: np.array([0.1, 1.0, 0.5]) * rng.uniform(0.5, 1.5, 3),
        "joint_spring": lambda: np.array([1.0, rng.uniform(-0.5, 0.5)]),
    }
    count = len(effect.coefficients)
    coefficients = mix[effect.type_name()]() if effect.type_name() in mix else np.ones(1)
    if len(coefficients) != count:
        bounded = np.isfinite([p.lower for p in effect.coefficient_parameters.values()])
        signs = np.where(bounded, 1.0, rng.choice([-1.0, 1.0], count))
        coefficients = signs * rng.uniform(0.5, 1.0, count)
    force = effect.columns(motion) @ coefficients
    rows = np.flatnonzero(force.any(axis=0))
    noise = TORQUE_NOISE * np.sqrt((torque**2).mean(axis=0)) * np.sqrt(2 * CUTOFF_HZ / SAMPLE_RATE_HZ)
    # what the declared model takes up of the effect does not stand out
    left = (force - _taken_up(effect, declared, motion, force))[:, rows]
    shown = np.sqrt((left**2).mean(axis=0)) / noise[rows]
    return effect.with_coefficients(coefficients * rng.uniform(*STRENGTH) / shown.max())


def _taken_up(effect: Effect, declared: Sequence[Effect], motion: Motion, force: Array) -> Array:
    """Part of a torque that the declared effects of the same joints can imitate, shape (N, joints)."""
    near = [e for e in declared if set(e.joints) & set(effect.joints)]
    columns = np.concatenate([e.columns(motion) for e in near], axis=2)
    flat = columns.reshape(-1, columns.shape[2])
    solution = np.linalg.lstsq(flat, force.reshape(-1), rcond=None)[0]
    return (flat @ solution).reshape(force.shape)
