"""Hidden effect against found effect, over frequency

    python benchmarks/closing_the_loop_over_frequency.py --out FILE.jsonl [--table FILE.md]

A robot (RX90B, UR10 or Panda, flexible at its first three joints) differs in one thing from what is declared: an effect that
is missing, or, every second seed of the types that a robot declares anyway, one of another value. Its frequency responses from drive
torques to drive accelerations are known in three poses with a noise of 3 % of each entry; two are fitted, the third is predicted.
They are made by `tests/modal_generator.py` from MuJoCo's mass matrix, without effect code of the package. Friction slopes and
the common factor of the dampings are not those declared; the links are.

The strength is a power: mean square error of the declared model over the stated errors, friction and dampings fitted,
less the noise floor, which is 1. It is set by measuring.

Studies: ``hidden``, ``nothing``, ``outside`` (what nothing that is tried explains).
One seed is one run. Finished runs are kept in the file, whole lines, and not run again.
"""

from __future__ import annotations

import itertools
import math
import os
import sys
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from hidden_effects.counting import (
    DEVIATIONS,
    NEAR_FLOOR,
    Case,
    continued,
    hidden_table,
    left_out,
    rate,
    show,
    study_parser,
)
from modal_generator import Truth, carrying, heavier, measured_response, truth_of, without_springs

import rx90b_flex as rf
from rx90b_flex.diagnose.flexible import Structure
from rx90b_flex.diagnose.likelihood import FoundChange
from rx90b_flex.diagnose.response import ResponseLoop, ResponseResidual, close_response, thinned
from rx90b_flex.effects import Effect, catalogue
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.robot import Robot

NOISE = 0.03  # of each entry's magnitude
BAND_HZ = (8.0, 80.0)
EXACT = 1e-3  # model error that is allowed for: the responses are those of a linear robot
LAG_S = 1e-3  # damping over stiffness, as declared
FITTED = 2  # poses; the third is held out
SHAKE, WRIST, TURN = 0.2, 0.5, 1.0  # rad, by which drawn angles differ from those below; of other joints; of the first
NEAR = 0.1  # of the strength: how well it is met
OFF_FRAME = 0.1  # m from the tip frame's origin to a payload that is not there


# ---- robots ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Subject:
    """A robot of the study.

    `inertia`, `twist` and `bend` are those of the drives and hinges of the measured joints (None: the robot's own file has
    them), `slope` the range of viscous friction, `load` a rated payload, kg, and `forearm` a link.
    """

    robot: str
    measured: tuple[str, str, str]
    poses: tuple[Mapping[str, float], ...]
    slope: tuple[float, float]
    load: float
    forearm: str
    inertia: tuple[float, ...] | None = None
    twist: tuple[float, ...] = ()
    bend: tuple[float, ...] = ()

    def declared(self) -> Robot:
        """Links, drives and hinges."""
        if self.inertia is None:
            return without_springs(self.robot)
        effects: list[Effect] = []
        for joint, inertia, twist, bend in zip(self.measured, self.inertia, self.twist, self.bend, strict=True):
            effects.append(effect("drive_inertia", joint=joint, inertia=inertia))
            effects.append(effect("drive_flexibility", joint=joint, stiffness=twist, damping=LAG_S * twist))
            effects.append(effect("joint_flexibility", joint=joint, stiffness=(bend,) * 2, damping=(LAG_S * bend,) * 2))
        return rf.load_robot(self.robot).with_effects(effects)


def effect(kind: str, **values: Any) -> Effect:
    return catalogue()[kind](**values)


