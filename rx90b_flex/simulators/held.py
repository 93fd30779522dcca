"""What of a robot's effects a simulator's format holds: numbers on coordinates, and what is lost.

A simulator knows a joint by an inertia, a damper, a spring with its rest, a constant torque and a level of dry friction, all
linear but the last. `rx90b_flex.effects.Law` says of an effect which of these it is; the law's function is asked for its values,
so that effects of other packages are held as well as one's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from scipy.optimize import nnls

from rx90b_flex.effects import Effect
from rx90b_flex.effects.elements import AnchoredSpring, GravityChange, PointMass, unit_body
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.motion import Array
from rx90b_flex.export import with_link_parameters
from rx90b_flex.flexify import UNLIMITED, read_xml
from rx90b_flex.robot import Robot

SLOWEST = 0.05  # of the joint's largest speed: below it friction turns over, which a simulator does in its own way
SPEED = 1.0  # rad/s, the largest speed of a joint whose URDF states none
SPEEDS = 60  # at which friction is compared
CREEP = 1e-3  # of that speed, down to which friction may still grow as it falls
EXACT = 1e-2  # of friction's largest torque: closer is no loss worth a line
ANGLES = (0.0, 0.7, -1.3)  # rad, at which a law is asked whether it depends on the angle

Weights: TypeAlias = tuple[tuple[str, float], ...]  # of a combination: coordinates and their factors


@dataclass(frozen=True)
class Format:
    """What a format holds beside links, joints and their limits.

    Attributes
    ----------
    name : str
        As a user writes it.
    title : str
        As a sentence has it.
    rotors : bool
        Inertia of a drive, seen by its own joint alone.
    springs : bool
        Springs on joints; without them no hinge is held either.
    constants : bool
        Constant torques.
    pairs : bool
        Anything on a combination of two coordinates; drive and torsion of one joint are two.
    gravity : bool
        Its direction.
    lines : bool
        Springs between two points.
    """

    name: str
    title: str
    rotors: bool
    springs: bool
    constants: bool
    pairs: bool
    gravity: bool
    lines: bool


@dataclass(frozen=True)
class Lost:
    """What a format does not hold, or not as it is.

    Attributes
    ----------
    what : str
        Place and type of the effect, or the link.
    why : str
    """

    what: str
    why: str

    def __str__(self) -> str:
        return f"{self.what}: {self.why}"


@dataclass(frozen=True)
class Port:
    """A combination of coordinates, and the torque along it: ``inertia x'' + damping x' + stiffness x + constant + dry friction``.

    Attributes
    ----------
    weights : tuple of (coordinate, factor)
    inertia, damping, stiffness, constant, friction : float
        kg m^2, N m s/rad, N m/rad, N m, N m.
    """

    weights: Weights
    inertia: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    constant: float = 0.0
    friction: float = 0.0

    @property
    def rest(self) -> float:
        """Where the spring is at rest, rad; the constant torque is in it."""
        return -self.constant / self.stiffness

    @property
    def coordinate(self) -> str | None:
        """The one coordinate that it is; None for a combination."""
        return self.weights[0][0] if len(self.weights) == 1 and self.weights[0][1] == 1.0 else None


@dataclass(frozen=True)
class LineSpring:
    """A spring between a point of the link before a joint and one of the link behind it; see `AnchoredSpring`."""

    joint: str
    fixed: Array
    moving: Array
    stiffness: float
    rest_m: float


@dataclass(frozen=True)
class Held:
    """A robot as a format holds it.

    Attributes
    ----------
    robot : Robot
        With the coordinates that the format has; its effects are those that were looked at.
    bodies : mapping of link to array (10,)
        Inertial parameters about the link's joint, payloads in them.
    ports : tuple of Port
    lines : tuple of LineSpring
    gravity : array, shape (3,)
        m/s^2, in the base frame.
    lost : tuple of Lost
    """

    robot: Robot
    bodies: dict[str, Array]
    ports: tuple[Port, ...]
    lines: tuple[LineSpring, ...]
    gravity: Array
    lost: tuple[Lost, ...]

    def on(self, coordinate: str) -> Port:
        """What acts on one coordinate alone; nothing where there is none."""
        found = (p for p in self.ports if p.coordinate == coordinate)
        return next(found, Port(((coordinate, 1.0),)))


@dataclass
class _Sum:
    """What is gathered on one combination of coordinates."""

    inertia: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    constant: float = 0.0
    rubbing: list[tuple[Effect, Callable[[float], float]]] = field(default_factory=list)


def held_by(robot: Robot, how: Format) -> Held:
    """What a format holds of a robot.

    Raises
    ------
    ValueError
        An effect that the format could hold has no value.
    """
    kept, lost = _kept(robot, how)
    try:
        return _gathered(robot.with_effects(kept), how, lost)
    except ValueError as error:
        raise ValueError(f"{robot.name}: {error}") from None


def with_carried(robot: Robot) -> tuple[Robot, tuple[str, ...], tuple[Lost, ...]]:
    """The robot with the masses that its effects put on it in its links, for a URDF that holds these alone.

    Returns
    -------
    Robot, labels of the effects that are in its links now, and those that are not, for they have no value.

    Raises
    ------
    ValueError
        A link that a URDF cannot hold.
    """
    lost: list[Lost] = []
    carried: list[str] = []
    bodies = dict(zip((n for n, _ in robot.bodies), robot.link_parameters.reshape(-1, 10).copy(), strict=True))
    for effect in robot.effects:
        try:
            element = effect.element()
        except ValueError:
            if effect.traits.adds_inertia and effect.traits.part == "links":
                lost.append(Lost(effect.label, "has no value; the links are written without it"))
            continue
        if isinstance(element, PointMass):
            _carry(robot, bodies, element)
            carried.append(effect.label)
    if carried:
        robot = with_link_parameters(robot, np.concatenate(list(bodies.values())), allow_inconsistent=True)
    return robot, tuple(carried), tuple(lost)


def _gathered(robot: Robot, how: Format, lost: list[Lost]) -> Held:
    sums: dict[Weights, _Sum] = {}
    lines: list[LineSpring] = []
    bodies = dict(zip((n for n, _ in robot.bodies), robot.link_parameters.reshape(-1, 10).copy(), strict=True))
    gravity = robot.model.gravity.linear.copy()
    pull = float(np.linalg.norm(gravity))
    for effect in robot.effects:
        element = effect.element()
        if isinstance(element, PointMass):
            _carry(robot, bodies, element)
        elif isinstance(element, GravityChange):
            if how.gravity:
                gravity = gravity + pull * element.direction
            else:
                felt = " ".join(f"{x:.9g}" for x in gravity + pull * element.direction)
                lost.append(Lost(effect.label, f"gravity is the world's, not the robot's: set it to {felt} m/s^2"))
        elif element is not None:
            lost += _add_line(effect, element, how, lines)
        else:
            lost += _add_laws(robot, effect, how, sums)
    ports = []
    order = {name: i for i, name in enumerate(robot.coordinates)}
    for weights, gathered in sorted(sums.items(), key=lambda item: [order[name] for name, _ in item[0]]):
        damping, friction, said = _rub(robot, weights, gathered)
        lost += said
        g = gathered
        ports.append(Port(weights, g.inertia, g.damping + damping, g.stiffness, g.constant, friction))
    return Held(robot, bodies, tuple(ports), tuple(lines), gravity, tuple(lost))


def _kept(robot: Robot, how: Format) -> tuple[list[Effect], list[Lost]]:
    """Effects that a format might hold, and the others."""
    kept: list[Effect] = []
    lost: list[Lost] = []
    gone: set[tuple[str, tuple[str, ...]]] = set()
    for effect in robot.effects:
        if not effect.traits.in_dynamics:
            lost.append(Lost(effect.label, "stands between the robot and its log, which a simulator does not make"))
        elif effect.traits.virtual and not how.springs:
            gone.add((effect.type_name(), effect.place))
            lost.append(Lost(effect.label, f"{how.title} has no springs: what bends here is rigid there"))
        elif "torsion" in effect.traits.virtual and not how.rotors:
            gone.add((effect.type_name(), effect.place))
            why = f"{how.title} has no rotor inertia, and without one a drive that twists has nothing to turn: rigid there"
            lost.append(Lost(effect.label, why))
        else:
            kept.append(effect)
    for effect in [e for e in kept if any((needed, e.place) in gone for needed in e.traits.needs)]:
        kept.remove(effect)
        lost.append(Lost(effect.label, "belongs to what is rigid there"))
    return kept, lost


def _carry(robot: Robot, bodies: dict[str, Array], carried: PointMass) -> None:
    """Put a point mass into the body that carries a frame."""
    place = robot.model.frames[robot.model.getFrameId(carried.frame)]
    for link, joint in robot.bodies:
        if joint == place.parentJoint:
            bodies[link] += carried.mass * unit_body(place.placement.act(carried.centre))


def _add_line(effect: Effect, spring: AnchoredSpring, how: Format, lines: list[LineSpring]) -> list[Lost]:
    if not how.lines:
        return [Lost(effect.label, f"{how.title} has no springs between links")]
    if spring.stiffness == 0.0:
        return [Lost(effect.label, f"{how.title} has no spring that pulls alike at any length")]
    rest = float(np.linalg.norm(spring.fixed - spring.moving)) - spring.prestress / spring.stiffness
    lines.append(LineSpring(effect.joints[0], spring.fixed, spring.moving, spring.stiffness, rest))
    return []


def _add_laws(robot: Robot, effect: Effect, how: Format, sums: dict[Weights, _Sum]) -> Iterable[Lost]:
    rest = np.zeros(robot.model.nv)
    laws = effect.laws(robot.motion(rest, rest, rest))
    if laws is None or any(law.wide for law in laws):
        yield Lost(effect.label, _why_no_law(effect))
        return
    missing: list[str] = []
    for law in laws:
        weights = tuple((robot.coordinates[i], float(law.port[i])) for i in np.flatnonzero(law.port))
        if len(weights) > 1 and not how.pairs:
            weights, what = _one_of(weights)
            if what:
                missing.append(what)
            if not weights:
                continue
        gathered = sums.setdefault(weights, _Sum())
        if how.rotors:
            gathered.inertia += law.inertia
        elif law.inertia:
            missing.append(f"{how.title} has no inertia of a rotor behind its gear")
        if how.springs:
            gathered.stiffness += law.stiffness
        elif law.stiffness:
            missing.append(f"{how.title} has no springs")
        gathered.damping += law.damping
        missing += _add_function(effect, law, gathered, how)
    if missing:
        yield Lost(effect.label, "; ".join(dict.fromkeys(missing)))


def _one_of(weights: Weights) -> tuple[Weights, str]:
    """What stands for a combination where there are none: the drive for the joint's angle; nothing for two joints."""
    joints = {name.rsplit(":", 1)[0] for name, _ in weights}
    if len(joints) == 1:
        return ((f"{joints.pop()}:drive", 1.0),), ""
    return (), f"turns with {' and '.join(sorted(joints))}, and a joint there knows itself alone"


