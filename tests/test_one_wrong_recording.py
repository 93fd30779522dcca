"""Claims about recordings of which one alone is wrong: the others tell which, and what is wrong in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf

ARM = ind.ur10(1.1)
COULOMB, VISCOUS = (8.0, 8.0, 5.0, 1.5, 1.2, 0.8), (12.0, 12.0, 8.0, 2.0, 1.5, 1.0)
NOISE = (0.8, 1.0, 0.6, 0.12, 0.1, 0.06)
FLANGE = 5  # turns about an axis of its own symmetry: reversed, its angle and its torque look alike


def campaign(
    folder: Path,
    seed: int,
    *,
    where: int = 0,
    joint: int = 0,
    torque: float = 1.0,
    position: float = 1.0,
    load_kg: Sequence[float] = (0.0, 0.0, 0.0),
    stated: Sequence[float] = (0.0, 0.0, 0.0),
    rubs: Sequence[float] = (1.0, 1.0, 1.0),
) -> Path:
    """Three recordings, of which one has a joint's torque or position so many times what it is; or each another friction."""
    rng, runs = np.random.default_rng(seed), []
    for r, role in enumerate(("identification", "identification", "validation")):
        m = ind.harmonics(rng, 6, period_s=10.0, rate_hz=200.0, lines=6)
        carried = [ind.carrying(ARM, "tool0", load_kg[r], (0.0, 0.05, 0.1))] if load_kg[r] else []
        friction = ind.friction(*(tuple(rubs[r] * x for x in every) for every in (COULOMB, VISCOUS)))
        made = ind.run(ARM, role, m, [friction, *carried], ind.white(rng, len(m.time), NOISE))
        if r == where:
            logged, q = made.torque.copy(), m.q.copy()
            logged[:, joint] *= torque
            q[:, joint] *= position
            made = replace(made, torque=logged, motion=replace(m, q=q))
        runs.append(made)
    declared = [{"type": t, "joint": j} for j in ARM.joints for t in ("coulomb_friction", "viscous_friction")]
    path = ind.write_files(folder, ARM, declared, runs, cutoff_hz=10.0)
    for n, kg in enumerate(stated, start=1):
        said = f'file = "log_{n}.csv"'
        payload = f"{said}\npayload = {{ mass = {kg}, centre = [0.0, 0.05, 0.1] }}"
        path.write_text(path.read_text().replace(said, payload if kg else said))
    return path


SLOW = [pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.long)]


@pytest.mark.parametrize("seed", [1, *SLOW])
@pytest.mark.parametrize(
    ("change", "kind", "signal"),
    [
        ({"torque": -1.0}, "reversed_sign", "torque"),
        pytest.param({"position": -1.0}, "reversed_sign", "motor_position", marks=pytest.mark.slow),
        pytest.param({"torque": 0.5}, "torque_gain", "torque", marks=pytest.mark.slow),
    ],
)
def test_a_wrong_column_of_one_recording_is_named_with_its_file(tmp_path, seed, change, kind, signal):
    rng = np.random.default_rng(100 + seed)
    where, joint = int(rng.integers(3)), int(rng.integers(FLANGE))
    checked = rf.check(campaign(tmp_path, seed, where=where, joint=joint, **change))
    (fault,) = checked.data_faults
    assert (fault.kind, fault.joints) == (kind, (ARM.joints[joint],))
    assert fault.signal == signal or "these data do not tell which of the two" in fault.message
    assert f"log_{where + 1}.csv" in fault.message and not checked.usable
    assert kind != "torque_gain" or fault.factor == pytest.approx(0.5, rel=0.02)


@pytest.mark.slow
def test_where_torque_and_position_may_be_reversed_as_well_both_are_said(tmp_path):
    (fault,) = rf.check(campaign(tmp_path, 1, where=1, joint=FLANGE, torque=-1.0)).data_faults
    assert (fault.kind, fault.joints) == ("reversed_sign", (ARM.joints[FLANGE],))
    assert "these data do not tell which of the two" in fault.message


@pytest.mark.parametrize("seed", [1, *SLOW])
def test_another_load_in_one_recording_is_said_and_is_nothing_once_it_is_stated(tmp_path, seed):
    loads = [0.0, 0.0, 0.0]
    loads[seed % 3] = 6.0
    checked = rf.check(campaign(tmp_path, seed, load_kg=loads))
    (fault,) = checked.data_faults
    assert f"log_{seed % 3 + 1}.csv was made with another load" in fault.message and checked.usable
    assert rf.check(campaign(tmp_path, seed, load_kg=loads, stated=loads)).data_faults == ()


