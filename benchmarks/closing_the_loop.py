"""Hidden effect against found effect: python benchmarks/closing_the_loop.py --out FILE.jsonl [--table FILE.md]

A robot (UR10, Panda or RX90B, links up to 15 % off their URDF) has an effect that its file does not declare. Two recordings are
identified on, one validates. Logs are made by `tests/independent.py` and `tests/log_effects.py`, which share no effect code with
the package; dry friction turns over as tanh(v / 1 mrad/s) there, as an arctangent five times as sharp in the package. The strength
is a power: what the hidden effect leaves in the residual of the declared model, identified, on the joint
that shows it most, over what the same identification leaves there with nothing hidden (the noise floor). It is set by measuring.

Studies: ``hidden`` (one effect), ``pair`` (two at once), ``nothing``, ``outside`` (what no effect of the catalogue explains).
One seed is one run. Finished runs are kept in the file, whole lines, and not run again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import tempfile
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import independent as ind
import joblib
import log_effects
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal, stats

import rx90b_flex as rf
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign, Recording

Array = NDArray[np.float64]

RATE_HZ, CUTOFF_HZ, SECONDS = 150.0, 15.0, 12.0
ROLES = ("identification", "identification", "validation")
TORQUE_NOISE = 0.01  # of a joint's root mean square torque, white, as logged
POSITION_NOISE = 2e-6  # rad
LINKS_OFF = 0.15  # of a link's inertia, at most
SPEED, RANGE = 0.7, 0.8  # of the joint's limits, at most
STRENGTHS = (1.0, 3.0, 10.0)
MOST = 0.5  # of a joint's root mean square torque: an effect that needs more to show does not show
DEVIATIONS = 3.0
NEAR_FLOOR = 1.2  # held-out error over the noise floor that is asked for


@dataclass(frozen=True)
class Kind:
    """How values of an effect type are drawn: what scales with the strength, and the shapes.

    `start` is a size that shows, where a torque's own size does not tell; `most` the largest that is believable.
    """

    sizes: Callable[[np.random.Generator], dict[str, float | list[float]]]
    shapes: Callable[[np.random.Generator], dict[str, float | list[float]]] = lambda rng: {}
    on: str = "joint"
    start: float | None = None
    most: float = np.inf
    absent: tuple[str, ...] = ()  # what the robot does not have where this is hidden
    known_links: bool = False


def _phase(rng: np.random.Generator) -> float:
    return float(rng.uniform(-np.pi, np.pi))


def one(name: str) -> Callable[[np.random.Generator], dict[str, float | list[float]]]:
    return lambda rng: {name: 1.0}


def sine(**ranges: tuple[float, float]) -> Callable[[np.random.Generator], dict[str, float | list[float]]]:
    return lambda rng: {name: float(rng.uniform(*r)) for name, r in ranges.items()} | {"phase": _phase(rng)}


def uniform(**ranges: tuple[float, float]) -> Callable[[np.random.Generator], dict[str, float | list[float]]]:
    return lambda rng: {name: float(rng.uniform(*r)) for name, r in ranges.items()}


def _tilt(rng: np.random.Generator) -> dict[str, float | list[float]]:
    angle = _phase(rng)
    return {"angle_x": float(np.cos(angle)), "angle_y": float(np.sin(angle))}


KINDS: Mapping[str, Kind] = {
    "drive_inertia": Kind(one("inertia")),
    "torque_offset": Kind(lambda rng: {"torque": float(rng.choice([-1.0, 1.0]))}),
    "coulomb_friction": Kind(one("torque"), absent=("coulomb_friction",)),
    "viscous_friction": Kind(one("coefficient"), absent=("viscous_friction",)),
    "viscous_power_friction": Kind(one("coefficient"), uniform(power=(0.35, 0.65)), absent=("viscous_friction",)),
    "stribeck_friction": Kind(one("torque"), uniform(velocity=(0.08, 0.3), power=(0.8, 2.0))),
    "asymmetric_friction": Kind(lambda rng: {"coefficient": float(rng.choice([-1.0, 1.0]))}),
    "load_friction": Kind(one("coefficient"), most=0.3),
    "friction_drift": Kind(one("coefficient"), uniform(time_constant=(3.0, 10.0)), start=1.0),
    "presliding_friction": Kind(one("torque"), uniform(deflection=(0.01, 0.05)), start=1.0),
    "joint_spring": Kind(one("stiffness"), uniform(rest_angle=(-0.5, 0.5))),
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
    "motor_saturation": Kind(one("coefficient"), start=np.nan),
    "torque_delay": Kind(one("delay"), on="robot or joint", start=3e-3, most=0.03),
    "resolver_error": Kind(one("amplitude"), sine(order=(4.0, 40.0)), start=3e-4, most=0.02),
    "line_interference": Kind(one("amplitude"), sine(frequency_hz=(4.0, 13.0)), start=1.0),
}
ADDITIVE = tuple(name for name in KINDS if name not in log_effects.BETWEEN)
OUTSIDE = ("contact", "angle_dependent_friction", "slipping_encoder")
OUTSIDE_KINDS: Mapping[str, Kind] = {
    "contact": Kind(one("stiffness"), uniform(quantile=(0.6, 0.8)), on="frame"),
    "angle_dependent_friction": Kind(one("coefficient"), on="pair"),
    "slipping_encoder": Kind(one("slip"), start=3e-4, most=0.1),
}
# types that a rigid band cannot show, and one whose geometry cannot be estimated: why they are not in this study
ELSEWHERE = {
    "drive_flexibility": "in `closing_the_loop_over_frequency.py`",
    "joint_flexibility": "in `closing_the_loop_over_frequency.py`",
    "base_flexibility": "in `closing_the_loop_over_frequency.py`",
    "stiffness_hardening": "needs a measured torsion: no motor signal in the rigid band holds it",
    "gravity_spring": "declared, its geometry given; no search tries it",
}


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot of the study: the arm that makes the logs, and the friction that it has and declares."""

    name: str
    arm: ind.Arm
    coulomb: tuple[float, ...]
    viscous: tuple[float, ...]


