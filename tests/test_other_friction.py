"""Claims about drives that rub more or less in one recording than in the others: that is said with its size, and gets no name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import independent as ind
import numpy as np
import pytest
from real_loops import closed_loop

import rx90b_flex as rf

COULOMB, VISCOUS, NOISE = (1.0, 0.6), (1.5, 0.8), (0.05, 0.05)  # N m, N m s/rad, N m


def closed(
    folder: Path, seed: int, coulomb: Sequence[float], viscous: Sequence[float], *hidden: ind.Torque
) -> rf.ClosedLoop:
    """Of two fitted recordings and one held out, whose frictions are so many times those of the arm."""
    arm, rng, runs = ind.two_joints(folder), np.random.default_rng(seed), []
    for i, role in enumerate(("identification", "identification", "validation")):
        m = ind.harmonics(rng, 2, period_s=10.0, rate_hz=200.0, lines=8)
        rubs = ind.friction(tuple(coulomb[i] * x for x in COULOMB), tuple(viscous[i] * x for x in VISCOUS))
        runs.append(ind.run(arm, role, m, [rubs, *hidden], ind.white(rng, len(m.time), NOISE)))
    declared = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    return rf.close_loop(ind.write_files(folder, arm, declared, runs, cutoff_hz=20.0))


def said(result: rf.ClosedLoop) -> list[str]:
    return [c for c in result.cautions if "friction differs" in c]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_friction_of_a_held_out_recording_is_told_with_its_size(tmp_path, seed):
    result = closed(tmp_path, seed, (1.0, 1.0, 0.9), (1.0, 1.0, 0.9))
    assert result.verdict == "unexplained" and result.effects == ()
    (words,) = said(result)
    assert "recording log_3 " in words
    assert all(f"of {joint} by -10." in words or f"of {joint} by -9.9%" in words for joint in ("shoulder", "elbow"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_fitted_recording_is_told_apart_too(tmp_path, seed):
    result = closed(tmp_path, seed, (1.0, 0.85, 1.0), (1.0, 0.85, 1.0))
    signs = {name: " by +" in words for words in said(result) for name in ("log_1", "log_2", "log_3") if name in words}
    assert signs == {"log_1": True, "log_2": False, "log_3": True} and result.effects == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6])
@pytest.mark.parametrize(
    "hidden",
    [
        (),
        (ind.hidden("stribeck_friction", 0, {"torque": 1.2, "velocity": 0.15, "power": 1.2}),),
        (ind.angle_dependent_friction(0, 1, 0.8),),
    ],
    ids=["nothing", "stribeck", "of another joint's angle"],
)
def test_friction_that_is_the_same_in_all_is_not_told(tmp_path, hidden, seed):
    assert said(closed(tmp_path, seed, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0), *hidden)) == []


ASYMMETRIC = ind.hidden("asymmetric_friction", 0, {"coefficient": 0.25})
BY_LOAD = ind.hidden("load_friction", 0, {"coefficient": 0.05})
BY_POWER = ind.hidden("viscous_power_friction", 1, {"coefficient": 0.4, "power": 0.5})


@pytest.mark.parametrize(
    ("label", "hidden", "seed"),
    [
        ("shoulder.asymmetric_friction", ASYMMETRIC, 12),
        pytest.param("shoulder.asymmetric_friction", ASYMMETRIC, 11, marks=pytest.mark.slow),
        *(pytest.param("shoulder.load_friction", BY_LOAD, s, marks=pytest.mark.slow) for s in (11, 12)),
        *(pytest.param("elbow.viscous_power_friction", BY_POWER, s, marks=pytest.mark.slow) for s in (11, 12)),
    ],
)
def test_an_effect_is_found_beside_frictions_that_differ_between_recordings(tmp_path, label, hidden, seed):
    """All six were missed, and in one `position_friction` stood for what differs."""
    times = np.random.default_rng(seed).uniform(0.75, 1.3, 3)
    result = closed(tmp_path, seed, times, times * (1.0, 0.95, 1.04), hidden)
    assert [e.effect.label for e in result.effects] == [label]
    assert len(said(result)) >= 2  # and still that they differ


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 22])
def test_frictions_that_differ_get_no_name_by_themselves(tmp_path, seed):
    """Dry and viscous friction each by itself."""
    times = np.random.default_rng(seed).uniform(0.75, 1.3, (2, 3))
    result = closed(tmp_path, seed, times[0], times[1])
    assert result.effects == ()


@pytest.mark.slow
@pytest.mark.xdist_group("emps")
def test_a_real_drive_rubs_more_in_the_recording_that_was_not_fitted():
    (words,) = said(closed_loop("emps"))
    assert "recording test_pulses " in words and " by +2." in words
