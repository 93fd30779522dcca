"""What results tell of a joint that slides; and what they print."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.view import plots
from rx90b_flex.view.preview import preview

MASS, DRY, VISCOUS, MORE, FADES = 8.0, 20.0, 40.0, 15.0, 0.02  # kg, N, N s/m; N and m/s of Stribeck friction
CAMPAIGN = """robot = "axis.urdf"
sample_rate_hz = 100.0
joints = ["axis"]
[signals]
motor_position = ["x"]
motor_current = ["i"]
[motor]
torque_constant = [2.0]
[preprocessing]
cutoff_hz = 20.0
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("axis")
    inertia = "".join(f' {k}="{v}"' for k, v in {"ixx": 1, "iyy": 1, "izz": 1, "ixy": 0, "ixz": 0, "iyz": 0}.items())
    (folder / "axis.urdf").write_text(
        f'<robot name="axis"><link name="base"/><link name="sled"><inertial><mass value="{MASS}"/><inertia{inertia}/></inertial>'
        '</link><joint name="axis" type="prismatic"><parent link="base"/><child link="sled"/><axis xyz="1 0 0"/>'
        '<limit lower="-1" upper="1" effort="500" velocity="4"/></joint></robot>'
    )
    text, rng = CAMPAIGN, np.random.default_rng(0)
    for i, role in enumerate(("identification", "identification", "validation")):
        t = np.arange(1000) / 100.0
        w = 2 * np.pi * np.array([0.2, 0.5, 0.9])
        size, phase = rng.uniform(0.02, 0.05, 3), rng.uniform(0, 6, 3)
        x, v, a = ((size * w**k * np.sin(np.outer(t, w) + phase + k * np.pi / 2)).sum(axis=1) for k in range(3))
        force = MASS * a + (DRY + MORE * np.exp(-np.abs(v) / FADES)) * np.tanh(v / 0.002) + VISCOUS * v
        columns = np.c_[t, x, (force + rng.normal(0, 0.1, len(t))) / 2.0]
        np.savetxt(folder / f"{i}.csv", columns, fmt="%.17g", delimiter=",", header="time,x,i", comments="")
        text += f'[[recording]]\nfile = "{i}.csv"\nrole = "{role}"\n'
    (folder / "campaign.toml").write_text(text)
    return folder / "campaign.toml"


@pytest.fixture(scope="module")
def closed(campaign: Path) -> rf.ClosedLoop:
    result = rf.close_loop(campaign, robot=campaign.with_name("axis.urdf"), basics=True)
    assert isinstance(result, rf.ClosedLoop)
    return result


def test_what_was_found_has_the_names_of_the_json(closed: rf.ClosedLoop) -> None:
    first = closed.effects[0]
    assert (first.type, first.joint, first.joints) == ("stribeck_friction", "axis", ("axis",))
    assert first.validation_relative_error_before > first.validation_relative_error_after


def test_figures_of_a_joint_that_slides_are_in_metres_and_newtons(closed: rf.ClosedLoop) -> None:
    (over,) = plots.residual_against_velocity(closed, "axis").axes
    assert over.get_xlabel().endswith("velocity, m/s") and over.get_ylabel() == "error, N"
    assert plots.residual_in_frequency(closed, "axis").axes[0].get_ylabel() == "amplitude, N"
    assert plots.residual_in_time(closed, "axis").axes[0].get_ylabel().endswith("N")


def test_a_fit_of_a_joint_that_slides_is_drawn_in_newtons(campaign: Path) -> None:
    fitted = rf.identify(campaign, basics=True).plot().figure
    drawn = preview(campaign)["axis"]
    for figure, model in ((fitted, "identified model"), (drawn, "declared model")):
        above, below = figure.axes
        assert above.get_ylabel() == "axis\ntorque, N" and below.get_ylabel() == "error, N"
        assert [t.get_text() for t in above.get_legend().get_texts()] == ["measured", model]


def test_a_torque_constant_that_was_stated_is_no_caution(closed: rf.ClosedLoop) -> None:
    assert not any("constant" in caution for caution in closed.cautions)


def test_friction_that_only_grows_far_below_a_joints_speed_is_lost_in_a_urdf(tmp_path: Path, campaign: Path) -> None:
    effects = "".join(
        f'[[effects]]\ntype = "{kind}"\njoint = "axis"\n{values}\n'
        for kind, values in (
            ("coulomb_friction", f"torque = {DRY}\nturnover = 0.002"),
            ("stribeck_friction", f"torque = {MORE}\nvelocity = {FADES}\npower = 1.0\nturnover = 0.002"),
        )
    )
    (tmp_path / "axis.urdf").write_text(campaign.with_name("axis.urdf").read_text())
    (tmp_path / "robot.toml").write_text(f'urdf = "axis.urdf"\n{effects}')
    (lost,) = rf.export_robot(tmp_path / "robot.toml", tmp_path / "out.urdf", "urdf").lost
    assert "stribeck_friction" in lost.what and "N between" in lost.why and "m/s" in lost.why


@pytest.mark.parametrize("shape", [(3,), (5, 12)])
def test_a_mass_matrix_is_of_one_pose_with_all_coordinates(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"^q h.* expected .*\(12,\)[^\n]*$"):
        rf.load_robot("rx90b_3dof").mass_matrix(np.zeros(shape))


def test_a_view_and_a_linearisation_print_as_one_line() -> None:
    robot = rf.load_robot("rx90b_3dof")
    assert len(repr(rf.view(robot, count=1))) < 400
    assert repr(robot.linearize([0.0] * 12)) == "<Linearization: 12 coordinates, 3 joints>"