# Where a robot's file says nothing: rotors of some 1e-4 kg m^2 behind gears of 100 to 160, strain-wave gears, bearings a
# few times as stiff. First resonances of the poses below: 24 to 31, 24 to 27 and 19 to 20 Hz.
SUBJECTS = {
    "rx90b": Subject(
        "rx90b",
        ("joint_1", "joint_2", "joint_3"),
        ({"joint_2": 1.4, "joint_3": 0.1}, {"joint_2": 0.6, "joint_3": 1.2}, {"joint_2": 1.0, "joint_3": 0.6}),
        slope=(15.0, 60.0),
        load=6.0,
        forearm="link_3",
    ),
    "ur10": Subject(
        "example-robot-data:ur10",
        ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
        (
            {"shoulder_lift_joint": -0.3, "elbow_joint": 0.1},
            {"shoulder_lift_joint": -1.2, "elbow_joint": 1.6},
            {"shoulder_lift_joint": -0.8, "elbow_joint": 0.8},
        ),
        slope=(10.0, 40.0),
        load=10.0,
        forearm="forearm_link",
        inertia=(1.5, 1.5, 0.8),
        twist=(8e4, 8e4, 3e4),
        bend=(1.5e5, 1.2e5, 6e4),
    ),
    "panda": Subject(
        "example-robot-data:panda",
        ("panda_joint1", "panda_joint2", "panda_joint3"),
        (
            {"panda_joint2": 0.9, "panda_joint4": -0.9, "panda_joint6": 1.5},
            {"panda_joint2": 0.1, "panda_joint4": -1.9, "panda_joint6": 1.5},
            {"panda_joint2": 0.5, "panda_joint4": -1.4, "panda_joint6": 1.5},
        ),
        slope=(4.0, 20.0),
        load=3.0,
        forearm="panda_link5",
        inertia=(0.6, 0.6, 0.5),
        twist=(1.4e4, 1.4e4, 9e3),
        bend=(4e4, 3e4, 2e4),
    ),
}


@dataclass(frozen=True, eq=False)
class Scene:
    """All that a run draws before the effect: robot, poses, friction, dampings, noise."""

    subject: Subject
    robot: Robot
    plain: Truth
    poses: tuple[dict[str, float], ...]
    slopes: tuple[float, ...]
    lag: float
    noise: int

    @staticmethod
    def draw(rng: np.random.Generator, name: str) -> Scene:
        subject = SUBJECTS[name]
        robot = subject.declared()
        far = {j: 0.0 if "finger" in j else WRIST for j in robot.joints} | {subject.measured[0]: TURN}
        poses = []
        for k in rng.permutation(len(subject.poses)):
            near = subject.poses[k]
            poses.append(
                {j: near.get(j, 0.0) + (SHAKE if j in near else r) * rng.uniform(-1.0, 1.0) for j, r in far.items()}
            )
        low, high = np.log(subject.slope)
        slopes = tuple(np.exp(rng.uniform(low, high, 3)).tolist())
        lag = LAG_S * float(np.exp(rng.uniform(-0.4, 0.4)))
        return Scene(subject, robot, truth_of(robot), tuple(poses), slopes, lag, int(rng.integers(2**31)))

    def responses(self, truth: Truth, poses: int) -> list[FrequencyResponse]:
        """In the first so many poses; the noise is the same whatever the truth."""
        return [
            measured_response(
                truth, np.random.default_rng([self.noise, k]), NOISE, angles, self.robot.joints,
                self.subject.measured, self.slopes, self.lag,
            )
            for k, angles in enumerate(self.poses[:poses])
        ]  # fmt: skip

    def inertia(self, coordinate: str, truth: Truth) -> float:
        """About a coordinate in the first pose, kg m^2."""
        names, mass, _ = truth.matrices(self.poses[0])
        return float(mass[names.index(coordinate), names.index(coordinate)])


# ---- what is hidden --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Hidden:
    """One difference between the robot and what is declared, of any size; at size 0 there is none.

    Attributes
    ----------
    declared : Robot
    place : tuple of str
        Joints.
    values : callable
        Parameters, as the effect type and the search call them, at a size.
    truth : callable
        The robot as it is, given these.
    most : float
        The largest size that is believable.
    """

    declared: Robot
    place: tuple[str, ...]
    values: Callable[[float], dict[str, Any]]
    truth: Callable[[dict[str, Any]], Truth]
    most: float = 1.0


def lacking(robot: Robot, joint: str, *kinds: str) -> Robot:
    """A robot without effects on one joint."""
    return robot.with_effects([e for e in robot.effects if e.joints != (joint,) or e.type_name() not in kinds])


