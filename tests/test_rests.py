"""Claims about motion from point to point, where friction holds anything at each rest: nothing is made of it, nothing lost in it."""

from __future__ import annotations

from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf

RATE_HZ, LENGTH_S, SPEED, REACH = 200.0, 30.0, 1.5, 0.8  # rad/s, rad
RESTS_S = (0.4, 1.2)


def from_point_to_point(rng: np.random.Generator, joints: int) -> tuple[ind.Motion, np.ndarray]:
    """Quintics between random poses, all joints at once, with a rest in each; and the number of the rest, shape (N,)."""
    samples = round(LENGTH_S * RATE_HZ)
    q, v, a = (np.zeros((samples, joints)) for _ in range(3))
    rest, at, pose = np.zeros(samples, dtype=int), 0, rng.uniform(-REACH, REACH, joints)
    while at < samples:
        stay = slice(at, at + int(rng.uniform(*RESTS_S) * RATE_HZ))
        q[stay], rest[stay] = pose, rest.max() + 1
        way = rng.uniform(-REACH, REACH, joints) - pose
        lasts = max(0.8, 1.875 * np.abs(way).max() / SPEED)
        s = (np.arange(1, int(lasts * RATE_HZ) + 1) / int(lasts * RATE_HZ))[:, None]
        go = slice(min(stay.stop, samples), min(stay.stop + len(s), samples))
        part = s[: go.stop - go.start]
        q[go] = pose + way * (10 * part**3 - 15 * part**4 + 6 * part**5)
        v[go] = way / lasts * 30 * part**2 * (1 - part) ** 2
        a[go] = way / lasts**2 * 60 * part * (1 - part) * (1 - 2 * part)
        at, pose = stay.stop + len(s), pose + way
    return ind.Motion(np.arange(samples) / RATE_HZ, q, v, a), rest


def closed(folder: Path, seed: int, hidden: str) -> rf.ClosedLoop:
    arm, rng, runs = ind.ur10(), np.random.default_rng(seed), []
    size = arm.torque(ind.harmonics(np.random.default_rng(0), 6, period_s=5.0, rate_hz=20.0)).std(axis=0)
    dry, viscous, noise = 0.12 * size + 0.3, 0.1 * size + 0.2, 0.01 * size + 0.01
    for role in ("identification", "identification", "validation"):
        m, rest = from_point_to_point(rng, 6)
        held = rng.uniform(-1, 1, (rest.max() + 1, 6))[rest]

        def friction(m: ind.Motion, load: ind.Array, held: ind.Array = held) -> ind.Array:
            return dry * np.where(m.v == 0.0, held, np.sign(m.v)) + viscous * m.v

        stribeck = [{"torque": 0.5 * dry[j], "velocity": 0.08, "power": 1.0} for j in range(6)]
        ripple = {"order": 40.0, "amplitude": 0.3 * dry[3], "phase": 0.3}
        known = {
            "load": [ind.hidden("load_friction", 1, {"coefficient": 0.05}), ind.hidden("gear_ripple", 3, ripple)],
            "speed": [ind.hidden("stribeck_friction", j, stribeck[j]) for j in (1, 2)],
            "nothing": [],
        }
        torques = [friction, *known[hidden]]
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), noise)))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    result = rf.close_loop(ind.write_files(folder, arm, declared, runs, cutoff_hz=20.0))
    assert isinstance(result, rf.ClosedLoop)
    return result


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
@pytest.mark.parametrize(
    ("hidden", "names"),
    [
        ("load", {"shoulder_lift_joint.load_friction", "wrist_1_joint.gear_ripple"}),
        ("speed", {"shoulder_lift_joint.stribeck_friction", "elbow_joint.stribeck_friction"}),
        ("nothing", set()),
    ],
)
def test_what_joints_hold_at_rests_is_no_effect_of_motion_and_hides_none_of_load_or_angle(
    tmp_path, seed, hidden, names
):
    result = closed(tmp_path, seed, hidden)
    found = {e.effect.label for e in result.effects}
    # what is fast shows little of a friction that falls with speed: it may stay hidden
    assert found == names or (hidden == "speed" and found < names)
    assert result.verdict == ("partly_explained" if found else "unexplained")  # what they hold is left
