"""Claims about the side of the gears on which torques are measured: stated in a campaign file, or worked out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.basics import with_basics
from rx90b_flex.signals import load_campaign

RATE_HZ, CUTOFF_HZ, NOISE = 100.0, 12.0, (0.05, 0.02)
GEARS = np.array([[80.0, 0.0], [10.0, 60.0]])
IN_DRIVES = ind.friction((2.0, 1.0), (3.0, 1.5))
BASICS = ("drive_inertia", "coulomb_friction", "viscous_friction")
DECLARED = [{"type": kind, "joint": j} for j in ("shoulder", "elbow") for kind in BASICS]


def campaign(
    folder: Path, torques: Sequence[ind.Torque] = (IN_DRIVES,), scale: float = 1.0, gears: np.ndarray | None = None
) -> Path:
    arm, rng, runs = ind.two_joints(folder), np.random.default_rng(3), []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=12.0, rate_hz=RATE_HZ)
        logged = ind.run(arm, role, m, torques, ind.white(rng, len(m.time), NOISE))
        runs.append(ind.Run(role, m, scale * logged.torque))
    return ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ, gear_matrix=gears)


def stating(path: Path, side: str) -> Path:
    path.write_text(path.read_text().replace("[signals]", f'[torque]\nside = "{side}"\n[signals]'))
    return path


def test_torques_with_friction_are_seen_through_the_drives(tmp_path: Path) -> None:
    side = rf.check(campaign(tmp_path)).torque_side
    assert (side.stated, side.found, side.message) == (None, "joint", "")


def test_torques_of_links_alone_are_those_of_sensors_behind_the_gears(tmp_path: Path) -> None:
    path = campaign(tmp_path, torques=())
    side = rf.check(path).torque_side
    assert side.found == "behind_gear"
    assert 'side = "behind_gear"' in side.message
    assert rf.check(stating(path, "behind_gear")).torque_side.message == ""


def test_torques_a_hundredth_of_what_links_ask_for_are_the_motors(tmp_path: Path) -> None:
    side = rf.check(campaign(tmp_path, scale=0.01)).torque_side
    assert side.found == "motor"
    assert "gear_matrix" in side.message


def test_friction_in_torques_that_are_stated_as_behind_the_gears_is_told(tmp_path: Path) -> None:
    side = rf.check(stating(campaign(tmp_path), "behind_gear")).torque_side
    assert (side.stated, side.found) == ("behind_gear", "joint")
    assert "friction" in side.message


@pytest.mark.parametrize("side", ["joint", "behind_gear"])
def test_a_gear_matrix_does_not_touch_torques_of_the_joints(tmp_path: Path, side: str) -> None:
    path = campaign(tmp_path, gears=GEARS)
    through = load_campaign(path).recordings[0]
    as_logged = load_campaign(stating(path, side)).recordings[0]
    np.testing.assert_array_equal(through.position, as_logged.position)
    # joint torque = G' motor torque, a row a sample
    np.testing.assert_allclose(through.torque, as_logged.torque @ GEARS, rtol=1e-12)


def test_motors_torques_are_brought_to_the_joints_with_or_without_the_key(tmp_path: Path) -> None:
    path = campaign(tmp_path, gears=GEARS)
    left_out = load_campaign(path).recordings[0].torque
    np.testing.assert_array_equal(load_campaign(stating(path, "motor")).recordings[0].torque, left_out)


@pytest.mark.parametrize(
    ("side", "said"), [("motors", "did you mean 'motor'"), ("motor", "there is no [motor] gear_matrix")]
)
def test_a_side_that_cannot_be_is_refused_in_one_line(tmp_path: Path, side: str, said: str) -> None:
    path = stating(campaign(tmp_path), side)
    with pytest.raises(ValueError, match=r"campaign\.toml: \[torque\] side: found") as refused:
        load_campaign(path)
    assert said in str(refused.value).replace('"', "'")
    assert "\n" not in str(refused.value)


def test_behind_the_gears_no_drive_is_offered(tmp_path: Path) -> None:
    arm = ind.two_joints(tmp_path)
    robot = rf.load_robot(tmp_path / arm.urdf)
    assert {e.type_name() for e in with_basics(robot, behind_gears=True).effects} == {"torque_offset"}