def _add_function(effect: Effect, law: Law, gathered: _Sum, how: Format) -> list[str]:
    if law.function is None:
        return []
    function, parameters = law.function, np.asarray(law.parameters, dtype=float)

    def torque(x: float, rate: float) -> float:
        out = np.zeros(3)
        function(x, rate, parameters, out)
        return float(out[0])

    speeds = (0.0, 1e-2, 0.1, 1.0, 3.0)
    forward = np.array([[torque(x, v) for v in speeds] for x in ANGLES])
    backward = np.array([[torque(x, -v) for v in speeds] for x in ANGLES])
    size = max(float(np.abs(forward).max()), float(np.abs(backward).max()), np.finfo(float).tiny)
    alike = float(max(np.ptp(forward, axis=0).max(), np.ptp(backward, axis=0).max())) <= 1e-12 * size
    if alike and max(np.ptp(forward), np.ptp(backward)) <= 1e-12 * size:
        constant = float(forward[0, 0])
        if law.stiffness and not how.springs:
            return []  # the rest of a spring that is lost as a whole
        if constant and not how.constants and not law.stiffness:
            return [f"{how.title} has no constant torque ({constant:.4g} N m)"]
        gathered.constant += constant
        return []
    if alike and not law.stores and float(np.abs(forward + backward).max()) <= 1e-9 * size:
        gathered.rubbing.append((effect, lambda v: torque(0.0, v)))
        return []
    what = "the angle" if not alike else "the direction of motion"
    return [f"its torque depends on {what} in a way that no simulator's joint has"]


