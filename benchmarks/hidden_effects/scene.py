"""What a run draws: an arm, its motions, the noise of their logs, what hides in it, and how strong that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
from independent import Array, Motion
from scipy import signal

from hidden_effects.arms import Subject, declared_robot, subject, with_links_off
from hidden_effects.friction import DEFLECTIONS, dry
from hidden_effects.kinds import KINDS, OUTSIDE_KINDS, Kind, drawn, places
from hidden_effects.motions import Experiment, spectral
from hidden_effects.physics import Hidden, Plant
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign, Recording

RATE_HZ, CUTOFF_HZ, PERIOD_S, PERIODS = 250.0, 20.0, 10.0, 2
THIN = 5  # of the samples of a period, every one that the strength is measured on
ROLES = ("identification", "identification", "validation")
TORQUE_NOISE = 0.004  # of a joint's root mean square torque, after the low-pass
POSITION_NOISE = 2e-6  # rad
MEMORY = 0.95  # of coloured noise, from one sample to the next
WITH_RESTS = 0.25  # of the runs
MOST = 0.7  # of a joint's root mean square torque: an effect that needs more to show does not show
NEAR = 0.05  # of the strength: how well it is met


@dataclass(frozen=True)
class Conditions:
    """How a run is logged: colour of the torque's noise, steps of the positions (0: fine), whether the period is stated."""

    colour: str = "white"
    step_rad: float = 0.0
    period_stated: bool = True


@dataclass(frozen=True, eq=False)
class Scene:
    """An arm, its experiments and the noise of their logs: all that a run draws before the effect."""

    subject: Subject
    plant: Plant
    experiments: tuple[Experiment, ...]
    noise: tuple[tuple[Array, Array], ...]  # of position and torque, unit variance (the latter's after the low-pass)
    conditions: Conditions
    known_links: bool

    @staticmethod
    def draw(
        rng: np.random.Generator, robot: str, form: str, conditions: Conditions, known_links: bool, rests: bool
    ) -> Scene:
        base = subject(robot)
        arm = base.arm if known_links else with_links_off(base.arm, rng)
        deflections = tuple(float(np.exp(rng.uniform(*np.log(d)))) for d in DEFLECTIONS)
        tip = declared_robot(robot, (), known_links).tip_frame
        plant = Plant(arm, tip, form, np.array(base.coulomb), np.array(base.viscous), deflections)
        pauses = bool(rng.random() < WITH_RESTS) or rests
        runs, noise = [], []
        size = (round(PERIOD_S * PERIODS * RATE_HZ), len(arm.joints))
        for _ in ROLES:
            runs.append(Experiment.draw(rng, arm.model, PERIOD_S, pauses))
            noise.append((rng.normal(size=size), coloured(rng, size, conditions.colour)))
        return Scene(base, plant, tuple(runs), tuple(noise), conditions, known_links)

    @property
    def joints(self) -> tuple[str, ...]:
        return self.plant.arm.joints

    def without(self, friction: Sequence[str], joint: int) -> Scene:
        """The same scene, one joint without some friction."""
        keep = np.arange(len(self.joints)) != joint
        plant = self.plant
        if "coulomb_friction" in friction:
            plant = replace(plant, coulomb=plant.coulomb * keep)
        if "viscous_friction" in friction:
            plant = replace(plant, viscous=plant.viscous * keep)
        return replace(self, plant=plant)

    @cached_property
    def rms(self) -> Array:
        """Root mean square torque of each joint with nothing hidden, N m."""
        torque = np.concatenate([self.plant.logged(e, RATE_HZ, 1)[1] for e in self.experiments])
        return np.asarray(np.sqrt((torque**2).mean(axis=0)))

    @property
    def floor(self) -> Array:
        """Root mean square noise of each joint's torque after the low-pass, N m."""
        return TORQUE_NOISE * self.rms

    def recordings(self, hidden: Sequence[tuple[Hidden, float]]) -> tuple[Recording, ...]:
        """The logs with effects of given sizes."""
        plant, out = self.plant.with_hidden(hidden), []
        for i, (run, role, (on_angle, on_torque)) in enumerate(zip(self.experiments, ROLES, self.noise, strict=True)):
            position, torque = plant.logged(run, RATE_HZ, PERIODS)
            position = position + POSITION_NOISE * on_angle
            step = self.conditions.step_rad
            out.append(
                Recording(
                    name=f"run_{i + 1}",
                    role=role,  # type: ignore[arg-type]
                    time=np.arange(len(torque)) / RATE_HZ,
                    sample_rate_hz=RATE_HZ,
                    joints=self.joints,
                    position=np.round(position / step) * step if step else position,
                    torque=torque + self.floor * on_torque,
                    period_s=PERIOD_S if self.conditions.period_stated else None,
                )
            )
        return tuple(out)

    def campaign(self, hidden: Sequence[tuple[Hidden, float]], name: str) -> Campaign:
        robot = self.subject.name
        return Campaign(Path(name), robot, robot, RATE_HZ, self.joints, self.recordings(hidden), CUTOFF_HZ, None)