def subject(name: str) -> Subject:
    if name == "ur10":
        return Subject(name, ind.ur10(), (10.0, 10.0, 6.0, 1.5, 1.5, 1.0), (20.0, 20.0, 12.0, 3.0, 3.0, 2.0))
    if name == "panda":
        return Subject(name, ind.panda(), (2.0, 2.0, 1.5, 1.5, 1.0, 0.8, 0.6), (4.0, 4.0, 3.0, 3.0, 1.5, 1.2, 1.0))
    return Subject(name, ind.rx90b(), (17.4, 16.7, 5.6, 4.6, 1.6, 0.8), (45.7, 42.7, 14.5, 11.8, 4.1, 2.1))


ROBOTS = ("ur10", "panda", "rx90b")


def with_links_off(arm: ind.Arm, rng: np.random.Generator) -> ind.Arm:
    """The arm with every link's inertia off by its own factor."""
    model = arm.model.copy()
    for i, inertia in enumerate(model.inertias):
        factor = 1.0 + LINKS_OFF * rng.uniform(-1.0, 1.0)
        model.inertias[i] = pin.Inertia(factor * inertia.mass, inertia.lever, factor * inertia.inertia)
    return ind.Arm(arm.urdf, model)


def within_limits(
    run: log_effects.Experiment, model: pin.Model, rng: np.random.Generator, seconds: float
) -> log_effects.Experiment:
    """An experiment whose joints keep to their speeds and ranges."""
    m = run.motion(np.arange(0.0, seconds, 0.01))
    half = 0.5 * np.minimum(model.upperPositionLimit - model.lowerPositionLimit, 2 * np.pi)
    middle = np.clip(0.5 * (model.upperPositionLimit + model.lowerPositionLimit), -np.pi, np.pi)
    reach = np.abs(m.q - run.centre).max(axis=0)
    scale = np.minimum(SPEED * model.velocityLimit / np.abs(m.v).max(axis=0), RANGE * half / reach)
    room = RANGE * half - scale * reach
    return replace(run, size=run.size * scale, centre=middle + rng.uniform(-1.0, 1.0, len(half)) * room)


@dataclass(frozen=True, eq=False)
class Hidden:
    """One effect to hide: its type, place (joint numbers) and values at size 1."""

    kind: str
    place: tuple[int, ...]
    sizes: dict[str, Any]
    shapes: dict[str, Any]

    def values(self, size: float) -> dict[str, Any]:
        scaled = {name: (size * np.asarray(x)).tolist() for name, x in self.sizes.items()}
        values = scaled | self.shapes
        if self.kind == "presliding_friction":
            values["stiffness"] = values["torque"] / values.pop("deflection")
        return values


