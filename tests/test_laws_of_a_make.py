"""One law on all joints, in a form that the catalogue does not have, found and named on short logs that rest between moves."""

from itertools import pairwise

import numpy as np
import pytest
from independent import Arm, Array, Motion, Torque, run, ur10, white, write_files
from scipy import stats

import rx90b_flex as rf
from rx90b_flex.diagnose.families import product_of_small

RATE_HZ = 250.0
MOVES, MOVE_S, REST_S = 14, 1.1, 0.35
COULOMB = np.array([8.0, 8.0, 5.0, 1.5, 1.2, 0.8])  # N m
VISCOUS = np.array([9.0, 9.0, 6.0, 1.6, 1.2, 0.8])  # N m s/rad
STICTION, FADES, BRISTLE = 0.9, 0.03, 2e-4  # of the dry friction more at rest; rad/s; rad
NOISE = 0.03 * COULOMB


def moves(rng: np.random.Generator, joints: int) -> Motion:
    """From pose to pose and a rest at each, along polynomials whose acceleration begins and ends at zero."""
    poses = np.cumsum(rng.uniform(-0.5, 0.5, (MOVES + 1, joints)), axis=0)
    s = np.arange(round(MOVE_S * RATE_HZ)) / round(MOVE_S * RATE_HZ)
    shape = [10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / MOVE_S]
    shape.append((60 * s - 180 * s**2 + 120 * s**3) / MOVE_S**2)
    rest = np.zeros(round(REST_S * RATE_HZ))
    q, v, a = [], [], []
    for begin, end in pairwise(poses):
        for out, part, still in zip((q, v, a), shape, (1.0, 0.0, 0.0), strict=True):
            out.append(np.outer(np.concatenate([part, rest + still]), end - begin))
        q[-1] += begin
    angle = np.concatenate(q)
    return Motion(np.arange(len(angle)) / RATE_HZ, angle, np.concatenate(v), np.concatenate(a))


def bristles(m: Motion, load: Array) -> Array:
    """LuGre's law: bristles that bend and give way at a torque which fades with speed like a Lorentz curve."""
    most = COULOMB * (1.0 + STICTION / (1.0 + (m.v / FADES) ** 2))
    out, part = np.zeros_like(m.q), np.zeros(m.q.shape[1])
    for k in range(1, len(m.q)):
        step = m.q[k] - m.q[k - 1]
        way = np.sign(step) * most[k]
        part = way - (way - part) * np.exp(-np.abs(step) / (BRISTLE * most[k] / COULOMB))
        out[k] = part
    return out + VISCOUS * m.v


def campaign(folder, arm: Arm, law: Torque, seed: int):
    rng = np.random.default_rng([17, seed])
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    runs = []
    for role in ("identification", "identification", "validation"):
        m = moves(rng, len(arm.joints))
        runs.append(run(arm, role, m, [law], white(rng, len(m.time), NOISE)))
    return write_files(folder, arm, declared, runs, cutoff_hz=10.0)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_friction_that_fades_with_speed_behind_hysteresis_is_found_on_all_joints(tmp_path, seed):
    result = rf.close_loop(campaign(tmp_path, ur10(), bristles, seed))
    print(
        [e.effect.label for e in result.effects],
        result.before.validation.relative_error,
        result.after.validation.relative_error,
        result.explainable.validation.relative_error,
        result.verdict,
    )


@pytest.mark.parametrize("tried", [2, 6, 12])
def test_a_product_of_small_p_values_is_no_smaller_than_chance_makes_it(tried):
    chance = np.random.default_rng(tried).uniform(size=(4000, tried))
    p = np.array([product_of_small(x, tried) for x in chance])
    for level in (0.05, 0.01) if tried > 2 else (0.01,):
        below = int((p < level).sum())
        assert stats.binomtest(below, len(p), level).pvalue > 1e-3
