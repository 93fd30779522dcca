"""The sampling loop between whose parts effects without a compiled law are asked for their forces, and other laws as well."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from rx90b_flex.compiled.controller import RUNNING, Inputs, Lanes, Logs, Loop
from rx90b_flex.compiled.loop import DIVISION
from rx90b_flex.compiled.packed import CHORDS
from rx90b_flex.compiled.parts import begin_all, control_all, finish_all
from rx90b_flex.compiled.step import Extra
from rx90b_flex.effects import Effect
from rx90b_flex.effects.law_effect import remembering
from rx90b_flex.effects.log_effect import LogEffect
from rx90b_flex.effects.motion import Array, Motion
from rx90b_flex.robot import Robot
from rx90b_flex.simulate.cs8 import drive_places


def measurement_errors(robot: Robot, between: Sequence[LogEffect], q: Array, v: Array) -> tuple[Array, Array]:
    """What the resolvers show beyond the drives' angles and speeds, each (lanes, joints)."""
    motion, drives = robot.motion(q, v, np.zeros_like(q)), drive_places(robot)
    errors = [e.measurement_error(motion) for e in between]
    zero = np.zeros((len(q), len(drives)))
    return (
        sum((e[0][:, drives] for e in errors if e is not None), zero),
        sum((e[1][:, drives] for e in errors if e is not None), zero),
    )


class ByParts:
    """Advances the lanes of a robot as `rx90b_flex.compiled.loop.run` does."""

    def __init__(self, robot: Robot, between: Sequence[LogEffect], loop: Loop, lanes: Lanes) -> None:
        self.robot, self.between, self.loop, self.lanes = robot, between, loop, lanes
        self.plant = robot.plant
        self.memory = self.plant.scratch(len(lanes.q))
        self.late_q, self.late_v = np.zeros_like(lanes.q), np.zeros_like(lanes.q)
        rest = robot.motion(lanes.q, lanes.v, lanes.a)
        self.memories = {e: e.memory(rest) for e in remembering(self.plant.others)}
        self.others = [e for e in self.plant.others if e not in self.memories]
        self.shows = any(e.measurement_error(rest) is not None for e in between)

    def advance(self, inputs: Inputs, logs: Logs, samples: int) -> None:
        """All running lanes by that many samples."""
        lanes, loop = self.lanes, self.loop
        torque = np.zeros_like(lanes.q)
        h = loop.period / loop.substeps
        for k in range(samples):
            if self.shows:
                inputs.noise[k] += np.stack(
                    [x.T for x in measurement_errors(self.robot, self.between, lanes.q, lanes.v)]
                )
            control_all(loop, lanes, inputs, logs, k, torque)
            if lanes.status.all():
                return
            for effect in self.between:
                torque[:, loop.drive] = effect.motor_torque(self.robot.joints, torque[:, loop.drive])
            for part in range(loop.substeps):
                kept, known = tuple(x.copy() for x in lanes), dict(self.memories)
                time = (inputs.first + k) * loop.period + part * h
                bend = self._step(torque, time, h)
                if part == 0 and k % logs.stride == 0:
                    running = lanes.status == RUNNING
                    logs.dissipated[running, logs.row + k // logs.stride] = lanes.closed[running]
                if bend > loop.tolerance:
                    for now, before in zip(lanes, kept, strict=True):
                        now[:] = before
                    self.memories = known
                    lanes.divided[:] += 1
                    fine = h / DIVISION
                    for i in range(DIVISION):
                        self.plant.packed.integers[CHORDS] = 1
                        self._step(torque, time + i * fine, fine)
                    self.plant.packed.integers[CHORDS] = 0

    def _step(self, torque: Array, time: float, h: float) -> float:
        """One step of all lanes; returns the largest bend of the laws."""
        plant, lanes, loop, memory = self.plant.packed, self.lanes, self.loop, self.memory
        extra = self._extra(time)
        begin_all(plant, memory, loop, extra, lanes, torque, h, self.late_q, self.late_v)
        late = self._force(self.late_q, self.late_v, lanes.a, time + h)
        return float(finish_all(plant, memory, loop, extra, late, lanes, torque, h))

    def _force(self, q: Array, v: Array, a: Array, time: float) -> Array:
        motion = self.robot.motion(q, v, a, np.full(len(q), time))
        force = np.zeros_like(q)
        for law, memory in self.memories.items():
            force += law.remembered(law.onward(memory, motion), motion)[0]
        for effect in self.others:
            force += effect.force(motion)
        return force

    def _extra(self, time: float) -> Extra:
        """Forces and slopes of the effects at the lanes' states."""
        robot, lanes = self.robot, self.lanes
        times = np.full(len(lanes.q), time)
        motion = robot.motion(lanes.q, lanes.v, lanes.a, times)
        still = robot.motion(lanes.q, np.zeros_like(lanes.v), np.zeros_like(lanes.v), times)
        count, n = lanes.q.shape
        force, lost = np.zeros((count, n)), np.zeros(count)
        slopes = [np.zeros((count, n, n)) for _ in range(3)]
        for law, memory in self.memories.items():
            self.memories[law] = law.onward(memory, motion)
            own, *by = law.remembered(self.memories[law], motion)
            force += own
            for total, slope in zip(slopes, by, strict=False):  # not by the acceleration
                total += slope
            # what the asperities store and give back again is counted as lost
            lost += np.sum(own * motion.v, axis=1)
        for effect in self.others:
            own = effect.force(motion)
            force += own
            for total, slope in zip(slopes, effect.derivatives(motion), strict=True):
                total += slope
            lost += _dissipated(effect, own, motion, still)
        # the compiled step wants the part that does not depend on the acceleration
        force -= np.einsum("lij,lj->li", slopes[2], lanes.a)
        by_q, by_v, by_a = (np.ascontiguousarray(x) for x in slopes)
        return Extra(lost, force, by_a, by_v, by_q)


def _dissipated(effect: Effect, force: Array, motion: Motion, still: Motion) -> Array:
    """Power that an effect without a compiled law takes out of the motion for good, shape (lanes,), W.

    What it asks for beyond its force at rest (which its `potential` holds) and beyond what goes into kinetic energy.
    """
    if effect.traits.part in ("links", "drives"):
        return np.zeros(len(motion))
    if not effect.traits.needs_load:
        force = effect.force(dataclasses.replace(motion, a=np.zeros_like(motion.a)))
    return np.asarray(np.sum((force - effect.force(still)) * motion.v, axis=1))