@dataclass(frozen=True, eq=False)
class Scene:
    """An arm, its experiments, and the noise of their logs: all that a run draws before the effect."""

    subject: Subject
    arm: ind.Arm
    tip: str
    experiments: tuple[log_effects.Experiment, ...]
    noise: tuple[tuple[Array, Array], ...]  # of position and torque, as white numbers of unit variance
    time: Array

    @staticmethod
    def draw(rng: np.random.Generator, robot: str, known_links: bool) -> Scene:
        base = subject(robot)
        arm = base.arm if known_links else with_links_off(base.arm, rng)
        tip = declared_robot(robot, (), known_links).tip_frame
        time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
        runs, noise = [], []
        for _ in ROLES:
            run = log_effects.Experiment.draw(rng, SECONDS, 1.0, base.coulomb, base.viscous)
            runs.append(within_limits(run, arm.model, rng, SECONDS))
            size = (len(time), len(arm.joints))
            noise.append((rng.normal(size=size), rng.normal(size=size)))
        return Scene(base, arm, tip, tuple(runs), tuple(noise), time)

    def without(self, friction: Sequence[str], joint: int) -> Scene:
        """The same scene, one joint without some friction."""
        keep = np.arange(len(self.arm.joints)) != joint
        change: dict[str, Array] = {}
        if "coulomb_friction" in friction:
            change["coulomb"] = self.experiments[0].coulomb * keep
        if "viscous_friction" in friction:
            change["viscous"] = self.experiments[0].viscous * keep
        return replace(self, experiments=tuple(replace(e, **change) for e in self.experiments))

    @property
    def sensor_noise(self) -> Array:
        """Root mean square noise of each joint's torque, as logged, N m."""
        torque = np.concatenate([e.torque(self.arm, self.time[::4]) for e in self.experiments])
        return TORQUE_NOISE * np.sqrt((torque**2).mean(axis=0))

    def torque_of(self, hidden: Hidden, size: float, run: log_effects.Experiment) -> ind.Torque:
        """An effect that is a torque beside the others."""
        p = hidden.values(size)
        if hidden.kind == "base_tilt":
            return ind.tilted(self.arm, p["angle_x"], p["angle_y"])
        if hidden.kind == "payload":
            return ind.carrying(self.arm, self.tip, p["mass"], p["centre"])
        if hidden.kind == "contact":
            place = self.arm.model.getFrameId(self.tip)
            data = self.arm.model.createData()
            x = []
            for q in run.motion(self.time[::20]).q:
                pin.forwardKinematics(self.arm.model, data, q)
                x.append(pin.updateFramePlacement(self.arm.model, data, place).translation[0])
            return ind.pressing(self.arm, self.tip, p["stiffness"], float(np.quantile(x, p["quantile"])))
        if hidden.kind == "angle_dependent_friction":
            return ind.angle_dependent_friction(*hidden.place, p["coefficient"])
        return ind.hidden(hidden.kind, hidden.place if len(hidden.place) == 2 else hidden.place[0], p)

    def logs(self, hidden: Sequence[tuple[Hidden, float]]) -> tuple[Recording, ...]:
        """Recordings with effects of given sizes; at most one of them stands between robot and log."""
        sensor = self.sensor_noise
        between = [(h, s) for h, s in hidden if h.kind in (*log_effects.BETWEEN, "slipping_encoder")]
        beside = [(h, s) for h, s in hidden if (h, s) not in between]
        out = []
        for i, (run, role, (on_angle, on_torque)) in enumerate(zip(self.experiments, ROLES, self.noise, strict=True)):
            loaded = replace(run, more=tuple(self.torque_of(h, s, run) for h, s in beside))
            position, torque = loaded.motion(self.time).q, None
            if between:
                ((effect, size),) = between
                joint = effect.place[0] if effect.place else None
                position, torque = log_effects.log(effect.kind, self.arm, loaded, self.time, joint, effect.values(size))
            if torque is None:
                torque = loaded.torque(self.arm, self.time)
            out.append(
                Recording(
                    name=f"run_{i + 1}",
                    role=role,  # type: ignore[arg-type]
                    time=self.time,
                    sample_rate_hz=RATE_HZ,
                    joints=self.arm.joints,
                    position=position + POSITION_NOISE * on_angle,
                    torque=torque + sensor * on_torque,
                )
            )
        return tuple(out)


