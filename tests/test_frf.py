"""Nonparametric frequency response: exact on a linear loop, covariances of noise and distortion apart, what is missing is named."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import rx90b_flex as rf
from rx90b_flex.effects import catalogue
from rx90b_flex.excitation import identity, minus_below_first, multisine, odd_lines
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.identify.frf import MeasuredResponse, confidence_radius, estimate_frequency_response, group_recordings
from rx90b_flex.signals import Recording, load_campaign
from rx90b_flex.simulate import Noise, load_cs8, run_campaign, section_662, square_wave, static_start
from rx90b_flex.view import frf_plots

SAMPLES, RATE = 128, 100.0
LINES = np.array(odd_lines(5, 45))
HZ = LINES * RATE / SAMPLES


def plant(hz: np.ndarray) -> np.ndarray:
    """Drive acceleration over torque of a symmetric two-mass-like pair, shape (F, 2, 2)."""
    s2 = -((hz / 20.0) ** 2) + 0.04j * hz / 20.0
    mode = np.array([[1.0, 0.4], [0.4, 0.8]])
    return np.array([[0.5, -0.2], [-0.2, 0.7]]) + s2[:, None, None] / (1.0 + s2[:, None, None]) * 0.3 * mode


def recordings(
    rng: np.random.Generator,
    realisations: int = 4,
    periods: int = 4,
    matrix: np.ndarray | None = None,
    torque_noise: float = 0.0,
    noise: float = 0.0,
    distortion: float = 0.0,
    loop: float = 1.0,
    names: bool = True,
    log_feedforward: bool = True,
) -> list[Recording]:
    """A linear loop ``u = f - loop (y + noise + reference's part)``, spectra drawn line by line, both signs.

    Noise is drawn anew for every period, distortion of the acceleration once a realisation and sign of the excitation.
    """
    inputs = minus_below_first(2) if matrix is None else matrix
    p = plant(HZ)
    sensitivity = np.linalg.inv(np.eye(2) + loop * p)
    out = []

    def circular(*shape: int) -> np.ndarray:
        return np.asarray((rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0))

    reference = 5.0 * circular(len(LINES), 2)  # the same in all runs
    for m in range(realisations):
        wave = multisine(list(LINES), SAMPLES, 10.0, rng)[:, 0]
        for k in range(inputs.shape[1]):
            repeats = distortion * circular(len(LINES), 2)
            for sign in (1, -1):
                feedforward = sign * np.outer(wave, inputs[:, k])
                f = 2.0 / SAMPLES * np.fft.rfft(feedforward, axis=0)[LINES]
                v_y, v_u = noise * circular(periods, len(LINES), 2), torque_noise * circular(periods, len(LINES), 2)
                d = sign * repeats
                u = np.einsum("fjk,mfk->mfj", sensitivity, f - loop * (d + v_y + reference))
                y = np.einsum("fjk,mfk->mfj", p, u) + d
                spectra = np.zeros((2, periods, SAMPLES // 2 + 1, 2), complex)
                spectra[0][:, LINES] = u + v_u
                spectra[1][:, LINES] = (y + v_y) / -((2.0 * np.pi * HZ[:, None]) ** 2)
                torque, angle = np.fft.irfft(0.5 * SAMPLES * spectra, SAMPLES, axis=2).reshape(2, -1, 2)
                out.append(
                    Recording(
                        f"run_{m:03d}_{k + 1}_{'plus' if sign > 0 else 'minus'}" if names else f"r{len(out)}",
                        "identification",
                        np.arange(len(torque)) / RATE,
                        RATE,
                        ("a", "b"),
                        angle + [0.3, -1.0],
                        torque,
                        feedforward_torque=np.tile(feedforward, (periods, 1)) if log_feedforward else None,
                        period_s=SAMPLES / RATE,
                    )
                )
    return out


def without(runs: Sequence[Recording], *names: str) -> list[Recording]:
    return [r for r in runs if r.name not in names]


# ---- the estimate ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("matrix", [identity(2), minus_below_first(2), np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 0.5]])])
def test_a_linear_loop_without_noise_gives_the_plant_exactly(matrix: np.ndarray) -> None:
    """With as many experiments as joints and with more; the references' response goes with the sign pairs."""
    r = estimate_frequency_response(recordings(np.random.default_rng(0), matrix=matrix))
    np.testing.assert_allclose(r.hz, HZ)
    for value in (r.value, r.h1, r.arithmetic_mean):
        np.testing.assert_allclose(value, plant(HZ), rtol=1e-8)
    np.testing.assert_allclose(r.acceleration, plant(HZ) @ r.torque, rtol=1e-8)
    assert r.joints == ("a", "b") and r.pose == pytest.approx([0.3, -1.0])
    assert r.std().max() < 1e-8


def test_spectra_are_brought_to_common_phases_before_they_are_averaged() -> None:
    """The mean keeps the size of one realisation's and loses its distortion; without the mapping it would fall itself."""
    runs = recordings(np.random.default_rng(0), realisations=25, distortion=0.1)
    one, every = (estimate_frequency_response(x, neighbours=9) for x in (runs[:8], runs))
    level = np.abs(plant(HZ) @ one.torque).mean()
    assert np.abs(every.acceleration).mean() == pytest.approx(level, rel=0.05)
    noise = np.abs(every.acceleration - plant(HZ) @ every.torque).mean()
    assert noise < 0.5 * np.abs(one.acceleration - plant(HZ) @ one.torque).mean()  # of 25 against 2: 0.28


def test_noise_covariance_holds_the_noise_of_both_signals_and_their_correlation_through_the_loop() -> None:
    """Of ``Y - P U`` it is ``s_y^2 + s_u^2 P P^H``, whatever the loop; halved by the sign pairs, divided by the periods."""
    r = estimate_frequency_response(recordings(np.random.default_rng(1), 30, 5, torque_noise=0.05, noise=0.02))
    p = plant(HZ)
    expected = (0.02**2 * np.eye(2) + 0.05**2 * p @ p.conj().swapaxes(1, 2)) / 2 / 5
    # each line has 30 * 4 * 2 degrees of freedom, its deviation is 1/sqrt of that; five of these for all lines
    assert r.equation_noise is not None
    scale = np.sqrt(np.einsum("fj,fk->fjk", *(2 * [np.einsum("fjj->fj", expected).real])))
    assert np.max(np.abs(r.equation_noise - expected) / scale) < 5 / np.sqrt(240)


def test_covariances_are_those_of_repeated_campaigns() -> None:
    """Noise alone: predicted from periods and from realisations, both the scatter of forty campaigns."""
    rng = np.random.default_rng(2)
    campaigns = [estimate_frequency_response(recordings(rng, 6, 3, torque_noise=0.05, noise=0.02)) for _ in range(40)]
    scatter = np.mean(np.abs(np.stack([c.value for c in campaigns]) - plant(HZ)) ** 2, axis=0)
    for which in ("noise_covariance", "covariance"):
        predicted = np.mean([np.einsum("faa->fa", getattr(c, which)).real for c in campaigns], axis=0)
        # 40 campaigns, 21 lines: 840 squares of a circular error, their mean deviates by 3.5 %
        ratio = np.mean(scatter.reshape(len(HZ), 4) / predicted, axis=0)
        assert np.all(np.abs(ratio - 1.0) < 4 * 0.035 + 0.02), which


@pytest.mark.parametrize(
    "seed", [3, pytest.param(13, marks=pytest.mark.slow), pytest.param(23, marks=pytest.mark.slow)]
)
def test_nonlinear_distortion_is_told_from_noise(seed: int) -> None:
    r = estimate_frequency_response(recordings(np.random.default_rng(seed), 40, 4, noise=0.03, distortion=0.1))
    assert r.noise_covariance is not None and r.distortion_covariance is not None
    noise, distortion = (
        np.mean(np.einsum("fjj->f", x).real) for x in (r.equation_noise, r.equation_total - r.equation_noise)
    )
    assert noise == pytest.approx(2 * 0.03**2 / 2 / 4, rel=0.1)
    assert distortion == pytest.approx(2 * 0.1**2, rel=0.1)  # 39 * 2 * 21 squares of two joints: 2.5 %, and noise's
    share = np.einsum("faa->f", r.distortion_covariance).real / np.einsum("faa->f", r.covariance).real
    assert np.all(share > 0.9)


@pytest.mark.parametrize(
    "seed", [4, pytest.param(14, marks=pytest.mark.slow), pytest.param(24, marks=pytest.mark.slow)]
)
def test_bands_hold_the_truth_in_95_percent_of_lines_with_few_realisations(seed: int) -> None:
    """Fisher's quantile makes up for a covariance that five realisations tell: of one line, or of all where they are alike."""
    rng = np.random.default_rng(seed)
    inside = []
    for _ in range(30):
        own = estimate_frequency_response(recordings(rng, 5, 2, noise=0.02, distortion=0.05), neighbours=0)
        every = estimate_frequency_response(recordings(rng, 5, 2, torque_noise=0.05), neighbours=30)
        inside.append([np.mean(np.abs(r.value - plant(HZ)) < confidence_radius(r)) for r in (own, every)])
    # 30 * 21 * 4 places deviate by 0.43 %, twice that if the four entries of a line were one; three deviations
    assert np.all(np.abs(np.mean(inside, axis=0) - 0.95) < 3 * 2 * 0.0043)


@pytest.mark.parametrize(
    "seed", [5, pytest.param(15, marks=pytest.mark.slow), pytest.param(25, marks=pytest.mark.slow)]
)
def test_in_closed_loop_h1_is_biased_as_theory_says_and_this_estimate_is_not(seed: int) -> None:
    """The loop feeds the angle's noise v back: ``E[(y - P u) u^H] = -c E[v v^H] S^H``, which H1 divides by ``E[u u^H]``."""
    noise, loop = 0.1, 2.0
    runs = recordings(np.random.default_rng(seed), 60, 8, noise=noise, loop=loop)
    r = estimate_frequency_response(runs)
    p = plant(r.hz)
    s = np.linalg.inv(np.eye(2) + loop * p)
    waves = np.stack([x.feedforward_torque[:SAMPLES] for x in runs if x.feedforward_torque is not None])
    lines = np.isin(HZ, r.hz)
    f = 2.0 / SAMPLES * np.fft.rfft(waves, axis=1)[:, LINES[lines]]
    left = 0.5 * noise**2  # of the half difference of a sign pair
    adjoint = s.conj().swapaxes(1, 2)
    power = s @ (np.mean(f[..., :, None] * f[..., None, :].conj(), axis=0) + loop**2 * left * np.eye(2)) @ adjoint
    bias = -loop * left * adjoint @ np.linalg.inv(power)
    assert np.diag(np.median(np.abs(bias) / r.std(), axis=0)).min() > 3.0
    np.testing.assert_array_less(np.mean(np.abs(r.h1 - p - bias), axis=0), 1.2 * np.mean(r.std(), axis=0))
    np.testing.assert_array_less(np.mean(np.abs(r.value - p), axis=0), 1.2 * np.mean(r.std(), axis=0))


# ---- which recording is what ----------------------------------------------------------------------------------


def test_realisations_experiments_and_signs_are_told_from_the_feedforward_in_any_order() -> None:
    for matrix in (identity(2), minus_below_first(2)):
        runs = recordings(np.random.default_rng(6), matrix=matrix, names=False)
        order = np.random.default_rng(0).permutation(len(runs))
        shuffled = estimate_frequency_response([runs[i] for i in order])
        np.testing.assert_allclose(shuffled.value, plant(HZ), rtol=1e-8)
        assert len({p.realisation for p in shuffled.places}) == 4
        assert sorted(p.sign for p in shuffled.places) == [-1] * 8 + [1] * 8


def test_without_feedforward_names_tell_and_lines_must_be_given() -> None:
    runs = recordings(np.random.default_rng(6), log_feedforward=False)
    with pytest.raises(ValueError, match="or from Python the excited lines as `hz`"):
        estimate_frequency_response(runs)
    np.testing.assert_allclose(estimate_frequency_response(runs, hz=HZ).value, plant(HZ), rtol=1e-8)
    unnamed = recordings(np.random.default_rng(6), log_feedforward=False, names=False)
    with pytest.raises(ValueError, match="'r0': neither feedforward_torque nor its name"):
        estimate_frequency_response(unnamed, hz=HZ)
    given = [dataclasses.replace(p, recording=r.name) for p, r in zip(group_recordings(runs), unnamed, strict=True)]
    np.testing.assert_allclose(estimate_frequency_response(unnamed, hz=HZ, places=given).value, plant(HZ), rtol=1e-8)


def test_a_run_that_is_there_twice_is_named() -> None:
    runs = recordings(np.random.default_rng(6))
    with pytest.raises(ValueError, match="run_000_1_plus, again have the same excitation"):
        group_recordings([*runs, dataclasses.replace(runs[0], name="again")])


# ---- what is missing ------------------------------------------------------------------------------------------


def exact(r: MeasuredResponse) -> None:
    np.testing.assert_allclose(r.value, plant(r.hz), rtol=1e-8)


def test_a_missing_experiment_costs_its_realisation() -> None:
    runs = recordings(np.random.default_rng(7))
    r = estimate_frequency_response(without(runs, "run_001_2_plus", "run_001_2_minus"))
    assert "realisation 2 has 1 of 2 experiments and is left out" in r.remarks
    assert len(r.realisations) == 3
    exact(r)


def test_a_missing_sign_costs_its_realisation() -> None:
    r = estimate_frequency_response(without(recordings(np.random.default_rng(7)), "run_001_2_plus"))
    assert any("run_001_2_minus lacks the run of opposite sign" in x for x in r.remarks)
    assert len(r.realisations) == 3
    exact(r)


def test_one_sign_alone_is_used_and_said() -> None:
    runs = [x for x in recordings(np.random.default_rng(7)) if x.name.endswith("plus")]
    r = estimate_frequency_response(runs)
    assert any("no experiment was run with both signs" in x for x in r.remarks)
    assert len(r.realisations) == 4


def test_too_few_experiments_are_refused() -> None:
    runs = [x for x in recordings(np.random.default_rng(7)) if "_1_" in x.name]
    with pytest.raises(ValueError, match="1 experiments a realisation for 2 joints"):
        estimate_frequency_response(runs)


def test_one_period_cannot_tell_noise_and_one_realisation_no_distortion() -> None:
    rng = np.random.default_rng(8)
    r = estimate_frequency_response(recordings(rng, 6, 1, noise=0.01))
    assert r.noise_covariance is None and np.isnan(r.spectra.torque_snr).all() and r.distortion_covariance is None
    assert any("one period: noise cannot be told from distortion" in x for x in r.remarks)
    r = estimate_frequency_response(recordings(rng, 1, 6, noise=0.01))
    assert any("one realisation: the nonlinear distortion is unknown" in x for x in r.remarks)
    np.testing.assert_array_equal(r.covariance, r.noise_covariance)
    with pytest.raises(ValueError, match="one realisation of one period"):
        estimate_frequency_response(recordings(rng, 1, 1))
    r = estimate_frequency_response(recordings(rng, 3, 2, noise=0.01), neighbours=0)
    assert any("3 realisations: 2 degrees of freedom are fewer than the 4 entries" in x for x in r.remarks)


def test_lines_at_which_the_experiments_are_dependent_are_left_out_and_the_rest_is_estimated() -> None:
    runs = recordings(np.random.default_rng(9), noise=0.001)
    lost = HZ[7]

    def same_everywhere(r: Recording) -> Recording:
        """Experiment 2 repeats experiment 1 at one line."""
        if "_2_" not in r.name:
            return r
        other = next(x for x in runs if x.name == r.name.replace("_2_", "_1_"))

        def mixed(own: np.ndarray, first: np.ndarray) -> np.ndarray:
            spectra = [np.fft.rfft(x.reshape(-1, SAMPLES, 2), axis=1) for x in (own, first)]
            spectra[0][:, LINES[7]] = spectra[1][:, LINES[7]]
            return np.fft.irfft(spectra[0], SAMPLES, axis=1).reshape(-1, 2)

        assert r.feedforward_torque is not None and other.feedforward_torque is not None
        return dataclasses.replace(
            r,
            torque=mixed(r.torque, other.torque),
            position=mixed(r.position, other.position),
            feedforward_torque=mixed(r.feedforward_torque, other.feedforward_torque),
        )

    r = estimate_frequency_response([same_everywhere(x) for x in runs])
    assert any(
        f"1 line is left out, the experiments' torques are dependent there: {lost:.4g} Hz" in x for x in r.remarks
    )
    np.testing.assert_allclose(r.hz, np.delete(HZ, 7))
    assert np.max(np.abs(r.value - plant(r.hz)) / r.std()) < 6
    with pytest.raises(ValueError, match="dependent at every line"):
        estimate_frequency_response(
            recordings(np.random.default_rng(9), matrix=np.outer([1.0, 1.0], [1.0, 0.5]), noise=0.001)
        )


def test_lines_beyond_nyquist_are_named() -> None:
    runs = recordings(np.random.default_rng(10))
    r = estimate_frequency_response(runs, hz=np.append(HZ, [64 * RATE / SAMPLES, 70 * RATE / SAMPLES]))
    assert any("2 lines from 50 Hz are at or beyond Nyquist (50 Hz) and left out" in x for x in r.remarks)
    exact(r)
    with pytest.raises(ValueError, match="no line is left"):
        estimate_frequency_response(runs, band_hz=(60.0, 80.0))
    with pytest.raises(ValueError, match="no multiple of"):
        estimate_frequency_response(runs, hz=np.array([1.0]))


def test_recordings_that_do_not_fit_together_are_named() -> None:
    runs = recordings(np.random.default_rng(11))
    with pytest.raises(ValueError, match="'run_000_1_plus' has no period_s"):
        estimate_frequency_response([dataclasses.replace(runs[0], period_s=None), *runs[1:]])
    with pytest.raises(ValueError, match=r"'run_000_1_minus' are 0\.2 rad apart"):
        estimate_frequency_response([runs[0], dataclasses.replace(runs[1], position=runs[1].position + 0.2), *runs[2:]])
    with pytest.raises(ValueError, match="joint 'c' is not recorded"):
        estimate_frequency_response(runs, joints=["a", "c"])


# ---- the robot ------------------------------------------------------------------------------------------------


def linear_robot() -> rf.Robot:
    """The example of section 5.9 with viscous friction alone."""
    robot = rf.load_robot("rx90b_3dof")
    viscous = catalogue()["viscous_friction"]
    kept = [e for e in robot.effects if "Friction" not in type(e).__name__]
    pairs = zip(robot.joints, (80.0, 80.0, 25.0), strict=True)
    return robot.with_effects([*kept, *(viscous(joint=j, coefficient=c) for j, c in pairs)])  # type: ignore[call-arg]


def test_a_simulated_campaign_at_rest_gives_the_linearised_robot(tmp_path: Path) -> None:
    """No noise, no quantisation, no nonlinear friction: what is left is the hold between two samples of the controller.

    The torque is constant over 0.25 ms, its logged value that of one instant: of order ``(w T)^2 / 12`` in magnitude, 0.13 % at
    80 Hz. Small entries, seen beside large ones, get more.
    """
    robot = linear_robot()
    pose = [0.0, 0.5 * np.pi, 0.0]
    plan = section_662(
        robot,
        load_cs8().ideal(),
        reference=square_wave(robot, pose, speed=0.0),
        realisations=1,
        periods=3,
        crest="clipping",
        noise=Noise(),
    )
    result = run_campaign(plan, tmp_path / "c")
    assert result.file is not None
    r = estimate_frequency_response(load_campaign(result.file), band_hz=(4.0, 80.0))
    truth = robot.linearize(static_start(robot, np.array(pose), np.zeros(3))[0]).frf(r.hz)
    error = np.abs(r.value - truth)
    assert np.median(error / np.abs(truth), axis=0).max() < 0.01
    assert np.max(error / np.abs(np.sqrt(np.einsum("fjj,fkk->fjk", truth, truth)))) < 0.01
    # ends of the log: all periods alike, so that noise comes out as none
    assert r.noise_covariance is not None and np.sqrt(np.einsum("faa->fa", r.noise_covariance).real).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_bands_of_a_campaign_with_friction_and_noise_cover_the_mean_of_many(seed: int, tmp_path: Path) -> None:
    """Section 6.6.2 by the perturbation method, friction exact: six campaigns of four realisations, each against the others' mean."""
    plan = section_662(
        rf.load_robot("rx90b_3dof"),
        load_cs8(),
        noise=Noise(torque=0.1, position=1e-6, velocity=1e-4),
        realisations=24,
        periods=3,
        crest="clipping",
        seed=seed,
        method="perturbation",
    )
    file = run_campaign(plan, tmp_path / "c").file
    assert file is not None
    runs = load_campaign(file).identification
    each = [estimate_frequency_response(runs[24 * i : 24 * i + 24], band_hz=(8.0, 80.0)) for i in range(6)]
    total = sum(r.value for r in each)
    widened = np.sqrt(1.0 + 1.0 / 5.0)  # the mean of five others is not exact either
    inside = [np.abs(r.value - (total - r.value) / 5.0) < widened * confidence_radius(r) for r in each]
    assert 0.90 < np.mean(inside) < 0.99
    by_entry = np.mean(inside, axis=(0, 1))
    assert by_entry.min() > 0.88 and by_entry.max() < 0.995
    # the source's covariance takes experiments as independent: friction's distortion follows each joint's own motion, and is not
    inverse, total = np.linalg.pinv(each[0].torque), each[0].equation_total
    spread = np.einsum(
        "fek,fek->fk", inverse, inverse.conj()
    ).real  # of one realisation's torques: of all nearly the same
    variance = np.einsum("fjj->fj", total).real[:, :, None] * spread[:, None, :] / len(each[0].realisations)
    ratio = np.sqrt(variance) / each[0].std()
    assert np.median(ratio[:, 0, 0]) < 1.0 < np.median(ratio[:, 1, 0])
    # friction's distortion is well above the noise, and the two estimates over single periods lie where the mean over periods does
    whole = estimate_frequency_response(runs, band_hz=(8.0, 80.0))
    assert whole.distortion_covariance is not None
    share = np.einsum("faa->f", whole.distortion_covariance).real / np.einsum("faa->f", whole.covariance).real
    apart = {
        name: np.median(np.abs(getattr(whole, name) - whole.value) / whole.std()) for name in ("arithmetic_mean", "h1")
    }
    assert share.mean() > 0.5
    assert apart["arithmetic_mean"] < 0.1 < apart["h1"]


# ---- figures --------------------------------------------------------------------------------------------------

FIGURES: list[Callable[[MeasuredResponse], Figure]] = [
    lambda r: frf_plots.magnitude(r, [(r.hz, r.h1, "H1")]),
    lambda r: frf_plots.phase(r, [(r.hz, r.h1, "H1")]),
    lambda r: frf_plots.difference(r, plant(r.hz), "plant"),
    frf_plots.signal_to_noise,
    frf_plots.channel_signal_to_noise,
    lambda r: frf_plots.excitation(r.spectra, r.joints),
]


@pytest.mark.parametrize("draw", FIGURES)
def test_figures_have_axes_with_units(draw: Callable[[MeasuredResponse], Figure], tmp_path: Path) -> None:
    figure = draw(estimate_frequency_response(recordings(np.random.default_rng(12), noise=0.01)))
    figure.savefig(tmp_path / "figure.png", dpi=40)
    labelled = [ax for ax in figure.axes if ax.get_xlabel() and ax.get_ylabel()]
    assert labelled and all("Hz" in ax.get_xlabel() for ax in labelled)
    assert all(any(unit in ax.get_ylabel() for unit in ("rad/s²", "°", "dB", "N m")) for ax in labelled)


def test_a_difference_needs_the_same_lines() -> None:
    r = estimate_frequency_response(recordings(np.random.default_rng(12)))
    with pytest.raises(ValueError, match="at the response's lines"):
        frf_plots.difference(r, plant(r.hz[:-1]))


def test_a_response_compares_itself_with_a_robot_and_shows_itself() -> None:
    robot = rf.load_robot("rx90b_3dof")
    robot = robot.with_effects([e for e in robot.effects if not e.traits.is_friction])
    linear = robot.linearize(robot.input_matrix @ [0.0, 1.5, 0.3])
    hz = np.linspace(8.0, 60.0, 40)
    true = linear.frf(hz)
    covariance = np.repeat(np.eye(9)[None] * 1e-6, len(hz), axis=0).astype(complex)
    off = 2e-3 * np.exp(2j * np.pi * np.arange(true.size) / 7).reshape(true.shape)
    response = FrequencyResponse(hz, true + off, covariance, robot.joints, np.zeros(3))
    # errors of twice the standard deviation
    np.testing.assert_allclose(np.abs(response.residuals(linear)), 2.0, rtol=1e-9)
    fit = response.compare(linear)
    j, k = robot.joints[0], robot.joints[2]
    spread = response.value[:, 0, 2] - response.value[:, 0, 2].mean()
    assert fit.loc[j, k] == pytest.approx(100 * (1 - 2e-3 * np.sqrt(len(hz)) / np.linalg.norm(spread)))
    assert (response.compare(response) == 100.0).all(axis=None)
    figure = response.bode(linear)
    assert len(figure.axes) == 18 and "model" in [line.get_label() for line in figure.axes[0].lines]
    table = response.to_pandas()
    row = table[(table["acceleration"] == j) & (table["torque"] == k)].iloc[3]
    assert (row["hz"], complex(row["real"], row["imag"])) == (hz[3], response.value[3, 0, 2])
    with pytest.raises(ValueError, match="40 lines"):
        response.compare(response.band(8.0, 20.0))
    pytest.importorskip("xarray")
    grid = response.to_xarray()
    assert complex(grid["value"].sel(acceleration=j, torque=k).isel(hz=3)) == response.value[3, 0, 2]
