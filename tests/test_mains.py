"""Claims about mains in the torque signals: known ones, on a linear robot's recordings, whose response without them is known too."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from linear_campaign import BENT, HZ, RATE, SAMPLES, recordings_at, viscous_robot, write

from rx90b_flex import cli
from rx90b_flex.identify.frf import estimate_frequency_response
from rx90b_flex.identify.mains import without_mains
from rx90b_flex.identify.transfer_function import fit_transfer_functions
from rx90b_flex.signals import Recording

ROBOT = viscous_robot()
OFF_HZ = 49.9  # a grid that runs slow; 204.4 cycles in a period
AMPLITUDE = 2.0  # N m; the excitation's peak is 20
CLEAN = recordings_at(ROBOT, BENT[0], np.random.default_rng(5), periods=4, noise=1e-3, torque_noise=0.01)


def with_mains(recordings: list[Recording], hz: float, wander: float = 0.0) -> tuple[list[Recording], np.ndarray]:
    """Every recording with its own phase and frequency; also the frequencies."""
    rng = np.random.default_rng(6)
    own = hz + wander * rng.uniform(-1.0, 1.0, len(recordings))
    out = []
    for r, f in zip(recordings, own, strict=True):
        sine = np.sin(2.0 * np.pi * (f * r.time[:, None] + rng.uniform(size=r.torque.shape[1])))
        out.append(dataclasses.replace(r, torque=r.torque + AMPLITUDE * sine))
    return out, own


def test_frequency_and_amplitude_are_found_within_their_noise() -> None:
    struck, hz = with_mains(CLEAN, OFF_HZ, wander=0.05)
    for r, plain, f in zip(struck, CLEAN, hz, strict=True):
        clean, found = without_mains(r, 50.0)
        # white noise of this size, N samples: amplitudes to sigma sqrt(2/N), frequency to sqrt(6/N) sigma/(pi duration A)
        sigma, samples = 0.011 * r.torque.std(axis=0).max(), r.samples
        assert np.abs(found.torque_amplitude - AMPLITUDE).max() < 6.0 * sigma * np.sqrt(2.0 / samples)
        assert abs(found.hz - f) < 6.0 * np.sqrt(6.0 / samples) * sigma / (np.pi * samples / RATE * AMPLITUDE)
        left = np.abs(clean.torque - plain.torque).max()  # amplitude, phase and frequency err together at the ends
        assert left < 6.0 * 3.0 * sigma * np.sqrt(2.0 / samples)


def test_mains_come_out_and_the_mode_next_to_them_is_unharmed() -> None:
    """The robot's mode next to 50 Hz, fitted with mains taken out, is that of recordings that never had any."""
    plain = estimate_frequency_response(CLEAN)
    struck, _ = with_mains(CLEAN, OFF_HZ, wander=0.05)
    left, clean = estimate_frequency_response(struck), estimate_frequency_response(struck, mains_hz=50.0)
    assert any("mains" in remark for remark in clean.remarks)
    beside = np.abs(HZ - 50.0) < 5.0
    harm, rest = (np.median(np.abs(x.value - plain.value)[beside] / plain.std()[beside]) for x in (left, clean))
    assert harm > 2.0  # leaked into lines that are no multiples of it
    assert rest < 0.2
    before, after = fit_transfer_functions(plain, 5), fit_transfer_functions(clean, 5)
    mode = int(np.argmin(np.abs(before.resonances_hz - 50.0)))
    moved = abs(after.resonances_hz[mode] - before.resonances_hz[mode])
    assert moved < before.resonances_std_hz()[mode]
    damping = [fit.model.damping_ratio[mode] for fit in (before, after)]
    # a mode's damping ratio is known as well as its frequency is, over the frequency
    assert abs(damping[1] - damping[0]) < before.resonances_std_hz()[mode] / before.resonances_hz[mode]


def test_recordings_without_mains_lose_nothing() -> None:
    plain, clean = estimate_frequency_response(CLEAN), estimate_frequency_response(CLEAN, mains_hz=60.0)
    assert np.median(np.abs(clean.value - plain.value) / plain.std()) < 0.2


def test_mains_that_repeat_with_the_period_cost_their_line() -> None:
    hz = HZ[np.argmin(np.abs(HZ - 50.0))]  # one of the multisine's
    struck, _ = with_mains(CLEAN, float(hz))
    plain = estimate_frequency_response(CLEAN)
    clean = estimate_frequency_response(struck, mains_hz=float(hz))
    kept = ~np.isclose(plain.hz, hz)
    np.testing.assert_allclose(clean.hz, plain.hz[kept])
    assert any("line" in remark and "left out" in remark for remark in clean.remarks)
    assert (np.abs(clean.value - plain.value[kept]) < 0.2 * plain.std()[kept]).mean() > 0.95


def test_what_cannot_be_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = write(tmp_path / "c", ROBOT, CLEAN)
    for hz in ("400", "0", "-50"):  # half the rate is 125 Hz
        arguments = ["frf", str(campaign), "--out", str(tmp_path / "out"), "--mains-hz", hz]
        monkeypatch.setattr("sys.argv", ["rx90b-flex", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 2
        assert f"--mains-hz is {hz}; expected 0.2 to 124.8 Hz" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["rx90b-flex", "frf", "--help"])
    with pytest.raises(SystemExit):
        cli.main()
    assert "any other frequency" in " ".join(capsys.readouterr().out.replace("│", " ").split())
    one = dataclasses.replace(
        CLEAN[0],
        time=CLEAN[0].time[:SAMPLES],
        position=CLEAN[0].position[:SAMPLES],
        torque=CLEAN[0].torque[:SAMPLES],
        feedforward_torque=None,
    )
    with pytest.raises(ValueError, match="has 1 periods; mains are told from the excitation by two or more"):
        without_mains(one, 50.0)