def declared_robot(name: str, absent: Sequence[tuple[str, str]], known_links: bool) -> Robot:
    """The robot as its file declares it: friction on every joint, less what is absent (type, joint)."""
    arm = subject(name).arm
    tables = [
        {"type": kind, "joint": j}
        for j in arm.joints
        for kind in ("coulomb_friction", "viscous_friction")
        if (kind, j) not in absent
    ]
    with tempfile.TemporaryDirectory() as folder:
        return rf.load_robot(ind.write_robot(Path(folder), arm, tables, known_links))


@dataclass(frozen=True, eq=False)
class Measured:
    """Mean square residual of the declared model, identified, a joint; (joints,), (N m)^2."""

    robot: Robot

    def residual_power(self, recordings: Sequence[Recording]) -> Array:
        regression = Regression.of(self.robot, recordings[:2], CUTOFF_HZ)
        fit_links = self.robot.inertial_parameters == "fitted"
        model = identify(regression, regression.robot.effects, fit_links=fit_links, with_covariance=False)
        return np.asarray((model.residual**2).mean(axis=0))


def excess(power: Array, floor: Array) -> float:
    """Strength: residual power beyond the floor over the floor, on the joint that shows most of it."""
    return float((power / floor - 1.0).max())


def sized(scene: Scene, hidden: Hidden, robot: Robot, strength: float, most: float, start: float) -> float | None:
    """Size at which a hidden effect has the strength, to 5 %; None where it cannot within `most`."""
    measure = Measured(robot)
    floor = measure.residual_power(scene.logs([]))
    size = min(start, most)
    for _ in range(5):
        reached = excess(measure.residual_power(scene.logs([(hidden, size)])), floor)
        if abs(reached / strength - 1.0) < 0.05:
            return size
        step = np.clip(np.sqrt(strength / max(reached, 1e-3)), 0.02, 50.0)
        if size * step > most:
            return None
        size *= float(step)
    return size


def places(kind: Kind, joints: int, rng: np.random.Generator) -> list[tuple[int, ...]]:
    """Where an effect may be hidden, in drawn order."""
    if kind.on in ("robot", "frame"):
        return [()]
    if kind.on == "pair":
        pairs = list(itertools.combinations(range(joints), 2))
        return [pairs[i] for i in rng.permutation(len(pairs))]
    single: list[tuple[int, ...]] = [(int(j),) for j in rng.permutation(joints)]
    return [(), *single] if kind.on == "robot or joint" and rng.random() < 0.5 else single


@dataclass(frozen=True)
class Case:
    """One run of a study; `name` is an effect type, two of them with a plus, or what is outside the catalogue."""

    study: str
    name: str
    strength: float
    seed: int

    @property
    def key(self) -> str:
        return f"{self.study}/{self.name}/{self.strength:g}/{self.seed}"


def raw_start(scene: Scene, hidden: Hidden, strength: float) -> tuple[float, float]:
    """A size to begin with, and the largest believable one, from the torque of size 1."""
    run = scene.experiments[0]
    plain = run.motion(scene.time)
    torque = run.torque(scene.arm, scene.time)
    rms = np.sqrt((torque**2).mean(axis=0))
    if hidden.kind == "motor_saturation":
        c = 1.0 / (np.abs(torque[:, hidden.place[0]]).max() ** 2)
        return 0.02 * c, 0.14 * c
    if hidden.kind in log_effects.BETWEEN:
        changed = log_effects.log(hidden.kind, scene.arm, run, scene.time, hidden.place[0], hidden.values(1.0))[1]
        own = np.sqrt(((changed - torque) ** 2).mean(axis=0))
    else:
        own = np.sqrt((scene.torque_of(hidden, 1.0, run)(plain, scene.arm.torque(plain)) ** 2).mean(axis=0))
    shown = float((own / rms).max())
    return 1.5 * 0.5 * TORQUE_NOISE * np.sqrt(strength) / shown, MOST / shown


