"""Claim about a torque over the angle with a bend that no law has: it is found as a curve and not as a series."""

from __future__ import annotations

import numpy as np
import pytest
from independent import Array, Motion, friction, harmonics, run, two_joints, white, write_files

import rx90b_flex as rf

STIFFNESS, BEGINS = 40.0, 0.1  # N m/rad, rad
NOISE = (0.02, 0.02)  # N m


def stop(motion: Motion, load: Array) -> Array:
    """A spring that the second joint runs into."""
    out = np.zeros_like(load)
    out[:, 1] = STIFFNESS * np.maximum(motion.q[:, 1] - BEGINS, 0.0)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_an_elastic_stop_is_a_curve(tmp_path, seed):
    arm, rng, runs = two_joints(tmp_path), np.random.default_rng(seed), []
    for role in ("identification", "identification", "validation"):
        m = harmonics(rng, 2, period_s=10.0, periods=2, rate_hz=200.0, lines=6)
        runs.append(run(arm, role, m, [friction((1.0, 0.6), (1.5, 0.8)), stop], white(rng, len(m.time), NOISE), 10.0))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    result = rf.close_loop(write_files(tmp_path, arm, declared, runs, cutoff_hz=20.0))
    names = [(e.effect.type_name(), e.effect.joints) for e in result.effects]
    assert names.count(("angle_curve", (arm.joints[1],))) == 1
    # where laws came before the curve, or find the corner that this rounds off: small beside it, how many differs between processors
    curve = next(e.effect for e in result.effects if e.effect.type_name() == "angle_curve")
    size = float(np.ptp(curve.known_coefficients()))
    others = [e.effect.known_coefficients() for e in result.effects if e.effect is not curve]
    assert len(others) <= 3 and all(np.abs(values).max() < 0.05 * size for values in others)
    assert result.verdict in ("explained", "partly_explained")
    # where the fitted recordings have been: beyond that no curve knows how hard the stop is
    (held_out,) = result.predictions
    seen = max(r.position[:, 1].max() for r in result.campaign.identification)
    known = held_out.recording.position[:, 1] < seen - 0.02  # the low-pass carries a little
    left = (held_out.torque - held_out.after)[known]
    assert np.linalg.norm(left) < 0.02 * result.before.validation.relative_error * np.linalg.norm(
        held_out.torque[known]
    )
