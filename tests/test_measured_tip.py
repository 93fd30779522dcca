"""Claims about a measured tip against the predicted one: what was put in between them is found, whatever the clock says."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from test_cli import Command

import rx90b_flex as rf
from rx90b_flex.path import PathCheck, PathOptions, Seam, check_path, compare_measured
from rx90b_flex.path.planning import HOLD_S
from rx90b_flex.simulate.command import controller_of

Array = NDArray[np.float64]
START = np.deg2rad([-11.3, 34.4, 68.8])
# up from a horizontal line is up; left of a path along +y is -x
LINE = Seam("line", np.array([[0.55, -0.04, 0.35], [0.55, 0.04, 0.35]]), speed=0.1, start=START)
SQUARE = np.array([[0.5, -0.02, 0.35], [0.54, -0.02, 0.35], [0.54, 0.02, 0.35], [0.5, 0.02, 0.35], [0.5, -0.02, 0.35]])
PATHS = {"line": LINE, "square": Seam("square", SQUARE, speed=0.1, start=START)}


@cache
def checked(name: str = "line") -> PathCheck:
    robot = rf.load_robot("rx90b_3dof")
    return check_path(PATHS[name], robot, controller_of(robot, None), PathOptions(0.1, False, False))


def tracker(result: PathCheck, rate_hz: float = 130.0, off: Array | None = None) -> tuple[Array, Array]:
    """The run's own tip as another clock samples it, with an offset (3,) m; times from the run's zero."""
    run = result.runs[0]
    time = np.arange(0.0, run.time[-1], 1.0 / rate_hz)
    tip = np.stack([np.interp(time, run.time, x) for x in run.tip[:, :3, 3].T], axis=1)
    return time, tip + (0.0 if off is None else off)


def write(path: Path, place: Array, time: Array | None = None, scale: float = 1.0, names: str = "xyz") -> Path:
    columns = {n if scale == 1.0 else f"{n}_mm": scale * c for n, c in zip(names, place.T, strict=True)}
    pd.DataFrame(({} if time is None else {"time": time}) | columns).to_csv(path, index=False)
    return path


@pytest.mark.parametrize("name", PATHS)
def test_a_tip_that_is_where_it_was_predicted_agrees(name: str, tmp_path: Path) -> None:
    result = checked(name)
    time, place = tracker(result)
    found = compare_measured(result, write(tmp_path / "tip.csv", place, time))
    # linear interpolation between the controller's samples: the tip's acceleration times the step squared over eight
    assert found.difference.max_across < 1e-3 and found.difference.max_along < 1e-2
    assert found.agrees and found.explained > 0.999 and found.seen > 0.99
    assert found.measured.max_across == pytest.approx(result.before.max_across, rel=0.02)


@pytest.mark.parametrize("shift_s", [-3.7, 0.0, 1234.5])
def test_the_clock_s_zero_is_found(shift_s: float, tmp_path: Path) -> None:
    result = checked()
    time, place = tracker(result)
    found = compare_measured(result, write(tmp_path / "tip.csv", place, time + shift_s))
    assert found.shift_s == pytest.approx(HOLD_S + shift_s, abs=2e-4)
    assert found.difference.max_across < 1e-3


@pytest.mark.parametrize("timed", [True, False])
def test_an_offset_across_the_path_is_the_difference_and_has_its_sign(timed: bool, tmp_path: Path) -> None:
    result = checked()
    time, place = tracker(result, off=np.array([-2e-4, 0.0, 3e-4]))  # 0.2 mm to the left of +y, 0.3 mm up
    found = compare_measured(result, write(tmp_path / "tip.csv", place, time if timed else None))
    assert found.aligned == ("time" if timed else "path")
    np.testing.assert_allclose(found.difference.left, 0.2, atol=5e-3)
    np.testing.assert_allclose(found.difference.up, 0.3, atol=5e-3)
    assert not found.agrees
    assert "not within 0.1 mm" in found.sentence


def test_noise_of_the_tracker_is_not_taken_for_a_shift(tmp_path: Path) -> None:
    result, rng = checked(), np.random.default_rng(4)
    time, place = tracker(result)
    noisy = place + 2e-5 * rng.standard_normal(place.shape)
    found = compare_measured(result, write(tmp_path / "tip.csv", noisy, time + 0.4))
    # std over the speed and the root of the samples on the path, five of them
    assert abs(found.shift_s - HOLD_S - 0.4) < 5 * 2e-5 / (0.1 * np.sqrt(len(time) / 3))
    assert found.difference.rms_across == pytest.approx(np.sqrt(2) * 0.02, rel=0.15)


def test_without_times_the_square_s_return_to_its_start_is_its_end(tmp_path: Path) -> None:
    result = checked("square")
    _, place = tracker(result)
    found = compare_measured(result, write(tmp_path / "tip.csv", place))
    assert found.seen > 0.95
    assert found.difference.rms_across < 0.01


def test_millimetres_are_read_as_such(tmp_path: Path) -> None:
    time, place = tracker(checked())
    found = compare_measured(checked(), write(tmp_path / "tip.csv", place, time, scale=1e3))
    assert found.difference.max_across < 1e-3


def test_a_part_of_the_path_is_said_to_be_one(tmp_path: Path) -> None:
    time, place = tracker(checked())
    half = time < HOLD_S + 0.5 * LINE.duration_s
    found = compare_measured(checked(), write(tmp_path / "tip.csv", place[half], time[half]))
    assert found.seen == pytest.approx(0.5, abs=0.03)
    assert "% of the path that were measured" in found.sentence


# ---- command ----------------------------------------------------------------------------------------------------


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(monkeypatch, capfd)


def path_file(folder: Path) -> Path:
    file = folder / "line.toml"
    file.write_text(
        f"points = {LINE.points.tolist()}\nspeed_mm_s = 100.0\nstart_deg = [-11.3, 34.4, 68.8]\nrobot = 'rx90b_3dof'\n"
    )
    return file


@pytest.mark.parametrize(("up_m", "status"), [(0.0, 0), (5e-4, 1)])
def test_the_command_compares_and_ends_by_the_tolerance(
    up_m: float, status: int, tmp_path: Path, command: Command
) -> None:
    time, place = tracker(checked(), off=np.array([0.0, 0.0, up_m]))
    tip, out = write(tmp_path / "tip.csv", place, time), tmp_path / "out"
    found = command("check-path", path_file(tmp_path), "--measured", tip, "--out", out)
    assert (found.status, found.err) == (status, "")
    content = json.loads((out / "measured.json").read_text())
    assert content["agrees"] == (status == 0)
    assert content["difference"]["max_across_mm"] == pytest.approx(1e3 * up_m, abs=5e-3)
    table = pd.read_csv(out / "measured.csv")
    np.testing.assert_allclose(table["up_measured_mm"] - table["up_predicted_mm"], table["up_difference_mm"], atol=2e-5)
    page = (out / "report.html").read_text()
    assert page.index("Measured against predicted") < page.index("Deviation along the path")
    assert "measured less predicted" in found.out


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        (lambda d: d.drop(columns="z"), "no column 'z'"),
        (lambda d: d.assign(time=d["time"].to_numpy()[::-1]), "'time', row 2: does not grow"),
        (lambda d: d.assign(x=np.where(d.index == 3, np.nan, d["x"])), "'x', row 4: no finite number"),
        (lambda d: d.head(5), "5 places"),
        (lambda d: d.assign(z=d["z"] + 0.5), "500 mm from the path"),
    ],
)
def test_a_bad_table_is_one_line_and_nothing_is_written(edit, named: str, tmp_path: Path, command: Command) -> None:
    time, place = tracker(checked())
    tip = write(tmp_path / "tip.csv", place, time)
    edit(pd.read_csv(tip)).to_csv(tip, index=False)
    found = command("check-path", path_file(tmp_path), "--measured", tip, "--out", tmp_path / "out")
    assert (found.status, found.out, found.err.count("\n")) == (2, "", 1)
    assert named in found.err and "tip.csv" in found.err
    assert not (tmp_path / "out").exists()