def hide(scene: Scene, name: str, kind: Kind, strength: float, rng: np.random.Generator) -> tuple[Any, ...] | None:
    """Draw place and values and set the size: (hidden, size, scene, what is not declared), or None if it shows nowhere."""
    for place in places(kind, len(scene.arm.joints), rng):
        hidden = Hidden(name, place, kind.sizes(rng), kind.shapes(rng))
        absent = tuple((a, scene.arm.joints[place[0]]) for a in kind.absent)
        here = scene.without(kind.absent, place[0]) if absent else scene
        robot = declared_robot(scene.subject.name, absent, kind.known_links)
        fixed = kind.start is not None and np.isfinite(kind.start) and kind.start != 1.0
        start, most = (kind.start, np.inf) if fixed else raw_start(here, hidden, strength)
        size = sized(here, hidden, robot, strength, min(kind.most, most), float(start))  # type: ignore[arg-type]
        if size is not None:
            return hidden, size, here, absent
    return None


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a run closes the loop on: the robot as declared, its campaign, and what was hidden; `skipped` says why there is none."""

    robot: Robot
    campaign: Campaign
    scene: Scene
    hidden: tuple[tuple[Hidden, float], ...]


def draw(case: Case) -> Drawn | str:
    """The drawn campaign of a run, or what could not be hidden."""
    rng = np.random.default_rng([case.seed, *case.key.rsplit("/", 1)[0].encode()])
    names = [] if case.study == "nothing" else case.name.split("+")
    kinds = {**KINDS, **OUTSIDE_KINDS}
    known_links = any(kinds[n].known_links for n in names)
    robot_name = ROBOTS[int(rng.integers(len(ROBOTS)))]
    scene = Scene.draw(rng, robot_name, known_links)
    hidden: list[tuple[Hidden, float]] = []
    absent: tuple[tuple[str, str], ...] = ()
    for name in names:
        kind = replace(kinds[name], known_links=known_links)
        made = hide(scene, name, kind, case.strength, rng)
        if made is None:
            return f"{name} shows nowhere on {robot_name} at strength {case.strength:g}"
        new, size, scene, gone = made
        hidden.append((new, size))
        absent += gone
    campaign = Campaign(
        Path(case.key),
        robot_name,
        robot_name,
        RATE_HZ,
        scene.arm.joints,
        scene.logs(hidden),
        CUTOFF_HZ,
        tuple(scene.sensor_noise.tolist()),
    )
    return Drawn(declared_robot(robot_name, absent, known_links), campaign, scene, tuple(hidden))


def run_case(case: Case) -> dict[str, Any]:
    """One run: draw, hide, close the loop, and compare."""
    began = clock.process_time()
    drawn = draw(case)
    if isinstance(drawn, str):
        return vars(case) | {"skipped": drawn}
    scene, joints = drawn.scene, drawn.scene.arm.joints
    result = rf.close_loop(drawn.campaign, robot=drawn.robot)
    on_validation = [n for (_, n), role in zip(scene.noise, ROLES, strict=True) if role == "validation"]
    floor = lowpassed_rms(scene.sensor_noise * np.concatenate(on_validation))
    found = [
        {
            "type": e.effect.type_name(),
            "joints": list(e.effect.joints),
            "parameters": {p.name: [p.value, p.std] for p in e.parameters},
            "p_value": e.p_value,
        }
        for e in result.effects
    ]
    before, after = (np.array(r.validation.torque_rms) / floor for r in (result.before, result.after))
    return vars(case) | {
        "robot": scene.subject.name,
        "hidden": [
            {"type": h.kind, "joints": [joints[i] for i in h.place], "values": h.values(size)}
            for h, size in drawn.hidden
        ],
        "found": found,
        "verdict": result.verdict,
        "before_over_floor": before.round(4).tolist(),
        "after_over_floor": after.round(4).tolist(),
        "held_out": float(np.sqrt(np.mean(after**2))),
        "unexplained": [[d.joint, d.signal, round(d.score, 3)] for d in result.unexplained.where[:3]],
        "seconds": round(clock.process_time() - began, 2),
    }


def lowpassed_rms(x: Array) -> Array:
    """Root mean square after INTERFACE.md's zero-phase low-pass, made with SciPy alone; (joints,)."""
    sos = signal.butter(4, CUTOFF_HZ, fs=RATE_HZ, output="sos")
    return np.asarray(np.sqrt((signal.sosfiltfilt(sos, x, axis=0) ** 2).mean(axis=0)))


# ---- what came out ------------------------------------------------------------------------------------------


def same(hidden: Mapping[str, Any], found: Mapping[str, Any]) -> bool:
    return hidden["type"] == found["type"] and hidden["joints"] == found["joints"]


def right(row: Mapping[str, Any]) -> bool:
    """Exactly what was hidden was found."""
    return len(row["found"]) == len(row["hidden"]) and all(any(same(h, f) for f in row["found"]) for h in row["hidden"])


