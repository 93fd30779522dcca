"""Orders that are a motor's."""

import pytest

from rx90b_flex.diagnose.motor_turns import turns_of_motor, turns_words
from rx90b_flex.identify.least_squares import Estimate

JOINTS = ("a", "b", "c")
COUPLED = ((32.0, 0.0, 0.0), (0.0, -45.0, 0.0), (0.0, 32.0, 32.0))  # the third motor turns with two joints


def order(value: float | None, std: float | None) -> Estimate:
    return Estimate("order", value, std, "1/turn")


@pytest.mark.parametrize(("joint", "turns"), [("a", 32.0), ("b", 45.0), ("c", None), ("d", None)])
def test_ratio_is_that_of_the_one_motor_that_turns_with_the_joint_alone(joint: str, turns: float | None) -> None:
    assert turns_of_motor(COUPLED, JOINTS, joint) == turns


def test_no_ratio_without_gears_or_without_a_gear() -> None:
    assert turns_of_motor(None, JOINTS, "a") is None
    assert turns_of_motor(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), JOINTS, "a") is None


@pytest.mark.parametrize(("value", "often"), [(44.9, "once"), (90.1, "twice"), (134.95, "3 times")])
def test_an_order_near_a_multiple_of_the_ratio_is_the_motor_s(value: float, often: str) -> None:
    text = turns_words("b.gear_ripple", "b", order(value, 0.075), 45.0)
    assert text.startswith(f"b.gear_ripple repeats {often} a turn of b's motor")


@pytest.mark.parametrize(
    ("value", "std"),
    [
        (44.7, 0.075),  # four standard deviations off
        (30.6, 0.036),
        (22.5, 0.075),  # half a turn: nothing of a motor repeats so seldom
        (45.0, 1.0),  # one order in ten is as near to some multiple
        (45.0 * 9, 0.075),
        (None, None),
        (45.0, None),
    ],
)
def test_others_are_not(value: float | None, std: float | None) -> None:
    assert turns_words("b.gear_ripple", "b", order(value, std), 45.0) == ""
