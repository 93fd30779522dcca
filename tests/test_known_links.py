"""Links that a robot file calls known while they are not: no fault of the data, and no name for it without a word."""

from __future__ import annotations

import re
from pathlib import Path

import independent as ind
import numpy as np
import pytest

import rx90b_flex as rf
from rx90b_flex.diagnose.check import _look
from rx90b_flex.diagnose.faults.gains import small_gain
from rx90b_flex.diagnose.search import Search
from rx90b_flex.effects import Sites
from rx90b_flex.effects.payload import Payload
from rx90b_flex.identify.least_squares import identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import load_campaign

FRICTION = ((1.0, 0.6), (1.5, 0.8))  # N m dry, N m s/rad viscous
LOWER = (
    '<origin xyz="0.17 -0.02 0.02"/><mass value="2"/>\n'
    '    <inertia ixx="0.01" iyy="0.03" izz="0.035" ixy="-0.001" ixz="0.001" iyz="0.002"/>'
)


def _about(mass: float, centre: np.ndarray) -> np.ndarray:
    """Inertia of a point mass about the origin, (3, 3), kg m^2."""
    return mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))


def _unloaded(mass: float, centre: tuple[float, float, float]) -> str:
    """The lower link without a point mass that it carries."""
    at, own, load = 2.0, np.array([0.17, -0.02, 0.02]), np.array(centre)
    inertia = np.array([[0.01, -0.001, 0.001], [-0.001, 0.03, 0.002], [0.001, 0.002, 0.035]])
    less = at - mass
    place = (at * own - mass * load) / less
    j = inertia + _about(at, own) - _about(mass, load) - _about(less, place)
    names = (
        f'{n}="{j[r, c]:.12g}"'
        for n, r, c in (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))
    )
    return f'<origin xyz="{place[0]:.12g} {place[1]:.12g} {place[2]:.12g}"/><mass value="{less}"/><inertia {" ".join(names)}/>'


WRONG = {
    "too light": ('<mass value="4"/>', '<mass value="2.2"/>'),
    "turned about": ('xyz="0.17 -0.02 0.02"', 'xyz="-0.09 0.12 0.02"'),
    "loaded": (LOWER, _unloaded(0.3, (0.25, 0.02, 0.0))),
    "right": ('<mass value="4"/>', '<mass value="4"/>'),
}


def campaign(folder: Path, wrong: str, seed: int) -> Path:
    """Two joints with friction; the URDF beside the logs has another link than the one that moved."""
    arm, rng = ind.two_joints(folder), np.random.default_rng(seed)
    tables = [{"type": k, "joint": j} for j in arm.joints for k in ("coulomb_friction", "viscous_friction")]
    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 2, period_s=10.0, rate_hz=100.0, lines=8)
        noise = ind.white(rng, len(m.time), (0.05, 0.03))
        runs.append(ind.run(arm, role, m, [ind.friction(*FRICTION)], noise))
    path = ind.write_files(folder, arm, tables, runs, cutoff_hz=15.0, known=True)
    urdf = folder / arm.urdf
    assert WRONG[wrong][0] in urdf.read_text()
    urdf.write_text(urdf.read_text().replace(*WRONG[wrong]))
    return path


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("wrong", ["too light", pytest.param("turned about", marks=pytest.mark.slow)])
def test_wrong_links_are_no_fault_of_the_data_and_said_to_be_behind_what_was_named(
    tmp_path: Path, wrong: str, seed: int
) -> None:
    path = campaign(tmp_path, wrong, seed)
    assert rf.check(path).data_faults == ()
    result = rf.close_loop(path)
    (told,) = (c for c in result.cautions if "declared as known" in c)
    assert 'inertial_parameters = "fitted"' in told
    assert all(e.effect.label in told for e in result.effects)
    assert result.verdict == "partly_explained"


@pytest.mark.slow
def test_a_payload_on_right_links_keeps_its_name_beside_the_other_explanation(tmp_path: Path) -> None:
    result = rf.close_loop(campaign(tmp_path, "loaded", 1))
    assert [e.effect.type_name() for e in result.effects] == ["payload"] and result.verdict == "explained"
    (told,) = (c for c in result.cautions if "declared as known" in c)
    assert "payload" in told


