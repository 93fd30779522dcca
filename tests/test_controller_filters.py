"""Claims about filters in controller files: what a filtered loop orders, by scipy's filters beside it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from sampled_loop import sampled_loop
from scipy import signal

from rx90b_flex.identify.frf_command import feedback_of
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.simulate import CS8, Trajectory, load_cs8, save_cs8, simulate_lanes
from rx90b_flex.simulate.closed_loop import hermite
from rx90b_flex.simulate.cs8 import drive_compliance
from rx90b_flex.simulate.perturbation import perturb_lanes

HZ = 4000.0
HEAD = f"reference_rate_hz = 500.0\ncontroller_rate_hz = {HZ}\nlog_rate_hz = 500.0\nlog_cutoff_hz = 180.0\n"
CASCADE = "position_loop = 25.0\nvelocity_loop = 150.0\nintegral_time_s = 0.04\nvelocity_feedforward = 1.0\ntorque_limit = 900.0\n"
PID = "position_gain = 6000.0\nvelocity_gain = 150.0\nintegral_gain = 90000.0\ntorque_limit = 900.0\n" + "".join(
    f"{name}_step = 0.0\n" for name in ("position", "velocity", "torque")
)
FILTERS = """velocity_filters = [{ type = "low_pass", frequency_hz = 120.0 }]
torque_filters = [
    { type = "notch", frequency_hz = 60.0, damping = 0.4 },
    { type = "low_pass", frequency_hz = 300.0, damping = 0.7071067811865476 },
]
"""
INERTIA = 2.0  # kg m^2


def controller_of(folder: Path, loops: str, filters: str = FILTERS, joints: tuple[str, ...] = ("turn",)) -> CS8:
    kind = "cascade" if loops is CASCADE else "joint"
    file = folder / "controller.toml"
    file.write_text(HEAD + "".join(f'[[{kind}]]\nname = "{j}"\n{loops}{filters}' for j in joints))
    return load_cs8(file)


@pytest.fixture
def wheel(tmp_path: Path) -> Robot:
    """One mass about a vertical axis."""
    (tmp_path / "wheel.urdf").write_text(f"""<robot name="wheel"><link name="base"/><link name="disc"><inertial>
      <mass value="10"/><inertia ixx="1" iyy="1" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="turn" type="revolute"><parent link="base"/><child link="disc"/><axis xyz="0 0 1"/>
      <limit lower="-3" upper="3" effort="900" velocity="20"/></joint></robot>""")
    (tmp_path / "wheel.toml").write_text('name = "wheel"\nurdf = "wheel.urdf"\ntip_frame = "disc"\n')
    return load_robot(tmp_path / "wheel.toml")


def shaken(rng: np.random.Generator) -> Trajectory:
    """A motion that begins with a speed, and torques fed forward."""
    time = np.arange(400)[:, None] / 500.0
    position, speed = 0.3 * np.sin(9.0 * time + 0.4), 2.7 * np.cos(9.0 * time + 0.4)
    return Trajectory("shaken", ("turn",), 500.0, position, speed, 20.0 * rng.standard_normal((400, 1)), None)


class Chain:
    """scipy's filters, sample by sample, settled at their first input."""

    def __init__(self, sos: np.ndarray, x: float) -> None:
        self.sos, self.state = sos, x * signal.sosfilt_zi(sos)

    def __call__(self, x: float) -> float:
        y, self.state = signal.sosfilt(self.sos, [x], zi=self.state)
        return float(y[0])


def speed_filter() -> np.ndarray:
    part = 1.0 - np.exp(-2.0 * np.pi * 120.0 / HZ)
    return np.array([[part, 0.0, 0.0, 1.0, part - 1.0, 0.0]])


def torque_filter() -> np.ndarray:
    # iirnotch is told its width at -3 dB on the warped axis
    width = 2.0 * np.arctan(0.4 * np.sin(2.0 * np.pi * 60.0 / HZ))
    notch = np.concatenate(signal.iirnotch(60.0, 60.0 / (width * HZ / (2.0 * np.pi)), HZ))
    return np.vstack([notch, signal.butter(2, 300.0, fs=HZ, output="sos")])


