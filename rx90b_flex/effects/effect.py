"""The base class of effects, their parameters, and the catalogue of all effect types."""

from __future__ import annotations

import dataclasses
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np

from rx90b_flex.effects.law import Law
from rx90b_flex.effects.motion import Array, Coordinates, JointMotion, Motion
from rx90b_flex.files.extensions import EFFECTS, brought, concrete, import_all, own, subclasses, wrong_class
from rx90b_flex.files.keys import check_keys, close_match

INERTIA, SPRING, FRICTION, STIFFNESS, DAMPING, OTHER = range(1, 7)  # ranks of parameters: the order of table D.1

_in_snake_case = cache(lambda name: re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower())
SMALLEST_PART = 0.02  # of a joint's root mean square error: what takes less off it is not worth a name


@dataclass(frozen=True)
class Sites:
    """Places of a robot where a search may try an effect: its joints in tree order and its tip frame."""

    joints: tuple[str, ...]
    tip_frame: str


@dataclass(frozen=True)
class RestSites(Sites):
    """Places of a robot at rest in a pose, where data over frequency may show an effect.

    Attributes
    ----------
    moving : tuple of str
        Joints whose drives move; the others are held.
    angles : mapping of joint to angle, rad
        The pose.
    declared : frozenset of (type name, place)
        Effects that the robot has.
    """

    moving: tuple[str, ...]
    angles: Mapping[str, float]
    declared: frozenset[tuple[str, tuple[str, ...]]]


@dataclass(frozen=True, eq=False)
class RestSizes:
    """How heavy a robot is at rest, and where data over frequency look: what a new value can be sized by.

    Attributes
    ----------
    coordinates : Coordinates
    mass_matrix : array, shape (n, n)
    total_mass : float, of the links, kg
    band_hz : (low, high)
    """

    coordinates: Coordinates
    mass_matrix: Array
    total_mass: float
    band_hz: tuple[float, float]

    def inertia(self, port: Array) -> float:
        """Along a port (n,), kg m^2."""
        return float(port @ self.mass_matrix @ port)


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect type.

    Attributes
    ----------
    unit : str
    kind : str
        ``linear``: the force is proportional to it. ``shape``: the force depends on it in another way.
        ``derived``: made from the coefficients by the effect's own class (amplitude, phase, rest angle).
        ``given``: geometry that is stated and never estimated.
    lower, upper : float
        Physical bounds. A linear parameter estimated beyond them says that another effect is at work.
    start : float
        Where a search for a shape parameter begins.
    size : int
        Number of values; zero: as many as are given.
    rank : int
        Place in the parameter vector.
    attribute : str
        Where its value stands in the effect.
    usual : bool
        Whether `start` is what a shape parameter mostly is: where the data lead it astray a search holds it there.
    """

    unit: str
    kind: str
    lower: float = -np.inf
    upper: float = np.inf
    start: float = np.nan
    size: int = 1
    rank: int = OTHER
    attribute: str = ""
    usual: bool = False


def linear(unit: str, *, lower: float = -np.inf, size: int = 1, rank: int = OTHER, public: str = "") -> Any:
    """Field of an effect: a parameter that the force is proportional to; `public`: its name in files, if not the attribute's."""
    parameter = Parameter(unit, "linear", lower, size=size, rank=rank)
    return dataclasses.field(default=None, metadata={"parameter": parameter, "public": public})


def shape(unit: str, *, start: float, lower: float, upper: float, size: int = 1, usual: bool = False) -> Any:
    """Field of an effect: a parameter that gives the force its shape."""
    parameter = Parameter(unit, "shape", lower, upper, start, size, usual=usual)
    return dataclasses.field(default=None, metadata={"parameter": parameter})


def derived(unit: str, *, lower: float = -np.inf, size: int = 1) -> Any:
    """Field of an effect: a parameter that its class makes from the coefficients, such as an amplitude."""
    return dataclasses.field(default=None, metadata={"parameter": Parameter(unit, "derived", lower, size=size)})


def choice(*values: str) -> Any:
    """Field of an effect: one of a few words, the first where a robot file says nothing."""
    return dataclasses.field(default=values[0], metadata={"choice": values})