def coloured(rng: np.random.Generator, size: tuple[int, int], colour: str, rate_hz: float = RATE_HZ) -> Array:
    """Noise of unit variance after the low-pass, white or first-order autoregressive, (N, n)."""
    memory = MEMORY if colour == "ar" else 0.0
    hz = np.linspace(0.0, rate_hz / 2, 2001)
    density = (1 - memory**2) / np.abs(1 - memory * np.exp(-2j * np.pi * hz / rate_hz)) ** 2
    kept = float((density * lowpass_gain(hz, rate_hz) ** 2).mean())
    driven = rng.normal(size=(size[0] + 400, size[1])) * np.sqrt(1 - memory**2)
    return np.asarray(signal.lfilter([1.0], [1.0, -memory], driven, axis=0)[400:] / np.sqrt(kept))


def lowpass_gain(hz: Array, rate_hz: float = RATE_HZ) -> Array:
    """Of INTERFACE.md's zero-phase low-pass: a Butterworth filter of fourth order, forward and backward."""
    sos = signal.butter(4, CUTOFF_HZ, fs=rate_hz, output="sos")
    return np.asarray(np.abs(signal.sosfreqz(sos, np.minimum(hz, 0.4999 * rate_hz), fs=rate_hz)[1]) ** 2)


def lowpassed(x: Array) -> Array:
    """One period of a signal that repeats, (N, ...), behind the low-pass."""
    gain = lowpass_gain(np.fft.rfftfreq(len(x), 1.0 / RATE_HZ))
    return np.asarray(np.fft.irfft(np.fft.rfft(x, axis=0) * gain[:, None], len(x), axis=0))


# ---- strength --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Measure:
    """What the declared model, identified, leaves of a hidden effect: power over the noise floor's, a joint.

    The declared model is taken with the links' regressor of Pinocchio and with the friction's own form, so that its turn-over costs
    nothing; it is fitted with the noise floor as weights on one period of each identification recording.
    """

    scene: Scene
    absent: tuple[str, ...] = ()
    joint: int = -1

    @cached_property
    def basis(self) -> Array:
        """Orthonormal, of the weighted columns; (rows * joints, rank)."""
        parts = [self._columns(run) for run in self.scene.experiments[:2]]
        x = np.concatenate(parts) / self.scene.floor[:, None]
        flat = x.reshape(-1, x.shape[2])
        length = np.linalg.norm(flat, axis=0)
        left, values, _ = np.linalg.svd(flat[:, length > 0] / length[length > 0], full_matrices=False)
        return np.asarray(left[:, values > 1e-9 * values[0]])

    def _columns(self, run: Experiment) -> Array:
        time = np.arange(round(PERIOD_S * RATE_HZ)) / RATE_HZ
        plant = self.scene.plant
        state = plant.state(run, time)
        n = len(self.scene.joints)
        parts = []
        if not self.scene.known_links:
            model, data = plant.arm.model, plant.arm.model.createData()
            m = Motion(time[::THIN], *(x[::THIN] for x in (state.motor.q, state.motor.v, state.motor.a)))
            rows = zip(m.q, m.v, m.a, strict=True)
            parts.append(np.array([pin.computeJointTorqueRegressor(model, data, q, v, a).copy() for q, v, a in rows]))
        for kind, basis in (("coulomb_friction", lowpassed(state.dry)), ("viscous_friction", state.motor.v)):
            keep = np.arange(n) != (self.joint if kind in self.absent else -1)
            parts.append(basis[::THIN, :, None] * np.diag(keep.astype(float)))
        return np.concatenate(parts, axis=2)

    def excess(self, hidden: Sequence[tuple[Hidden, float]]) -> float:
        """Strength on the joint that shows most of it."""
        plant = self.scene.plant
        left = np.concatenate(
            [self._left(plant.with_hidden(hidden), run)[::THIN] for run in self.scene.experiments[:2]]
        )
        flat = (left / self.scene.floor).reshape(-1)
        flat = flat - self.basis @ (self.basis.T @ flat)
        return float((flat.reshape(left.shape) ** 2).mean(axis=0).max())

    def _left(self, plant: Plant, run: Experiment) -> Array:
        """Logged torque less that of the arm without anything hidden on the logged motion, behind the low-pass."""
        position, torque = plant.logged(run, RATE_HZ, 1)
        plain = self.scene.plant
        state, nominal = plain.torque(run, np.arange(len(torque)) / RATE_HZ)
        moved = position - state.motor.q
        if np.abs(moved).max() > 0:
            moved = lowpassed(moved)
            q, v, a = (spectral(moved, PERIOD_S, k) if k else moved for k in range(3))
            m = Motion(state.motor.time, state.motor.q + q, state.motor.v + v, state.motor.a + a)
            dry_there = dry(plain.form, m.q, m.v, plain.deflections)
            nominal = nominal + plain.arm.torque(m) - state.load
            nominal = nominal + (dry_there - state.dry) * plain.coulomb + v * plain.viscous
        return lowpassed(torque - nominal)