def added_inertia(scene: Scene, joint: str, rng: np.random.Generator) -> Hidden:
    """On a drive that does not twist: one that does has an inertia that is declared."""
    declared = lacking(scene.robot, joint, "drive_inertia", "drive_flexibility")
    typical, plain, drive = scene.plain.armature[f"{joint}:drive"], truth_of(declared), f"{joint}:drive"
    return Hidden(
        declared,
        (joint,),
        lambda size: {"inertia": size * typical},
        lambda p: replace(plain, armature=plain.armature | {drive: p["inertia"]}),
        most=2.0,
    )


def added_twist(scene: Scene, joint: str, rng: np.random.Generator) -> Hidden:
    declared = lacking(scene.robot, joint, "drive_flexibility")
    typical, plain, hinge = scene.plain.stiffness[f"{joint}:torsion"], truth_of(declared), f"{joint}:torsion"
    return Hidden(
        declared,
        (joint,),
        lambda size: {"stiffness": typical / size},
        lambda p: replace(plain, torsion=(*plain.torsion, joint), stiffness=plain.stiffness | {hinge: p["stiffness"]}),
        most=3.0,
    )


def added_bending(scene: Scene, joint: str, rng: np.random.Generator) -> Hidden:
    """Alike about both axes: a round bearing."""
    declared = lacking(scene.robot, joint, "joint_flexibility")
    hinges = (f"{joint}:bend_1", f"{joint}:bend_2")
    typical, plain = scene.plain.stiffness[hinges[0]], truth_of(declared)
    return Hidden(
        declared,
        (joint,),
        lambda size: {"stiffness": typical / size},
        lambda p: replace(
            plain, bending=(*plain.bending, joint), stiffness=plain.stiffness | dict.fromkeys(hinges, p["stiffness"])
        ),
        most=3.0,
    )


