"""Claims about torques that are logged later than any drive gives them: a delay is found, and its name doubted."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from independent import friction, harmonics, run, two_joints, white, write_files

import rx90b_flex as rf

RATE_HZ = 200.0
DECLARED = ("torque_offset", "coulomb_friction", "viscous_friction")


def closed(folder: Path, samples: int) -> rf.ClosedLoop:
    """Of recordings whose torques were all moved by a number of rows."""
    arm, rng, runs = two_joints(folder), np.random.default_rng(11), []
    for role in ("identification", "identification", "validation"):
        m = harmonics(rng, 2, period_s=20.0, rate_hz=RATE_HZ, lines=8)
        made = run(arm, role, m, [friction((1.0, 0.6), (1.5, 0.8))], white(rng, len(m.time), (0.05, 0.03)))
        runs.append(dataclasses.replace(made, torque=np.roll(made.torque, samples, axis=0)))  # motions repeat
    declared = [{"type": t, "joint": j} for j in arm.joints for t in DECLARED]
    return rf.close_loop(write_files(folder, arm, declared, runs, cutoff_hz=20.0))


@pytest.mark.parametrize(
    ("samples", "doubted"), [pytest.param(7, True, marks=pytest.mark.slow), (-6, True), (1, False)]
)
def test_a_delay_that_no_drive_has_is_doubted(tmp_path: Path, samples: int, doubted: bool) -> None:
    result = closed(tmp_path, samples)
    (found,) = result.effects
    assert found.effect.type_name() == "torque_delay" and found.effect.joints == ()
    # 3 % off where friction turns over slowly: its turnover, found before the delay, took part of it
    assert found.effect.known_coefficients()[0] == pytest.approx(samples / RATE_HZ, rel=0.04)
    said = [c for c in result.cautions if "longer than filters and buses take" in c]
    assert bool(said) == doubted
    if doubted:
        assert f"ms {'after' if samples > 0 else 'before'} the positions" in said[0]