def test_right_links_are_not_doubted(tmp_path: Path) -> None:
    result = rf.close_loop(campaign(tmp_path, "right", 1))
    assert list(result.effects) == [] and not any("declared as known" in c for c in result.cautions)


def carried(
    folder: Path,
    mass: float,
    centre: tuple[float, float, float],
    stated: float = 0.0,
    said: tuple[float, float, float] | None = None,
    frame: str = "ee_link",
) -> Path:
    """A UR5 of known links with a mass at its tip, of which so much is stated, there or elsewhere."""
    arm, rng, noise = ind.ur5(), np.random.default_rng(2), 0.03 * np.array([1.0, 20.0, 5.0, 1.0, 1.0, 1.0])
    runs = []
    for role in ("identification", "identification", "validation"):
        m = ind.harmonics(rng, 6, period_s=15.0)
        torques = [ind.friction(20.0 * noise, 15.0 * noise), ind.carrying(arm, frame, mass, centre)]
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), noise)))
    kinds = ("coulomb_friction", "viscous_friction", "drive_inertia", "torque_offset")
    tables = [{"type": k, "joint": j} for j in arm.joints for k in kinds]
    path = ind.write_files(folder, arm, tables, runs, cutoff_hz=15.0, known=True)
    robot = folder / "robot_declared.toml"
    robot.write_text(f'tip_frame = "{frame}"\n{robot.read_text()}')
    if stated:
        head, *recordings = path.read_text().split("[[recording]]")
        payload = f"payload = {{ mass = {stated}, centre = {list(said or centre)} }}\n"
        path.write_text("[[recording]]".join([head, *(r + payload for r in recordings)]))
    return path


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.02, -0.03, 0.25)])
def test_a_search_for_a_payload_begins_about_where_it_is(tmp_path: Path, centre: tuple[float, float, float]) -> None:
    """A look at some places around the tip alone sees none of them explain what the last joints feel."""
    loaded = load_campaign(carried(tmp_path, 1.0, centre))
    regression = Regression.of(rf.load_robot(loaded.robot_source), loaded.identification, loaded.cutoff_hz)
    robot = regression.robot
    model = identify(regression, robot.effects, fit_links=False, with_covariance=False)
    search = Search(model, Sites(robot.joints, robot.tip_frame), lambda kind: kind is Payload)
    ((_, rough),), _ = search._first_looks([0])
    assert np.abs(rough.effect.shape - centre).max() < 0.01
    assert rough.gain > 0.5 * search.present.squares.sum()


@pytest.mark.slow
@pytest.mark.parametrize("centre", [pytest.param((0.0, 0.0, 0.0), marks=pytest.mark.long), (0.05, 0.0, 0.0)])
@pytest.mark.parametrize("stated", [0.0, 2.0])
def test_a_payload_and_what_a_stated_one_lacks_is_a_payload_and_no_gain_of_all_motors(
    tmp_path: Path, centre: tuple[float, float, float], stated: float
) -> None:
    result = rf.close_loop(carried(tmp_path, stated + 1.0, centre, stated))
    assert [e.type for e in result.effects] == ["payload"] and result.verdict == "explained"
    mass, *place = result.effects[0].parameters
    assert mass.value is not None and mass.std is not None and abs(mass.value - 1.0) < 4.0 * mass.std
    assert mass.std < 0.01
    for found, true in zip(place, centre, strict=True):
        assert found.value is not None and abs(found.value - true) < 0.002


def _numbers(message: str) -> tuple[float, float, list[float]]:
    """Of a stated payload that is another one: kg, std, and the place in m."""
    found = re.search(r"the torques go with (\S+) kg \(std (\S+) kg\) at \((.*?)\) m", message)
    assert found is not None, message
    return float(found[1]), float(found[2]), [float(x) for x in found[3].split(",")]


AT = (0.02, -0.03, 0.1)