def sized(scene: Scene, hidden: Hidden, measure: Measure, strength: float, kind: Kind) -> float | None:
    """Size at which a hidden effect has the strength, to 5 %; None where it cannot within what is believable."""
    size = min(kind.start, kind.most)
    for _ in range(12):
        reached = measure.excess([(hidden, size)])
        if not np.isfinite(reached):
            size *= 0.3
            continue
        if abs(reached / strength - 1.0) < NEAR:
            return size if size <= kind.most and shows(scene, hidden, size) else None
        step = float(np.clip(np.sqrt(strength / max(reached, 1e-12)), 1e-3, 1e3))
        if size >= kind.most and step > 1.0:
            return None
        size = min(size * step, kind.most)
    return None


def shows(scene: Scene, hidden: Hidden, size: float) -> bool:
    """Whether a hidden effect's torque keeps to a believable part of the joints' torque."""
    run = scene.experiments[0]
    _, torque = scene.plant.with_hidden([(hidden, size)]).logged(run, RATE_HZ, 1)
    own = torque - scene.plant.logged(run, RATE_HZ, 1)[1]
    return bool((np.sqrt((own**2).mean(axis=0)) <= MOST * scene.rms).all())


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a run closes the loop on: the robot as declared, its campaign, and what was hidden."""

    robot: Robot
    campaign: Campaign
    scene: Scene
    hidden: tuple[tuple[Hidden, float], ...]


def hide(
    scene: Scene, name: str, kind: Kind, strength: float, rng: np.random.Generator
) -> tuple[Hidden, float, Scene, tuple[tuple[str, str], ...]] | None:
    """Draw place and values and set the size: (hidden, size, scene, what is not declared), or None if it shows nowhere."""
    for place in places(kind, len(scene.joints), rng):
        hidden = drawn(name, kind, place, rng)
        here = scene.without(kind.absent, place[0]) if kind.absent else scene
        measure = Measure(here, kind.absent, place[0] if kind.absent else -1)
        size = sized(here, hidden, measure, strength, kind)
        if size is not None:
            return hidden, size, here, tuple((a, scene.joints[place[0]]) for a in kind.absent)
    return None


def draw(
    names: Sequence[str],
    robot: str,
    form: str,
    strength: float,
    conditions: Conditions,
    rng: np.random.Generator,
    label: str,
) -> Drawn | str:
    """The drawn campaign of a run, or what could not be hidden."""
    kinds = {**KINDS, **OUTSIDE_KINDS}
    known_links = any(kinds[n].known_links for n in names)
    scene = Scene.draw(rng, robot, form, conditions, known_links, any(kinds[n].rests for n in names))
    hidden: list[tuple[Hidden, float]] = []
    absent: tuple[tuple[str, str], ...] = ()
    for name in names:
        if form in kinds[name].not_with:
            return f"{name} is part of the friction's form {form}"
        made = hide(scene, name, kinds[name], strength, rng)
        if made is None:
            return f"{name} shows nowhere on {robot} at strength {strength:g}"
        new, size, scene, gone = made
        hidden.append((new, size))
        absent += gone
    robot_ = declared_robot(robot, absent, known_links)
    return Drawn(robot_, scene.campaign(hidden, label), scene, tuple(hidden))
