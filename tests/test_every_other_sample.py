"""Claims about every other sample of a log, at which a search looks first: there the columns are those of all samples."""

from __future__ import annotations

import numpy as np
import pytest

from rx90b_flex.effects import catalogue
from rx90b_flex.identify.regression import LOOKED_AT, Regression
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import Recording

RATE_HZ = 250.0
JOINTS = ("joint_1", "joint_2")
EFFECTS = (
    ("coulomb_friction", {"turnover": 0.02}),
    ("stribeck_friction", {"velocity": 0.1, "power": 1.0, "turnover": 0.02}),
    ("presliding_friction", {"deflection": 1e-3}),
    ("resolver_error", {"order": 3.0}),
    ("gear_ripple", {"order": 12.0}),
    ("drive_inertia", {}),
    ("load_friction", {"turnover": 0.02}),
)


def recording(seconds: float, seed: int) -> Recording:
    """Slow moves of two joints, logged from another sample of them on each."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    turn = 2.0 * np.pi * np.arange(1, 6) * 0.15
    angles = [np.sin(np.outer(time, turn) + rng.uniform(0, 6.28, 5)) @ rng.normal(0.0, 0.2, 5) for _ in JOINTS]
    return Recording(
        name="run",
        role="identification",
        time=time,
        sample_rate_hz=RATE_HZ,
        joints=JOINTS,
        position=np.column_stack(angles),
        torque=rng.normal(size=(len(time), len(JOINTS))),
    )


def regression(cutoff_hz: float | None, seconds: float = 12.0) -> Regression:
    robot = load_robot("rx90b").rigid().restricted(JOINTS)
    # odd and even numbers of samples
    runs = [recording(seconds + i / RATE_HZ, i) for i in range(2)]
    return Regression.of(robot, runs, cutoff_hz)


@pytest.mark.parametrize("cutoff_hz", [10.0, 12.5, None])
def test_columns_at_every_other_sample_are_those_of_all(cutoff_hz: float | None) -> None:
    whole = regression(cutoff_hz)
    assert whole.halved is not None
    half, samples = whole.halved
    for s, h in zip(whole.segments, half.segments, strict=True):
        assert len(h.motion) == (len(s.motion) + 1) // 2
        assert h.rate_hz * h.factor == pytest.approx(s.rate_hz * s.factor / 2.0)
    np.testing.assert_array_equal(half.torque, whole.torque[samples])
    for name, shape in EFFECTS:
        for joint in JOINTS:
            effect = catalogue()[name](joint=joint, **shape)
            known, found = whole.columns(effect)[samples], half.columns(effect)
            # a step of friction between two samples is seen at another time by those that are left
            assert np.linalg.norm(found - known) < 0.02 * np.linalg.norm(known), (name, joint)


def test_a_low_pass_that_needs_all_samples_gets_all() -> None:
    assert regression(20.0).halved is None


def test_where_a_log_is_long_pieces_of_it_are_looked_at_and_not_every_other_sample() -> None:
    whole = regression(10.0, seconds=2.1 * LOOKED_AT / RATE_HZ)
    assert whole.excerpt is not None and whole.halved is None


def test_a_glimpse_sees_as_much_of_the_log_at_every_other_sample() -> None:
    whole = regression(10.0, seconds=40.0)
    half, samples = whole.halved or (whole, np.empty(0))
    found, seen = whole.glimpse or (whole, np.empty(0))
    assert set(seen) < set(samples)
    parts = [np.ptp(s.time) / np.ptp(w.time) for s, w in zip(found.segments, np.repeat(half.segments, 4), strict=True)]
    np.testing.assert_allclose(parts, 0.05, rtol=0.05)  # 4,000 of 20,000 working samples, in four pieces each
    np.testing.assert_array_equal(found.torque, whole.torque[seen])