@pytest.mark.parametrize(
    ("mass", "stated", "said"),
    [
        (1.0, 2.0, AT),
        pytest.param(2.4, 2.5, AT, marks=pytest.mark.slow),
        pytest.param(0.5, 3.0, AT, marks=pytest.mark.slow),
        pytest.param(3.0, 2.0, AT, marks=pytest.mark.slow),
        pytest.param(2.0, 2.0, (0.02, -0.03, 0.2), marks=pytest.mark.slow),
    ],
)
def test_a_payload_that_is_not_the_stated_one_is_said_and_is_no_gain_of_motors(
    tmp_path: Path, mass: float, stated: float, said: tuple[float, float, float]
) -> None:
    checked = rf.check(carried(tmp_path, mass, AT, stated, said))
    (fault,) = checked.data_faults
    assert fault.kind == "kinematics" and checked.usable == (mass > stated)
    found, std, place = _numbers(fault.message)
    assert abs(found - mass) < max(4.0 * std, 0.02) and np.abs(np.array(place) - AT).max() < 0.005
    assert mass == stated or fault.factor == pytest.approx(stated / mass, rel=0.03)


def test_a_payload_of_a_frame_before_the_last_link_is_told_in_that_frame(tmp_path: Path) -> None:
    (fault,) = rf.check(carried(tmp_path, 1.0, AT, 2.0, frame="wrist_1_link")).data_faults
    found, std, place = _numbers(fault.message)
    assert abs(found - 1.0) < max(4.0 * std, 0.02) and np.abs(np.array(place) - AT).max() < 0.005


def test_a_payload_as_stated_is_no_fault(tmp_path: Path) -> None:
    assert rf.check(carried(tmp_path, 2.0, AT, 2.0)).data_faults == ()


@pytest.mark.slow
def test_a_stated_payload_that_is_not_there_is_said(tmp_path: Path) -> None:
    (fault,) = rf.check(carried(tmp_path, 1e-9, AT, 2.0)).data_faults
    assert "the torques go with none" in fault.message and not fault.usable and fault.factor is None


@pytest.mark.slow
@pytest.mark.parametrize("joint", [4, *(pytest.param(j, marks=pytest.mark.long) for j in (3, 5))])
@pytest.mark.parametrize("lacks", ["gain", "spring"])
def test_what_one_joint_lacks_is_no_other_payload(tmp_path: Path, joint: int, lacks: str) -> None:
    """A stated payload tells a motor's gain: it is not what is wrong where one joint's torque alone is off."""
    path = carried(tmp_path, 2.0, AT, 2.0)
    for log in sorted(tmp_path.glob("log_*.csv")):
        rows = np.loadtxt(log, delimiter=",", skiprows=1)
        torque, angle = rows[:, 7 + joint], rows[:, 1 + joint]
        rows[:, 7 + joint] = 1.4 * torque if lacks == "gain" else torque + 3.0 * np.cos(angle)
        header = log.read_text().splitlines()[0]
        np.savetxt(log, rows, fmt="%.17g", delimiter=",", header=header, comments="")
    assert not any("payload" in f.message for f in rf.check(path).data_faults)


def test_a_gain_that_is_a_little_off_is_what_another_scale_of_an_angle_must_explain_more_than(tmp_path: Path) -> None:
    path = carried(tmp_path, 2.0, AT, 2.0)
    for log in sorted(tmp_path.glob("log_*.csv")):
        rows = np.loadtxt(log, delimiter=",", skiprows=1)
        rows[:, 7 + 2] *= 0.95
        header = log.read_text().splitlines()[0]
        np.savetxt(log, rows, fmt="%.17g", delimiter=",", header=header, comments="")
    loaded = load_campaign(path)
    look = _look(loaded, loaded.recordings, rf.load_robot(loaded.robot_source).rigid().restricted(loaded.joints))
    gain, _ = look.refined(small_gain(look, loaded.joints[2]))
    assert gain.factor == pytest.approx(0.95, abs=0.005)
    assert look.fit(gain.reading).score < look.fit().score - 0.5
    assert not any(f.kind == "unit" for f in rf.check(path).data_faults)
