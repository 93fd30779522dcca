"""Flexible drives, joints and base: the hinges of figure 3.5 with their constitutive equations (3.58) and (3.60)."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from rx90b_flex.effects.at_rest import RestSites, RestSizes, ShownAtRest
from rx90b_flex.effects.calm import Calm
from rx90b_flex.effects.deflection import Spring, by_links, deflected, each_alone, softest
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.hints import LeftOver, ShapeSearch, Sites
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.law_effect import LawEffect
from rx90b_flex.effects.motion import Array, Coordinates, Motion
from rx90b_flex.effects.parameters import DAMPING, STIFFNESS, Parameter, derived, linear
from rx90b_flex.effects.stand_in import StandIn
from rx90b_flex.pieces import AT_ONCE

DAMPING_TIME = 1.0e-3  # s, damping over stiffness of a hinge that a search tries: table D.1's
LAGS = (1.0e-7, 1.0)  # s, damping over stiffness of a drive that torques over time may show,
NO_LAG = 1.0e-6  # and what shows in no log
# damping ratio of drives that a search over time begins with: what swings for long fits at one stiffness alone
LOSSY = 0.1
STARTS = 10  # stiffnesses that it begins with
# times a drive's torque at its largest twist: hardening that a search begins with
HARDER = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
ABOVE = 6.0  # times the cutoff: where links swing on the stiffest of them


@dataclass(frozen=True, kw_only=True)
class _Flexibility(ShownAtRest, part="flexibility"):
    """Hinges with a spring and a damper each: ``stiffness_i * eps_i + damping_i * d(eps_i)/dt`` on coordinate i.

    A subclass states the hinges in `virtual` and declares stiffnesses, then dampings, one of each a hinge.
    """

    @property
    @abstractmethod
    def _site(self) -> str:
        """What the hinges' coordinates are named after."""

    def _hinges(self, coordinates: Coordinates) -> Array:
        """One row a hinge that picks its angle out of the coordinates, shape (m, n)."""
        return np.stack([coordinates.port(self._site, kind) for kind in self.traits.virtual])

    def columns(self, motion: Motion) -> Array:
        hinges = self._hinges(motion.coordinates)
        stiffness = (motion.q @ hinges.T)[:, None, :] * hinges.T
        damping = (motion.v @ hinges.T)[:, None, :] * hinges.T
        return np.concatenate([stiffness, damping], axis=2)

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        hinges = self._hinges(motion.coordinates)
        stiffness, damping = np.split(self.known_coefficients(), 2)
        zero = np.zeros((len(motion), len(motion.coordinates), len(motion.coordinates)))
        return zero + (hinges.T * stiffness) @ hinges, zero + (hinges.T * damping) @ hinges, zero

    def potential(self, motion: Motion) -> Array:
        stiffness, _ = np.split(self.known_coefficients(), 2)
        deformation = motion.q @ self._hinges(motion.coordinates).T
        return 0.5 * deformation**2 @ stiffness

    def laws(self, motion: Motion) -> tuple[Law, ...]:
        both = np.split(self.known_coefficients(), 2)
        hinges = zip(self._hinges(motion.coordinates), *both, strict=True)
        return tuple(Law(port, stiffness=float(k), damping=float(d)) for port, k, d in hinges)

    def starts_at_rest(self, sizes: RestSizes) -> Array:
        """Stiffnesses that put what stands behind a hinge alone at frequencies of the band."""
        low, high = sizes.band_hz
        frequencies = 2 * np.pi * np.array([0.7 * low, np.sqrt(low * high), high, 3.0 * high])
        hinges = self._hinges(sizes.coordinates)
        return np.outer(frequencies**2, [sizes.inertia(hinges[group[0]]) for group in self.traits.scaled])


@dataclass(frozen=True, kw_only=True)
class _FlexibilityOfJoint(_Flexibility):
    """Hinges behind the drive of a joint."""

    joint: str

    @property
    def joints(self) -> tuple[str, ...]:
        return (self.joint,)

    @property
    def _site(self) -> str:
        return self.joint


