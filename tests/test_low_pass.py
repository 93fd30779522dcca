"""How far in frequency torques follow a model, and that a log without a low-pass is told so."""

import numpy as np
import pytest
from scipy import signal

from rx90b_flex.diagnose.low_pass import beyond_model

RATE_HZ = 500.0
LOWEST = 20.0  # Hz


def end_of_band(noise: float) -> float:
    """Hz up to which the model takes away a tenth of the power: from the filters' gains, noise below 8.9 times the signal."""
    through = signal.butter(6, LOWEST, fs=RATE_HZ, output="sos")
    hz, gain = signal.sosfreqz(through, 4096, fs=RATE_HZ)
    own, rising = np.abs(gain) ** 4, np.abs(1.0 - np.exp(-2j * np.pi * hz / RATE_HZ)) ** 2
    blue = noise**2 * rising / rising.mean() * own.mean()
    return float(hz[np.flatnonzero(blue < 8.9 * own)[-1]])


def logs(seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Torque of two joints that a model says to nine tenths below 20 Hz, and noise of a rising spectrum beyond."""
    rng = np.random.default_rng(seed)
    through = signal.butter(6, LOWEST, fs=RATE_HZ, output="sos")
    torque = signal.sosfiltfilt(through, rng.normal(size=(20_000, 2)), axis=0)
    blue = np.diff(rng.normal(size=(20_001, 2)), axis=0)
    return torque + noise * torque.std() * blue / blue.std(), 0.9 * torque


@pytest.mark.parametrize("seed", range(4))
def test_the_band_that_follows_ends_where_noise_begins_to_rule(seed):
    measured, model = logs(seed, 0.5)
    found = beyond_model([measured], [model], [RATE_HZ])
    assert found is not None
    assert found.hz == pytest.approx(end_of_band(0.5), rel=0.15)  # bands are a quarter wide
    left = measured - model
    sos = signal.butter(10, found.hz, "highpass", fs=RATE_HZ, output="sos")
    assert found.part == pytest.approx((signal.sosfiltfilt(sos, left, axis=0) ** 2).sum() / (left**2).sum(), abs=0.1)
    assert f"cutoff_hz = {found.hz:.2g}" in found.words


@pytest.mark.parametrize("seed", range(4))
def test_little_noise_beyond_is_not_worth_a_word(seed):
    measured, model = logs(seed, 0.02)
    assert beyond_model([measured], [model], [RATE_HZ]) is None


def test_a_model_that_nothing_follows_has_no_band():
    rng = np.random.default_rng(5)
    measured, model = rng.normal(size=(2, 5000, 1))
    assert beyond_model([measured], [model], [RATE_HZ]) is None


def test_too_few_samples_say_nothing():
    measured, model = logs(0, 0.5)
    assert beyond_model([measured[:60]], [model[:60]], [RATE_HZ]) is None