def by_hand(trajectory: Trajectory, loops: str) -> tuple[np.ndarray, np.ndarray]:
    """Angles and torques of the wheel at the controller's instants, its loops written as their makers do."""
    rows = np.arange(len(trajectory.position))
    parts = np.arange(8) / 8
    position, rate, _ = (x[:, 0] for x in hermite(trajectory.position, trajectory.velocity, rows, parts, 500.0))
    fed = np.append(trajectory.torque[:, 0], trajectory.torque[-1, 0])
    angle, speed = trajectory.position[0, 0], trajectory.velocity[0, 0]
    seen, out = Chain(speed_filter(), speed), Chain(torque_filter(), 0.0)
    summed, angles, torques = -fed[0], [], []
    for k, (r, w) in enumerate(zip(position, rate, strict=True)):
        row, part = divmod(k, 8)
        forward = fed[row] + part / 8 * (fed[row + 1] - fed[row])
        slow = seen(speed)
        if loops is CASCADE:
            asked = 25.0 * (r - angle) + w - slow
            summed += 150.0 / 0.04 / HZ * asked
            torque = out(150.0 * asked + summed + forward)
        else:
            summed += 90000.0 / HZ * (r - angle)
            torque = out(6000.0 * (r - angle) + 150.0 * (w - slow) + summed + forward)
        angles.append(angle)
        torques.append(torque)
        angle += speed / HZ + 0.5 * torque / INERTIA / HZ**2
        speed += torque / INERTIA / HZ
    return np.array(angles), np.array(torques)


@pytest.mark.parametrize("loops", [pytest.param(CASCADE, marks=pytest.mark.slow), PID], ids=["cascade", "pid"])
@pytest.mark.parametrize("method", [simulate_lanes, perturb_lanes], ids=["full", "perturbation"])
def test_a_filtered_loop_does_what_scipy_s_filters_do(wheel: Robot, tmp_path: Path, loops: str, method) -> None:  # type: ignore[no-untyped-def]
    controller = controller_of(tmp_path, loops)
    trajectory = shaken(np.random.default_rng(2))
    runs = method(wheel, controller, [trajectory, trajectory.with_feedforward(None)], raw=True)
    angle, torque = by_hand(trajectory, loops)
    raw = runs[0].raw
    assert runs[0].ended is None and raw is not None
    # the log has a torque's mean over a period centred on the sample
    logged = 0.5 * (torque[1:] + torque[:-1])
    # a cascade sums speeds where the package integrates angles: half a sample of the speeds' change, beside what springs of 6000 hold
    near = 0.5 * 150.0 / 0.04 / HZ * 0.1 if loops is CASCADE else 1e-3
    assert np.abs(raw.position[:-8, 0] - angle[:-8]).max() < near / 2000.0
    assert np.abs(raw.torque[1:-8, 0] - logged[:-8]).max() < 10.0 * near
    assert np.ptp(torque) > 50.0
    # and without the filters it would be another
    bare = method(wheel, controller_of(tmp_path, loops, ""), [trajectory], raw=True)[0].raw
    assert bare is not None and np.abs(bare.torque[1:-8, 0] - logged[:-8]).max() > 5.0


def test_chains_at_their_frequencies(tmp_path: Path) -> None:
    """A notch passes its depth, and root half of the way at half its width; a low-pass of first order turns by 45 degrees."""
    notch = 'torque_filters = [{ type = "notch", frequency_hz = 80.0, damping = 0.01, depth = 0.2 }]\n'
    plain, notched = (controller_of(tmp_path, PID, f) for f in ("", notch))
    hz = np.array([1.0, 79.2, 80.0, 80.8, 1000.0])
    gain = np.abs(notched.frequency_response(hz) / plain.frequency_response(hz))[:, 0]
    assert gain[[0, 2, 4]] == pytest.approx([1.0, 0.2, 1.0], abs=1e-3)
    assert gain[[1, 3]] == pytest.approx(np.sqrt(0.5 * (1.0 + 0.2**2)), abs=0.01)
    slow = controller_of(tmp_path, PID, 'velocity_filters = [{ type = "low_pass", frequency_hz = 20.0 }]\n')
    hz = np.array([20.0])
    s = 2j * np.pi * hz[:, None]
    lost = (plain.frequency_response(hz) - slow.frequency_response(hz)) / (150.0 * s * plain._acting(s, np.exp(s / HZ)))
    # half a sample earlier than a continuous one would be
    assert abs(1.0 - lost[0, 0] - 1.0 / (1.0 + 1j)) < np.pi * 20.0 / HZ