@dataclass(frozen=True, kw_only=True)
class DriveFlexibility(
    _FlexibilityOfJoint, behind_gear=True, virtual=("torsion",), scaled=((0, 1),), rescaled="drive_stiffness"
):
    """Torsion of a drive, equation 3.58: ``stiffness * eps1 + damping * d(eps1)/dt`` on the coordinate ``torsion``.

    Signature
    ---------
    In a frequency response an antiresonance followed by a resonance in this drive's own entry; in a rigid model's
    residual a rise with frequency.

    Neighbours
    ----------
    `joint_flexibility` bends across the axis and is shared by several drives; the trace of poles less zeros of a
    drive holds its torsion alone (equation 5.53). Below a third of the first antiresonance a rigid model with more
    inertia does as well.

    Source
    ------
    Hardeman 2008, equations 3.58, 3.68 and 3.70.
    """

    stiffness: float | None = linear("N m/rad", lower=0.0, rank=STIFFNESS)
    damping: float | None = linear("N m s/rad", lower=0.0, rank=DAMPING)

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        # a drive that moves needs an inertia of its own to turn apart from its link
        heavy = [j for j in sites.joints if j not in sites.moving or ("drive_inertia", (j,)) in sites.declared]
        return [cls(joint=j, stiffness=1.0, damping=DAMPING_TIME) for j in heavy]

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [_DriveDeflection(joint=j) for j in sites.joints]

    def on_rigid_tree(self) -> Effect | None:
        """The deflection that the drive's own torque gives it; None, stiff, where it has no stiffness."""
        if self.stiffness is None:
            return None
        damping = DAMPING_TIME * self.stiffness if self.damping is None else self.damping
        return _StatedDeflection(joint=self.joint, stiffness=self.stiffness, damping=damping)


def stiff_for_want_of_values(effects: Iterable[Effect]) -> list[str]:
    """What is said of effects that bend, are declared without a value, and so stand for nothing where motors alone are measured, with
    those that need them.
    """
    every = list(effects)
    stiff = [e for e in every if e.traits.virtual and e.on_rigid_tree() is None]
    on_them = [e for e in every if any(s.place == e.place and s.type_name() in e.traits.needs for s in stiff)]
    labels = ", ".join(e.label for e in (*stiff, *on_them))
    said = (
        "declared without a stiffness and taken as stiff where nothing here tells one: torques of motors seldom do; frf tells it "
        "from responses, close-loop from link_position, static from deflections under loads."
    )
    return [f"{labels}: {said}"] if labels else []


@dataclass(frozen=True, kw_only=True)
class _OnRigidTree(
    StandIn, behind_gear=True, needs_load=True, needs_model=True, coefficients_follow=True, part="flexibility"
):
    """What motors feel of a drive on a rigid tree: one coefficient, which follows from the shape in a fit."""

    coefficient: ClassVar[Mapping[str, Parameter]]
    shapes: ClassVar[Mapping[str, Parameter]] = {}

    joint: str

    @property
    def joints(self) -> tuple[str, ...]:
        return (self.joint,)

    @property
    def coefficient_parameters(self) -> Mapping[str, Parameter]:
        return self.coefficient

    @property
    def shape_parameters(self) -> Mapping[str, Parameter]:
        return self.shapes


class _Stated(_OnRigidTree):
    """One whose value is stated: it is taken as it is."""

    shapes: ClassVar[Mapping[str, Parameter]] = {}

    @property
    def shape(self) -> Array:
        return np.zeros(0)

    def with_shape(self, values: Sequence[float] | Array) -> Self:
        return self


