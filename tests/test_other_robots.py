"""Claims that hold for every arm, not for the RX90B alone: five of example-robot-data and a robot file of one's own.

Each arm gets the same effects on every joint, sized by its own URDF (speed and effort limits, rigid inertia), so that nothing here is
tuned to a robot. The recordings are the package's own closed-loop simulations.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from independent import TWO_JOINTS
from marked import by_cost

import rx90b_flex as rf
from rx90b_flex.diagnose.residual import ReplayedTorques
from rx90b_flex.effects import Effect
from rx90b_flex.effects.drive import DriveInertia
from rx90b_flex.effects.flexibility import DriveFlexibility, JointFlexibility
from rx90b_flex.effects.friction import CoulombFriction, StribeckFriction, ViscousFriction
from rx90b_flex.export import save_robot
from rx90b_flex.identify.command import identify_campaign
from rx90b_flex.identify.segment import prepare
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Campaign, load_campaign, write_campaign
from rx90b_flex.simulate import Noise, Simulation, design_cs8, harmonics, rigid_inertia, simulate

ARMS = ("ur10", "panda", "kinova", "xarm7", "tiago", "own_file")

MODES_HZ = 20.0  # of a joint's rigid inertia on its own spring
CUTOFF_HZ = 20.0

OWN_FILE = """
name = "own_file"
urdf = "two_joints.urdf"
tip_frame = "lower"
[[effects]]
type = "drive_inertia"
joint = "shoulder"
inertia = 0.3
[[effects]]
type = "drive_flexibility"
joint = "shoulder"
stiffness = 6.0e3
damping = 6.0
[[effects]]
type = "viscous_friction"
joint = "elbow"
coefficient = 1.5
[[effects]]
type = "joint_flexibility"
joint = "elbow"
stiffness = [8.0e3, 9.0e3]
damping = [8.0, 9.0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("own")


def own_file(folder: Path) -> Robot:
    """As its file declares it: one drive twists, one joint bends."""
    (folder / "two_joints.urdf").write_text(TWO_JOINTS)
    (folder / "own.toml").write_text(OWN_FILE)
    return load_robot(folder / "own.toml")


@cache
def arm(name: str, folder: Path) -> Robot:
    """A rigid arm without effects: grippers, hands, wheels and heads are held."""
    if name == "own_file":
        return own_file(folder).with_effects([])
    whole = load_robot(f"example-robot-data:{name}")
    if name == "tiago":
        return whole.restricted([j for j in whole.joints if j.startswith("arm_")])
    return whole.restricted([j for j in whole.joints if "finger" not in j])


def middle(robot: Robot) -> np.ndarray:
    """A pose well inside the limits, (joints,)."""
    low, high = (np.clip(x, -np.pi, np.pi) for x in (robot.tree.lowerPositionLimit, robot.tree.upperPositionLimit))
    return 0.5 * (low + high)


def drives(robot: Robot) -> list[Effect]:
    """A drive with friction on every joint: at full speed friction takes 6 % of the URDF's effort limit."""
    found: list[Effect] = []
    tree = robot.tree
    sizes = zip(robot.joints, rigid_inertia(robot, middle(robot)), tree.effortLimit, tree.velocityLimit, strict=True)
    for joint, inertia, effort, speed in sizes:
        found += [
            DriveInertia(joint=joint, inertia=0.3 * inertia + 1e-4 * effort),
            CoulombFriction(joint=joint, torque=0.03 * effort),
            ViscousFriction(joint=joint, coefficient=0.03 * effort / speed),
        ]
    return found


@cache
def flexible(name: str, folder: Path) -> Robot:
    """Every drive twists and every joint bends; of one's own robot, what its file says."""
    if name == "own_file":
        return own_file(folder)
    robot = arm(name, folder).with_effects(drives(arm(name, folder)))
    hinges: list[Effect] = []
    for joint, inertia in zip(robot.joints, rigid_inertia(robot, middle(robot)), strict=True):
        stiffness = float(inertia * (2.0 * np.pi * MODES_HZ) ** 2)
        damping = 1e-3 * stiffness
        hinges += [
            DriveFlexibility(joint=joint, stiffness=stiffness, damping=damping),
            JointFlexibility(joint=joint, stiffness=(2.0 * stiffness, 3.0 * stiffness), damping=(damping, damping)),
        ]
    return robot.with_effects([*robot.effects, *hinges])


def states(robot: Robot, count: int = 4) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Coordinates, velocities away from reversal, accelerations."""
    rng = np.random.default_rng(1)
    n = robot.model.nv
    return [
        (rng.uniform(-1, 1, n), rng.uniform(0.2, 1.0, n) * rng.choice([-1.0, 1.0], n), rng.uniform(-3, 3, n))
        for _ in range(count)
    ]


# ---- the model --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_flexified_arm_without_deflection_is_the_rigid_arm(name: str, folder: Path) -> None:
    rigid, robot = arm(name, folder), flexible(name, folder)
    assert len(robot.coordinates) == (5 if name == "own_file" else 4 * len(rigid.joints))
    bare = robot.with_effects([e for e in robot.effects if e.traits.virtual])
    for pose in np.random.default_rng(2).uniform(-1, 1, (3, len(rigid.joints))):
        q = robot.input_matrix @ pose
        zero = np.zeros_like(pose)
        np.testing.assert_allclose(
            bare.input_matrix.T @ bare.inverse_dynamics(q, 0 * q, 0 * q),
            rigid.inverse_dynamics(pose, zero, zero),
            atol=1e-10,
        )
        mass = rigid.mass_matrix(pose)
        np.testing.assert_allclose(
            bare.input_matrix.T @ bare.mass_matrix(q) @ bare.input_matrix, mass, atol=1e-12 * np.abs(mass).max()
        )


@pytest.mark.parametrize("name", ARMS)
def test_forward_dynamics_undo_inverse_dynamics(name: str, folder: Path) -> None:
    robot = flexible(name, folder)
    drive = np.argmax(robot.input_matrix, axis=0)
    for q, v, _ in states(robot):
        torque = np.random.default_rng(3).normal(size=len(robot.joints)) * robot.tree.effortLimit
        acceleration = robot.forward_dynamics(q, v, torque)
        force = robot.inverse_dynamics(q, v, acceleration)
        # what rounding leaves grows with the condition of the mass matrix and the largest term of the sum
        mass = robot.mass_matrix(q)
        size = np.finfo(float).eps * np.linalg.cond(mass) * np.abs(mass @ acceleration).max()
        np.testing.assert_allclose(force[drive], torque, atol=10 * size)
        np.testing.assert_allclose(np.delete(force, drive), 0.0, atol=10 * size)


@pytest.mark.parametrize("name", ARMS)
def test_regressor_times_parameters_is_inverse_dynamics(name: str, folder: Path) -> None:
    robot = flexible(name, folder)
    assert robot.regressor(*states(robot)[0]).shape == (len(robot.coordinates), len(robot.parameter_names))
    for q, v, a in states(robot):
        expected = robot.inverse_dynamics(q, v, a)
        np.testing.assert_allclose(
            robot.regressor(q, v, a) @ robot.parameters, expected, atol=1e-10 * np.abs(expected).max()
        )


@pytest.mark.parametrize("name", ARMS)
def test_linearisation_is_the_slope_of_inverse_dynamics(name: str, folder: Path) -> None:
    robot = flexible(name, folder)
    step = 1e-5  # third derivatives are of the size of the second, so the error is near step^2 of the matrix
    q, v, a = states(robot, 1)[0]
    at = robot.linearize(q, v, a)
    for matrix, place in ((at.K, 0), (at.D, 1), (at.M, 2)):
        numeric = np.empty_like(matrix)
        for column in range(len(q)):
            up, down = ([x.copy() for x in (q, v, a)] for _ in range(2))
            up[place][column] += step
            down[place][column] -= step
            numeric[:, column] = (robot.inverse_dynamics(*up) - robot.inverse_dynamics(*down)) / (2 * step)
        np.testing.assert_allclose(matrix, numeric, atol=1e-6 * np.abs(matrix).max())


# ---- under its controller -----------------------------------------------------------------------------------------


@cache
def run(name: str, folder: Path) -> Simulation:
    """Half a second of harmonics."""
    robot = flexible(name, folder)
    motion = harmonics(robot, np.random.default_rng(4)).part(0.0, 0.5)
    return simulate(robot, design_cs8(robot), motion)


@pytest.mark.parametrize("name", ARMS)
def test_simulation_goes_to_its_end_and_keeps_its_energy(name: str, folder: Path) -> None:
    result = run(name, folder)
    assert result.ended is None
    # second order in a step of 0.25 ms; friction that reverses is what is hardest to account for
    assert result.power_balance_error < 1e-3


@pytest.mark.parametrize("name", ARMS)
def test_joints_start_bent_by_the_load_that_they_carry(name: str, folder: Path) -> None:
    result = run(name, folder)
    model = result.robot.model
    load = pin.nonLinearEffects(model, model.createData(), result.q[0], result.v[0])  # of the links alone
    for effect in result.robot.effects:
        if isinstance(effect, JointFlexibility):
            bends = [result.robot.coordinates.index(f"{effect.joint}:bend_{i}") for i in (1, 2)]
            assert effect.stiffness is not None
            np.testing.assert_allclose(
                np.asarray(effect.stiffness) * result.q[0][bends], -load[bends], atol=1e-9 * np.abs(load).max()
            )


# ---- identification and closing the loop --------------------------------------------------------------------------


def hidden(robot: Robot) -> Effect:
    """Stribeck friction on the second joint."""
    effort, speed = robot.tree.effortLimit[1], robot.tree.velocityLimit[1]
    return StribeckFriction(joint=robot.joints[1], torque=0.06 * effort, velocity=0.05 * speed, power=1.0)


def truth(name: str, folder: Path, with_hidden: bool) -> Robot:
    """The rigid arm with drives that the recordings are of."""
    rigid = arm(name, folder)
    return rigid.with_effects([*drives(rigid), *([hidden(rigid)] if with_hidden else [])])


@cache
def campaign(name: str, folder: Path, with_hidden: bool) -> Campaign:
    """Two recordings to identify on and one to validate on, simulated under the controller; declared without values."""
    rigid, true = arm(name, folder), truth(name, folder, with_hidden)
    rng = np.random.default_rng(5)
    noise = Noise(torque=tuple(2e-3 * rigid.tree.effortLimit))
    recordings = []
    for i, role in enumerate(("identification", "identification", "validation")):
        result = simulate(true, design_cs8(true), harmonics(true, rng), noise=noise, rng=rng)
        assert result.ended is None
        recordings.append(dataclasses.replace(result.recording, name=f"run_{i}", role=role))  # type: ignore[arg-type]
    at = folder / f"{name}_{'hidden' if with_hidden else 'declared'}"
    unknown = [type(e)(joint=e.joints[0]) for e in drives(rigid)]  # type: ignore[call-arg]
    save_robot(rigid.with_effects(unknown), at, "declared.toml")
    return load_campaign(write_campaign(at, "declared.toml", recordings, cutoff_hz=CUTOFF_HZ))


def true_error(name: str, folder: Path, with_hidden: bool) -> float:
    """Relative error that the true arm itself makes on the log that is held out: noise, and what the log does to sharp friction."""
    rigid, true = arm(name, folder), truth(name, folder, with_hidden)
    (recording,) = campaign(name, folder, with_hidden).validation
    replay = ReplayedTorques(rigid, prepare(rigid, recording, CUTOFF_HZ, thin=False))
    error = replay.torque - replay.predict(true.effects, true.link_parameters)
    return float(np.linalg.norm(error) / np.linalg.norm(replay.torque))


@pytest.mark.parametrize("name", by_cost(ARMS, slow={*ARMS} - {"kinova", "own_file"}))
def test_identified_arm_is_as_good_as_the_true_arm_on_other_motion(name: str, folder: Path) -> None:
    result = identify_campaign(campaign(name, folder, False))
    assert result.validation is not None
    floor = true_error(name, folder, False)
    # p parameters fitted to N samples cost p / N of the squared error, below 1 % here; a tenth is room for coloured noise
    assert result.validation.relative_error < 1.1 * floor
    found = {p.name: p.value for p in result.parameters}
    values = {e.label: e for e in drives(arm(name, folder))}
    recordings = campaign(name, folder, False).recordings
    rates = np.concatenate([np.gradient(r.position, 1.0 / r.sample_rate_hz, axis=0) for r in recordings])
    for joint, speed in zip(recordings[0].joints, np.sqrt((rates**2).mean(axis=0)), strict=True):
        # coulomb and viscous friction by themselves trade with each other; what they add up to at the motion's speeds does not
        dry, viscous = values[f"{joint}.coulomb_friction"], values[f"{joint}.viscous_friction"]
        assert isinstance(dry, CoulombFriction) and isinstance(viscous, ViscousFriction)
        expected = dry.torque + speed * viscous.coefficient
        friction = found[f"{dry.label}.torque"] + speed * found[f"{viscous.label}.coefficient"]
        assert friction == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("name", by_cost(ARMS, slow=ARMS, long={"xarm7", "panda"}))
def test_closing_the_loop_finds_what_was_hidden(name: str, folder: Path) -> None:
    result = rf.close_loop(campaign(name, folder, True))
    (found,) = result.effects
    truly = hidden(arm(name, folder))
    assert found.effect.label == truly.label
    # a normal error exceeds four standard deviations once in 16000; three values on six arms are asked for
    for (key, _, value), estimate in zip(truly.public_values(), found.parameters, strict=True):
        assert estimate.name == key and estimate.value is not None and estimate.std is not None
        if key == "turnover":  # of a step, which no log resolves
            continue
        assert abs(estimate.value - value) < 4.0 * estimate.std < 0.2 * value
    before, after = (errors.validation.relative_error for errors in (result.before, result.after))
    floor = true_error(name, folder, True)
    # nine tenths of what the declared model lacks on motion that it was not fitted to
    assert after**2 - floor**2 < 0.1 * (before**2 - floor**2)
