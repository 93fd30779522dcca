from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from rx90b_flex.pieces import in_pieces
from rx90b_flex.signals import (
    decimation_factor,
    difference_weights,
    differentiate,
    lowpass,
    minimum_samples,
    motion,
    noise_cutoff_hz,
    periods,
    resample,
)

Array = NDArray[np.float64]
EPS = np.finfo(float).eps


def sine(hz: float, rate: float, seconds: float, phase: float = 0.3) -> Array:
    return np.asarray(np.sin(2 * np.pi * hz * np.arange(round(rate * seconds)) / rate + phase))


# --- low-pass --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cutoff", "rate"), [(40.0, 5000.0), (20.0, 500.0), (100.0, 250.0), (1.0, 5000.0)])
def test_lowpass_gain_is_that_of_two_butterworth_passes_and_has_no_phase(cutoff: float, rate: float) -> None:
    # The digital filter's frequency axis is warped by the tangent; its gain follows from the definition.
    for ratio in (0.2, 0.5, 0.8, 1.0, 1.2):
        hz = ratio * cutoff
        x = sine(hz, rate, 200.0 / hz)
        gain = 1.0 / (1.0 + (np.tan(np.pi * hz / rate) / np.tan(np.pi * cutoff / rate)) ** 8)
        middle = slice(len(x) // 3, 2 * len(x) // 3)
        # the ends' transient has decayed there
        np.testing.assert_allclose(lowpass(x, cutoff, rate)[middle], gain * x[middle], atol=1e-6)


@given(ratio=st.floats(1e-4, 0.45), offset=st.floats(-100.0, 100.0), slope=st.floats(-1.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_lowpass_leaves_a_straight_line_alone_up_to_its_ends(ratio: float, offset: float, slope: float) -> None:
    rate = 1000.0
    count = minimum_samples(ratio * rate, rate) + 5
    line = offset + slope * np.arange(count) / count
    # Odd reflection continues a line exactly; what is left is the end of the impulse response, twice 1/1000 of the
    # slope over the padding, and rounding, which grows with the inverse of the cutoff.
    tolerance = 2e-2 * abs(slope) + 1e-9 * (1.0 + abs(offset))
    np.testing.assert_allclose(lowpass(line, ratio * rate, rate), line, atol=tolerance)


def test_lowpass_keeps_a_constant_at_a_cutoff_far_below_the_sample_rate() -> None:
    x = np.full((40_000, 2), 3.0)
    # a section's gain at 0 Hz is a difference of coefficients of the size (pi * cutoff / rate)^2
    np.testing.assert_allclose(lowpass(x, 0.5, 5000.0), x, rtol=10 * EPS / (np.pi * 1e-4) ** 2)


def test_lowpass_filters_each_column_by_itself() -> None:
    x = np.random.default_rng(0).normal(size=(800, 3))
    together = lowpass(x, 30.0, 1000.0)
    for column in range(3):
        np.testing.assert_array_equal(together[:, column], lowpass(x[:, column], 30.0, 1000.0))


def test_lowpass_takes_the_minimum_number_of_samples_and_refuses_one_less() -> None:
    shortest = minimum_samples(40.0, 5000.0)
    assert 0.02 < shortest / 5000.0 < 0.2  # some periods of the cutoff
    lowpass(np.zeros(shortest), 40.0, 5000.0)
    with pytest.raises(ValueError, match=f"{shortest - 1} samples .* {shortest} or more"):
        lowpass(np.zeros(shortest - 1), 40.0, 5000.0)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 500.0, 600.0, float("nan")])
def test_lowpass_refuses_a_cutoff_outside_zero_to_nyquist(cutoff: float) -> None:
    with pytest.raises(ValueError, match="half the sample rate, 500 Hz"):
        lowpass(np.zeros(1000), cutoff, 1000.0)


def test_samples_that_are_not_finite_are_refused_with_their_row() -> None:
    x = np.zeros((1000, 2))
    x[17, 1] = np.nan
    with pytest.raises(ValueError, match="sample 17 "):
        lowpass(x, 40.0, 1000.0)


# --- differentiation -------------------------------------------------------------------------------------------------


def test_difference_weights_are_the_known_eighth_order_ones() -> None:
    known = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    np.testing.assert_allclose(difference_weights(np.arange(-4, 5), 1), known, atol=20 * EPS)
    known = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
    np.testing.assert_allclose(difference_weights(np.arange(-4, 5), 2), known, atol=20 * EPS)


@given(
    coefficients=st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9),
    derivative=st.sampled_from([1, 2]),
    count=st.integers(10, 40),
)
def test_derivatives_of_polynomials_of_degree_eight_are_exact_up_to_the_ends(
    coefficients: list[float], derivative: int, count: int
) -> None:
    t = np.linspace(-1.0, 1.0, count)
    rate = (count - 1) / 2.0
    polynomial = np.polynomial.Polynomial(coefficients)
    expected = polynomial.deriv(derivative)(t)
    # rounding of the samples (up to 9) times the off-centre weights' sum of magnitudes (below 2000)
    tolerance = 9 * 2000 * 4 * EPS * rate**derivative + 1e-12
    found = differentiate(polynomial(t), rate, derivative=derivative)
    np.testing.assert_allclose(found, expected, atol=tolerance)


