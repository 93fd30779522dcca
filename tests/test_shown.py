"""Claims about results in Python and in notebooks: their tables hold their numbers, their figures are there, cells are safe HTML."""

from __future__ import annotations

import base64
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_cli import write_campaign
from test_measured_stiffness import write_test

import rx90b_flex as rf
from rx90b_flex.identify.static_command import fit_tests, read_static_tests
from rx90b_flex.path import compare_measured
from rx90b_flex.showing import Showing


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Showing]:
    folder = tmp_path_factory.mktemp("shown")
    campaign = write_campaign(folder / "data")
    swapped = write_campaign(folder / "swapped")
    text = swapped.read_text()
    assert '["moment_0", "moment_1"]' in text
    swapped.write_text(text.replace('["moment_0", "moment_1"]', '["moment_1", "moment_0"]'))
    path = rf.check_path("square", robot="rx90b_3dof", speed_mm_s=250, correct=False, contributions=False)
    run = path.runs[0]
    tip = pd.DataFrame({"time": run.time} | {axis: run.tip[:, i, 3] for i, axis in enumerate("xyz")})
    tip.to_csv(folder / "tip.csv", index=False)
    return {
        "check": rf.check(campaign),
        "identify": rf.identify(campaign),
        "close_loop": rf.close_loop(campaign),
        "refused": rf.close_loop(swapped),
        "check_path": path,
        "measured": compare_measured(path, folder / "tip.csv"),
        "simulate": run,
        "modes": modes_of("rx90b_3dof"),
        "static": static_result(folder),
    }


def modes_of(name: str) -> Showing:
    robot = rf.load_robot(name)
    return robot.linearize(robot.input_matrix @ np.array([0.0, 0.5, 0.3])).modes()


def static_result(folder: Path) -> Showing:
    table = write_test(folder, "joint_2", 2.0e5, 1.0, np.random.default_rng(0))
    file = folder / "tests.toml"
    file.write_text(f'[[test]]\ncoordinate = "joint_2"\nfile = "{table}"\nlever_arm_m = 1.0\n')
    return fit_tests(read_static_tests(file))


NAMES = ("check", "identify", "close_loop", "refused", "check_path", "measured", "simulate", "modes", "static")


class Tags(HTMLParser):
    """What a cell is made of; fails where tags do not close."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.image = b""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            source = dict(attrs)["src"] or ""
            self.image = base64.b64decode(source.split("base64,")[1])
        else:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize("name", NAMES)
def test_a_cell_shows_words_and_the_figure_and_is_whole(name: str, results: dict[str, Showing]) -> None:
    tags = Tags()
    html = results[name]._repr_html_()
    tags.feed(html)
    assert not tags.open
    assert tags.image.startswith(b"<?xml") and b"<svg" in tags.image
    assert len(html) < 2_000_000


@pytest.mark.parametrize("name", NAMES)
def test_a_result_is_one_line_where_it_is_printed(name: str, results: dict[str, Showing]) -> None:
    line = repr(results[name])
    assert line.startswith(f"<{type(results[name]).__name__}: ") and "\n" not in line and len(line) < 300


@pytest.mark.parametrize("name", ("identify", "check_path", "measured", "simulate"))
def test_a_cell_s_lines_zoom_and_keep_their_picture_for_paper(name: str, results: dict[str, Showing]) -> None:
    html = results[name]._repr_html_()
    assert html.count("<script>") == 1 and html.count('<script type="application/json">') == 1 and "<img" in html


@pytest.mark.parametrize("name", NAMES)
def test_plot_returns_axes_with_labels_and_opens_no_window(
    name: str, results: dict[str, Showing], tmp_path: Path
) -> None:
    axes = results[name].plot()
    assert any(a.get_xlabel() for a in axes.figure.axes)
    axes.figure.savefig(tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 1000


def test_the_table_of_a_closed_loop_is_its_effects(results: dict[str, Showing]) -> None:
    loop = results["close_loop"]
    table = loop.to_pandas()
    assert list(table["effect"]) == ["torque_offset"] and list(table["joint"]) == ["elbow"]
    (found,) = loop.effects  # type: ignore[attr-defined]
    assert table["value"][0] == found.parameters[0].value and table["error_after"][0] == found.after.relative_error


@pytest.mark.parametrize("over", ["velocity", "position", "time", "frequency"])
def test_a_joint_s_residual_is_drawn_over_what_is_asked_for(over: str, results: dict[str, Showing]) -> None:
    axes = results["close_loop"].plot_residual("elbow", over)  # type: ignore[attr-defined]
    drawn = axes.figure.axes
    assert any(a.get_xlabel() for a in drawn) and any(a.get_ylabel() for a in drawn)
    assert sum(len(a.lines) for a in drawn) >= 2


def test_a_residual_of_what_is_not_there_is_refused(results: dict[str, Showing]) -> None:
    for arguments, words in ((("elbo",), "'elbow'"), (("elbow", "speed"), "over is 'speed'")):
        with pytest.raises(ValueError, match=words):
            results["close_loop"].plot_residual(*arguments)  # type: ignore[attr-defined]


def test_the_table_of_an_identification_is_its_parameters(results: dict[str, Showing]) -> None:
    table = results["identify"].to_pandas()
    estimates = results["identify"].parameters  # type: ignore[attr-defined]
    assert list(table["parameter"]) == [e.name for e in estimates]
    # a parameter that only combinations determine has no value, and no zero
    np.testing.assert_array_equal(table["value"].isna(), [e.value is None for e in estimates])
    assert table.set_index("parameter").loc["elbow.viscous_friction.coefficient", "value"] == pytest.approx(
        1.5, rel=0.3
    )


def test_the_table_of_a_check_is_its_faults(results: dict[str, Showing]) -> None:
    assert len(results["check"].to_pandas()) == 0
    refused = results["refused"].to_pandas()
    assert "swapped_columns" in set(refused["kind"])


def test_the_tables_over_a_path_are_its_samples(results: dict[str, Showing]) -> None:
    table = results["measured"].to_pandas()
    np.testing.assert_allclose(
        table["up_measured_mm"] - table["up_predicted_mm"], table["up_difference_mm"], atol=1e-12
    )
    run = results["simulate"].to_pandas()
    assert {"time", "joint_1:drive", "joint_1:torsion", "tip_x"} <= set(run.columns)
    path = results["check_path"].to_pandas()
    np.testing.assert_allclose(np.hypot(path["left_mm"], path["up_mm"]), path["across_mm"], atol=1e-12)


def test_names_of_joints_are_no_html(results: dict[str, Showing]) -> None:
    import dataclasses

    checked = dataclasses.replace(results["check"], robot="<script>alert(1)</script>")  # type: ignore[type-var]
    assert "<script" not in checked._repr_html_()


@pytest.mark.slow
def test_motor_signals_show_their_parameters_and_the_response(tmp_path: Path) -> None:
    rf.excite("rx90b_3dof", tmp_path / "runs", realisations=2, periods=3, simulate=True)
    found = rf.frf(tmp_path / "runs" / "campaign.toml", replay=False)
    table = found.to_pandas()
    assert found.grey is not None
    assert list(table["parameter"]) == [e.name for e in found.grey.estimates]
    assert ((table["low"] < table["value"]) & (table["value"] < table["high"]))[table["determined"]].all()
    assert len(found.plot().figure.axes) == 9  # every entry of three joints
    tags = Tags()
    tags.feed(found._repr_html_())
    assert not tags.open and b"<svg" in tags.image
