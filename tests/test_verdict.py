"""Claims about the verdict: it is about what remains, and nothing is called explained that is at no measure."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rx90b_flex.diagnose.check import Checked
from rx90b_flex.diagnose.events import Events
from rx90b_flex.diagnose.evidence import Dependence
from rx90b_flex.diagnose.refused import verdict_despite
from rx90b_flex.diagnose.residual import Errors, RoleErrors
from rx90b_flex.diagnose.verdict import Remains, raised
from rx90b_flex.diagnose.yardstick import Explainable
from rx90b_flex.signals.data_fault import DataFault

JOINTS = ("one", "two")
SIZE = 10.0  # N m, of each joint's torque
CURVES = ("smooth curves", "smooth curves")
NAMED = Dependence("two", "two velocity", 0.3, 1e-6)


def errors(*rms: float) -> Errors:
    return Errors(float(np.hypot(*rms) / np.hypot(SIZE, SIZE)), rms)


def roles(*rms: float) -> RoleErrors:
    return RoleErrors(errors(*rms), errors(*rms))


def test_errors_on_some_joints_of_another_model_are_those_of_torques_put_together():
    rng = np.random.default_rng(0)
    measured = [rng.normal(size=(60, 3)), rng.normal(size=(40, 3))]
    one, other = ([m + scale * rng.normal(size=m.shape) for m in measured] for scale in (0.5, 0.1))
    mixed = [np.where([False, True, False], b, a) for a, b in zip(one, other, strict=True)]
    found = Errors.of(measured, one).partly(Errors.of(measured, other), [False, True, False])
    expected = Errors.of(measured, mixed)
    assert found.relative_error == pytest.approx(expected.relative_error, rel=1e-12)
    assert found.torque_rms == pytest.approx(expected.torque_rms, rel=1e-12)


def explained_to(*rms: float, share: float, forms: tuple[str, ...] = CURVES) -> Explainable:
    return Explainable(errors(*rms), share, forms)


def verdict(
    after: tuple[float, float],
    *,
    before: tuple[float, float] = (2.0, 2.0),
    found: bool = True,
    floor: tuple[float, float] | None = None,
    free: tuple[float, float] | None = None,
    forms: tuple[str, ...] = CURVES,
    where: tuple[Dependence, ...] = (),
    doubtful: bool = False,
    spread: tuple[float, float] | None = None,
) -> str:
    known = None
    if free is not None:
        drop = np.hypot(*before) - np.hypot(*free)
        share = (np.hypot(*before) - np.hypot(*after)) / drop if drop > 0 else 1.0
        known = explained_to(*free, share=float(share), forms=forms)
    noise, sized = (None if x is None else np.array(x) for x in (floor, spread))
    return Remains(JOINTS, found, roles(*before), roles(*after), noise, known, where, doubtful, sized).verdict


def test_closed_again_what_was_explained_is_not_unexplained():
    near, far = (1.05, 1.05), (0.8, 0.8)
    assert verdict(near, before=(4.0, 4.0), free=(1.0, 1.0)) == "explained"
    assert verdict(near, before=near, found=False, free=(1.0, 1.0)) == "nothing_missing"
    assert verdict(near, before=near, found=False, free=(1.0, 1.0), where=(NAMED,)) == "unexplained"
    assert verdict(near, before=near, found=False, free=far) == "unexplained"


def test_errors_below_what_any_torque_is_measured_to_are_no_remainder():
    none = (1e-6, 1e-6)  # N m, of torques of about 1
    assert verdict(none, before=none, found=False, where=(NAMED,)) == "nothing_missing"
    assert verdict(none, floor=(1e-8, 1e-8), where=(NAMED,)) == "explained"


def test_at_the_noise_floor_all_is_explained_whatever_a_free_form_says():
    assert verdict((1.0, 1.0), floor=(1.0, 1.0)) == "explained"
    assert verdict((1.0, 1.0), floor=(1.0, 1.0), free=(0.1, 0.1)) == "explained"
    assert verdict((1.0, 1.0), before=(1.0, 1.0), found=False, floor=(1.0, 1.0)) == "nothing_missing"


def test_far_above_the_noise_floor_something_is_left():
    assert verdict((1.0, 1.6), floor=(1.0, 1.0)) == "partly_explained"
    assert verdict((1.0, 1.6), found=False, floor=(1.0, 1.0)) == "unexplained"


def test_at_the_noise_where_fitted_and_far_above_it_elsewhere_is_not_explained():
    fitted, elsewhere = roles(1.0, 1.0).identification, roles(1.0, 1.6).validation
    left = Remains(JOINTS, True, roles(2.0, 2.0), RoleErrors(elsewhere, fitted), np.ones(2), None, ())
    assert left.verdict == "partly_explained"


def test_a_curve_that_does_not_carry_over_explains_nothing_though_a_free_form_carries_no_further():
    fitted, elsewhere = roles(1.0, 1.0).identification, roles(1.0, 1.6).validation
    as_much = explained_to(1.0, 1.6, share=1.0)
    left = Remains(JOINTS, True, roles(2.0, 2.0), RoleErrors(elsewhere, fitted), np.ones(2), as_much, ())
    assert left.verdict == "explained"
    assert replace(left, curved=JOINTS[:1]).verdict == "explained"
    assert replace(left, curved=JOINTS[1:]).verdict == "partly_explained"


def test_a_little_above_the_noise_floor_it_takes_a_signal_that_the_residual_depends_on():
    assert verdict((1.0, 1.3), floor=(1.0, 1.0)) == "explained"
    assert verdict((1.0, 1.3), floor=(1.0, 1.0), where=(NAMED,)) == "partly_explained"


def test_what_happened_at_an_instant_is_left_even_at_a_floor_that_holds_it():
    happened = (Events("two", (("held out", 3.0),), share=0.6, times=8.0),)
    left = Remains(JOINTS, True, roles(2.0, 2.0), roles(1.0, 1.0), np.ones(2), None, (), events=happened)
    assert left.verdict == "partly_explained"


def test_less_than_four_fifths_of_what_a_free_form_explains_is_not_enough():
    assert verdict((1.15, 1.15), free=(1.0, 1.0)) == "explained"
    assert verdict((1.3, 1.3), free=(1.0, 1.0)) == "partly_explained"


def test_one_joint_left_with_more_than_it_should_have_is_enough_to_doubt():
    """Nearly all of a large joint's error is explained, nothing of a small one's."""
    big, small = 5.0, 0.5
    free = (1.0, 0.2)
    assert verdict((1.05, 0.2), before=(big, small), free=free) == "explained"
    assert verdict((1.05, small), before=(big, small), free=free) == "partly_explained"


def test_a_joint_that_still_depends_on_a_signal_has_less_room():
    assert verdict((1.0, 1.08), before=(2.0, 1.0), free=(1.0, 1.0)) == "explained"
    assert verdict((1.0, 1.08), before=(2.0, 1.0), free=(1.0, 1.0), where=(NAMED,)) == "partly_explained"


def test_where_the_free_form_finds_nothing_a_signal_that_the_residual_depends_on_is_enough():
    same = (2.0, 2.0)
    silent = ("none", "none")
    assert verdict(same, found=False, free=same, forms=silent) == "nothing_missing"
    assert verdict(same, found=False, free=same, forms=silent, where=(NAMED,)) == "unexplained"


@pytest.mark.parametrize("found", [True, False])
def test_a_joint_left_with_most_of_its_torque_is_not_explained_unless_that_is_known_to_be_noise(found):
    """Torques of another motion: nothing predicts them, neither does a free form."""
    left = {"before": (2.0, 2.5), "free": (1.0, 2.0), "forms": ("smooth curves", "none"), "found": found}
    assert verdict((1.0, 2.0), spread=(3.0, 10.0), **left) == ("explained" if found else "nothing_missing")
    assert verdict((1.0, 2.0), spread=(3.0, 2.1), **left) == ("partly_explained" if found else "unexplained")
    known = verdict((1.0, 2.0), spread=(3.0, 2.1), floor=(1.0, 2.0), **left)
    assert known == ("explained" if found else "nothing_missing")


@pytest.mark.parametrize("found", [True, False])
def test_where_neither_measure_is_known_nobody_can_say_that_nothing_is_left(found):
    assert verdict((0.1, 0.1), found=found) == ("partly_explained" if found else "unexplained")


def test_what_does_not_carry_over_explains_nothing():
    assert verdict((1.0, 1.0), before=(0.9, 0.9), floor=(1.0, 1.0)) == "partly_explained"


def test_data_that_holds_what_a_rigid_tree_cannot_have_is_never_explained():
    assert verdict((1.0, 1.0), floor=(1.0, 1.0), doubtful=True) == "partly_explained"


def look(*faults: DataFault) -> Checked:
    usable = all(f.usable for f in faults)
    return Checked(usable, (), faults, (), (), "arm", JOINTS, (), None, (), Path("campaign.toml"))


@pytest.mark.parametrize(
    ("errors_say", "at_most"), [("explained", "partly_explained"), ("nothing_missing", "unexplained")]
)
def test_on_faulty_data_nothing_is_explained_however_small_the_errors(errors_say, at_most):
    fault = DataFault("reversed_sign", "torque", ("one",), "turn it round")
    assert verdict_despite(errors_say, look(fault), ()) == at_most
    assert verdict_despite(at_most, look(fault), ()) == at_most
    assert verdict_despite(errors_say, look(), ()) == errors_say


def test_a_wrong_torque_gain_is_explained_only_by_a_model_that_has_it():
    """Left alone it becomes mass and friction, and errors are as small."""
    gain = DataFault("torque_gain", "torque", ("two",), "check its motor constant", usable=True, factor=3.0, std=0.1)
    assert verdict_despite("nothing_missing", look(gain), ()) == "unexplained"
    assert verdict_despite("explained", look(gain), {"one"}) == "partly_explained"
    assert verdict_despite("explained", look(gain), {"two"}) == "explained"


def test_a_joint_that_is_held_is_no_reason_to_doubt():
    held = DataFault("stuck", "motor_position", ("two",), "taken as held", usable=True)
    assert verdict_despite("nothing_missing", look(held), ()) == "nothing_missing"


def test_nothing_is_called_explained_that_is_far_from_both_measures():
    """Whatever else holds."""
    for after, free, floor, where, found in itertools.product(
        ((2.0, 2.0), (1.0, 2.0), (1.9, 1.9)),
        ((1.0, 1.0), (0.5, 1.0), None),
        ((0.5, 0.5), None),
        ((), (NAMED,)),
        (True, False),
    ):
        said = verdict(after, before=(2.1, 2.1), found=found, floor=floor, free=free, where=where)
        assert said in ("partly_explained", "unexplained"), (after, free, floor, where, found)


def test_a_joint_whose_error_rises_by_what_was_added_is_said() -> None:
    before, after = (Errors(0.1, rms) for rms in ((0.36, 1.0, 0.0), (0.61, 0.5, 0.1)))
    (text,) = raised(("j2", "j3", "j4"), before, after)
    assert "j2, held out, to 1.69 times" in text