@pytest.mark.parametrize("derivative", [1, 2])
def test_the_error_falls_with_the_eighth_power_of_the_sample_period(derivative: int) -> None:
    def worst(rate: float) -> float:
        t = np.arange(round(2 * rate)) / rate
        exact = 5.0 * np.cos(5.0 * t) if derivative == 1 else -25.0 * np.sin(5.0 * t)
        return float(np.max(np.abs(differentiate(np.sin(5.0 * t), rate, derivative=derivative) - exact)))

    # the off-centre ends are the worst and have the order, too: 2^8 = 256
    assert worst(20.0) / worst(40.0) > 0.6 * 256


def test_a_signal_shorter_than_the_stencil_is_refused() -> None:
    with pytest.raises(ValueError, match=r"8 samples .* 9 are needed"):
        differentiate(np.zeros(8), 100.0)


@pytest.mark.parametrize("accuracy", [0, 3, -2])
def test_an_odd_accuracy_is_refused(accuracy: int) -> None:
    with pytest.raises(ValueError, match="even number"):
        differentiate(np.zeros(100), 100.0, accuracy=accuracy)


def test_motion_of_a_known_sine_has_its_velocity_and_acceleration() -> None:
    rate, hz = 500.0, 3.0
    w = 2 * np.pi * hz
    t = np.arange(2000) / rate
    q = np.column_stack([np.sin(w * t), np.cos(w * t)])
    result = motion(q, rate, None)
    # relative errors w^8/630 and w^8/3150 with w = 0.038 rad a sample are below rounding, eps * rate^2
    np.testing.assert_allclose(result.position, q)
    np.testing.assert_allclose(result.velocity, w * np.column_stack([np.cos(w * t), -np.sin(w * t)]), atol=1e-9)
    np.testing.assert_allclose(result.acceleration, -(w**2) * q, atol=1e-6)


def test_one_second_difference_is_flatter_than_two_first_differences() -> None:
    rate = 100.0
    x = sine(25.0, rate, 4.0)
    exact = -((2 * np.pi * 25.0) ** 2) * x
    middle = slice(50, -50)
    one = np.max(np.abs(motion(x, rate).acceleration - exact)[middle])
    two = np.max(np.abs(differentiate(differentiate(x, rate), rate) - exact)[middle])
    assert one < two / 5.0


def test_motion_filters_before_it_differentiates() -> None:
    x = sine(2.0, 1000.0, 4.0) + 0.01 * sine(200.0, 1000.0, 4.0)
    filtered = lowpass(x, 20.0, 1000.0)
    middle = slice(300, -300)
    np.testing.assert_allclose(
        motion(x, 1000.0, 20.0).acceleration[middle],
        differentiate(filtered, 1000.0, derivative=2)[middle],
        rtol=1e-6,
        atol=1e-6,
    )


