"""Claims about what the camera's command tells of a stiffness, and of mistakes in its table."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_measured_stiffness import ROBOT, STD_MM, TRIANGLE, write_poses

import rx90b_flex as rf
from rx90b_flex.identify.camera_command import CameraResult, fit_markers, read_markers
from rx90b_flex.identify.camera_faults import outliers
from rx90b_flex.identify.measured_stiffness import REACH, HingeStiffness
from rx90b_flex.view.camera_report import headline


def hinges(stiffness: np.ndarray, share: np.ndarray, seed: int) -> list[HingeStiffness]:
    """Of compliances that are known with normal errors, of some share of the true one."""
    compliance = (1.0 + share * np.random.default_rng(seed).standard_normal(len(stiffness))) / stiffness
    std = share / stiffness
    return [HingeStiffness("hinge", 1.0 / c, s / c**2) for c, s in zip(compliance, std, strict=True)]


@pytest.mark.parametrize("seed", range(3))
def test_what_is_called_determined_holds_about_as_often_as_stated(seed: int) -> None:
    """Of hinges of all kinds, most of them told weakly; 95 % of 4000 are known to 0.35 %."""
    share = np.exp(np.random.default_rng(seed).uniform(np.log(0.02), np.log(2.0), 8000))
    found = [h for h in hinges(np.full(8000, 2.1e4), share, seed) if h.determined]
    assert len(found) > 3000
    assert 0.93 < np.mean([abs(h.value - 2.1e4) < REACH * h.even_std for h in found]) < 0.96


@pytest.mark.parametrize("share", [0.03, 0.2, 0.43, 1.0])
def test_the_interval_of_a_stiffness_holds_in_95_percent_however_weakly_it_is_told(share: float) -> None:
    found = hinges(np.full(2000, 2.1e4), np.full(2000, share), 1)
    assert np.mean([h.interval[0] <= 2.1e4 <= h.interval[1] for h in found]) == pytest.approx(0.95, abs=0.02)
    wrong = [h for h in found if h.determined and abs(h.value - 2.1e4) > REACH * h.even_std]
    assert len(wrong) / len(found) < 0.07  # selected or not: no stiffness is called determined and wrong more often


def test_a_compliance_below_zero_bounds_no_stiffness() -> None:
    low, high = HingeStiffness("hinge", -1e4, 1e3).interval
    assert np.isinf(low) and np.isinf(high)
    low, high = HingeStiffness("hinge", -1e4, 1e4).interval
    assert low == pytest.approx(1e4 / (REACH - 1.0)) and np.isinf(high)


# ---- mistakes -----------------------------------------------------------------------------------------------------


JOINT = "joint_3"
ANGLES = [f"q_joint_{k}" for k in range(1, 5)]


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pd.DataFrame]:
    """A folder with a file of markers, and its sound table."""
    folder = tmp_path_factory.mktemp("markers")
    write_poses(folder, rf.load_robot(ROBOT), JOINT, 25, seed=3)
    return folder, pd.read_csv(folder / "markers.csv")


def told(folder: Path, table: pd.DataFrame) -> CameraResult:
    table.to_csv(folder / "markers.csv", index=False)
    return fit_markers(read_markers(folder / "camera.toml"))


def places(table: pd.DataFrame, axis: str = "") -> list[str]:
    return [name for name in table.columns if name.startswith("be") and (not axis or f"_{axis}_" in name)]


def in_degrees(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{name: np.degrees(table[name]) for name in ANGLES})


def without_unit(table: pd.DataFrame) -> pd.DataFrame:
    return table.rename(columns={name: name.removesuffix("_mm") for name in places(table)})


def in_metres(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{name: 1e-3 * table[name] for name in places(table)})


def other_sign(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(q_joint_1=-table["q_joint_1"])


def one_in_degrees(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(q_joint_3=np.degrees(table["q_joint_3"]))


def exchanged(table: pd.DataFrame) -> pd.DataFrame:
    other = {"before": "behind", "behind": "before"}
    return table.rename(columns={name: other[name[:6]] + name[6:] for name in places(table)})


def left_handed(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{name: -table[name] for name in places(table, "y")})


@pytest.mark.parametrize(
    ("mistake", "named"),
    [
        (in_degrees, "degrees (rad is expected)"),
        (without_unit, "before_1_x_mm"),
        (in_metres, "columns ..._mm are in mm"),
        (other_sign, "column q_joint_1 has the other sign"),
        (one_in_degrees, "what explains it: column q_joint_3 is in degrees (rad is expected)"),
        (exchanged, "the columns before_... and behind_... are exchanged"),
        (left_handed, "left-handed"),
    ],
)
def test_a_mistake_in_the_table_is_named(
    mistake: Callable[[pd.DataFrame], pd.DataFrame], named: str, poses: tuple[Path, pd.DataFrame]
) -> None:
    folder, table = poses
    with pytest.raises(ValueError, match=re.escape(named)) as refused:
        told(folder, mistake(table))
    assert str(folder / "camera.toml") in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize("seed", range(4))
def test_a_sound_table_gets_no_caution(seed: int, tmp_path: Path) -> None:
    write_poses(tmp_path, rf.load_robot(ROBOT), JOINT, 25, seed)
    assert fit_markers(read_markers(tmp_path / "camera.toml")).cautions == ()


@pytest.mark.parametrize("column", ["before_2_x_mm", "behind_1_y_mm", "behind_3_z_mm"])
def test_a_marker_that_stands_off_in_one_row_is_named(column: str, poses: tuple[Path, pd.DataFrame]) -> None:
    folder, table = poses
    wrong = table.copy()
    wrong.loc[6, column] += 5.0
    (line,) = told(folder, wrong).cautions
    assert line.startswith("row 7: ") and column.removesuffix(column[-5:]) in line


def test_an_angle_that_is_off_in_one_row_is_named(poses: tuple[Path, pd.DataFrame]) -> None:
    folder, table = poses
    wrong = table.copy()
    wrong.loc[6, "q_joint_3"] += 0.02
    (line,) = told(folder, wrong).cautions
    assert line.startswith("row 7: the turn of joint_3")


def test_noise_that_is_stated_too_small_widens_what_follows_from_it(poses: tuple[Path, pd.DataFrame]) -> None:
    folder, table = poses
    sound, file = told(folder, table), folder / "camera.toml"
    stated = file.read_text()
    (noise,) = [line for line in stated.splitlines() if line.startswith("std_mm")]
    try:
        file.write_text(stated.replace(noise, f"std_mm = {[float(x) / 5.0 for x in STD_MM]}"))
        small = told(folder, table)
    finally:
        file.write_text(stated)
    assert sound.fit.loudness == 1.0 and small.fit.loudness == pytest.approx(25.0, rel=0.4)
    np.testing.assert_allclose(small.fit.stiffness_std, sound.fit.stiffness_std, rtol=0.4)
    assert "widened" in headline(small)[-1] and not any("widened" in line for line in headline(sound))


def test_stated_noise_seldom_gives_an_outlier() -> None:
    """In one table of 1000; more than 4 of 1000 in 0.4 % of all cases."""
    rng = np.random.default_rng(0)
    std = 1e-3 * STD_MM
    count = sum(bool(outliers(TRIANGLE + std * rng.standard_normal((2, 30, 3, 3)), std)) for _ in range(1000))
    assert count <= 4


def test_markers_in_another_order_in_one_row_are_named() -> None:
    std = 1e-3 * STD_MM
    markers = TRIANGLE * [[1.0], [1.5], [2.0]] + std * np.random.default_rng(1).standard_normal((2, 10, 3, 3))
    markers[0, 3] = markers[0, 3, [1, 0, 2]]
    assert outliers(markers, std) == ["row 4: the markers before_... are in another order than in the other rows"]