def given(unit: str, *, size: int = 1) -> Any:
    """Field of an effect: stated geometry."""
    return dataclasses.field(default=None, metadata={"parameter": Parameter(unit, "given", size=size)})


@dataclass(frozen=True, kw_only=True)
class Effect(ABC):
    """Something a robot has beyond its rigid tree.

    A subclass is one effect type: its name in files is the class name in snake case, its fields are its
    parameters. None as a value means: not known, to be identified.

    The force is linear in the *coefficients*: ``force = columns @ coefficients``. They are the linear
    parameters unless a subclass says otherwise (an amplitude and a phase are a sine and a cosine).
    """

    on: ClassVar[str] = "joint"  # "joint", "joints", "robot", "frame", "robot or joint"
    repeats: ClassVar[bool] = False  # may stand twice in the same place
    replaces: ClassVar[tuple[str, ...]] = ()  # effect types that it stands in for at the same place
    refines: ClassVar[tuple[str, ...]] = ()  # those that it is tried in place of; declared, both may stand side by side
    needs_load: ClassVar[bool] = False  # its columns depend on the torque through the transmission
    needs_model: ClassVar[bool] = False  # its columns depend on the torque of the model as a whole
    in_dynamics: ClassVar[bool] = True  # a force of the robot; otherwise it stands between robot and log
    remembers: ClassVar[bool] = False  # its force depends on the motion before, which a simulation step does not know
    # a torque sensor behind the gear feels it; what may be on either side is the motor's
    behind_gear: ClassVar[bool] = False
    multiplies: ClassVar[bool] = False  # its one coefficient scales all that its joint's log shows of the model
    last_resort: ClassVar[bool] = False  # a curve of no known law, tried where nothing with a name explains more
    repeats_with_motion: ClassVar[bool] = True  # False: where the motion repeats, its torque does not
    by_clock: ClassVar[bool] = False  # its torque is a line at a frequency of its own, whatever the robot does
    adds_inertia: ClassVar[bool] = False  # its force holds accelerations, so it is part of the mass matrix
    virtual: ClassVar[tuple[str, ...]] = ()  # coordinates it adds to its place: "torsion", "bend_1", "bend_2"
    needs: ClassVar[tuple[str, ...]] = ()  # effect types that must stand at the same place
    part: ClassVar[str] = "friction"  # of a linearisation: "links", "drives", "flexibility", "spring" or "friction"
    scaled: ClassVar[tuple[tuple[int, ...], ...]] = ()  # coefficients that a search over frequency multiplies together
    coefficients_follow: ClassVar[bool] = False  # from its shape, in a fit; a search may leave them free
    rescaled: ClassVar[str] = ""  # what such a search may find another value of where it is declared; empty: nothing

    # ---- description ------------------------------------------------------------------------------------

    @classmethod
    def type_name(cls) -> str:
        """Name in robot files and reports: the class name in snake case."""
        return _in_snake_case(cls.__name__)

    @classmethod
    @cache
    def parameters(cls) -> Mapping[str, Parameter]:
        """Parameters by name, in the order in which they are declared."""
        fields = [f for f in dataclasses.fields(cls) if "parameter" in f.metadata]
        named = ((f.metadata.get("public") or f.name, f) for f in fields)
        return MappingProxyType({n: dataclasses.replace(f.metadata["parameter"], attribute=f.name) for n, f in named})

    @classmethod
    @cache
    def choices(cls) -> Mapping[str, tuple[str, ...]]:
        """Words that it may be given, by name, the usual one first."""
        return MappingProxyType(
            {f.name: f.metadata["choice"] for f in dataclasses.fields(cls) if "choice" in f.metadata}
        )

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints it sits on; empty for an effect on the robot or a frame."""
        return ()

    @property
    def label(self) -> str:
        """Place and type, as in ``joint_2.viscous_friction``."""
        return ".".join(("_".join(self.joints) or "robot", self.type_name()))

    @property
    def place(self) -> tuple[str, ...]:
        """What tells two effects of one type apart."""
        return self.joints

    # ---- values -----------------------------------------------------------------------------------------

    @classmethod
    @cache
    def _named(cls, kind: str) -> tuple[tuple[str, Parameter], ...]:
        return tuple((n, p) for n, p in cls.parameters().items() if p.kind == kind)

    @classmethod
    @cache
    def _flat(cls, kind: str) -> tuple[tuple[str, Parameter], ...]:
        flat: list[tuple[str, Parameter]] = []
        for name, p in cls._named(kind):
            flat += [(name, p)] if p.size == 1 else [(f"{name}_{i + 1}", p) for i in range(p.size)]
        return tuple(flat)

    @classmethod
    @cache
    def _flat_names(cls, kind: str) -> tuple[str, ...]:
        return tuple(name for name, _ in cls._flat(kind))

    def _values(self, kind: str) -> Array:
        out: list[float] = []
        for _, p in self._named(kind):
            value = getattr(self, p.attribute)
            if isinstance(value, float):
                out.append(value)
            else:
                out += [np.nan] * p.size if value is None else list(np.atleast_1d(np.asarray(value, dtype=float)))
        return np.array(out, dtype=float)

    def _with_values(self, kind: str, values: Sequence[float] | Array) -> Self:
        change: dict[str, Any] = {}
        at = 0
        for _, p in self._named(kind):
            part = [None if np.isnan(x) else float(x) for x in values[at : at + p.size]]
            change[p.attribute] = part[0] if p.size == 1 else (None if None in part else tuple(part))
            at += p.size
        return dataclasses.replace(self, **change)

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names of the coefficients that the force is linear in."""
        return self._flat_names("linear")

    @property
    def coefficient_units(self) -> tuple[str, ...]:
        """Unit of each coefficient."""
        return tuple(p.unit for _, p in self._flat("linear"))

    @property
    def coefficient_ranks(self) -> tuple[int, ...]:
        """Rank of each coefficient in a robot's parameter vector."""
        return tuple(p.rank for _, p in self._flat("linear"))

    @property
    def coefficient_bounds(self) -> Array:
        """Smallest physical value of each coefficient, shape (k,)."""
        return np.array([p.lower for _, p in self._flat("linear")])

    @property
    def coefficients(self) -> Array:
        """Values of the coefficients, NaN where not known; shape (k,)."""
        return self._values("linear")

    def with_coefficients(self, values: Sequence[float] | Array) -> Self:
        """The same effect with other coefficients; NaN becomes unknown."""
        return self._with_values("linear", values)

    @classmethod
    def shape_names(cls) -> tuple[str, ...]:
        """Names of the shape parameters."""
        return cls._flat_names("shape")

    @classmethod
    def shape_bounds(cls) -> Array:
        """Lower and upper bounds of the shape parameters; (2, s)."""
        return np.array([[p.lower, p.upper] for _, p in cls._flat("shape")]).reshape(-1, 2).T

    def shape_range(self, motion: Motion) -> Array:
        """Lower and upper ends, (2, s), between which this motion can tell the shape parameters, within their bounds."""
        return self.shape_bounds()

    @property
    def shape_keys(self) -> tuple[tuple[str, ...] | None, ...]:
        """What names the one value that several effects share, for each shape parameter; None: it is this effect's own."""
        return (None,) * len(self.shape_names())

    @property
    def shape(self) -> Array:
        """Values of the shape parameters, NaN where not known; shape (s,)."""
        return self._values("shape")

    def with_shape(self, values: Sequence[float] | Array) -> Self:
        """The same effect with other shape parameters."""
        return self._with_values("shape", values)

    def shape_starts(self, motion: Motion) -> Array:
        """Shapes from which a search begins, shape (M, s). Dense enough for one to lie in the best valley."""
        return np.array([[p.start for _, p in self._flat("shape")]])

    @classmethod
    def stands_for(cls) -> tuple[str, ...]:
        """Effect types whose place it takes where it is added."""
        return (*cls.replaces, *cls.refines)

    @classmethod
    def usual_shapes(cls) -> dict[str, float]:
        """Shape parameters that mostly have one value, and that value."""
        return {name: p.start for name, p in cls._flat("shape") if p.usual}

    def starts_beside(self, motion: Motion, residual: Sequence[tuple[Motion, Array]], cutoff_hz: float | None) -> Array:
        """Shapes to begin from where the residual helps to find them, shape (M, s).

        Parameters
        ----------
        motion : Motion
            Of the longest recording.
        residual : one (motion, torque left over) a recording, N samples each
            Of the first joint that it sits on; uniform in time.
        cutoff_hz : float or None
            Of the low-pass that the residual went through.
        """
        return self.shape_starts(motion)

    def starts_in_place_of(self, other: Effect) -> Array:
        """Shapes to begin from where it is tried in the place of another effect that is known, shape (M, s)."""
        return np.zeros((0, len(self.shape)))

    def shape_spread(self, motion: Motion) -> Array:
        """How far the best shape may lie from the best start, shape (s,)."""
        return 0.3 * self.shape

    def independent_shapes(self, motion: Motion) -> int:
        """How many independent shapes a search tries, for the correction of its significance."""
        return 1

    def possible(self) -> bool:
        """Whether its values go together, and with what its force assumes; bounds of single values are no part of it."""
        return True

    def too_small(self, part: float, sample_s: float, motion: Motion) -> str:
        """Why it is not worth a name, however certain it is, in words; empty where it is.

        Parameters
        ----------
        part : float
            Of the root mean square error of the joint for which it does most, that it takes off on held-out data.
        sample_s : float
            Time between two samples of the log, s.
        motion : Motion
            The longest of the fitted recordings.
        """
        return (
            "" if part >= SMALLEST_PART else f"it takes {max(part, 0.0):.1%} off a joint's error, too little for a name"
        )

    def public_values(self) -> list[tuple[str, str, float]]:
        """Name, unit and value (NaN where not known) of each parameter that can be estimated."""
        out: list[tuple[str, str, float]] = []
        for name, p in self.parameters().items():
            if p.kind == "given":
                continue
            value = getattr(self, p.attribute)
            size = p.size or (len(self.coefficients) if value is None else len(value))
            values = np.full(size, np.nan) if value is None else np.atleast_1d(np.asarray(value, dtype=float))
            names = [name] if p.size == 1 else [f"{name}_{i + 1}" for i in range(size)]
            out += [(n, p.unit, float(x)) for n, x in zip(names, values, strict=True)]
        return out

    # ---- physics ----------------------------------------------------------------------------------------

    @abstractmethod
    def columns(self, motion: Motion) -> Array:
        """Generalised force per unit of each coefficient; shape (N, n, k)."""

    def factors(self, motion: Motion) -> tuple[Array, Array] | None:
        """Columns as the outer product of a constant port (n,) and a basis (N, k), where they are one."""
        return None

    def force(self, motion: Motion) -> Array:
        """Generalised force on the inverse-dynamics side, shape (N, n), N m."""
        factors, coefficients = self.factors(motion), self.known_coefficients()
        if factors is None:
            return self.columns(motion) @ coefficients
        port, basis = factors
        return np.outer(basis @ coefficients, port)

    def leading(self, motion: Motion) -> tuple[Array, Array] | None:
        """The larger part of the columns as `factors` has it, enough for a first look; the same where they are factors."""
        return self.factors(motion)

    def by_links(self, motion: Motion) -> Array | None:
        """Change of its force per change of the links' parameters, (N, n, 10 * bodies), where it is large; None: not worth it."""
        return None

    def logged(self, motion: Motion, torque: Array) -> Array:
        """Torque in the log (N, n) where the model's torque is `torque` (N, n); for effects that are not in the dynamics."""
        return torque + self.force(motion)

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        """Derivatives of the force by q, v and a; each (N, n, n)."""
        raise TypeError(f"{self.type_name()} has no derivatives")

    # ---- simulation --------------------------------------------------------------------------------------

    def simulated(self, beside: Sequence[Effect]) -> Effect | None:
        """The force that it is in a simulation, beside the robot's other effects; None where it is none."""
        return self if self.in_dynamics else None

    def links_at(self, motion: Motion) -> Array:
        """Coordinates (N, n) that put the links where they are, where the robot's own do not."""
        return motion.q

    def potential(self, motion: Motion) -> Array:
        """Potential energy whose gradient is the force at rest, shape (N,), J; zero for what only dissipates."""
        return np.zeros(len(motion))

    def breakaway_torque(self) -> float:
        """Dry friction of its joint just before it slides, N m."""
        return 0.0

    def laws(self, motion: Motion) -> tuple[Law, ...] | None:
        """The force as scalar laws, for a compiled simulation; None: that asks for `force` and `derivatives` at each step.

        Optional, and only for speed. ``motion`` is any sample: the laws need its coordinates and its tree.
        """
        return None

    def point_mass(self) -> tuple[str, float, Array] | None:
        """Frame, mass (kg) and centre (3,) (m) of a point mass that is the whole effect, for a compiled simulation.

        Optional, like `laws`.
        """
        return None

    def gravity_change(self) -> Array | None:
        """What the effect adds to the direction of gravity on the links, (3,), where that is all it does.

        For a compiled simulation; optional, like `laws`.
        """
        return None

    def line_spring(self) -> tuple[Array, Array, float, float] | None:
        """Anchors (3,) on the link before the joint and on the one behind it, stiffness (N/m) and prestress (N).

        Of a spring between two points that is the whole effect, both in the joint's own frame at zero angle, m, its prestress the
        pull at zero angle. For simulators; optional, like `laws`.
        """
        return None

    def known_coefficients(self) -> Array:
        """Coefficients, with an error that names the first one without a value."""
        values = self.coefficients
        if np.isnan(values).any():
            name = self.coefficient_names[int(np.isnan(values).argmax())]
            raise ValueError(f"{self.label}: {name} has no value; give it in the robot file or identify it")
        return values

    def known_shape(self) -> Array:
        """Shape parameters, with an error that names the first one without a value."""
        return self.checked_shape(self.shape)

    def checked_shape(self, values: Array) -> Array:
        """Values of the shape parameters (s,), with an error that names the first one that is not known."""
        if np.isnan(values).any():
            name = self.shape_names()[int(np.isnan(values).argmax())]
            raise ValueError(f"{self.label}: {name} has no value; give it in the robot file or identify it")
        return values

    def placed(self, motion: Motion) -> Self:
        """Prepared for a search on a motion: with what of its geometry this motion suggests."""
        return self

    @property
    def known(self) -> bool:
        """Whether all that its force needs has a value."""
        try:
            self.known_coefficients(), self.known_shape()
        except ValueError:
            return False
        return True

    # ---- search -----------------------------------------------------------------------------------------

    @classmethod
    @abstractmethod
    def everywhere(cls, sites: Sites) -> list[Self]:
        """This effect, without values, in every place where a search may try it."""

    @classmethod
    def over_time(cls, sites: Sites) -> list[Effect]:
        """What a search over time tries, without values: of an effect that adds coordinates, what acts on the rigid tree."""
        return [] if cls.virtual else [*cls.everywhere(sites)]

    def on_rigid_tree(self) -> Effect | None:
        """What stands for it where the tree is rigid and motors alone are measured; None: nothing, it is left out."""
        return None if self.virtual else self

    def in_tree(self, motion: Motion) -> Effect:
        """The inverse of `on_rigid_tree`: the effect as a robot file has it, on the tree of any sample of motion."""
        return self

    @classmethod
    def at_rest(cls, sites: RestSites) -> list[Self]:
        """This effect, with values to be multiplied, wherever frequency responses and modes may show it; empty: nowhere."""
        return []

    def starts_at_rest(self, sizes: RestSizes) -> Array:
        """Values of the first coefficient of each group of `scaled` from which a search over frequency begins, (S, groups)."""
        raise TypeError(f"{self.type_name()} is not tried against data over frequency")

    def rescaled_to(self, values: Mapping[int, float]) -> Self:
        """With other values of some coefficients, by their numbers."""
        own = self.coefficients
        for number, value in values.items():
            own[number] = value
        return self.with_coefficients(own)