@dataclass(frozen=True, kw_only=True)
class _DriveDeflection(_OnRigidTree):
    """A flexible drive on a rigid tree: what motors feel of its torsion, which follows from the model's own torque.

    The coefficient is the compliance, ``1 / stiffness``; its column is the torque (see `deflection`) over it. A search leaves the
    compliance free of the stiffness that the column is worked out for, which comes to the same where the drive is stiff.
    """

    in_files: ClassVar[type[Effect]] = DriveFlexibility
    coefficient: ClassVar[Mapping[str, Parameter]] = {
        "compliance": Parameter("rad/(N m)", "linear", 0.0, rank=STIFFNESS)
    }
    shapes: ClassVar[Mapping[str, Parameter]] = {
        "stiffness": Parameter("N m/rad", "shape", 1e-6, 1e15),
        "lag": Parameter("s", "shape", *LAGS),
    }
    swings: ClassVar[float] = 1.0  # whose load says how far it is twisted as a log begins

    stiffness: float | None = derived("N m/rad", lower=0.0)
    damping: float | None = derived("N m s/rad", lower=0.0)

    @property
    def coefficients(self) -> Array:
        return np.array([np.nan if self.stiffness is None else 1.0 / self.stiffness])

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        (compliance,) = (float(x) for x in values)
        if np.isnan(compliance):
            return self
        stiffness = 1.0 / compliance if compliance != 0.0 else np.inf
        return dataclasses.replace(self, stiffness=stiffness, damping=self._lag * stiffness)

    @property
    def _lag(self) -> float:
        """Damping over stiffness, s."""
        if self.stiffness is None or self.damping is None or not np.isfinite(self.stiffness):
            return DAMPING_TIME
        return self.damping / self.stiffness

    @property
    def shape(self) -> Array:
        return np.array([np.nan, np.nan] if self.stiffness is None else [self.stiffness, self._lag])

    def with_shape(self, values: Sequence[float] | Array) -> Self:
        stiffness, lag = (float(x) for x in values)
        return dataclasses.replace(self, stiffness=stiffness, damping=max(lag, NO_LAG) * stiffness)

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        """From stiffnesses on which the link swings at frequencies of the band and above, from the softest that carries it."""
        place = motion.coordinates.index(self.joint)
        some = motion if len(motion) <= AT_ONCE else motion.part(slice(None, None, -(-len(motion) // AT_ONCE)))
        by_q, _, by_a = (by[:, place, place] for by in some.on_tree.derivatives())
        inertia = float(np.median(by_a))
        step = float(motion.time[1] - motion.time[0]) if len(motion) > 1 else 0.0
        starts = np.zeros((0, 2))
        if inertia > 0 and step > 0:
            slowest = max(softest(by_q, inertia), 10.0 / float(np.ptp(motion.time)))
            cutoff_hz = None if left is None else left.cutoff_hz
            fastest = max(2 * np.pi * ABOVE * (cutoff_hz or 0.1 / step), 2.0 * slowest)
            frequencies = np.geomspace(slowest, fastest, STARTS)
            starts = np.stack([inertia * frequencies**2, 2.0 * LOSSY / frequencies], axis=1)
        return ShapeSearch(starts, STARTS, part=np.array([0.4, 0.8]))

    def independent_shapes(self, motion: Motion) -> int:
        return STARTS

    def possible(self) -> bool:
        return self.stiffness is not None and self.stiffness > 0

    def columns(self, motion: Motion) -> Array:
        self.known_coefficients()
        present = [e for e in motion.effects if isinstance(e, _DriveDeflection)]
        others = [e for e in present if e.joint != self.joint]
        load = _through_drives(motion)
        known = _springs_of_model(motion)
        found = deflected(motion, [self.spring, *(e.spring for e in others)], known, load)
        # together the drives of a model give all of the torque: what the others' share is at present is theirs
        out = found.torque.sum(axis=0)
        if others:
            now = deflected(motion, [e.spring for e in present], known, load)
            out = out - sum(t for t, e in zip(now.torque, present, strict=True) if e.joint != self.joint)
        if present and present[0].joint == self.joint:
            out = out + found.beyond
        return np.asarray(out * self.stiffness)[:, :, None]

    def side_by_side(
        self, effects: Sequence[Effect], motion: Motion, leading: bool = False
    ) -> tuple[Array | None, Array]:
        if any(type(e) is not type(self) for e in effects) or any(
            isinstance(e, _DriveDeflection) for e in motion.effects
        ):
            return super().side_by_side(effects, motion, leading)
        springs = [e.spring for e in effects if isinstance(e, _DriveDeflection)]
        torque = each_alone(motion, springs, _through_drives(motion))
        stiffness = np.array([s.stiffness for s in springs])
        return None, np.ascontiguousarray((torque * stiffness[:, None, None]).transpose(1, 2, 0))

    def by_links(self, motion: Motion) -> Array | None:
        present = [e for e in motion.effects if isinstance(e, _DriveDeflection)]
        if not present or present[0].joint != self.joint:
            return None  # the first one answers for all
        return by_links(motion, _springs_of_model(motion), _through_drives(motion), _calm(motion))

    @property
    def spring(self) -> Spring:
        """As the solver of torsions knows it."""
        assert self.stiffness is not None
        return Spring(self.joint, self.stiffness, self._lag, swings=self.swings)

    def begun_otherwise(self) -> Sequence[Effect]:
        kinds: tuple[type[_DriveDeflection], ...] = (_BegunSooner, _BegunLater)
        return [begun(joint=self.joint, stiffness=self.stiffness, damping=self.damping) for begun in kinds]

    def in_tree(self, motion: Motion) -> Effect:
        return DriveFlexibility(joint=self.joint, stiffness=self.stiffness, damping=self.damping)


@dataclass(frozen=True, kw_only=True)
class _BegunSooner(_DriveDeflection):
    """One whose twist as a log begins is taken from the load of half a swing."""

    swings: ClassVar[float] = 0.5


@dataclass(frozen=True, kw_only=True)
class _BegunLater(_DriveDeflection):
    """One whose twist as a log begins is taken from the load of one swing and a half."""

    swings: ClassVar[float] = 1.5


@dataclass(frozen=True, kw_only=True)
class _StatedDeflection(_Stated, _DriveDeflection):
    """A flexible drive whose stiffness is stated."""


def _springs_of_model(motion: Motion) -> list[Spring]:
    """Of the drives that twist in the present model, as stiff as they are when they twist."""
    cubic = {e.joint: float(e.cubic or 0.0) for e in motion.effects if isinstance(e, _HardeningDeflection)}
    drives = [e.spring for e in motion.effects if isinstance(e, _DriveDeflection)]
    return [dataclasses.replace(s, cubic=cubic.get(s.joint, 0.0)) for s in drives]


def _through_drives(motion: Motion) -> Array:
    """Torque that links and what springs stand between them ask of the drives, as far as it stands out of noise; (N, n)."""

    def make() -> tuple[Array]:
        load, calm = _as_logged(motion), _calm(motion)
        return (load if calm is None else calm(load),)

    (load,) = motion.once(("load of drives",), make)
    return load


def _as_logged(motion: Motion) -> Array:
    ours = [e for e in motion.effects if isinstance(e, Effect) and e.traits.part in ("links", "spring")]
    return np.asarray(sum((e.force(motion) for e in ours), np.array(motion.on_tree.load())))


def _calm(motion: Motion) -> Calm | None:
    """The filter that takes the noise of angles out of the drives' load."""

    def make() -> tuple[Array, ...]:
        found = Calm.of(motion, _as_logged(motion))
        return () if found is None else (found.gain, found.kept)

    known = motion.once(("filter of load",), make)
    return Calm(*known) if known else None


@dataclass(frozen=True, kw_only=True)
class JointFlexibility(
    _FlexibilityOfJoint,
    behind_gear=True,
    virtual=("bend_1", "bend_2"),
    scaled=((0, 1, 2, 3),),
    rescaled="joint_stiffness",
):
    """Bending of a joint about the two axes across its own, equation 3.60, on ``bend_1`` and ``bend_2``.

    Signature
    ---------
    Resonances that several drives share and that move with the pose; nothing in a motor's signals at rest.

    Neighbours
    ----------
    `drive_flexibility` turns about the joint's own axis. Bendings of two joints about parallel axes cannot be told
    apart in one pose; a second pose, or bearings that are known to be round, tells.

    Source
    ------
    Hardeman 2008, equations 3.60, 3.68 and 3.70.
    """

    stiffness: tuple[float, float] | None = linear("N m/rad", lower=0.0, size=2, rank=STIFFNESS)
    damping: tuple[float, float] | None = linear("N m s/rad", lower=0.0, size=2, rank=DAMPING)

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        return [cls(joint=j, stiffness=(1.0, 1.0), damping=(DAMPING_TIME,) * 2) for j in sites.joints]

    def on_rigid_tree(self) -> Effect | None:
        """What motors feel of its bending, where it has a stiffness; torques over time do not tell one."""
        return None if self.stiffness is None else _StatedBending(joint=self.joint, hinges=self)


@dataclass(frozen=True, kw_only=True)
class BaseFlexibility(
    _Flexibility,
    behind_gear=True,
    on="robot",
    virtual=("bend_1", "bend_2"),
    scaled=((0, 2), (1, 3)),
    rescaled="base_stiffness",
):
    """Floor and mounting (section 7.2): the base tilts about its x and its y, ``base:bend_1`` and ``base:bend_2``.

    Signature
    ---------
    A low resonance in the drives that shake the whole arm, there in every pose.

    Neighbours
    ----------
    `joint_flexibility` of the first joint bends about axes that turn with it, the base about fixed ones: compare
    frequency responses with the arm turned.

    Source
    ------
    Hardeman 2008, section 7.2, left open there.
    """

    stiffness: tuple[float, float] | None = linear("N m/rad", lower=0.0, size=2, rank=STIFFNESS)
    damping: tuple[float, float] | None = linear("N m s/rad", lower=0.0, size=2, rank=DAMPING)

    @property
    def _site(self) -> str:
        return "base"

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        return [cls(stiffness=(1.0, 1.0), damping=(DAMPING_TIME,) * 2)]

    def on_rigid_tree(self) -> Effect | None:
        """What motors feel of its tilting, where it has a stiffness; torques over time do not tell one."""
        return None if self.stiffness is None else _StatedTilt(joint=self._site, hinges=self)


@dataclass(frozen=True, kw_only=True)
class _StatedBending(_Stated):
    """What motors feel on a rigid tree of hinges across the axes, beyond what its twisting drives do.

    The motors' motion is put on the tree with all hinges of the model, which give way to it (see `deflection`). The first of
    them answers for all.
    """

    in_files: ClassVar[type[Effect]] = JointFlexibility
    coefficient: ClassVar[Mapping[str, Parameter]] = {"bending": Parameter("1", "linear", 0.0, rank=STIFFNESS)}

    hinges: Any  # the effect that it stands for

    @property
    def coefficients(self) -> Array:
        return np.ones(1)

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        return self

    @property
    def springs(self) -> list[Spring]:
        """As the solver knows them, on the tree with hinges."""
        stiffness = np.array(self.hinges.stiffness)
        damping = DAMPING_TIME * stiffness if self.hinges.damping is None else np.array(self.hinges.damping)
        kinds = zip(stiffness, damping, type(self.hinges).traits.virtual, strict=True)
        return [Spring(self.joint, float(k), float(d / k), kind=kind) for k, d, kind in kinds]

    def columns(self, motion: Motion) -> Array:
        found = self._found(motion)
        if found is None:
            return np.zeros((*motion.q.shape, 1))
        bent, springs = found
        load, drives = _through_drives(bent), [bent.coordinates.index(j) for j in motion.coordinates.joints]
        all_of_them = deflected(bent, springs, springs, load)
        there = all_of_them.on(bent, springs)
        held_by = (e for e in motion.effects if isinstance(e, Effect) and e.traits.part == "spring")
        more = sum((e.force(there) - e.force(bent) for e in held_by), all_of_them.beyond)
        out = (all_of_them.torque.sum(axis=0) + more)[:, drives]
        twisting = _springs_of_model(motion)
        if twisting:
            alone = deflected(motion, twisting, twisting, _through_drives(motion))
            out = out - alone.torque.sum(axis=0) - alone.beyond
        return np.asarray(out)[:, :, None]

    def _found(self, motion: Motion) -> tuple[Motion, list[Spring]] | None:
        """The motion on the tree with the model's hinges, and those; None where another one answers."""
        present = [e for e in motion.effects if isinstance(e, _StatedBending)] or [self]
        if present[0].label != self.label:
            return None
        twisting = _springs_of_model(motion)
        drives = tuple(DriveFlexibility(joint=s.joint) for s in twisting)
        bent = motion.on_tree.with_hinges((*drives, *(e.hinges for e in present)))
        turned = [dataclasses.replace(s, kind="torsion") for s in twisting]
        return bent, [*turned, *(s for e in present for s in e.springs)]

    def in_tree(self, motion: Motion) -> Effect:
        return self.hinges


@dataclass(frozen=True, kw_only=True)
class _StatedTilt(_StatedBending):
    """The base's."""

    in_files: ClassVar[type[Effect]] = BaseFlexibility

    @property
    def joints(self) -> tuple[str, ...]:
        return ()


@dataclass(frozen=True, kw_only=True)
class StiffnessHardening(LawEffect, behind_gear=True, needs=("drive_flexibility",), part="flexibility"):
    """A drive that gets stiffer as it twists, ``cubic * eps1^3``; beside the `drive_flexibility` of the same joint.

    Signature
    ---------
    Resonances that rise with the load or with the excitation; a static line that bends upwards, moment against
    angle.

    Neighbours
    ----------
    `drive_flexibility` alone gives the same resonance at any amplitude. `backlash` softens at small loads, at zero
    load altogether.

    Source
    ------
    Not in Hardeman 2008; the cubic term of a hardening gear, as strain-wave gears have it.
    """

    acts_at: ClassVar[str] = "torsion"
    law_stores: ClassVar[bool] = True

    cubic: float | None = linear("N m/rad^3", lower=0.0, rank=STIFFNESS)

    @classmethod
    def everywhere(cls, sites: Sites) -> Sequence[Effect]:
        return [_HardeningDeflection(joint=j) for j in sites.joints]

    def on_rigid_tree(self) -> Effect:
        """What it changes of the deflection; as stated where it has a value, else to be identified."""
        kind = _HardeningDeflection if self.cubic is None else _StatedHardening
        return kind(joint=self.joint, cubic=self.cubic)

    @staticmethod
    def law(x: Any, rate: Any, parameters: Any, out: Any) -> None:
        out[0] = parameters[0] * x * x * x
        out[1] = 3.0 * parameters[0] * x * x
        out[2] = 0.0

    def potential(self, motion: Motion) -> Array:
        return 0.25 * self.known_coefficients()[0] * motion.joint(self.joint, self.port_kind).q ** 4


@dataclass(frozen=True, kw_only=True)
class _HardeningDeflection(_OnRigidTree, needs=StiffnessHardening.traits.needs):
    """What motors feel of a drive that gets stiffer as it twists, beyond the same drive without; on a rigid tree.

    The coefficient is the cubic stiffness; its column is that difference over it.
    """

    in_files: ClassVar[type[Effect]] = StiffnessHardening
    coefficient: ClassVar[Mapping[str, Parameter]] = {"cubic": Parameter("N m/rad^3", "linear", 0.0, rank=STIFFNESS)}
    shapes: ClassVar[Mapping[str, Parameter]] = {"cubic": Parameter("N m/rad^3", "shape", 1e-6, 1e24)}

    cubic: float | None = derived("N m/rad^3", lower=0.0)

    @property
    def coefficients(self) -> Array:
        return np.array([np.nan if self.cubic is None else self.cubic])

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        return self if np.isnan(values[0]) else dataclasses.replace(self, cubic=float(values[0]))

    @property
    def shape(self) -> Array:
        return self.coefficients

    def with_shape(self, values: Sequence[float] | Array) -> Self:
        return dataclasses.replace(self, cubic=float(values[0]))

    def _drives(self, motion: Motion) -> tuple[list[Spring], int]:
        """The present model's, and which of them is the joint's own; -1: none."""
        springs = [e.spring for e in motion.effects if isinstance(e, _DriveDeflection)]
        return springs, next((i for i, s in enumerate(springs) if s.joint == self.joint), -1)

    def shape_search(self, motion: Motion, left: LeftOver | None = None) -> ShapeSearch:
        """From cubic stiffnesses that take a part of the torque which the drive has at its largest twist."""
        springs, own = self._drives(motion)
        starts = np.zeros((0, 1))
        if own >= 0:
            largest = np.abs(deflected(motion, springs, springs, _through_drives(motion)).torsion[:, own]).max()
            starts = springs[own].stiffness / max(float(largest), 1e-9) ** 2 * np.array(HARDER)[:, None]
        return ShapeSearch(starts, len(HARDER), part=1.0)

    def possible(self) -> bool:
        return self.cubic is not None and self.cubic > 0

    def columns(self, motion: Motion) -> Array:
        springs, own = self._drives(motion)
        if own < 0:
            return np.zeros((*motion.q.shape, 1))
        (cubic,) = self.known_coefficients()
        harder = [dataclasses.replace(s, cubic=float(cubic)) if i == own else s for i, s in enumerate(springs)]
        load = _through_drives(motion)
        known = _springs_of_model(motion)
        soft, hard = (deflected(motion, x, known, load).torque.sum(axis=0) for x in (springs, harder))
        return np.asarray((hard - soft) / cubic)[:, :, None]

    def in_tree(self, motion: Motion) -> Effect:
        return StiffnessHardening(joint=self.joint, cubic=self.cubic)


@dataclass(frozen=True, kw_only=True)
class _StatedHardening(_Stated, _HardeningDeflection):
    """A hardening whose cubic stiffness is stated."""
