"""Campaigns: every run is saved as it finishes, seeds do not depend on batches or workers, the result is a campaign file."""

from __future__ import annotations

import dataclasses
import tracemalloc
from pathlib import Path

import joblib
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.signals import load_campaign
from rx90b_flex.simulate import Noise, load_cs8, simulate_lanes
from rx90b_flex.simulate import campaign as campaigns
from rx90b_flex.simulate.campaign import CampaignPlan, batch_bytes, run_campaign, section_662, simulate_batch


def small_plan(**changes: object) -> CampaignPlan:
    """Two joints of three move for a tenth of a second, twice: 2 realisations, 3 experiments, both signs."""
    robot = rf.load_robot("rx90b_3dof")
    plan = section_662(robot, load_cs8(), realisations=2, periods=2, lines=(1, 3, 5), noise=Noise(0.1, 1e-6, 1e-4))
    short = dataclasses.replace(plan.reference.part(0.0, 0.1), period_s=0.1)
    return dataclasses.replace(plan, reference=short, **changes)


def numbers(folder: Path) -> np.ndarray:
    return np.stack([np.hstack([r.position, r.torque]) for r in load_campaign(folder / "campaign.toml").recordings])


def test_the_plan_of_section_662_has_96_runs_of_nine_periods() -> None:
    plan = section_662(rf.load_robot("rx90b_4dof"), load_cs8())
    assert len(plan.runs) == 96
    first, second, opposite = (plan.trajectory(plan.runs[i]) for i in (0, 2, 1))
    assert first.duration_s == pytest.approx(9 * 4.096)
    np.testing.assert_array_equal(opposite.torque, -first.torque)
    np.testing.assert_array_equal(second.torque[:, 0], first.torque[:, 0])
    np.testing.assert_array_equal(second.torque[:, 1], -first.torque[:, 1])  # column 2 of (6.50)
    assert abs(first.torque).max() == pytest.approx(45.0)


def test_a_campaign_ends_as_a_campaign_file_with_roles_and_period(tmp_path: Path) -> None:
    result = run_campaign(small_plan(validation=1), tmp_path / "c")
    assert result.failed == () and len(result.done) == 12
    campaign = load_campaign(tmp_path / "c" / "campaign.toml")
    assert len(campaign.identification) == len(campaign.validation) == 6
    assert all(r.period_s == 0.1 and r.samples == 25 for r in campaign.recordings)  # without the first period
    assert rf.load_robot(tmp_path / "c" / "robot.toml").coordinates == rf.load_robot("rx90b_3dof").coordinates


@pytest.mark.slow
def test_batches_and_workers_do_not_change_a_run(tmp_path: Path) -> None:
    plan = small_plan(realisations=1)
    run_campaign(plan, tmp_path / "one")
    run_campaign(plan, tmp_path / "many", jobs=2, batch=1)
    np.testing.assert_array_equal(numbers(tmp_path / "one"), numbers(tmp_path / "many"))


