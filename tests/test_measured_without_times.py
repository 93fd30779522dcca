"""Claims about measured places without times: each gets its place on the path, whatever their order, and holes are said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from test_measured_tip import LINE, checked, tracker, write

from rx90b_flex.path import compare_measured
from rx90b_flex.path.pairing import nearest_on_path, unmeasured
from rx90b_flex.path.planning import HOLD_S
from rx90b_flex.view.measured_section import measured_along_path

Array = NDArray[np.float64]
POINTS = 20001


def evenly(corners: list[list[float]]) -> Array:
    """A polyline (K, 2), m, at even distances."""
    at = np.asarray(corners)
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))]
    s = np.linspace(0.0, length[-1], POINTS)
    return np.stack([*(np.interp(s, length, x) for x in at.T), np.zeros(POINTS)], axis=1)


angle = np.linspace(0.0, 2 * np.pi, POINTS)
CURVES = {
    "corner": evenly([[0.0, 0.0], [0.0, 0.3], [0.1, 0.3]]),
    # two strands 1 mm apart: a place between them may be nearer to the wrong one
    "hairpin": evenly([[0.0, 0.0], [0.2, 0.0], [0.2, 0.001], [0.0, 0.001]]),
    "square": evenly([[0.0, 0.0], [0.05, 0.0], [0.05, 0.05], [0.0, 0.05], [0.0, 0.0]]),
    "crossing": evenly([[0.0, 0.0], [0.1, 0.1], [0.1, 0.0], [0.0, 0.1]]),
}
CLOSED = ["square"]


def length(curve: Array) -> float:
    return float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())


def missed(curve: Array, found: NDArray[np.int64], truth: NDArray[np.int64], closed: bool = False) -> float:
    """Largest distance along the path between the places that were found and the true ones, m."""
    apart = np.abs(found - truth)
    apart = np.minimum(apart, POINTS - 1 - apart) if closed else apart
    return float(apart.max()) * length(curve) / (POINTS - 1)


def measured(curve: Array, truth: NDArray[np.int64], noise: float = 2e-5) -> Array:
    return curve[truth] + noise * np.random.default_rng(1).standard_normal((len(truth), 3))


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize(("begin", "end"), [(0.0, 1.0), (0.0, 0.4), (0.6, 1.0), (0.3, 0.65)])
@pytest.mark.parametrize("count", [40, 400, 3000])
def test_places_in_order_are_found_from_any_start(name: str, begin: float, end: float, count: int) -> None:
    curve = CURVES[name]
    truth = (np.linspace(begin, end, count) * (POINTS - 1)).astype(int)
    # five standard deviations, at a corner times the root of two
    assert missed(curve, nearest_on_path(curve, measured(curve, truth)), truth, name in CLOSED) < 2e-4


@pytest.mark.parametrize("name", ["corner", "square", "crossing"])
def test_places_against_the_path_are_found(name: str) -> None:
    curve = CURVES[name]
    truth = np.linspace(POINTS - 1, 0.2 * POINTS, 300).astype(int)
    assert missed(curve, nearest_on_path(curve, measured(curve, truth)), truth) < 2e-4


@pytest.mark.parametrize("way", [1, -1])
def test_a_closed_path_may_be_measured_past_its_beginning(way: int) -> None:
    curve = CURVES["square"]
    truth = (np.linspace(0.4, 1.3, 500)[::way] * (POINTS - 1)).astype(int) % (POINTS - 1)
    assert missed(curve, nearest_on_path(curve, measured(curve, truth)), truth, closed=True) < 2e-4


@pytest.mark.parametrize("name", ["corner", "square"])
@pytest.mark.parametrize("count", [30, 1500])
def test_places_in_no_order_get_the_nearest(name: str, count: int) -> None:
    curve, rng = CURVES[name], np.random.default_rng(3)
    truth = rng.integers(0, POINTS, count)
    assert missed(curve, nearest_on_path(curve, measured(curve, truth)), truth, name in CLOSED) < 2e-4


def test_two_parts_in_the_wrong_order_get_the_nearest() -> None:
    curve = CURVES["corner"]
    truth = np.r_[np.linspace(0.6, 1.0, 150), np.linspace(0.0, 0.6, 200)] * (POINTS - 1)
    found = nearest_on_path(curve, measured(curve, truth.astype(int)))
    assert missed(curve, found, truth.astype(int)) < 2e-4


def test_a_place_nearer_to_another_strand_stays_on_its_own() -> None:
    curve = CURVES["hairpin"]
    truth = np.linspace(0.0, POINTS - 1, 800).astype(int)
    off = np.where(truth < POINTS / 2, 7e-4, 0.0)[:, None] * [0.0, 1.0, 0.0]  # the first strand's, towards the second
    along = np.abs(curve[nearest_on_path(curve, measured(curve, truth) + off)] - curve[truth])
    away = np.abs(curve[truth, 0] - 0.2) > 0.003  # at the turn both are one
    assert along[away].max() < 2e-4


@pytest.mark.parametrize("part", [slice(0.7, 1.0), slice(0.3, 0.8)])
@pytest.mark.parametrize("order", ["along", "against", "none"])
def test_a_part_of_a_run_without_times_agrees_with_its_prediction(part: slice, order: str, tmp_path: Path) -> None:
    time, place = tracker(checked())
    on = (time - HOLD_S) / LINE.duration_s
    place = place[(on > part.start) & (on < part.stop)]
    rows = {
        "along": np.arange(len(place)), "against": np.arange(len(place))[::-1],
        "none": np.random.default_rng(0).permutation(len(place)),
    }[order]  # fmt: skip
    found = compare_measured(checked(), write(tmp_path / "tip.csv", place[rows]))
    assert found.difference.rms_across < 0.01 and found.agrees
    reached = LINE.motion(LINE.duration_s * np.array([part.start, part.stop])) / 0.08
    assert found.seen == pytest.approx(np.diff(reached)[0], abs=0.05)  # the tip lags


@pytest.mark.parametrize("timed", [True, False])
def test_a_hole_of_the_measurement_is_said(timed: bool, tmp_path: Path) -> None:
    time, place = tracker(checked())
    kept = np.abs((time - HOLD_S) / LINE.duration_s - 0.5) > 0.15
    found = compare_measured(checked(), write(tmp_path / "tip.csv", place[kept], time[kept] if timed else None))
    hole = LINE.motion(LINE.duration_s * np.array([0.35, 0.65])) * 1e3
    assert len(found.unmeasured_mm) == 1
    # a sample either side, and without times the tip's lag
    np.testing.assert_allclose(found.unmeasured_mm[0], hole, atol=2.0 * 100 / 130 if timed else 4.0)
    assert found.seen == pytest.approx(1.0 - np.diff(hole)[0] / 80.0, abs=0.03)
    assert "% of the path that were measured (not on" in found.sentence
    assert found.difference.max_across < 5e-3
    # the figure's lines run along the path and leave the hole out
    for ax in measured_along_path(found).axes:
        x, y = np.array(ax.lines[-1].get_data())
        assert (np.diff(x) >= 0.0).all() and np.isnan(y[(x > hole[0] + 5.0) & (x < hole[1] - 5.0)]).tolist() == [True]


def test_sparse_places_are_no_holes() -> None:
    rng = np.random.default_rng(5)
    assert unmeasured(np.linspace(20.0, 380.0, 16) + rng.uniform(-3, 3, 16), 400.0) == []
    assert unmeasured(np.r_[np.linspace(0.0, 100.0, 50), np.linspace(150.0, 385.0, 70)], 400.0) == [
        (100.0, 150.0), (385.0, 400.0)
    ]  # fmt: skip


def test_times_in_milliseconds_are_guessed(tmp_path: Path) -> None:
    time, place = tracker(checked())
    file = write(tmp_path / "tip.csv", place, 1e3 * time)
    with pytest.raises(ValueError, match=r"(1 place|\d\d? places) while .*look whether it is in ms$"):
        compare_measured(checked(), file)


def test_a_table_without_any_place_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "tip.csv").write_text("a,b\n1,2\n3,4\n")
    with pytest.raises(ValueError, match=r"tip.csv: has none of the columns time, x, y, z, x_mm"):
        compare_measured(checked(), tmp_path / "tip.csv")