@dataclass(frozen=True, kw_only=True)
class JointEffect(Effect):
    """An effect on one joint: a torque that depends on that joint's own motion."""

    joint: str
    acts_at: ClassVar[str] = "joint"  # the joint angle theta, or the "drive" angle alone

    @property
    def joints(self) -> tuple[str, ...]:
        return (self.joint,)

    @property
    def port_kind(self) -> str:
        """Which of the joint's angles it acts on, as `Coordinates.port` has it."""
        return self.acts_at

    @abstractmethod
    def basis(self, at: JointMotion) -> Array:
        """Torque per unit of each coefficient, shape (N, k)."""

    def at(self, motion: Motion) -> JointMotion:
        """The motion that it depends on."""
        return motion.joint(self.joint, self.port_kind)

    def factors(self, motion: Motion) -> tuple[Array, Array] | None:
        at = self.at(motion)
        return at.port, self.basis(at)

    def columns(self, motion: Motion) -> Array:
        at = self.at(motion)
        return at.port[None, :, None] * self.basis(at)[:, None, :]

    @classmethod
    def everywhere(cls, sites: Sites) -> list[Self]:
        return [cls(joint=j) for j in sites.joints]


class JointForce(JointEffect):
    """An effect on one joint that is a force of the robot."""

    @abstractmethod
    def slopes(self, at: JointMotion) -> tuple[Array, Array, Array]:
        """Derivatives of the basis by position, velocity and acceleration; each (N, k)."""

    def derivatives(self, motion: Motion) -> tuple[Array, Array, Array]:
        at = motion.joint(self.joint, self.port_kind)
        outer = np.outer(at.port, at.port)[None]
        by_q, by_v, by_a = (outer * (slope @ self.known_coefficients())[:, None, None] for slope in self.slopes(at))
        return by_q, by_v, by_a


