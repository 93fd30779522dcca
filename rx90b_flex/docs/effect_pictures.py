"""The gallery: what each effect leaves of a torque, drawn from its class alone, so that a new effect needs no edit here.

An arm moves by a sum of harmonics and rests for a while. A type's columns for that motion, of one joint, are what it adds to the
logged torque; what the joint's basic friction, fitted again, cannot imitate of them is the residual. A type that adds coordinates and
shows in no torque over time is drawn in the frequency response of a drive.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rx90b_flex.default_flexibility import with_default_flexibility
from rx90b_flex.demo import LINES, PERIOD_S, ROBOT, SPEED
from rx90b_flex.effects import Effect, Motion, Sites, catalogue
from rx90b_flex.effects.motion import Array
from rx90b_flex.excitation import harmonic_motion
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.view.axes import AFTER, BEFORE, MEASURED
from rx90b_flex.view.plots import explained

RATE_HZ = 400.0
START_S = 1.5  # until the arm, which begins at rest, has its full speed
REST_S = (6.0, 7.5)  # when the arm stands still
PART = 0.1  # of the torque's root mean square, how large the effect is drawn
BASIC = ("torque_offset", "coulomb_friction", "viscous_friction")
ORDER, NODES, MANY = 6.0, 7, 5
CROWDED, SHORT_S = 300, (4.0, 4.5)  # changes of sign beyond which a part is shown
HZ = np.linspace(3.0, 60.0, 800)


def draw(cls: type[Effect]) -> Figure | None:
    """The picture of an effect type; None where it shows in neither way."""
    robot, motion = _scene()
    sites = Sites(robot.joints, robot.tip_frame)
    places = [] if cls.traits.needs else cls.everywhere(sites)  # what refines another effect is nothing without it
    return _over_time(places[len(places) // 2], robot, motion) if places else _over_frequency(cls)


def save(cls: type[Effect], path: Path) -> bool:
    """Draw a type into a file; False where there is no picture."""
    figure = draw(cls)
    if figure is None:
        return False
    figure.savefig(path, metadata={"Date": None})
    return True


@cache
def _scene() -> tuple[Robot, Motion]:
    """The demonstration's robot; its joints begin at rest, slow down together, rest, and go on."""
    robot = load_robot(ROBOT)
    time = np.arange(round(PERIOD_S * RATE_HZ)) / RATE_HZ
    ends = np.array([0.0, START_S, REST_S[0] - 0.5, REST_S[0], REST_S[1], REST_S[1] + 0.5])
    pace = np.interp(time, ends, [0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    pace = pace**2 * (3.0 - 2.0 * pace)
    along = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]))]) / RATE_HZ
    q, v, a = harmonic_motion(robot.tree, along, np.random.default_rng(3), period_s=PERIOD_S, lines=LINES, speed=SPEED)
    v, a = v * pace[:, None], a * pace[:, None] ** 2 + v * np.gradient(pace, time)[:, None]
    motion = robot.motion(q, v, a, time)
    return robot, dataclasses.replace(motion, effects=tuple(robot.forces))