def test_motion_keeps_the_acceleration_at_the_ends_of_a_noisy_recording() -> None:
    rate, w, noise = 1000.0, 2 * np.pi * 0.5, 1e-5
    t = np.arange(0, 3.3, 1 / rate)
    for seed in range(5):
        x = np.sin(w * t) + noise * np.random.default_rng(seed).normal(size=len(t))
        error = motion(x, rate, 40.0).acceleration + w**2 * np.sin(w * t)
        # noise through the filter: 1e-5 rad times (2 pi 40 Hz)^2, a few times that at an end
        assert np.abs(error).max() < 5 * noise * (2 * np.pi * 40.0) ** 2


# --- resampling ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [2, 5, 20])
def test_decimation_of_a_band_limited_signal_picks_every_factor_th_sample(factor: int) -> None:
    rate = 5000.0
    x = np.column_stack([sine(0.35 * rate / factor, rate, 1.0), 2.0 + sine(0.05 * rate / factor, rate, 1.0)])
    y = resample(x, rate, rate / factor)
    assert y.shape == (-(-len(x) // factor), 2)
    # away from the ends, where the reflection of a sine is not the sine; 100 dB
    inside = slice(40, -40)
    np.testing.assert_allclose(y[inside], x[::factor][inside], atol=3e-5)


def test_what_lies_above_the_new_nyquist_frequency_does_not_fold_down() -> None:
    x = sine(330.0, 5000.0, 2.0)
    y = resample(x, 5000.0, 500.0)  # would appear at 170 Hz
    assert np.max(np.abs(y[40:-40])) < 3e-5


@given(up=st.integers(1, 7), down=st.integers(1, 7))
@settings(max_examples=20, deadline=None)
def test_a_rational_ratio_keeps_the_times_of_the_samples(up: int, down: int) -> None:
    rate = 1000.0
    new_rate = rate * up / down
    hz = 0.3 * min(rate, new_rate)
    x = sine(hz, rate, 2.0)
    y = resample(x, rate, new_rate)
    t = np.arange(len(y)) / new_rate
    inside = (t > 0.3) & (t < 1.7)
    np.testing.assert_allclose(y[inside], np.sin(2 * np.pi * hz * t + 0.3)[inside], atol=5e-5)


def test_a_straight_line_is_resampled_up_to_its_ends() -> None:
    t = np.arange(4000) / 4000.0
    np.testing.assert_allclose(resample(t, 4000.0, 500.0), t[::8], atol=2e-5)


def test_a_signal_shorter_than_the_resampling_filter_is_refused() -> None:
    with pytest.raises(ValueError, match="50 samples are too few to resample from 5000 to 500 Hz"):
        resample(np.zeros(50), 5000.0, 500.0)


@pytest.mark.parametrize("rate_to", [0.0, -5.0, 1000.0 * np.pi])
def test_a_ratio_that_is_no_fraction_is_refused(rate_to: float) -> None:
    with pytest.raises(ValueError, match=r"sample rate|no fraction"):
        resample(np.zeros(5000), 1000.0, rate_to)


@given(cutoff=st.floats(0.1, 400.0), rate=st.floats(801.0, 20_000.0), margin=st.floats(1.0, 20.0))
def test_the_decimation_factor_is_the_largest_that_keeps_the_margin(cutoff: float, rate: float, margin: float) -> None:
    factor = decimation_factor(cutoff, rate, margin)
    if factor > 1:
        assert rate / factor / 2 >= margin * cutoff * (1 - 1e-9)
    assert rate / (factor + 1) / 2 < margin * cutoff * (1 + 1e-9)


def test_what_the_lowpass_leaves_beyond_the_decimated_nyquist_is_negligible() -> None:
    factor = decimation_factor(40.0, 5000.0)
    assert factor == 15
    x = sine(0.5 * 5000.0 / factor, 5000.0, 2.0)
    assert np.max(np.abs(lowpass(x, 40.0, 5000.0)[2000:-2000])) < 2e-5


# --- noise and periods -----------------------------------------------------------------------------------------------


def trajectory(rate: float, highest_hz: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Random-phase sum of sines up to a frequency, falling as 1/f², and its exact acceleration."""
    t = np.arange(round(20.0 * rate)) / rate
    hz = np.arange(0.13, highest_hz, 0.37)
    phase = rng.uniform(0, 2 * np.pi, len(hz))
    amplitude = 0.3 / (1.0 + hz**2)
    w = 2 * np.pi * hz
    q = np.sin(t[:, None] * w + phase) @ amplitude
    return q, -np.sin(t[:, None] * w + phase) @ (amplitude * w**2)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4))])
@pytest.mark.parametrize(("highest_hz", "noise"), [(5.0, 1e-6), (20.0, 1e-5), (20.0, 1e-4)])
def test_the_estimated_cutoff_is_nearly_the_best_for_the_acceleration(
    seed: int, highest_hz: float, noise: float
) -> None:
    rate = 500.0
    rng = np.random.default_rng(seed)
    q, acceleration = trajectory(rate, highest_hz, rng)
    measured = q + noise * rng.normal(size=len(q))

    def error(cutoff: float) -> float:
        # the ends follow the filter's continuation, not the noise
        return float(np.std((motion(measured, rate, cutoff).acceleration - acceleration)[500:-500]))

    cutoff = noise_cutoff_hz(measured[:, None], rate)
    assert cutoff is not None
    best = min(error(candidate) for candidate in np.geomspace(0.5, 200.0, 60))
    assert error(cutoff) < 1.3 * best


@pytest.mark.parametrize("seed", range(3))
def test_positions_without_noise_need_no_cutoff(seed: int) -> None:
    q, _ = trajectory(500.0, 10.0, np.random.default_rng(seed))
    assert noise_cutoff_hz(q, 500.0) is None
    assert noise_cutoff_hz(np.column_stack([q, np.zeros_like(q)]), 500.0) is None


def test_rounding_to_encoder_counts_is_seen_as_noise() -> None:
    q, _ = trajectory(1000.0, 5.0, np.random.default_rng(4))
    count = 2 * np.pi / 2**17
    cutoff = noise_cutoff_hz(np.round(q / count) * count, 1000.0)
    assert cutoff is not None
    assert 4.0 < cutoff < 50.0


def test_more_noise_gives_a_lower_cutoff() -> None:
    rng = np.random.default_rng(5)
    q, _ = trajectory(500.0, 40.0, rng)
    noise = rng.normal(size=len(q))
    found = [noise_cutoff_hz(q + level * noise, 500.0) for level in (1e-6, 1e-5, 1e-4, 1e-3)]
    cutoffs = [cutoff for cutoff in found if cutoff is not None]
    assert len(cutoffs) == 4
    assert cutoffs == sorted(cutoffs, reverse=True)


def test_periods_are_cut_from_the_start_and_the_rest_left_out() -> None:
    x = np.arange(22.0).reshape(11, 2)
    cut = periods(x, 4)
    assert cut.shape == (2, 4, 2)
    np.testing.assert_array_equal(cut[1, 0], x[4])


def test_less_than_one_period_is_refused() -> None:
    with pytest.raises(ValueError, match="3 samples hold no whole period of 4"):
        periods(np.zeros((3, 2)), 4)


@pytest.mark.parametrize("samples", [7, 100, 104, 105, 200, 351])
def test_work_in_pieces_gives_what_work_on_the_whole_gives(samples: int) -> None:
    x = np.random.default_rng(samples).normal(size=(samples, 2))
    mean = functools.partial(uniform_filter1d, size=9, axis=0, mode="nearest")
    np.testing.assert_allclose(in_pieces(mean, x, 4, at_once=100), mean(x), rtol=0, atol=1e-13)


# --- ends of a motion --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cutoff", [1.0, 2.0, 4.0, None])
def test_the_ends_of_a_slow_log_keep_the_acceleration_to_a_third(cutoff: float | None) -> None:
    # a robot's motion up to 0.6 Hz with 1e-5 rad of noise, logged at 10 Hz: a quartic through seconds of it cannot follow
    hz, time = np.arange(1, 7) / 10.0, np.arange(300) / 10.0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        phase, size = rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.5, 1.0, 6) / hz**2 / 50.0
        angle = 2 * np.pi * hz * time[:, None] + phase
        q, a = np.sin(angle) @ size, -np.sin(angle) @ (size * (2 * np.pi * hz) ** 2)
        found = motion((q + 1e-5 * rng.normal(size=300))[:, None], 10.0, cutoff).acceleration[:, 0]
        error = np.abs(found - a) / np.abs(a).max()
        assert max(error[:4].max(), error[-4:].max()) < 1 / 3
