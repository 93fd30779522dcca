"""Faults put into real recordings: they are told there, too, where friction is large and drives have what no file declares."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import independent as ind
import numpy as np
import pytest
from data_folder import data_folder
from marked import by_cost

import rx90b_flex as rf
from rx90b_flex.signals import Campaign, Recording, load_campaign

Array = np.ndarray
Change = Callable[[Campaign], Campaign]


def each(change: Callable[[Recording], Recording], only: str | None = None) -> Change:
    """Every recording changed, or that of a name."""

    def changed(campaign: Campaign) -> Campaign:
        recordings = tuple(change(r) if only in (None, r.name) else r for r in campaign.recordings)
        return dataclasses.replace(campaign, recordings=recordings)

    return changed


def torque_times(joint: int | slice, factor: float, only: str | None = None) -> Change:
    def change(r: Recording) -> Recording:
        torque = r.torque.copy()
        torque[:, joint] *= factor
        return dataclasses.replace(r, torque=torque)

    return each(change, only)


def torques_exchanged(i: int, j: int) -> Change:
    def change(r: Recording) -> Recording:
        torque = r.torque.copy()
        torque[:, [i, j]] = torque[:, [j, i]]
        return dataclasses.replace(r, torque=torque)

    return each(change)


def torque_late(joint: int, seconds: float) -> Change:
    def change(r: Recording) -> Recording:
        late, torque = round(seconds * r.sample_rate_hz), r.torque.copy()
        torque[:, joint] = np.roll(torque[:, joint], late)
        return part(dataclasses.replace(r, torque=torque), slice(late, None))

    return each(change)


def angle_off(joint: int, radians: float) -> Change:
    return each(lambda r: dataclasses.replace(r, position=r.position + radians * (np.arange(len(r.joints)) == joint)))


def stated_rate(factor: float) -> Change:
    def change(campaign: Campaign) -> Campaign:
        rate = factor * campaign.sample_rate_hz
        stated = each(lambda r: dataclasses.replace(r, sample_rate_hz=rate, time=np.arange(r.samples) / rate))
        return dataclasses.replace(stated(campaign), sample_rate_hz=rate)

    return change


def part(r: Recording, rows: slice) -> Recording:
    """Some rows of angles and torques."""
    time, position, torque = (x[rows] for x in (r.time, r.position, r.torque))
    return Recording(r.name, r.role, time - time[0], r.sample_rate_hz, r.joints, position, torque)


def of(name: str) -> Campaign:
    """A campaign of real recordings, angles and torques alone."""
    campaign = load_campaign(data_folder(name) / "campaign.toml")
    return each(lambda r: part(r, slice(None)))(campaign)


FAULTS: dict[str, tuple[str, Change, str, set[str]]] = {
    "every torque reversed": ("kr300_encoders", torque_times(slice(None), -1.0), "reversed_sign", {f"A{k}" for k in range(1, 7)}),
    "a torque reversed": ("kr300_encoders", torque_times(4, -1.0), "reversed_sign", {"A5"}),
    "a torque reversed in one": ("kr300_encoders", torque_times(4, -1.0, "B"), "reversed_sign", {"A5"}),
    "torques exchanged": ("kr300_encoders", torques_exchanged(3, 4), "swapped_columns", {"A4", "A5"}),
    "a wrong motor constant": ("kr300_encoders", torque_times(2, 3.0), "torque_gain", {"A3"}),
    "a torque of coupled joints reversed": ("tx40", torque_times(4, -1.0), "reversed_sign", {"joint_5"}),
    "a torque of coupled joints late": ("tx40", torque_late(4, 0.3), "time_shift", {"joint_5"}),
    "a zero beside coupled joints": ("tx40", angle_off(2, np.pi / 2), "kinematics", {"joint_3"}),
    "a stated rate beside coupled joints": ("tx40", stated_rate(2.0), "sample_rate", set()),
    "a torque reversed where gains are wrong": ("dualarm_v2", torque_times(5, -1.0), "reversed_sign", {"joint_6"}),
}  # fmt: skip
BY_HAND = {"a torque reversed in one", "a stated rate beside coupled joints", "a torque reversed where gains are wrong"}
SLOW = FAULTS.keys() - BY_HAND - {"torques exchanged"}


@pytest.mark.parametrize("name", by_cost(FAULTS, slow=SLOW, long=BY_HAND))
def test_a_fault_of_real_recordings_is_named_on_its_joints(name: str) -> None:
    robot, change, kind, joints = FAULTS[name]
    found = rf.check(change(of(robot))).data_faults
    assert any(f.kind == kind and (not joints or set(f.joints) == joints) for f in found), [f.message for f in found]


@pytest.mark.slow
def test_an_axis_of_the_urdf_beside_coupled_joints_is_named(tmp_path: Path) -> None:
    campaign = of("tx40")
    source = Path(campaign.robot_source)
    root = ElementTree.parse(source.with_name("tx40.urdf")).getroot()
    axis = next(j for j in root.iter("joint") if j.get("name") == "joint_4").find("axis")
    axis.set("xyz", "0 1 0" if axis.get("xyz") == "0 0 1" else "0 0 1")
    (tmp_path / "tx40.urdf").write_bytes(ElementTree.tostring(root))
    robot = tmp_path / "tx40.toml"
    robot.write_text(re.sub(r'(?m)^urdf = ".*"$', 'urdf = "tx40.urdf"', source.read_text()))
    found = rf.check(campaign, robot=robot).data_faults
    assert [(f.kind, f.joints) for f in found] == [("kinematics", ("joint_4",))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signals", "i", "j"),
    [
        (("motor_tau",), 4, 5),
        pytest.param(("motor_q",), 1, 2, marks=pytest.mark.slow),
        pytest.param(("motor_tau", "motor_q"), 2, 3, marks=pytest.mark.slow),
    ],
)
def test_columns_of_motors_are_exchanged_with_their_gears(
    tmp_path: Path, signals: tuple[str, ...], i: int, j: int
) -> None:
    # of other ratios, signs and zeros, or coupled: at the joints none of their columns is another's
    folder = data_folder("tx40")
    text = (folder / "campaign.toml").read_text()
    for name in ("tx40.toml", "tx40.csv.gz"):
        text = text.replace(f'"{name}"', f'"{folder / name}"')
    for signal in signals:
        one, other = f'"{signal}{i}"', f'"{signal}{j}"'
        text = text.replace(one, "<one>").replace(other, one).replace("<one>", other)
    path = tmp_path / "campaign.toml"
    path.write_text(text)
    found = rf.check(path).data_faults
    signal = {("motor_tau",): "torque", ("motor_q",): "motor_position"}.get(signals, "all")
    assert [(f.kind, f.signal, set(f.joints)) for f in found] == [
        ("swapped_columns", signal, {f"joint_{i}", f"joint_{j}"})
    ]


@pytest.mark.slow
@pytest.mark.parametrize("start_s", [0.5, 3.0, 6.0])
def test_three_seconds_of_sound_recordings_have_no_wrong_sign(start_s: float) -> None:
    # friction of so short a log may well come out driving
    rows = slice(round(250 * start_s), round(250 * (start_s + 3.0)))
    found = rf.check(each(lambda r: part(r, rows))(of("kr300_encoders"))).data_faults
    assert not [f.message for f in found if f.kind == "reversed_sign"]


@pytest.mark.parametrize("friction", [1.0, pytest.param(0.2, marks=pytest.mark.slow)])
def test_what_gravity_drives_all_through_a_log_is_not_reversed(tmp_path: Path, friction: float) -> None:
    # two joints go down all through a log, in the others up: there their torque drives them
    arm, rng = ind.ur10(1.1), np.random.default_rng(0)
    coulomb, viscous = (8.0, 8.0, 5.0, 1.5, 1.2, 0.8), (12.0, 12.0, 8.0, 2.0, 1.5, 1.0)
    torques = [ind.friction(*(tuple(friction * x for x in some) for some in (coulomb, viscous)))]
    runs = []
    for role, way in (("identification", 1.0), ("identification", -1.0), ("validation", 1.0)):
        m = ind.harmonics(rng, 6, period_s=10.0, rate_hz=100.0, speed=0.25)
        q, v, a = one_way(m, {1: 1.2 * way, 2: 1.0 * way})
        m = ind.Motion(m.time, q, v, a)
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), (0.8, 1.0, 0.6, 0.12, 0.1, 0.06))))
    declared = [{"type": k, "joint": j} for j in arm.joints for k in ("coulomb_friction", "viscous_friction")]
    assert rf.check(ind.write_files(tmp_path, arm, declared, runs, cutoff_hz=15.0)).data_faults == ()


def one_way(m: ind.Motion, reach: dict[int, float]) -> tuple[Array, Array, Array]:
    """Some joints from one end of their way to the other, a little of their motion on top."""
    part, whole = m.time / m.time[-1], m.time[-1]
    s = 10 * part**3 - 15 * part**4 + 6 * part**5
    ds = (30 * part**2 - 60 * part**3 + 30 * part**4) / whole
    dds = (60 * part - 180 * part**2 + 120 * part**3) / whole**2
    q, v, a = m.q.copy(), m.v.copy(), m.a.copy()
    for k, far in reach.items():
        q[:, k] = q[0, k] + 0.15 * (q[:, k] - q[0, k]) + far * (s - 0.5) - (k == 1)
        v[:, k], a[:, k] = 0.15 * v[:, k] + far * ds, 0.15 * a[:, k] + far * dds
    return q, v, a
