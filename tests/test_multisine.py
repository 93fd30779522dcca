"""Excitation: spectra, crest factors, input matrices, whitening, the reference that keeps joints from reversing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rx90b_flex as rf
from rx90b_flex.excitation import (
    crest_factor,
    hadamard,
    identity,
    lines_in_band,
    minus_below_first,
    multisine,
    odd_lines,
    scaled,
    smoothed_square,
    whitening,
)
from rx90b_flex.simulate import load_cs8, section_662
from rx90b_flex.simulate.trajectories import FEEDFORWARD_LINES


def amplitudes(wave: np.ndarray) -> np.ndarray:
    return np.abs(np.fft.rfft(wave)) * 2.0 / len(wave)


@pytest.mark.parametrize("crest", ["random", "clipping", "lp"])
def test_a_multisine_has_the_given_amplitudes_on_its_lines_and_nothing_elsewhere(crest: str) -> None:
    lines = odd_lines(3, 61)
    spectrum = np.linspace(1.0, 3.0, len(lines))
    wave = multisine(lines, 256, 45.0, np.random.default_rng(1), amplitudes=spectrum, crest=crest)[:, 0]  # type: ignore[arg-type]
    found = amplitudes(wave)
    np.testing.assert_allclose(found[list(lines)] / spectrum, found[3] / spectrum[0], rtol=1e-9)
    assert np.delete(found, lines).max() < 1e-12 * found.max()
    assert np.abs(wave).max() == pytest.approx(45.0)


def test_the_crest_factor_of_section_662_falls_from_three_to_the_sources_and_below() -> None:
    """The source: from 3.1 to 1.3 by clipping. Every one of five starts is checked, none chosen."""
    for seed in range(5):
        waves = {
            crest: multisine(FEEDFORWARD_LINES, 1024, 45.0, np.random.default_rng(seed), crest=crest)
            for crest in ("random", "clipping", "lp")
        }  # type: ignore[var-annotated]
        factor = {crest: crest_factor(wave).item() for crest, wave in waves.items()}
        assert 2.6 < factor["random"] < 3.6
        assert factor["clipping"] < 1.36
        assert factor["lp"] < 1.30 < factor["clipping"]


def test_between_the_samples_the_peak_is_lowered_only_if_asked_for() -> None:
    rng = np.random.default_rng
    fine = [multisine(odd_lines(1, 61), 128, 1.0, rng(3), crest="lp", oversampling=over) for over in (1, 8)]
    crest = []
    for wave in fine:
        spectrum = np.zeros(1025, complex)
        spectrum[:64] = np.fft.rfft(wave[:, 0])[:64]
        crest.append(crest_factor(np.fft.irfft(spectrum, 2048)).item())
    assert crest[1] < 1.5 < crest[0]


def test_the_crest_factor_of_a_sine_and_of_a_square_wave() -> None:
    t = np.arange(1000) / 1000
    assert crest_factor(np.sin(2 * np.pi * t)).item() == pytest.approx(np.sqrt(2.0))
    assert crest_factor(np.sign(t - 0.4995)).item() == pytest.approx(1.0)


def test_phases_of_random_multisines_are_uniform_and_columns_differ() -> None:
    waves = multisine(range(1, 101), 256, 1.0, np.random.default_rng(0), 40)
    phases = np.angle(np.fft.rfft(waves, axis=0)[1:101]).ravel()
    # the mean of exp(j phase) of N independent uniform phases is 1/sqrt(N) in size, and less than 3 of these in 1 - exp(-9) of cases
    assert abs(np.mean(np.exp(1j * phases))) < 3.0 / np.sqrt(len(phases))


def test_a_longer_period_has_finer_lines_in_the_same_band() -> None:
    coarse, fine = lines_in_band(8.0, 80.0, 4.096), lines_in_band(8.0, 80.0, 16.384)
    assert all(k % 2 for k in coarse + fine)
    assert min(coarse) / 4.096 >= 8.0 and max(coarse) / 4.096 <= 80.0
    assert len(fine) == pytest.approx(4 * len(coarse), abs=4)


@pytest.mark.parametrize(
    ("lines", "what"), [((1, 128), "Nyquist"), ((0, 3), "Nyquist"), ((3, 3), "twice"), ((), "no lines")]
)
def test_lines_that_cannot_be_are_named(lines: tuple[int, ...], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        multisine(lines, 256, 1.0, np.random.default_rng(0))


@given(st.integers(1, 24))
def test_rows_of_a_hadamard_matrix_are_orthogonal_and_full(joints: int) -> None:
    matrix = hadamard(joints)
    assert joints <= matrix.shape[1] < 2 * joints + 4
    np.testing.assert_array_equal(matrix @ matrix.T, matrix.shape[1] * np.eye(joints))
    assert np.all(np.abs(matrix) == 1.0)


def test_input_matrices_of_the_source() -> None:
    np.testing.assert_array_equal(identity(3), np.eye(3))
    np.testing.assert_array_equal(minus_below_first(3), [[1, 1, 1], [1, -1, 1], [1, 1, -1]])
    assert np.linalg.cond(minus_below_first(3)) == pytest.approx(2.0)  # not orthogonal, as the source has it


def test_amplitudes_follow_each_joints_limit() -> None:
    limits = 0.1 * np.array([450.0, 450.0, 200.0])
    matrix = scaled(minus_below_first(3), limits)
    np.testing.assert_allclose(np.abs(matrix).max(axis=1), limits)
    plan = section_662(
        rf.load_robot("rx90b_3dof"),
        load_cs8(),
        input_matrix=tuple(map(tuple, matrix.tolist())),
        peak=1.0,
        crest="random",
    )
    np.testing.assert_allclose(np.abs(plan.trajectory(plan.runs[0]).torque).max(axis=0), limits)


def test_a_whitened_multisine_reaches_the_drives_flat() -> None:
    """Through the loop's sensitivity the spectrum of each joint's torque, excited alone, is the same at every line."""
    robot = rf.load_robot("rx90b_3dof")
    lines = np.array(FEEDFORWARD_LINES)
    moving = np.tile([0.11, 0.0, 0.0, 0.0], 3)
    pose = np.zeros(12)
    pose[4] = 0.5 * np.pi
    sensitivity = load_cs8().sensitivity(robot.linearize(pose, v=moving), lines / 4.096)
    spectrum = whitening(sensitivity)
    plan = section_662(robot, load_cs8(), amplitudes=tuple(map(tuple, spectrum.tolist())), crest="random")
    torque = plan.trajectory(plan.runs[0]).torque[:1024]  # one period
    for j in range(3):
        drive = amplitudes(torque[:, j])[lines] * np.abs(sensitivity[:, j, j])
        assert np.ptp(drive) < 1e-9 * drive.mean()
        assert np.ptp(amplitudes(torque[:, j])[lines]) > 0.5 * amplitudes(torque[:, j])[lines].mean()


def test_the_smoothed_square_wave_has_odd_lines_alone_and_its_integral_fits() -> None:
    velocity, position = smoothed_square(1024, 9)
    spectrum = amplitudes(velocity)
    assert spectrum[::2].max() < 1e-12 and spectrum[19:].max() < 1e-12
    slope = np.fft.irfft(1j * np.arange(513) * np.fft.rfft(position), 1024)  # d/d(phase)
    np.testing.assert_allclose(slope, velocity, atol=1e-9)
    assert np.sum(np.diff(np.sign(velocity[1:-1])) != 0) == 1  # one reversal inside the period, one where it repeats


def test_runs_of_a_realisation_share_its_multisine_and_realisations_do_not() -> None:
    plan = section_662(rf.load_robot("rx90b_3dof"), load_cs8(), crest="clipping")
    torque = {(k.realisation, k.experiment, k.sign): plan.trajectory(k).torque for k in plan.runs[:12]}
    np.testing.assert_array_equal(torque[0, 1, 1], torque[0, 0, 1] * [1, -1, 1])
    np.testing.assert_array_equal(torque[0, 2, -1], -torque[0, 2, 1])
    unlike = np.corrcoef(torque[0, 0, 1][:, 0], torque[1, 0, 1][:, 0])[0, 1]
    assert abs(unlike) < 0.5
    again = dataclasses.replace(plan, seed=plan.seed)
    np.testing.assert_array_equal(again.trajectory(plan.runs[0]).torque, torque[0, 0, 1])