@dataclass(frozen=True, kw_only=True)
class PairEffect(Effect):
    """An effect on two joints [a, b]."""

    on: ClassVar[str] = "joints"
    joint_pair: tuple[str, str]

    @property
    def joints(self) -> tuple[str, ...]:
        return self.joint_pair

    @classmethod
    def everywhere(cls, sites: Sites) -> list[Self]:
        return [cls(joint_pair=(a, b)) for i, a in enumerate(sites.joints) for b in sites.joints[i + 1 :]]


@dataclass(frozen=True, kw_only=True)
class FrameEffect(Effect):
    """An effect on a frame of the robot."""

    on: ClassVar[str] = "frame"
    frame: str

    @property
    def place(self) -> tuple[str, ...]:
        return (self.frame,)

    @property
    def label(self) -> str:
        return f"{self.frame}.{self.type_name()}"

    @classmethod
    def everywhere(cls, sites: Sites) -> list[Self]:
        return [cls(frame=sites.tip_frame)]


def catalogue() -> dict[str, type[Effect]]:
    """All effect types by name: every concrete subclass of `Effect` in the modules of this folder, and what other packages bring.

    Those name a class in the entry point group ``rx90b_flex.effects``.
    """
    import_all("rx90b_flex.effects")
    brought(EFFECTS, _why_no_type)
    found: dict[str, type[Effect]] = {}
    for sub in filter(concrete, subclasses(Effect)):
        name = sub.type_name()
        if own(sub) or name not in found or not own(found[name]):
            found[name] = sub
    return dict(sorted(found.items()))