@pytest.mark.parametrize(
    ("load_kg", "stated", "where"),
    [
        ((3.0, 0.0, 3.0), (6.0, 0.0, 6.0), "log_1.csv, log_3.csv"),
        pytest.param((0.0, 6.0, 0.0), (0.0, 4.0, 0.0), "log_2.csv", marks=pytest.mark.slow),
        pytest.param((2.0, 3.0, 0.0), (2.0, 6.0, 0.0), "log_2.csv", marks=pytest.mark.slow),
    ],
)
def test_another_load_than_is_stated_is_told_beside_the_other_recordings(tmp_path, load_kg, stated, where):
    checked = rf.check(campaign(tmp_path, 1, load_kg=load_kg, stated=stated))
    (fault,) = checked.data_faults
    assert f"{where}: stated is a payload of" in fault.message and not checked.usable
    true, said = next((a, b) for a, b in zip(load_kg, stated, strict=True) if a != b)
    assert fault.factor == pytest.approx(said / true, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("load_kg", [(0.0, 3.0, 3.0), (2.0, 0.0, 5.0)])
def test_a_wrong_column_of_recordings_that_state_other_loads_is_named(tmp_path, load_kg):
    """Where loads differ and one recording stands apart, it was held against the others without what it states."""
    checked = rf.check(campaign(tmp_path, 1, where=1, joint=2, torque=-1.0, load_kg=load_kg, stated=load_kg))
    (fault,) = checked.data_faults
    assert (fault.kind, fault.joints) == ("reversed_sign", (ARM.joints[2],)) and "log_2.csv" in fault.message


@pytest.mark.parametrize("seed", [1, *SLOW])
def test_three_sound_recordings_have_no_fault(tmp_path, seed):
    assert rf.check(campaign(tmp_path, seed)).data_faults == ()


@pytest.mark.parametrize("seed", [1, *SLOW])
@pytest.mark.parametrize(
    "rubs",
    [(1.6, 1.3, 0.9), *(pytest.param(r, marks=pytest.mark.slow) for r in ((1.3, 1.3, 1.0), (1.0, 1.0, 1.5)))],
)
def test_a_robot_that_is_warmer_in_one_recording_has_no_other_unit_and_no_other_load(
    tmp_path: Path, rubs: tuple[float, float, float], seed: int
) -> None:
    checked = rf.check(campaign(tmp_path, seed, rubs=rubs))
    assert checked.usable and not checked.data_faults, checked.data_faults


HIDDEN = (
    ind.hidden("gear_ripple", 2, {"order": 18.0, "amplitude": 3.0, "phase": 0.7}),
    ind.hidden("joint_coupling", (4, 5), {"inertia": 0.1, "viscous": 0.8, "coulomb": 0.6}),
    ind.hidden("stribeck_friction", 0, {"torque": 10.0, "velocity": 0.15, "power": 1.2}),
    ind.hidden("load_friction", 1, {"coefficient": 0.08}),
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [25, *(pytest.param(s, marks=pytest.mark.slow) for s in (13, 35, 301, 302, 303, 304))])
def test_effects_beside_a_friction_that_warms_are_no_fault_of_the_data(tmp_path: Path, seed: int) -> None:
    """A zero 73 degrees off, an angle in degrees and a torque of another unit took up what the recordings differ by."""
    warmth = np.random.default_rng(900 + seed)
    dry = warmth.uniform(0.75, 1.3, 3)
    rng, runs = np.random.default_rng(seed), []
    viscous = dry * warmth.uniform(0.9, 1.1, 3)
    if seed == 13:
        dry = viscous = np.array([1.0, 0.85, 1.1])
    for r, role in enumerate(("identification", "identification", "validation")):
        m = ind.harmonics(rng, 6, period_s=10.0, rate_hz=500.0, lines=8)
        rubs = ind.friction(tuple(dry[r] * np.array(COULOMB)), tuple(viscous[r] * np.array(VISCOUS)))
        runs.append(ind.run(ARM, role, m, [rubs, *HIDDEN], ind.white(rng, len(m.time), NOISE)))
    declared = [{"type": t, "joint": j} for j in ARM.joints for t in ("coulomb_friction", "viscous_friction")]
    checked = rf.check(ind.write_files(tmp_path, ARM, declared, runs, cutoff_hz=25.0))
    assert checked.usable and not checked.data_faults, checked.data_faults