def floor(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    """Stiffnesses on which the arm alone would rock at 20 Hz, unlike about the two axes.

    A floor that is alike about both is the bending of the first joint, a little lower.
    """
    shaken = replace(scene.plain, base=True)
    heavy = 0.5 * (scene.inertia("base:bend_1", shaken) + scene.inertia("base:bend_2", shaken))
    apart = math.sqrt(rng.uniform(2.0, 5.0)) ** float(rng.choice([-1.0, 1.0]))
    typical = heavy * (2 * np.pi * 20.0) ** 2
    return {"base:bend_1": typical * apart, "base:bend_2": typical / apart}


def added_floor(scene: Scene, place: None, rng: np.random.Generator) -> Hidden:
    typical, plain = floor(scene, rng), scene.plain
    return Hidden(
        scene.robot,
        (),
        lambda size: {"stiffness": [k / size for k in typical.values()]},
        lambda p: replace(
            plain, base=True, stiffness=plain.stiffness | dict(zip(typical, p["stiffness"], strict=True))
        ),
        most=3.0,
    )


def added_spring(scene: Scene, joint: str, rng: np.random.Generator) -> Hidden:
    """At the most what makes the joint of a rigid arm swing at the lower edge of the band."""
    rigid = replace(scene.plain, torsion=(), bending=(), stiffness={})
    most = scene.inertia(f"{joint}:drive", rigid) * (2 * np.pi * BAND_HZ[0]) ** 2
    return Hidden(
        scene.robot,
        (joint,),
        lambda size: {"stiffness": size * most},
        lambda p: replace(scene.plain, springs={joint: p["stiffness"]}),
    )


def added_load(scene: Scene, place: None, rng: np.random.Generator) -> Hidden:
    """A point mass at the tip frame's origin, where the search looks for it."""
    return Hidden(
        scene.robot,
        (),
        lambda size: {"mass": size * scene.subject.load},
        lambda p: replace(scene.plain, urdf=carrying(scene.plain.urdf, scene.robot.tip_frame, p["mass"])),
    )


def coupled(scene: Scene, turns: Mapping[str, float], inertia: float) -> Truth:
    return replace(scene.plain, coupling=({f"{j}:drive": n for j, n in turns.items()}, inertia))


def added_coupling(scene: Scene, pair: tuple[str, str], rng: np.random.Generator) -> Hidden:
    typical = min(scene.plain.armature[f"{j}:drive"] for j in pair)
    return Hidden(
        scene.robot,
        pair,
        lambda size: {"inertia": size * typical},
        lambda p: coupled(scene, dict.fromkeys(pair, 1.0), p["inertia"]),
    )


def changed(name: str, kind: str, hinges: Sequence[str]) -> Callable[[Scene, str, np.random.Generator], Hidden]:
    """Another value of what is declared, by a factor of 3 at the most; `hinges` as ``torsion``, ``drive`` for the inertia."""

    def make(scene: Scene, joint: str, rng: np.random.Generator) -> Hidden:
        sign = float(rng.choice([-1.0, 1.0]))
        places = [f"{joint}:{h}" for h in hinges]

        def truth(p: dict[str, Any]) -> Truth:
            values: dict[str, float] = getattr(scene.plain, kind)
            return replace(scene.plain, **{kind: values | {h: p[name] * values[h] for h in places}})

        return Hidden(scene.robot, (joint,), lambda size: {name: math.exp(sign * size)}, truth, most=math.log(3.0))

    return make


def changed_floor(scene: Scene, place: None, rng: np.random.Generator) -> Hidden:
    k = tuple(floor(scene, rng).values())
    known = effect("base_flexibility", stiffness=k, damping=tuple(LAG_S * x for x in k))
    robot = scene.robot.with_effects([*scene.robot.effects, known])
    standing = replace(scene, robot=robot, plain=truth_of(robot))
    hidden = changed("base_stiffness", "stiffness", ("bend_1", "bend_2"))(standing, "base", rng)
    return replace(hidden, place=())


@dataclass(frozen=True)
class Kind:
    """How an effect type is hidden: where (``joint``, ``pair``, ``robot``), as missing, and with another value."""

    on: str
    added: Callable[[Scene, Any, np.random.Generator], Hidden]
    changed: Callable[[Scene, Any, np.random.Generator], Hidden] | None = None


KINDS: Mapping[str, Kind] = {
    "drive_flexibility": Kind("joint", added_twist, changed("drive_stiffness", "stiffness", ("torsion",))),
    "joint_flexibility": Kind("joint", added_bending, changed("joint_stiffness", "stiffness", ("bend_1", "bend_2"))),
    "base_flexibility": Kind("robot", added_floor, changed_floor),
    "drive_inertia": Kind("joint", added_inertia, changed("drive_inertia", "armature", ("drive",))),
    "joint_spring": Kind("joint", added_spring),
    "payload": Kind("robot", added_load),
    "joint_coupling": Kind("pair", added_coupling),
}


def differential(scene: Scene, place: None, rng: np.random.Generator) -> Hidden:
    """A motor that turns with the second joint and twice against the third."""
    a, b = scene.subject.measured[1:]
    typical = min(scene.plain.armature[f"{j}:drive"] for j in (a, b))
    return Hidden(
        scene.robot, (a, b), lambda size: {"inertia": size * typical},
        lambda p: coupled(scene, {a: 1.0, b: -2.0}, p["inertia"]),
    )  # fmt: skip


def heavier_forearm(scene: Scene, place: None, rng: np.random.Generator) -> Hidden:
    return Hidden(
        scene.robot,
        (),
        lambda size: {"factor": 1.0 + size},
        lambda p: replace(scene.plain, urdf=heavier(scene.plain.urdf, scene.subject.forearm, p["factor"])),
    )


def load_off_frame(scene: Scene, place: None, rng: np.random.Generator) -> Hidden:
    """In the catalogue, but over frequency the search knows no other place than the frame's origin."""
    direction = rng.standard_normal(3)
    centre = (OFF_FRAME * direction / np.linalg.norm(direction)).tolist()
    return Hidden(
        scene.robot,
        (),
        lambda size: {"mass": size * scene.subject.load},
        lambda p: replace(scene.plain, urdf=carrying(scene.plain.urdf, scene.robot.tip_frame, p["mass"], centre)),
    )


OUTSIDE = {
    "differential": Kind("robot", differential),
    "heavier forearm": Kind("robot", heavier_forearm),
    "payload off its frame": Kind("robot", load_off_frame),
}


@dataclass(frozen=True, eq=False)
class Strength:
    """Power that a hidden difference leaves in the declared model's residual over the noise floor, by its size."""

    scene: Scene
    hidden: Hidden
    structure: Structure

    @staticmethod
    def of(scene: Scene, hidden: Hidden) -> Strength:
        robot = hidden.declared
        angles = [np.array([p.get(j, 0.0) for j in robot.joints]) for p in scene.poses[:FITTED]]
        return Strength(scene, hidden, Structure.of(robot, scene.subject.measured, angles, BAND_HZ))

    def at(self, size: float) -> float:
        responses = self.scene.responses(self.hidden.truth(self.hidden.values(size)), FITTED)
        residual = ResponseResidual(self.structure, [thinned(r.band(*BAND_HZ))[0] for r in responses], EXACT)
        errors = residual.errors(residual.fit(()))
        return float(np.mean([e.weighted**2 for e in errors])) - 1.0

    def size(self, strength: float) -> float | None:
        """Size of a strength, to 10 %; None where it cannot have it. The power grows with the square of what is small."""
        low, high, size = 0.0, math.inf, 0.1 * self.hidden.most
        for _ in range(20):
            reached = self.at(size)
            if abs(reached / strength - 1.0) < NEAR:
                return size
            if reached < strength and size >= self.hidden.most:
                return None
            low, high = (size, high) if reached < strength else (low, size)
            if low > 0.0 and high < math.inf:
                size = math.sqrt(low * high)  # where modes pass antiresonances it is steep
            else:
                size *= float(np.clip(math.sqrt(strength / max(reached, 1e-9)), 0.1, 6.0))
            size = min(size, self.hidden.most)
        return None


def places(on: str, measured: Sequence[str], rng: np.random.Generator) -> list[Any]:
    """Where an effect may be hidden, in drawn order."""
    every = {"robot": [None], "joint": list(measured), "pair": list(itertools.combinations(measured, 2))}[on]
    return [every[i] for i in rng.permutation(len(every))]


# ---- runs ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a run closes the loop on: declared robot, responses (the last is held out), and what was hidden."""

    robot: Robot
    responses: tuple[FrequencyResponse, ...]
    way: str
    place: tuple[str, ...] = ()
    values: Mapping[str, Any] | None = None

    def close(self) -> ResponseLoop:
        return close_response(
            self.responses[:FITTED], self.robot, held_out=self.responses[FITTED:], band_hz=BAND_HZ, model_error=EXACT
        )


def robot_of(case: Case) -> str:
    """Robots take turns, so that each type is hidden in every one of them."""
    names = [*KINDS, *OUTSIDE]
    turn = names.index(case.name) if case.name in names else 0
    return list(SUBJECTS)[(case.seed + turn) % len(SUBJECTS)]


def draw(case: Case) -> Drawn | str:
    """What is measured in a run, or what could not be hidden."""
    rng = np.random.default_rng([case.seed, *case.key.rsplit("/", 1)[0].encode()])
    scene = Scene.draw(rng, robot_of(case))
    if case.study == "nothing":
        return Drawn(scene.robot, tuple(scene.responses(scene.plain, len(scene.poses))), "nothing")
    kind = {**KINDS, **OUTSIDE}[case.name]
    way = "changed" if kind.changed is not None and case.seed % 2 else "added"
    make = kind.changed if way == "changed" and kind.changed is not None else kind.added
    for place in places(kind.on, scene.subject.measured, rng):
        hidden = make(scene, place, rng)
        size = Strength.of(scene, hidden).size(case.strength)
        if size is not None:
            values = hidden.values(size)
            responses = tuple(scene.responses(hidden.truth(values), len(scene.poses)))
            return Drawn(hidden.declared, responses, way, hidden.place, values)
    return f"{case.name}, {way}, shows too little on {robot_of(case)} at strength {case.strength:g}"


def joints_of(found: FoundChange, structure: Structure) -> list[str]:
    """Joints of a change; what it calls its place where it is on several effects."""
    here = (
        e
        for e in structure.full.effects
        if e.type_name() == found.change.type and "_".join(e.place) in (found.change.place, "")
    )
    return next((list(e.joints) for e in here), [found.change.place])


def run_case(case: Case) -> dict[str, Any]:
    """One run: draw, hide, close the loop, and compare."""
    began = clock.process_time()
    drawn = draw(case)
    if isinstance(drawn, str):
        return vars(case) | {"skipped": drawn}
    hiding = clock.process_time() - began
    loop = drawn.close()
    found = [
        {
            "type": f.change.type,
            "joints": joints_of(f, loop.structure),
            "label": f.change.label,
            "parameters": {n: [float(v), float(s)] for n, v, s in zip(f.change.names, f.values, f.stds, strict=True)},
            "p_value": f.p_value,
            "alternatives": [t.change.label for t in f.alternatives],
        }
        for f in loop.found
    ]
    hidden = {"type": case.name, "joints": list(drawn.place), "values": drawn.values}
    before, after = ([e.weighted for e in x] for x in (loop.errors_before, loop.errors_after))
    return vars(case) | {
        "robot": robot_of(case),
        "way": drawn.way,
        "hidden": [hidden] if drawn.values is not None else [],
        "found": found,
        "verdict": loop.verdict,
        "reached": float(np.mean(np.square(before))) - 1.0,
        "before_over_floor": np.round(before, 4).tolist(),
        "after_over_floor": np.round(after, 4).tolist(),
        "between_lines": [round(e.weighted, 4) for e in loop.held_out_after[:-1]],
        "held_out": round(loop.held_out_after[-1].weighted, 4),
        "chance_after": loop.result.chance_after,
        "seconds": round(clock.process_time() - began, 2),
        "seconds_hiding": round(hiding, 2),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The study in Markdown."""
    done = [r for r in rows if "skipped" not in r]
    lines = [
        "# Hidden effect against found effect, over frequency",
        "",
        "Right: what was found is what was hidden, on its joint, and nothing else. Within: parameters less than",
        f"{DEVIATIONS:g} standard deviations off. Held out: runs whose error in a pose that was not fitted is at most",
        f"{NEAR_FLOOR:g} times the noise floor.",
        "Rates with their 95 % intervals. Data: frequency responses, made without the package.",
        "",
        *hidden_table(done),
        "",
        "| study | strength | rate |",
        "|---|---|---|",
    ]
    none = [r for r in done if r["study"] == "nothing"]
    if none:
        lines.append(f"| nothing hidden, nothing added | | {rate(sum(not r['found'] for r in none), len(none))} |")
    for name, strength in sorted({(r["name"], r["strength"]) for r in done if r["study"] == "outside"}):
        these = [r for r in done if (r["name"], r["strength"]) == (name, strength)]
        honest = sum(r["verdict"] in ("unexplained", "partly_explained") for r in these)
        lines.append(f"| outside: {name}, not called explained | {strength:g} | {rate(honest, len(these))} |")
    return "\n".join([*lines, "", *left_out(rows)]).rstrip() + "\n"


def cases(studies: Sequence[str], types: Sequence[str], strengths: Sequence[float], seeds: int) -> Iterator[Case]:
    """Runs in an order in which every part of the study grows alike; the weakest last."""
    for seed in range(seeds):
        if "hidden" in studies:
            for strength in sorted((s for s in strengths if s > 1.0), reverse=True):
                yield from (Case("hidden", name, strength, seed) for name in types)
        if "nothing" in studies:
            yield from (Case("nothing", "nothing", 0.0, 6 * seed + i) for i in range(6))
        if "outside" in studies:
            yield from (Case("outside", name, max(strengths), seed) for name in OUTSIDE)
    if "hidden" in studies:
        for seed, strength in itertools.product(range(seeds), (s for s in strengths if s <= 1.0)):
            yield from (Case("hidden", name, strength, seed) for name in types)


def main() -> None:
    parser = study_parser(__doc__, ("hidden", "outside", "nothing"), KINDS)
    parser.add_argument("--seeds", type=int, default=5)
    o = parser.parse_args()
    every = cases(o.studies, o.types, o.strengths, o.seeds)
    show(table(continued(o.out, every, run_case, o.limit, o.jobs)), o.table)


if __name__ == "__main__":
    main()
