"""Claims about free forms of a residual: they find what carries over to parts held out, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from rx90b_flex.diagnose.free_form import NO_FORM, Families, best_form

SAMPLES, NOISE = 1500, 0.2
WAVES = np.random.default_rng(7).uniform(0.5, 2.0, 3)


def motion(samples: int, start: float) -> np.ndarray:
    """Three signals that never repeat, (N, 3)."""
    time = start + 0.02 * np.arange(samples)
    return np.stack([np.sin(w * time + 0.3 * np.sin(0.7 * w * time)) for w in WAVES], axis=1)


HERE, THERE = motion(SAMPLES, 0.0), motion(600, 500.0)


def families(x: np.ndarray) -> dict[str, np.ndarray]:
    """Curves over each signal alone."""
    return {f"over {i}": np.stack([x[:, i] ** k for k in range(1, 8)], axis=1) for i in range(3)}


def parts(count: int = 3) -> np.ndarray:
    return np.arange(SAMPLES) * count // SAMPLES


def form(residual: np.ndarray, layouts: list[np.ndarray] | None = None):
    columns = Families(families(HERE), families(THERE).__getitem__, len(THERE))
    return best_form(columns, (HERE, THERE), residual, layouts or [parts()])


def noise(seed: int) -> np.ndarray:
    return NOISE * np.random.default_rng(seed).standard_normal(SAMPLES)


def law(x: np.ndarray) -> np.ndarray:
    """What a smooth curve over one signal says."""
    return np.tanh(2.0 * x[:, 1]) - 0.5 * x[:, 1]


def test_a_smooth_law_is_found_to_a_small_part_of_the_noise():
    found = form(law(HERE) + noise(0))
    assert found.name == "smooth curves"
    # eight parameters of 1500 samples: their noise has sqrt(8 / 1500) of the samples' standard deviation; twice that for bias
    off = np.sqrt(((found.elsewhere - law(THERE)) ** 2).mean())
    assert off < 2 * NOISE * np.sqrt(8 / SAMPLES) + 0.02


def test_what_a_part_is_told_does_not_come_from_that_part():
    """Another residual in one part leaves what is said there unchanged, unless the choice of curves changes."""
    residual = law(HERE) + noise(0)
    other = residual.copy()
    other[parts() == 2] += 0.01 * HERE[parts() == 2, 1]
    one, two = form(residual), form(other)
    assert one.name == two.name == "smooth curves"
    assert one.held_out[parts() == 2] == pytest.approx(two.held_out[parts() == 2], abs=1e-9)
    assert one.held_out[parts() == 1] != pytest.approx(two.held_out[parts() == 1], abs=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_in_noise_nothing_is_found(seed):
    found = form(noise(seed))
    assert found.name == NO_FORM
    assert not found.elsewhere.any() and not found.held_out.any()


def test_what_turns_round_from_part_to_part_is_not_found():
    """It explains each part well and says nothing of the next."""
    turned = law(HERE) * np.where(parts(2) == 0, 1.0, -1.0)
    assert form(turned + noise(1), [parts(2)]).name == NO_FORM


def test_trees_take_over_where_no_sum_of_curves_follows():
    """A product of two signals' signs has no sum of curves over either."""
    residual = np.sign(HERE[:, 0] * HERE[:, 2])
    found = form(residual + noise(2))
    assert found.name == "boosted trees"
    agree = np.sign(found.elsewhere) == np.sign(THERE[:, 0] * THERE[:, 2])
    assert agree.mean() > 0.9


def test_without_signals_there_are_no_trees():
    columns = Families(families(HERE), families(THERE).__getitem__, len(THERE))
    product = np.sign(HERE[:, 0] * HERE[:, 2]) + noise(2)
    assert best_form(columns, None, product, [parts()]).name == NO_FORM
    assert best_form(columns, None, law(HERE) + noise(2), [parts()]).name == "smooth curves"


def test_the_same_data_gives_the_same_form():
    residual = law(HERE) + np.sign(HERE[:, 0] * HERE[:, 2]) + noise(3)
    one, two = form(residual, [parts(3), parts(4)]), form(residual, [parts(3), parts(4)])
    assert one.name == two.name
    np.testing.assert_array_equal(one.elsewhere, two.elsewhere)


def test_only_families_that_are_taken_in_are_asked_for_elsewhere():
    asked = []

    def there(name: str) -> np.ndarray:
        asked.append(name)
        return families(THERE)[name]

    assert best_form(Families(families(HERE), there, len(THERE)), None, law(HERE) + noise(0), [parts()]).name != NO_FORM
    assert asked == ["over 1"]


def test_constant_columns_do_no_harm():
    here, there = ({"still": np.full((len(x), 2), 3.0), "over 1": x[:, [1]]} for x in (HERE, THERE))
    columns = Families(here, there.__getitem__, len(THERE))
    found = best_form(columns, (HERE, THERE), HERE[:, 1] + noise(4), [parts()])
    assert found.elsewhere == pytest.approx(THERE[:, 1], abs=0.1)