def _over_time(effect: Effect, robot: Robot, motion: Motion) -> Figure:
    effect = _with_shape(effect, motion)
    columns = effect.columns(motion)
    columns = columns / np.maximum(np.sqrt((columns**2).mean(axis=(0, 1))), 1e-300)
    count = columns.shape[2]
    added = columns @ (np.ones(count) if count < MANY else np.random.default_rng(0).normal(size=count))
    torque = robot.inverse_dynamics(motion.q, motion.v, motion.a)
    joint = int(np.argmax((added**2).mean(axis=0) / (torque**2).mean(axis=0)))
    left = added[:, joint] - _imitated(effect, robot.joints[joint], motion, added[:, joint], joint)
    left *= PART * np.sqrt((torque[:, joint] ** 2).mean()) / max(np.sqrt((left**2).mean()), 1e-300)
    figure = Figure(figsize=(7.6, 2.3), layout="constrained", dpi=100)
    over, against = figure.subplots(1, 2, width_ratios=(1.5, 1.0), sharey=True)
    over.plot(motion.time, left, color=BEFORE, linewidth=0.9)
    over.axvspan(*REST_S, color=MEASURED, alpha=0.2, linewidth=0)
    _labels(over, "time, s (shaded: at rest)", f"residual of {robot.joints[joint]}, N m")
    over.set_ylim(*(np.array([-1.3, 1.3]) * np.quantile(np.abs(left), 0.98)))  # spikes may leave the frame
    if np.count_nonzero(np.diff(np.sign(left))) > CROWDED:
        over.set_xlim(*SHORT_S)
    moving = (motion.time < REST_S[0]) | (motion.time > REST_S[1])
    signals = {"torque, N m": torque[:, joint]}
    for name in dict.fromkeys((robot.joints[joint], *effect.joints)):
        column = robot.joints.index(name)
        signals |= {
            f"{name} velocity, rad/s": motion.v[:, column],
            f"{name} angle, rad": motion.q[:, column],
            f"{name} acceleration, rad/s²": motion.a[:, column],
        }
    best = max(signals, key=lambda name: explained(signals[name][moving], left[moving]))
    against.plot(signals[best][moving], left[moving], ".", color=BEFORE, markersize=1.2, rasterized=True)
    _labels(against, best, "")
    return figure


def _with_shape(effect: Effect, motion: Motion) -> Effect:
    """With shape parameters that a picture can show; a curve gets nodes over the joint's range."""
    for name, p in effect.parameters().items():
        if p.kind == "given" and p.size == 0:
            signal = motion.v if name == "velocities" else motion.q
            of = signal[:, motion.coordinates.index(effect.joints[0])]
            effect = dataclasses.replace(effect, **{p.attribute: tuple(np.linspace(of.min(), of.max(), NODES))})
    starts = effect.shape_search(motion).starts
    if not starts.shape[1]:
        return effect
    names = list(effect.shape_parameters)
    if "order" in names:  # few enough to be seen one by one
        return effect.with_shape(starts[np.argmin(np.abs(starts[:, names.index("order")] - ORDER))])
    return effect.with_shape(starts[len(starts) // 2])


def _imitated(effect: Effect, joint: str, motion: Motion, added: Array, row: int) -> Array:
    """What the basic friction of a joint takes up of a torque, (N,)."""
    known = catalogue()
    others = [n for n in BASIC if n != effect.type_name() and n not in effect.traits.replaces]
    columns = np.hstack([known[name](joint=joint).columns(motion)[:, row] for name in others])  # type: ignore[call-arg]
    return np.asarray(columns @ np.linalg.lstsq(columns, added)[0])


def _over_frequency(cls: type[Effect]) -> Figure | None:
    """Drive point of the second joint with and without the type."""
    base = with_default_flexibility(load_robot(ROBOT).with_effects([]), base=True)
    own = [e for e in base.effects if isinstance(e, cls)]
    if not own:
        return None
    without = base.with_effects([e for e in base.effects if not isinstance(e, cls)])
    figure = Figure(figsize=(7.6, 2.3), layout="constrained", dpi=100)
    ax = figure.subplots()
    for robot, colour, label in ((base, MEASURED, "measured"), (without, AFTER, "model without it")):
        pose = robot.input_matrix @ np.array([0.0, 0.4, 0.9, 0.0, 0.5, 0.0])[: len(robot.joints)]
        ax.semilogy(HZ, np.abs(robot.linearize(pose).frf(HZ)[:, 1, 1]), color=colour, label=label)
    ax.legend(fontsize=8, frameon=False)
    _labels(ax, "frequency, Hz", "|acceleration over torque|\nof joint 2, rad/s² per N m")
    return figure


def _labels(ax: Axes, x: str, y: str) -> None:
    ax.set_xlabel(x, fontsize=8)
    ax.set_ylabel(y, fontsize=8)
    ax.tick_params(labelsize=7)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color="#e6e6e6", linewidth=0.5)
