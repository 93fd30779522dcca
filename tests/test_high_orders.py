"""Claim about ripple with many cycles a turn, as a motor's poles behind a gear or a screw of small lead make it: it is found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from independent import Array, Motion, friction, harmonics, run, two_joints, white, write_files

import rx90b_flex as rf

NOISE = (0.05, 0.05)  # N m


@pytest.mark.slow
@pytest.mark.parametrize("order", [404.0, pytest.param(628.3, marks=pytest.mark.slow)])
def test_a_ripple_of_high_order_is_found(tmp_path: Path, order: float) -> None:
    def cogging(motion: Motion, load: Array) -> Array:
        out = np.zeros_like(load)
        out[:, 1] = 0.4 * np.sin(order * motion.q[:, 1] + 0.7)
        return out

    arm, rng, runs = two_joints(tmp_path), np.random.default_rng(3), []
    for role in ("identification", "identification", "validation"):
        m = harmonics(rng, 2, period_s=20.0, rate_hz=500.0, lines=6)
        runs.append(run(arm, role, m, [friction((1.0, 0.6), (1.5, 0.8)), cogging], white(rng, len(m.time), NOISE)))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    result = rf.close_loop(write_files(tmp_path, arm, declared, runs, cutoff_hz=80.0))
    (found,) = result.effects
    values = {p.name: p.value for p in found.parameters}
    assert (found.effect.type_name(), found.effect.joints) == ("gear_ripple", (arm.joints[1],))
    assert values["order"] == pytest.approx(order, rel=1e-3) and values["amplitude"] == pytest.approx(0.4, rel=0.05)
    assert result.verdict == "explained"
