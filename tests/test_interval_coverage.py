"""Claims about 95 % intervals of identified parameters: how often they hold the truth, over draws of noise on several motions."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal, stats

from rx90b_flex.identify.coloured import absorbed_by_fit, residual_spectrum, widening
from rx90b_flex.identify.regression import Regression

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import interval_coverage as coverage
from hidden_effects.arms import declared_robot
from hidden_effects.scene import CUTOFF_HZ, Conditions, Scene

MOTIONS, DRAWS = 5, 50


def held(colour: str, arm: str, rate_hz: float) -> np.ndarray:
    """Whether each interval holds the truth, (motions * draws, parameters); no dry friction, whose form is a question of its own."""
    out = []
    for seed in range(MOTIONS):
        scene = Scene.draw(np.random.default_rng([8, seed]), arm, "sign", Conditions(), False, False)
        scene = replace(scene, plant=replace(scene.plant, coulomb=0.0 * scene.plant.coulomb))
        robot = declared_robot(arm, tuple(("coulomb_friction", j) for j in scene.joints), False)
        clean = Regression.of(robot, coverage.recordings(scene, rate_hz, 1), CUTOFF_HZ)
        _, rows = coverage.drawn(scene, clean, colour, DRAWS, seed)
        value, std, true = np.moveaxis(rows, 2, 0)
        out.append(np.abs(value - true) < coverage.INTERVAL * std)
    return np.concatenate(out)


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["ur10", pytest.param("panda", marks=pytest.mark.long)])
@pytest.mark.parametrize("colour", ["white", "ar"])
def test_intervals_of_95_per_cent_hold_in_93_to_97(colour, arm):
    """Two recordings of 10 s; noise with a memory of 20 samples leaves some fifty independent ones of a thousand."""
    holds = held(colour, arm, 100.0)
    assert 0.93 <= holds.mean() <= 0.97
    # each parameter's count is binomial over draws of noise; all of them are within these limits in 999 of 1000 cases
    draws, parameters = holds.shape
    assert holds.sum(axis=0).min() >= stats.binom.ppf(1e-3 / parameters, draws, 0.93)
    assert holds.sum(axis=0).max() <= stats.binom.isf(1e-3 / parameters, draws, 0.97)


def test_a_steep_spectrum_is_found_where_a_fit_took_half_of_it():
    """Noise of memory 0.95, every other line below 1 Hz taken out of it: on average what is found is that of the whole noise."""
    rng, count, rate_hz, memory = np.random.default_rng(0), 1000, 100.0, 0.95
    time = np.arange(count) / rate_hz
    waves = [f(2 * np.pi * k * time / 10.0) for k in range(1, 11, 2) for f in (np.sin, np.cos)]
    basis = np.linalg.qr(np.stack(waves, axis=1))[0]
    spans, size = (slice(0, count),), 4000
    absorbed = absorbed_by_fit(basis, spans, 100)
    nothing = 0.0 * absorbed
    slow = np.fft.rfftfreq(size, 1 / rate_hz) < 1.0
    whole, back, without = [], [], []
    for _ in range(100):
        noise = signal.lfilter([1.0], [1.0, -memory], rng.normal(size=count + 400))[400:]
        left = noise - basis @ (basis.T @ noise)
        for found, x, taken in ((whole, noise, nothing), (back, left, absorbed), (without, left, nothing)):
            found.append(float(residual_spectrum(x, spans, taken, 100).density(size)[slow].mean()))
    assert np.mean(without) < 0.7 * np.mean(whole)
    assert np.mean(back) == pytest.approx(np.mean(whole), rel=0.1)


def test_an_interval_is_wider_where_the_spectrum_is_less_known():
    """By the tables of Student's distribution: 1.980 at 120 degrees of freedom, 2.042 at 30, where 1.960 is the normal one's."""
    for freedom, limit in ((120.0, 1.980), (30.0, 2.042)):
        spectrum = replace(residual_spectrum(np.ones(60), (slice(0, 60),), np.zeros(0), 10), degrees_of_freedom=freedom)
        assert np.sqrt(widening([spectrum])) == pytest.approx(limit / 1.960, rel=5e-4)