def test_an_interrupted_campaign_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, folder = small_plan(realisations=1), tmp_path / "c"
    saved = campaigns.save_recording
    left = iter(range(4))

    def save(*args: object) -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt
        saved(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(campaigns, "save_recording", save)
    with pytest.raises(KeyboardInterrupt):
        run_campaign(plan, folder, batch=2)
    monkeypatch.undo()
    before = {p: p.stat().st_mtime_ns for p in (folder / "runs").iterdir()}
    assert len(before) == 4 and not (folder / "campaign.toml").exists()
    told: list[tuple[str, float]] = []
    result = run_campaign(plan, folder, batch=2, progress=lambda text, part: told.append((text, part)))
    assert len(result.resumed) == 4 and len(result.done) == 6
    assert {p: p.stat().st_mtime_ns for p in before} == before
    assert told[0] == ("4 of 6 runs", 4 / 6) and told[-1] == ("6 of 6 runs", 1.0)
    run_campaign(plan, tmp_path / "whole")
    np.testing.assert_array_equal(numbers(folder), numbers(tmp_path / "whole"))


def test_a_folder_with_another_plan_is_refused(tmp_path: Path) -> None:
    plan = small_plan(realisations=1)
    run_campaign(plan, tmp_path / "c")
    before = sorted(p.name for p in (tmp_path / "c").rglob("*"))
    for other in (dataclasses.replace(plan, seed=1), dataclasses.replace(plan, method="perturbation")):
        with pytest.raises(ValueError, match="another plan"):
            run_campaign(other, tmp_path / "c")
    robot = plan.robot.with_effects(plan.robot.effects[:-1])
    with pytest.raises(ValueError, match="another plan"):
        run_campaign(dataclasses.replace(plan, robot=robot), tmp_path / "c")
    assert sorted(p.name for p in (tmp_path / "c").rglob("*")) == before


def test_a_failed_run_is_reported_and_the_others_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = small_plan(realisations=1)

    def lanes(robot: object, controller: object, trajectories: list, **options: object) -> list:
        if any(t.name == "run_000_2_minus" for t in trajectories):
            raise RuntimeError("no luck")
        return simulate_lanes(robot, controller, trajectories, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(campaigns, "simulate_lanes", lanes)
    result = run_campaign(plan, tmp_path / "c", batch=6)
    assert [f.run for f in result.failed] == ["run_000_2_minus"]
    assert result.failed[0].reason == "RuntimeError: no luck"
    assert len(load_campaign(tmp_path / "c" / "campaign.toml").recordings) == 5


def test_a_run_that_ends_early_is_no_part_of_the_campaign(tmp_path: Path) -> None:
    strict = dataclasses.replace(load_cs8(), overload_time_s=0.001)
    plan = small_plan(realisations=1, peak=4000.0, controller=strict)
    result = run_campaign(plan, tmp_path / "c")
    assert result.file is None and len(result.failed) == 6
    assert "at t = " in result.failed[0].reason


@pytest.mark.slow
def test_both_methods_share_plan_and_noise(tmp_path: Path) -> None:
    plan = small_plan(realisations=1)
    run_campaign(plan, tmp_path / "nonlinear")
    run_campaign(dataclasses.replace(plan, method="perturbation"), tmp_path / "perturbation")
    a, b = numbers(tmp_path / "nonlinear"), numbers(tmp_path / "perturbation")
    motion = a[:, :, :3] - a[:, :1, :3]
    assert np.linalg.norm(a[:, :, :3] - b[:, :, :3]) < 0.01 * np.linalg.norm(motion)


@pytest.mark.parametrize("method", ["nonlinear", "perturbation"])
def test_memory_of_a_batch_stays_below_what_is_stated(tmp_path: Path, method: str) -> None:
    realisations, periods = {"nonlinear": (1, 1), "perturbation": (4, 2)}[method]
    robot, noise = rf.load_robot("rx90b_3dof"), Noise(0.1, 1e-6, 1e-4)
    plan = section_662(robot, load_cs8(), noise=noise, realisations=realisations, periods=periods, method=method)
    (tmp_path / "runs").mkdir()
    simulate_batch(plan, plan.runs, tmp_path)  # what is made once, compiled code say
    tracemalloc.start()
    results = simulate_batch(plan, plan.runs, tmp_path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert all(reason is None for _, reason in results)
    stated = batch_bytes(plan, len(plan.runs))
    assert 0.5 * stated < peak < stated, (peak, stated)


@pytest.mark.parametrize("change", [{"signs": (2,)}, {"periods": 0}, {"validation": 2}, {"moving": ("joint_9",) * 3}])
def test_a_plan_that_cannot_be_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"expected|none of"):
        small_plan(**change)


def test_a_campaign_runs_on_a_dask_cluster(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    plan = small_plan(realisations=1)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        result = run_campaign(plan, tmp_path / "dask", jobs=-1, batch=2)
    assert len(result.done) == 6
    run_campaign(plan, tmp_path / "here")
    np.testing.assert_array_equal(numbers(tmp_path / "dask"), numbers(tmp_path / "here"))