def among(row: Mapping[str, Any]) -> bool:
    """What was hidden was found, whatever else was."""
    return all(any(same(h, f) for f in row["found"]) for h in row["hidden"])


def deviations(row: Mapping[str, Any]) -> list[float]:
    """Errors of the parameters of effects that were found where they are, over their standard deviations."""
    out = []
    for h in row["hidden"]:
        for f in (f for f in row["found"] if same(h, f)):
            for name, true in h["values"].items():
                values = true if isinstance(true, list) else [true]
                names = [name] if len(values) == 1 else [f"{name}_{i + 1}" for i in range(len(values))]
                for n, x in zip(names, values, strict=True):
                    value, std = f["parameters"].get(n, (None, None))
                    if value is None or not std:
                        continue
                    error = value - x
                    error = (error + np.pi) % (2 * np.pi) - np.pi if n == "phase" else error
                    out.append(float(error / std))
            break
    return out


def rate(good: int, total: int) -> str:
    """Share with its 95 % interval (Clopper and Pearson)."""
    if not total:
        return "-"
    interval = stats.binomtest(good, total).proportion_ci()
    return f"{good}/{total} ({100 * interval.low:.0f}-{100 * interval.high:.0f} %)"


def mistakes(rows: Sequence[Mapping[str, Any]]) -> str:
    """What was named where it should not have been, most frequent first."""
    count: dict[str, int] = {}
    for row in rows:
        if not right(row):
            text = (
                " + ".join(f["type"] for f in row["found"] if not any(same(h, f) for h in row["hidden"])) or "nothing"
            )
            count[text] = count.get(text, 0) + 1
    return ", ".join(f"{text} ({n})" for text, n in sorted(count.items(), key=lambda item: -item[1])[:3])


