"""The perturbation method: a rigid nominal motion, and the linear time-varying system of the vibration about it (section 3.4).

With the nominal motion ``q0 = (e0, 0)`` and ``q = q0 + dq``, equation 3.65 becomes, to first order,

    M(t) d(q'') + D(t) d(q') + K(t) dq = B tau - f(q0, q0', q0''),

with M, D and K of equation 3.90 along the nominal motion and f the inverse dynamics there. tau is the controller's own torque: it
samples nominal + perturbation, with its quantisation, limits and current loop, as in the nonlinear simulation.

All excitations of one nominal motion share M, D and K: the implicit midpoint rule,

    (M + h/2 D + h^2/4 K) v_m = M v + h/2 (B tau - f - K q),   v <- 2 v_m - v,   q <- q + h v_m,

is put into one matrix a step, and a step of all runs is one product of that matrix with the array of their states.

Friction stays as it is: its torque depends on one rate a joint, so that the linear step leaves one scalar equation a joint and step,
``rate + c torque(rate) = b``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.compiled.about_mean import Along, Ports, Steps, make_steps
from rx90b_flex.compiled.controller import Inputs, Logs
from rx90b_flex.compiled.perturbed import Perturbed, advance
from rx90b_flex.compiled.rate_table import CELLS, fill_tables
from rx90b_flex.effects.law import Law
from rx90b_flex.effects.motion import Array
from rx90b_flex.robot import Robot
from rx90b_flex.simulate import closed_loop
from rx90b_flex.simulate.closed_loop import Noise, Progress, Simulation, hermite
from rx90b_flex.simulate.cs8 import CS8, drive_places
from rx90b_flex.simulate.trajectories import Trajectory

Indices = NDArray[np.int64]
Manipulator = Literal["moving", "frozen"]

KNOWN_BYTES = 128e6  # of steps that are kept in case the motion repeats: 97 MB for 4.096 s of 16 coordinates
NEAR_RAD = 0.02  # references that differ by no more are excitations of one nominal motion
PROBES = (-1.3, -0.21, 0.0, 0.37, 2.9)  # rad; a torque that is the same at these angles does not depend on the angle


def perturb_lanes(
    robot: Robot,
    controller: CS8,
    trajectories: Sequence[Trajectory],
    *,
    noise: Noise | None = None,
    rng: np.random.Generator | None = None,
    raw: bool = False,
    manipulator: Manipulator = "moving",
    progress: Progress | None = None,
) -> list[Simulation]:
    """Several runs of one nominal motion by the perturbation method, advanced together.

    Parameters
    ----------
    robot : Robot
    controller : CS8
    trajectories : sequence of Trajectory
        The nominal motion is the mean of their references, which the rigid robot follows if its controller is ideal. The excitations
        are the torques fed forward, and what the references differ by from that mean: at most `NEAR_RAD`.
    noise, rng, raw, progress
        As in `simulate_lanes`.
    manipulator : str
        ``moving``: mass, damping and stiffness matrices follow the nominal motion; ``frozen``: they stay those at rest in its mean
        pose, so that links and hinges are linear and time-invariant, as in section 6.6.6. Friction and springs with a law of
        their own see the motion in either case.

    Returns
    -------
    list of Simulation
        One a trajectory, nominal + perturbation. `Simulation.dissipated` is not known: NaN.

    Raises
    ------
    ValueError
        Trajectories with different references, or that do not fit robot and controller.
    """
    closed_loop._refuse(robot, controller, trajectories, noise, rng, 1)
    _refuse(robot, trajectories)
    own = controller.for_joints(robot.joints)
    job = closed_loop._Job(robot, (), own, tuple(trajectories), noise or Noise(), 1, raw, "identification")
    children = [] if rng is None else rng.spawn(len(trajectories))
    return _PerturbationRunner(job, children, mean_reference(trajectories), manipulator == "frozen").run(progress)


def _refuse(robot: Robot, trajectories: Sequence[Trajectory]) -> None:
    for effect in robot.effects:
        if effect.traits.remembers or not effect.traits.in_dynamics:
            raise ValueError(
                f"{robot.name}: {effect.label} is beyond the perturbation method; simulate the nonlinear robot, or take it out"
            )
    first = trajectories[0]
    for t in trajectories:
        if not np.abs(t.position - first.position).max() <= NEAR_RAD:
            raise ValueError(
                f"trajectory {t.name!r} has other references than {first.name!r}, by more than {NEAR_RAD:g} rad; "
                "the perturbation method takes excitations of one nominal motion"
            )


def mean_reference(trajectories: Sequence[Trajectory]) -> Trajectory:
    """The motion that all are excitations of; their own where they share it, bit by bit."""
    first = trajectories[0]
    if all(np.array_equal(t.position, first.position) for t in trajectories):
        return first
    position, velocity = (np.mean([getattr(t, x) for t in trajectories], axis=0) for x in ("position", "velocity"))
    return dataclasses.replace(first, position=position, velocity=velocity)


# ---- the system along the nominal motion ----------------------------------------------------------------------


def _ports(robot: Robot) -> Ports:
    """The ports of the compiled laws of one rate or angle (friction, hardening), which keep their nonlinearity."""
    laws, n = robot.plant.laws, robot.model.nv
    found: dict[tuple[bytes, int], tuple[Array, list[int]]] = {}
    for m in np.flatnonzero(laws.address):
        port = np.zeros(n)
        np.add.at(port, laws.place[m], laws.weight[m])
        # friction and springs apart, so that friction depends on the rate alone
        found.setdefault((port.tobytes(), int(laws.stores[m])), (port, []))[1].append(int(m))
    # springs first: what they change is then part of what friction, which may hold a joint, answers to
    ordered = [found[key] for key in sorted(found, key=lambda key: -key[1])]
    vectors = [port for port, _ in ordered]
    lists = [own for _, own in ordered]
    start = np.cumsum([0, *(len(own) for own in lists)])
    law = np.array([m for own in lists for m in own], dtype=np.int64)
    vector = np.stack(vectors, axis=1) if vectors else np.zeros((n, 0))
    start = np.asarray(start, dtype=np.int64)
    tabulated, table = np.zeros(len(lists), dtype=np.int64), np.zeros((len(lists), 2 * CELLS, 4))
    fill_tables(laws, start, law, np.array(PROBES), tabulated, table)
    return Ports(np.ascontiguousarray(vector), start, law, tabulated, table)


class _Along:
    """M, D, K and the nominal motion, chunk by chunk."""

    def __init__(self, robot: Robot, nominal: Trajectory, up: int, frozen: bool) -> None:
        self.robot, self.rate_hz, self.up = robot, nominal.rate_hz, up
        self.position, self.velocity = nominal.position, nominal.velocity
        self.pose = self.position.mean(axis=0) if frozen else None
        self.drives = drive_places(robot)
        self.acceleration = np.gradient(self.velocity, 1.0 / self.rate_hz, axis=0)
        laws, n = robot.plant.laws, robot.model.nv
        self.constant = [np.zeros((n, n)) for _ in range(3)]
        for m in range(len(laws.inertia)):
            port = np.zeros(n)
            np.add.at(port, laws.place[m], laws.weight[m])
            for total, value in zip(self.constant, (laws.stiffness, laws.damping, laws.inertia), strict=True):
                total += value[m] * np.outer(port, port)

    def nodes(self, rows: Indices) -> Array:
        """M, D and K without the compiled laws' functions at samples of the nominal motion, (len(rows), 3, n, n)."""
        rows = np.minimum(rows, len(self.position) - 1)
        state = [x[rows] for x in (self.position, self.velocity, self.acceleration)]
        if self.pose is not None:
            state = [np.tile(self.pose, (len(rows), 1)), *(np.zeros_like(x) for x in state[1:])]
        q, v, a = (self._whole(x) for x in state)
        motion = self.robot.motion(q, v, a, rows / self.rate_hz)
        totals = [own + fixed for own, fixed in zip(motion.on_tree.derivatives(), self.constant, strict=True)]
        for effect in (*self.robot.plant.others, *self.robot.plant.in_tree):
            for total, own in zip(totals, effect.derivatives(motion), strict=True):
                total += own
        return np.stack(totals[::-1], axis=1)

    def key(self, rows: Indices) -> bytes:
        """Of the nominal motion at samples: the same where it is the same."""
        rows = np.minimum(rows, len(self.position) - 1)
        return b"".join(x[rows].tobytes() for x in (self.position, self.velocity, self.acceleration))

    def at_samples(self, rows: Indices) -> tuple[Array, Array]:
        """Nominal coordinates and rates at the controller's samples and at the end, each (len(rows) * up + 1, n)."""
        x, v, _ = hermite(self.position, self.velocity, rows, np.arange(self.up) / self.up, self.rate_hz)
        end_x, end_v, _ = hermite(self.position, self.velocity, rows[-1:], np.ones(1), self.rate_hz)
        return self._whole(np.concatenate([x, end_x])), self._whole(np.concatenate([v, end_v]))

    def between(self, rows: Indices) -> tuple[Array, Array, Array]:
        """Coordinates, rates and accelerations in the middle of each sample, each (len(rows) * up, n)."""
        part = (np.arange(self.up) + 0.5) / self.up
        x, v, a = (self._whole(y) for y in hermite(self.position, self.velocity, rows, part, self.rate_hz))
        return x, v, a

    def other_forces(self, x: Array, v: Array, a: Array, first: int, period: float) -> Array:
        """Forces of the effects without a compiled law along the nominal motion, shape of x."""
        if not self.robot.plant.others:
            return np.zeros_like(x)
        time = np.asarray((first + np.arange(len(x)) + 0.5) * period, dtype=np.float64)
        motion = self.robot.motion(x, v, a, time)
        return np.ascontiguousarray(sum(effect.force(motion) for effect in self.robot.plant.others))

    def _whole(self, of_drives: Array) -> Array:
        out = np.zeros((len(of_drives), self.robot.model.nv))
        out[:, self.drives] = of_drives
        return out


