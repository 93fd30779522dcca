"""Springs between two anchors, hidden: named as such where ripples of a low order and straight springs come near."""

from __future__ import annotations

from pathlib import Path

import independent as plain
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.base import parameters_told
from rx90b_flex.effects import Sites, catalogue, effect_from_table

FAR, NEAR = 0.42, 0.16  # m from the axis to its anchors
NOISE = (0.05, 0.05)


def between_anchors(stiffness: float, angle: float, prestress: float) -> plain.Torque:
    """``(k (l - l_0) + p) dl/dq`` on the elbow, l by the law of cosines."""

    def torque(m: plain.Motion, load: np.ndarray) -> np.ndarray:
        turned = m.q[:, 1] - angle
        length, rest = (np.sqrt(FAR**2 + NEAR**2 - 2.0 * FAR * NEAR * np.cos(x)) for x in (turned, -angle))
        out = np.zeros_like(load)
        out[:, 1] = (stiffness * (length - rest) + prestress) * FAR * NEAR * np.sin(turned) / length
        return out

    return torque


@pytest.mark.parametrize(
    ("seed", "angle"),
    [(1, 0.4), (2, -1.2), *(pytest.param(*more, marks=pytest.mark.slow) for more in ((3, 1.8), (4, -0.3), (5, 1.0)))],
)
def test_a_hidden_spring_is_named_and_nothing_else(tmp_path: Path, seed: int, angle: float) -> None:
    arm = plain.two_joints(tmp_path)
    torques = [plain.friction([1.0, 0.6], [2.0, 1.1]), between_anchors(60.0, angle, 5.0)]
    declared = [{"type": k, "joint": j} for j in arm.joints for k in ("coulomb_friction", "viscous_friction")]
    runs = []
    for i, role in enumerate(("identification", "identification", "validation")):
        rng = np.random.default_rng([seed, i])
        m = plain.harmonics(rng, 2, period_s=10.0)
        runs.append(plain.run(arm, role, m, torques, plain.white(rng, len(m.time), NOISE)))
    result = rf.close_loop(plain.write_files(tmp_path, arm, declared, runs, cutoff_hz=15.0))
    assert [e.effect.label for e in result.effects] == ["elbow.gravity_spring"]
    # of levers torques tell no length: 60 N/m at these ends is what they tell, whatever ends are written
    (said,) = (c for c in result.cautions if "both levers" in c)
    told = float(said.split("both levers, ")[1].split(" N m")[0])
    assert told == pytest.approx(60.0 * FAR * NEAR, rel=0.25) and "ends 0.4 m and" in said and "assumed" in said


def test_springs_of_several_angles_and_ratios_side_by_side_are_those_by_themselves() -> None:
    robot = rf.load_robot("example-robot-data:ur10")
    rng = np.random.default_rng(0)
    motion = robot.motion(*rng.normal(size=(3, 50, 6)), np.arange(50) / 100.0)
    kind = next(e for e in catalogue()["gravity_spring"].everywhere(Sites(robot.joints, "tool0")) if len(e.shape) == 2)
    springs = [kind.with_shape(np.array([angle, ratio])) for angle in (-2.0, 0.3, 3.0) for ratio in (0.05, 0.5, 0.95)]
    port, columns = kind.side_by_side(springs, motion)
    q = motion.q[:, [robot.joints.index(kind.joints[0])]]
    angle, ratio = np.array([e.shape for e in springs]).T
    pull = np.sin(q - angle)
    slack = pull / np.sqrt(1.0 - ratio * np.cos(q - angle))
    np.testing.assert_allclose(columns, np.stack([pull, slack], axis=2).reshape(50, -1), atol=1e-12)
    assert port is not None and np.array_equal(port, np.eye(6)[robot.joints.index(kind.joints[0])])


def test_a_sine_of_which_less_than_a_period_shows_is_no_ripple() -> None:
    robot = rf.load_robot("example-robot-data:ur10")
    q = np.zeros((200, 6))
    q[:, 2] = np.linspace(0.0, 1.5, 200)
    motion = robot.motion(q, np.zeros_like(q), np.zeros_like(q), np.arange(200) / 100.0)
    for order, curve in ((3.0, True), (5.0, False)):  # 0.7 and 1.2 periods
        table = {"type": "gear_ripple", "joint": robot.joints[2], "order": order, "amplitude": 1.0, "phase": 0.0}
        said = effect_from_table(table, "here", robot.joints).too_small(0.5, 0.01, motion)
        assert ("of a period" in said) is curve


def test_what_a_model_wholly_explains_of_a_candidate_is_no_parameter_of_it() -> None:
    rng = np.random.default_rng(0)
    base = rng.normal(size=(300, 4))
    columns = np.column_stack([base @ rng.normal(size=4), rng.normal(size=(300, 2))])
    left = columns - base @ np.linalg.lstsq(base, columns, rcond=None)[0]
    assert parameters_told(left.T @ left, columns.T @ columns, np.zeros((3, 3))) == 2.0