def _why_no_law(effect: Effect) -> str:
    if effect.traits.remembers:
        return "depends on the motion before, which no simulator's joint remembers"
    if effect.traits.needs_load:
        return "depends on the load, which no simulator's joint friction does"
    return "no simulator's joint has a torque of this form"


# ---- friction ------------------------------------------------------------------------------------------------


def _rub(robot: Robot, weights: Weights, gathered: _Sum) -> tuple[float, float, list[Lost]]:
    """Damper and level of dry friction nearest to friction of any form, and how far off they are."""
    if not gathered.rubbing:
        return 0.0, 0.0, []
    fastest = _speed(robot, weights)
    v = np.linspace(SLOWEST * fastest, fastest, SPEEDS)
    torque = sum(np.array([law(x) for x in v]) for _, law in gathered.rubbing)
    (level, slope), _ = nnls(np.stack([np.ones_like(v), v], axis=1), np.maximum(torque, 0.0))
    off, largest, slowest = float(np.abs(torque - level - slope * v).max()), float(np.abs(torque).max()), v[0]
    # what is slower turns over there, but does not grow
    slow = np.geomspace(CREEP, 1.0, SPEEDS) * v[0]
    grown = float((sum(np.array([law(x) for x in slow]) for _, law in gathered.rubbing) - level - slope * slow).max())
    if grown > off:
        off, largest, slowest = grown, max(largest, level + grown), slow[0]
    if off <= EXACT * largest:
        return float(slope), float(level), []
    labels = " + ".join(dict.fromkeys(effect.label for effect, _ in gathered.rubbing))
    (unit,) = robot.units_of([weights[0][0].rsplit(":", 1)[0]])
    why = (
        f"written as dry friction of {level:.4g} {unit.force} and damping of {slope:.4g} {unit.of('N m s/rad')}: off by up to "
        f"{off:.3g} of {largest:.3g} {unit.force} between {slowest:.2g} and {v[-1]:.2g} {unit.speed}"
    )
    return float(slope), float(level), [Lost(labels, why)]


def _speed(robot: Robot, weights: Weights) -> float:
    """Largest speed that the URDF lets a joint have."""
    limits = {j.name: j.limit for j in read_xml(robot.urdf).robot.joints}
    found = (limits.get(name.rsplit(":", 1)[0]) for name, _ in weights)
    speeds = (float(limit.velocity or 0.0) for limit in found if limit is not None)
    return min((speed for speed in speeds if 0.0 < speed < UNLIMITED), default=SPEED)