def _why_no_type(found: Any) -> str:
    """What is wrong with an effect type that another package brings; empty: nothing."""
    wrong = wrong_class(found, Effect)
    if not wrong and any(own(sub) and sub.__name__ == found.__name__ for sub in subclasses(Effect)):
        return f"there is an effect type {found.type_name()!r} already"
    return wrong


def effect_from_table(
    table: Mapping[str, Any], where: str, joints: Sequence[str], frames: Sequence[str] = ()
) -> Effect:
    """Make an effect from a table of a robot file.

    Parameters
    ----------
    table : mapping
        ``type``, the place, and parameter values.
    where : str
        Named in errors: the file and the entry.
    joints, frames : sequence of str
        Names that exist.

    Raises
    ------
    ValueError
        Unknown type, key, joint or frame; a value of the wrong kind or number.
    """
    types = catalogue()
    if "type" not in table:
        raise ValueError(f"{where}: key 'type' is missing")
    if not isinstance(table["type"], str) or table["type"] not in types:
        kind = str(table["type"])
        why = brought(EFFECTS, _why_no_type).why_missing(kind) or f"; {close_match(kind, list(types))}"
        raise ValueError(f"{where}: unknown effect type {table['type']!r}{why}")
    cls = types[table["type"]]
    where = f"{where} ({cls.type_name()})"
    key = {"robot or joint": "joint"}.get(cls.on, cls.on if cls.on != "robot" else None)
    allowed = ["type", *([key] if key else []), *cls.parameters(), *cls.choices()]
    check_keys(table, allowed, where)
    values: dict[str, Any] = {}
    if key:
        if key in table:
            values |= _read_place(cls, key, table[key], where, joints, frames)
        elif cls.on != "robot or joint":
            raise ValueError(f"{where}: key {key!r} is missing")
    for name, parameter in cls.parameters().items():
        if name in table:
            values[parameter.attribute] = _read_value(table[name], parameter, f"{where}: {name}")
        elif parameter.kind == "given":
            raise ValueError(f"{where}: key {name!r} is missing; it cannot be identified")
    for name, words in cls.choices().items():
        if name in table:
            if table[name] not in words:
                raise ValueError(f"{where}: {name} is {table[name]!r}; {close_match(str(table[name]), words)}")
            values[name] = table[name]
    return cls(**values)


