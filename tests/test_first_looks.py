"""Columns that every round of a search asks for: the same from memory, and no more of them than there is room for."""

import numpy as np
import pytest

from rx90b_flex.effects import Effect, effect_from_table
from rx90b_flex.identify import first_looks
from rx90b_flex.identify.first_looks import FirstLooks

SAMPLES = 1000


def ripple(order: float) -> Effect:
    return effect_from_table({"type": "gear_ripple", "joint": "a", "order": order}, "", ["a"])


class Made:
    """Columns of effects by their order, and how many were made."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, effects):
        self.count += len(effects)
        waves = [np.outer(np.arange(SAMPLES), [e.order, -e.order]) for e in effects]
        return np.array([0]), np.concatenate(waves, axis=1)[:, None]


@pytest.mark.parametrize("room", [0, 10, 1000])
def test_columns_are_the_same_from_memory_and_take_no_more_than_the_room(monkeypatch, room):
    monkeypatch.setattr(first_looks, "KEPT_BYTES", room * 2 * 4 * SAMPLES)
    looks, made = FirstLooks(), Made()
    every = [[ripple(1.0 + i + 10 * j) for i in range(4)] for j in range(5)]
    for _ in range(2):
        for effects in every:
            rows, columns = looks.columns(effects, made)
            assert np.array_equal(rows, [0])
            assert np.array_equal(columns, Made()(effects)[1].astype(np.float32))
        looks.round_over()
    assert made.count == {0: 40, 10: 32, 1000: 20}[room]


def test_what_a_round_did_not_ask_for_is_given_back():
    looks, made = FirstLooks(), Made()
    for effects in ([ripple(1.0), ripple(2.0)], [ripple(1.0)]):
        looks.columns(effects, made)
        looks.round_over()
    looks.columns([ripple(1.0), ripple(2.0)], made)
    assert made.count == 3
