"""Claims about logged velocities: those that are no rates of the logged positions are named, noisy and filtered ones are not."""

from __future__ import annotations

from dataclasses import replace

import independent as ind
import numpy as np
import pytest
from scipy import signal

from rx90b_flex.diagnose.faults.speeds import speeds
from rx90b_flex.signals import Recording

RATE_HZ = 200.0


def recording(**changes: object) -> Recording:
    rng = np.random.default_rng(7)
    m = ind.harmonics(rng, 3, period_s=10.0, rate_hz=RATE_HZ, lines=6)
    logged = Recording("log", "identification", m.time, RATE_HZ, ("a", "b", "c"), m.q, 0.0 * m.q, m.v)
    return replace(logged, **changes)


def found(velocity: np.ndarray) -> list[tuple[str, tuple[str, ...]]]:
    return [(f.kind, f.joints) for f in speeds([recording(velocity=velocity)])]


def test_rates_of_positions_are_no_fault_though_noisy_filtered_or_of_a_coarse_counter():
    v, rng = recording().velocity, np.random.default_rng(1)
    assert found(v) == [] and list(speeds([recording(velocity=None)])) == []
    assert found(v + 0.5 * v.std() * rng.normal(size=v.shape)) == []
    assert found(signal.sosfilt(signal.butter(2, 8.0, fs=RATE_HZ, output="sos"), v, axis=0)) == []
    coarse = recording(position=np.round(recording().position / 1e-3) * 1e-3)
    assert list(speeds([coarse])) == []


@pytest.mark.parametrize(
    ("factors", "kind", "joints"),
    [
        ((180 / np.pi,) * 3, "unit", ("a", "b", "c")),
        ((1.0, -1.0, 1.0), "reversed_sign", ("b",)),
        ((1.0, 1.0, 30 / np.pi), "unit", ("c",)),
        ((1.0, 1.0, 100.0), "unit", ("c",)),
    ],
)
def test_another_unit_or_sign_is_named_with_its_joints(factors, kind, joints):
    assert found(recording().velocity * factors) == [(kind, joints)]


def test_exchanged_columns_are_named():
    v = recording().velocity
    assert found(v[:, [1, 0, 2]]) == [("swapped_columns", ("a", "b"))]
    assert [joints for _, joints in found(v[:, [1, 2, 0]])] == [("a", "b"), ("b", "c"), ("c", "a")]