def hidden_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line a type and strength, then one a strength over all types."""
    lines = [
        "| hidden | strength | right | among those found | within | held out | else named |",
        "|---|---|---|---|---|---|---|",
    ]
    singles = [r for r in rows if r["study"] == "hidden"]
    groups = sorted({(r["name"], r["strength"]) for r in singles})
    strengths = sorted({s for _, s in groups})
    for name, strength in [*groups, *(("all types", s) for s in strengths)]:
        these = [r for r in singles if r["strength"] == strength and name in (r["name"], "all types")]
        z = [x for r in these for x in deviations(r)]
        within = sum(abs(x) <= DEVIATIONS for x in z)
        held = sum(r["held_out"] <= NEAR_FLOOR for r in these)
        lines.append(
            f"| {name} | {strength:g} | {rate(sum(map(right, these)), len(these))} | {sum(map(among, these))}/{len(these)}"
            f" | {within}/{len(z)} | {held}/{len(these)} | {mistakes(these) if name != 'all types' else ''} |"
        )
    return lines


def left_out(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What could not be hidden, a sentence each."""
    skipped: dict[str, int] = {}
    for r in rows:
        if "skipped" in r:
            skipped[r["skipped"]] = skipped.get(r["skipped"], 0) + 1
    return [f"Left out {n} times: {text}." for text, n in skipped.items()]


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The study in Markdown."""
    done = [r for r in rows if "skipped" not in r]
    lines = ["# Hidden effect against found effect", ""]
    lines += [
        "Right: the effects found are the one hidden, on its joint, and no other. Within: parameters less than",
        f"{DEVIATIONS:g} standard deviations off. Held out: runs whose error on held-out data is at most {NEAR_FLOOR:g} times",
        "the noise floor (root mean square over joints).",
        "Rates with their 95 % intervals. Data: torque over time, made without the package.",
        "",
        *hidden_table(done),
    ]
    strengths = sorted({r["strength"] for r in done if r["study"] == "hidden"})
    lines += ["", "| study | strength | rate |", "|---|---|---|"]
    for strength in strengths:
        pairs = [r for r in done if r["study"] == "pair" and r["strength"] == strength]
        if pairs:
            lines.append(f"| two at once, both found | {strength:g} | {rate(sum(map(among, pairs)), len(pairs))} |")
            lines.append(
                f"| two at once, both and nothing else | {strength:g} | {rate(sum(map(right, pairs)), len(pairs))} |"
            )
    none = [r for r in done if r["study"] == "nothing"]
    if none:
        lines.append(f"| nothing hidden, nothing added | | {rate(sum(not r['found'] for r in none), len(none))} |")
    for name in OUTSIDE:
        for strength in sorted({r["strength"] for r in done if r["name"] == name}):
            these = [r for r in done if r["name"] == name and r["strength"] == strength]
            honest = sum(r["verdict"] in ("unexplained", "partly_explained") for r in these)
            lines.append(f"| outside: {name}, not called explained | {strength:g} | {rate(honest, len(these))} |")
    lines += ["", *left_out(rows)]
    lines += ["", "Not in this study:", "", *(f"- `{name}`: {why}" for name, why in ELSEWHERE.items())]
    return "\n".join(lines) + "\n"


# ---- running ------------------------------------------------------------------------------------------------


def pair_names(count: int) -> list[str]:
    """Pairs of types, drawn once for all: the first acts beside the links, the second anywhere but on their sum."""
    rng = np.random.default_rng(0)
    first = [n for n in ADDITIVE if n not in ("payload",)]
    second = [n for n in KINDS if n not in ("payload", "torque_delay", "motor_saturation")]
    out: list[str] = []
    while len(out) < count:
        a, b = str(rng.choice(first)), str(rng.choice(second))
        if a != b and f"{a}+{b}" not in out:
            out.append(f"{a}+{b}")
    return out


def cases(studies: Sequence[str], types: Sequence[str], strengths: Sequence[float], seeds: int) -> Iterator[Case]:
    """Runs in an order in which every part of the study grows alike."""
    for seed in range(seeds):
        if "hidden" in studies:
            for strength in sorted(strengths, reverse=True):
                yield from (Case("hidden", name, strength, seed) for name in types if strength > 1.0)
        if "outside" in studies:
            yield from (Case("outside", name, s, seed) for name in OUTSIDE for s in strengths if s > 1.0)
        if "pair" in studies:
            yield from (Case("pair", name, 10.0, seed) for name in pair_names(10))
        if "nothing" in studies:
            yield from (Case("nothing", "nothing", 0.0, 20 * seed + i) for i in range(20))
    if "hidden" in studies:
        for seed, strength in itertools.product(range(seeds), (s for s in strengths if s <= 1.0)):
            yield from (Case("hidden", name, strength, seed) for name in types)


def finished(path: Path) -> list[dict[str, Any]]:
    """Rows of a file of results; a last line that was cut is left out."""
    rows = []
    for line in path.read_text().splitlines() if path.is_file() else []:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def continued(
    path: Path, every: Iterator[Case], run: Callable[[Case], dict[str, Any]], limit: int, jobs: int
) -> list[dict[str, Any]]:
    """Rows of a file of results, with at most `limit` of the runs that it lacks added to it."""
    rows = finished(path)
    keys = {Case(r["study"], r["name"], r["strength"], r["seed"]).key for r in rows}
    left = list(itertools.islice((c for c in every if c.key not in keys), limit))
    began = clock.monotonic()
    parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
    for number, row in enumerate(parallel(joblib.delayed(run)(case) for case in left), start=1):
        rows.append(row)
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        found = row.get("skipped") or [f"{f['type']}@{','.join(f['joints'])}" for f in row["found"]]
        key = Case(row["study"], row["name"], row["strength"], row["seed"]).key
        print(f"{number}/{len(left)} {clock.monotonic() - began:.0f} s {key} {found}", flush=True)
    return rows


def command(
    doc: str | None,
    studies: Sequence[str],
    types: Sequence[str],
    cases: Callable[[Sequence[str], Sequence[str], Sequence[float], int], Iterator[Case]],
    run: Callable[[Case], dict[str, Any]],
    table: Callable[[Sequence[Mapping[str, Any]]], str],
) -> None:
    """A study as a command: its runs, kept and continued in a file, and its table."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="file of results, one JSON line a run; it is continued")
    parser.add_argument("--table", type=Path, help="file for the table, Markdown")
    parser.add_argument("--studies", nargs="+", default=list(studies), choices=list(studies))
    parser.add_argument("--types", nargs="+", default=list(types), choices=list(types))
    parser.add_argument("--strengths", nargs="+", type=float, default=list(STRENGTHS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--limit", type=int, default=10**9, help="runs at most, this time")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    every = cases(options.studies, options.types, options.strengths, options.seeds)
    rows = continued(options.out, every, run, options.limit, options.jobs)
    text = table(rows)
    print(text)
    if options.table:
        options.table.write_text(text)


if __name__ == "__main__":
    command(__doc__, ("hidden", "pair", "outside", "nothing"), tuple(KINDS), cases, run_case, table)
