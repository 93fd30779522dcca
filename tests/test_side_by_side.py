"""Claims about processes that try candidates beside each other: what they find is the same, whatever their number."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import independent as ind
import joblib
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.side_by_side import FEWEST, MOST, WORTH, SideBySide, worth_while

DECLARED = ("coulomb_friction", "viscous_friction")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two joints with two hidden effects."""
    folder = tmp_path_factory.mktemp("campaign")
    rng, arm = np.random.default_rng(5), ind.two_joints(folder)
    torques = [
        ind.friction((1.0, 0.6), (1.5, 0.8)),
        ind.hidden("stribeck_friction", 0, {"torque": 1.2, "velocity": 0.15, "power": 1.2}),
        ind.hidden("gear_ripple", 1, {"order": 12.0, "amplitude": 0.5, "phase": 0.7}),
    ]
    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=10.0, rate_hz=100.0, lines=8)
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), (0.1, 0.05)), 10.0))
    tables = [{"type": kind, "joint": j} for j in arm.joints for kind in DECLARED]
    return ind.write_files(folder, arm, tables, runs, cutoff_hz=25.0)


@pytest.mark.slow
def test_what_is_found_is_the_same_to_the_last_digit_for_any_number_of_processes(
    campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    told: list[float] = []
    alone, two = (rf.close_loop(campaign, jobs=jobs, progress=lambda _text, part: told.append(part)) for jobs in (1, 2))
    assert {e.effect.type_name() for e in alone.effects} == {"stribeck_friction", "gear_ripple"}
    assert two.model.theta.tobytes() == alone.model.theta.tobytes()
    assert two.model.effects == alone.model.effects
    assert two.after.validation.relative_error == alone.after.validation.relative_error
    for theirs, ours in ((two.effects, alone.effects), (two.last_round.trials, alone.last_round.trials)):
        assert [repr(x) for x in theirs] == [repr(x) for x in ours]
    assert np.max(told) == 1.0
    assert not list(tmp_path.iterdir()), "what processes read is left behind"


def test_items_come_back_in_their_order_and_no_more_are_begun_than_were_asked_for() -> None:
    with SideBySide(100, 1) as here:
        begun: list[int] = []
        results = here.each(lambda large, item: begun.append(item) or large + item, [1, 2, 3])
        assert next(results) == 101
        assert begun == [1]
    with SideBySide(100, 2) as beside:
        assert list(beside.each(lambda large, item: large + item, [1, 2, 3])) == [101, 102, 103]
        parts = list(beside.all(lambda _large, items: items, list(range(11))))
        assert sorted(x for part in parts for x in part) == list(range(11))


def test_a_fault_in_another_process_is_told_here() -> None:
    def fails(_large: int, item: int) -> int:
        raise ValueError(f"item {item} cannot be done")

    with SideBySide(0, 2) as beside, pytest.raises(ValueError, match="item 7 cannot be done"):
        list(beside.each(fails, [7]))


def test_long_logs_get_processes_and_wrong_numbers_one_line(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert worth_while(None, WORTH - 1) == 1
    for cores, processes in ((1, 1), (FEWEST - 1, 1), (FEWEST, FEWEST), (MOST, MOST), (4 * MOST, MOST)):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        monkeypatch.setattr(joblib, "cpu_count", lambda cores=cores: cores)
        assert worth_while(None, WORTH) == processes
    monkeypatch.setattr(joblib, "cpu_count", lambda: 2)  # of a machine's many this process has two
    assert worth_while(None, WORTH) == 1
    assert worth_while(3, 1) == 3
    with pytest.raises(ValueError, match=r"^jobs is 0; expected 1 to"):
        rf.close_loop(campaign, jobs=0)