def _read_place(
    cls: type[Effect], key: str, found: Any, where: str, joints: Sequence[str], frames: Sequence[str]
) -> dict[str, Any]:
    if key == "joint":
        if found not in joints:
            raise ValueError(f"{where}: unknown joint {found!r}; {close_match(str(found), joints)}")
        return {"joint": found}
    if key == "frame":
        if found not in frames:
            raise ValueError(f"{where}: unknown frame {found!r}; {close_match(str(found), frames)}")
        return {"frame": found}
    if not isinstance(found, list) or len(found) != 2 or found[0] == found[1]:
        raise ValueError(f"{where}: joints is {found!r}; expected two different joints [a, b]")
    for name in found:
        if name not in joints:
            raise ValueError(f"{where}: unknown joint {name!r}; {close_match(str(name), joints)}")
    return {"joint_pair": tuple(found)}


def _read_value(found: Any, parameter: Parameter, where: str) -> Any:
    # a pure number has no unit to print
    unit, unit_after = (f" in {parameter.unit}", f" {parameter.unit}") if parameter.unit != "-" else ("", "")
    if parameter.size == 1:
        if isinstance(found, bool) or not isinstance(found, int | float) or not np.isfinite(found):
            raise ValueError(f"{where} is {found!r}; expected one finite number{unit}")
        if parameter.kind == "shape" and not parameter.lower <= found <= parameter.upper:
            raise ValueError(f"{where} is {found!r}; expected {parameter.lower:g} to {parameter.upper:g}{unit_after}")
        if found < parameter.lower:
            raise ValueError(f"{where} is {found!r}; expected at least {parameter.lower:g}{unit_after}")
        return float(found)
    try:
        values = np.asarray(found, dtype=float)
    except (TypeError, ValueError):
        values = np.array([])
    if values.size != (parameter.size or max(1, values.size)) or not np.isfinite(values).all():
        raise ValueError(f"{where} is {found!r}; expected {parameter.size or 'some'} finite numbers{unit}")
    if (values < parameter.lower).any():
        raise ValueError(f"{where} is {found!r}; expected at least {parameter.lower:g}{unit_after}")
    if (values > parameter.upper).any():
        raise ValueError(f"{where} is {found!r}; expected at most {parameter.upper:g}{unit_after}")
    return tuple(float(x) for x in values.ravel())


def effect_to_table(effect: Effect) -> dict[str, Any]:
    """The table of a robot file that `effect_from_table` turns into this effect; values that are not known are left out."""
    table: dict[str, Any] = {"type": effect.type_name()}
    if effect.on in ("joint", "robot or joint") and effect.joints:
        table["joint"] = effect.joints[0]
    elif effect.on == "joints":
        table["joints"] = list(effect.joints)
    elif isinstance(effect, FrameEffect):
        table["frame"] = effect.frame
    for name, parameter in effect.parameters().items():
        value = getattr(effect, parameter.attribute)
        if value is not None:
            table[name] = list(value) if isinstance(value, tuple) else float(value)
    table |= {
        name: getattr(effect, name) for name, words in effect.choices().items() if getattr(effect, name) != words[0]
    }
    return table