@pytest.mark.parametrize("loops", [CASCADE, PID], ids=["cascade", "pid"])
def test_linear_responses_are_the_sampled_loops(wheel: Robot, tmp_path: Path, loops: str) -> None:
    controller = dataclasses.replace(controller_of(tmp_path, loops), current_bandwidth_hz=500.0)
    linear = wheel.linearize(np.zeros(1), np.zeros(1))
    loop = sampled_loop(controller, linear)
    poles = np.linalg.eigvals(loop.A)
    assert np.abs(poles).max() < 1.0
    hz = np.array([3.0, 15.0, 30.0, 55.0, 100.0])
    z = np.exp(2j * np.pi * hz / HZ)
    at = np.array([loop.C @ np.linalg.solve(x * np.eye(len(loop.A)) - loop.A, loop.B) + loop.D for x in z])
    # the torque of a sample, held, lags by half a period behind the sample's start
    foretold = controller.sensitivity(linear, hz)
    assert np.abs(at[:, 1:] * (z**-0.5)[:, None, None] - foretold).max() < 0.01
    angle = drive_compliance(linear, hz) @ foretold
    assert np.abs(at[:, :1] / angle - 1.0).max() < 0.01
    # what the loop over frequency takes as feedback is the same law, over accelerations
    back = feedback_of(controller, ("turn",))(hz)[:, 0, 0]
    acceleration = (2j * np.pi * hz) ** 2 * drive_compliance(linear, hz)[:, 0, 0]
    hold = controller._acting(2j * np.pi * hz[:, None], z[:, None])[:, 0]
    assert np.abs(hold / (1.0 + back * acceleration) / foretold[:, 0, 0] - 1.0).max() < 1e-9


def test_a_reference_orders_the_torque_that_is_asked_for(wheel: Robot, tmp_path: Path) -> None:
    """Of a vibration of the reference, by the notch too: the torque beside what the drive's own motion takes back."""
    controller = controller_of(tmp_path, CASCADE)
    linear = wheel.linearize(np.zeros(1), np.zeros(1))
    hz, time = np.array([50.0]), np.arange(1500)[:, None] / 500.0
    wave = 2.0 * np.pi * hz * time
    trajectory = Trajectory("wave", ("turn",), 500.0, 1e-4 * np.sin(wave), 2e-4 * np.pi * hz * np.cos(wave), None, None)
    run = simulate_lanes(wheel, controller, [trajectory], raw=True)[0]
    assert run.raw is not None
    last = slice(-4000, None)
    turns = np.exp(-2j * np.pi * hz * run.raw.time[last])
    torque = 2.0 * (run.raw.torque[last, 0] * turns).mean()
    # `sensitivity` is that of torques that are fed forward, which pass the filters that are part of what is ordered
    s = 2j * np.pi * hz[:, None]
    passed = [c._acting(s, np.exp(s / HZ))[0, 0] for c in (controller, controller_of(tmp_path, CASCADE, ""))]
    ordered = -1e-4j * controller.by_references(hz)[0, 0] * passed[1] / passed[0]
    assert abs(torque / (ordered * controller.sensitivity(linear, hz)[0, 0, 0]) - 1.0) < 0.01


def test_filters_that_are_saved_come_back(tmp_path: Path) -> None:
    for loops in (CASCADE, PID):
        controller = controller_of(tmp_path, loops)
        save_cs8(controller, tmp_path / "again.toml")
        assert load_cs8(tmp_path / "again.toml") == controller


@pytest.mark.parametrize(
    ("filters", "message"),
    [
        ("velocity_filters = 200.0\n", "velocity_filters: found 200.0, tables"),
        ("torque_filters = [{ frequency_hz = 9.0 }]\n", "1 type: missing; 'low_pass' or 'notch' is expected"),
        ('torque_filters = [{ type = "nitch", frequency_hz = 9.0 }]\n', "1 type: found 'nitch', 'low_pass' or 'notch'"),
        ('torque_filters = [{ type = "low_pass" }]\n', "1 frequency_hz: missing"),
        ('torque_filters = [{ type = "low_pass", frequency_hz = 2000 }]\n', "found 2000, expected less than half of contr"),
        ('torque_filters = [{ type = "low_pass", frequency_hz = 0 }]\n', "found 0, a number above 0 is expected"),
        ('torque_filters = [{ type = "low_pass", frequency_hz = 9, depth = 0.5 }]\n', "depth: found 0.5, expected none"),
        ('torque_filters = [{ type = "notch", frequency_hz = 9 }]\n', "damping: missing"),
        ('torque_filters = [{ type = "notch", frequency_hz = 9, damping = -1 }]\n', "damping: found -1, a number above 0"),
        ('torque_filters = [{ type = "notch", frequency_hz = 9, damping = 1, depth = 2 }]\n', "found 2, expected 0 to 1"),
        ('torque_filters = [{ type = "notch", frequency_hz = 9, damping = 1, q = 2 }]\n', "'q': unknown key"),
    ],
)  # fmt: skip
def test_a_wrong_filter_is_one_line_that_names_file_and_key(tmp_path: Path, filters: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"controller.toml: .*cascade.* 1.*{message}"):
        controller_of(tmp_path, CASCADE, filters)