# ---- the runner -----------------------------------------------------------------------------------------------


class _PerturbationRunner(closed_loop._Runner):
    """The nonlinear runner with its integrator replaced: inputs, noise, filter, log and results are the same."""

    def __init__(
        self, job: closed_loop._Job, children: Sequence[np.random.Generator], nominal: Trajectory, frozen: bool
    ) -> None:
        super().__init__(job, children)
        self.ports = _ports(job.robot)
        self.along = _Along(job.robot, nominal, self.up, frozen)
        q, v = self.along.at_samples(np.array([0]))
        angle = np.ascontiguousarray(self.lanes.q[:, self.loop.drive].T)
        y = np.concatenate([(self.lanes.v - v[0]).T, (self.lanes.q - q[0]).T, self.lanes.held])
        n, lanes = len(v[0]), len(job.trajectories)
        self.state = Perturbed(y, np.zeros((n, lanes)), np.zeros((self.ports.vector.shape[1], lanes)), angle)
        self.known: dict[bytes, Steps] = {}

    def _step_compiled(self, laws: Sequence[Law]) -> None:
        """Nothing: the lanes stay in the robot's coordinates."""

    def _advance(self, inputs: Inputs, logs: Logs, samples: int) -> None:
        steps = self._steps(inputs.first, samples)
        laws = self.plant.laws
        advance(laws, self.ports, self.loop, self.lanes, inputs, logs, steps, self.state, samples)

    def _steps(self, first: int, samples: int) -> Steps:
        """The linear system of a chunk; a nominal motion that repeats comes back to the same steps."""
        along, plant = self.along, self.plant
        rows = np.arange(first // self.up, (first + samples) // self.up)
        key = along.key(np.append(rows, rows[-1] + 1))
        if key in self.known:
            return self.known[key]
        q, v = along.at_samples(rows)
        middle = np.stack(along.between(rows), axis=1)
        other = along.other_forces(middle[:, 0], middle[:, 1], middle[:, 2], first, self.loop.period)
        chunk = Along(along.nodes(np.append(rows, rows[-1] + 1)), q, v, middle, other)
        steps = _room(samples, q.shape[1], len(self.loop.drive), self.ports.vector.shape[1])
        make_steps(
            plant.tree, plant.laws, self.ports, self.memory[0], self.loop.drive, self.loop.period, self.up, chunk, steps
        )
        # effects without a compiled law may depend on time
        if not plant.others and (len(self.known) + 1) * sum(x.nbytes for x in steps) < KNOWN_BYTES:
            self.known[key] = steps
        return steps

    def _result(self, *args: object) -> Simulation:
        result = super()._result(*args)  # type: ignore[arg-type]
        return dataclasses.replace(result, dissipated=np.full_like(result.dissipated, np.nan))


def steps_bytes(robot: Robot, controller: CS8, reference: Trajectory) -> float:
    """Bound of the memory of the steps along a nominal motion: those that are kept, and those of a chunk in work, bytes."""
    n, joints = robot.model.nv, len(robot.joints)
    one = sum(x.nbytes for x in _room(1, n, joints, _ports(robot).vector.shape[1]))
    chunk = one * closed_loop.CHUNK_S * controller.controller_rate_hz
    # chunks at the ends of a run differ from those inside, since the nominal acceleration does
    once = one * reference.duration_s * controller.controller_rate_hz + 2.0 * chunk
    return min(KNOWN_BYTES, once) + 2.0 * chunk


def _room(samples: int, n: int, joints: int, ports: int) -> Steps:
    """Steps that are still to be filled."""
    shapes = [(n,), (n,), (n, 2 * n + joints), (n,), (n, ports), (ports,), (ports,), (ports, ports)]
    return Steps(*(np.empty((samples, *shape)) for shape in shapes))
