"""The report of a closed loop: what it says, and that it needs nothing but itself."""

from __future__ import annotations

import base64
import dataclasses
import re
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

from rx90b_flex.diagnose.close import ClosedLoop, LastRound, Unexplained, close_loop
from rx90b_flex.diagnose.evidence import STANDSTILL, Band, Dependence, signals
from rx90b_flex.diagnose.output import closed_loop_json
from rx90b_flex.diagnose.yardstick import Explainable
from rx90b_flex.effects import Effect
from rx90b_flex.effects.friction import CoulombFriction
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import Recording, write_campaign
from rx90b_flex.view import plots, report_html, write_report
from rx90b_flex.view.advice import next_measurements, standstill
from rx90b_flex.view.estimates import measured, number, values
from rx90b_flex.view.report import headline, p_value, percent
from rx90b_flex.view.zoom import envelope, script, script_hash

JOINTS = ("shoulder", 'elbow <b>"1" & $x_1$</b>')  # names that break HTML or mathematics if they are not escaped
RATE_HZ, DURATION_S, NOISE = 100.0, 6.0, 0.02
HIDDEN = CoulombFriction(joint=JOINTS[1], torque=1.5)
SECTIONS = ("found", "data", "errors", "alternatives", "residuals", "tried", "remains", "next", "parameters", "how")


def arm_urdf() -> str:
    """Two links that swing in a vertical plane."""
    links = ['<link name="base"/>']
    for i, (joint, parent) in enumerate(zip(JOINTS, ("base", "link_1"), strict=True), start=1):
        links.append(
            f'<link name="link_{i}"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>'
            '<inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name={quoteattr(joint)} type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
            f'<origin xyz="{0.4 * (i - 1)} 0 0"/><axis xyz="0 1 0"/>'
            '<limit lower="-3" upper="3" velocity="10" effort="100"/></joint>'
        )
    return f'<robot name="arm">{"".join(links)}</robot>'


def closed_loop(folder: Path, hidden: Sequence[Effect], noise: Sequence[float] | None) -> ClosedLoop:
    """The result for recordings of the arm with effects that its file does not declare."""
    folder.mkdir()
    (folder / "arm.urdf").write_text(arm_urdf(), encoding="utf-8")
    robot = load_robot(folder / "arm.urdf").with_effects(hidden)
    rng = np.random.default_rng(1)
    time = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    recordings = []
    for name, role in (("run_1", "identification"), ("run_2", "validation")):
        w = 2 * np.pi * np.arange(1, 6) / DURATION_S * np.array([[1.0], [1.3]])
        size, phase = rng.uniform(0.1, 0.3, (2, 5)), rng.uniform(0, 2 * np.pi, (2, 5))
        angle = w[..., None] * time + phase[..., None]
        q = np.einsum("jk,jkt->tj", size, np.sin(angle))
        v = np.einsum("jk,jkt->tj", size * w, np.cos(angle))
        a = np.einsum("jk,jkt->tj", -size * w**2, np.sin(angle))
        tau = robot.inverse_dynamics(q, v, a) + NOISE * rng.standard_normal(q.shape)
        recordings.append(Recording(name, role, time, RATE_HZ, JOINTS, q, tau))
    return close_loop(write_campaign(folder, folder / "arm.urdf", recordings, noise_torque=noise))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> ClosedLoop:
    """Dry friction hidden, noise stated."""
    return closed_loop(tmp_path_factory.mktemp("found") / "data", [HIDDEN], [NOISE, NOISE])


@pytest.fixture(scope="module")
def nothing(tmp_path_factory: pytest.TempPathFactory) -> ClosedLoop:
    """Nothing hidden, noise not known."""
    return closed_loop(tmp_path_factory.mktemp("nothing") / "data", [], None)


def remaining(result: ClosedLoop, relative_error: float, *where: Dependence) -> Unexplained:
    """Something left over in a result."""
    return Unexplained(relative_error, where, result.unexplained.data)


class Page(HTMLParser):
    """Tags and visible text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.parts: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1][0] not in ("style", "script"):
            self.parts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.parts).split())

    def pictures(self) -> list[str]:
        """The SVG of every image."""
        prefix = "data:image/svg+xml;base64,"
        sources = [str(a["src"]) for tag, a in self.tags if tag == "img"]
        assert all(s.startswith(prefix) for s in sources)
        return [base64.b64decode(s[len(prefix) :]).decode("utf-8") for s in sources]


@pytest.fixture(scope="module")
def html(found: ClosedLoop) -> str:
    return report_html(found)


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


@pytest.fixture(scope="module")
def empty_page(nothing: ClosedLoop) -> Page:
    """The report where nothing is missing."""
    return Page(report_html(nothing))


@pytest.fixture(scope="module")
def unsure(nothing: ClosedLoop) -> ClosedLoop:
    """A dependence on a signal that is not there, no measure, and a caution."""
    dependence = Dependence(JOINTS[0], "ambient temperature", 0.2, 1e-4)
    return dataclasses.replace(
        nothing,
        verdict="unexplained",
        unexplained=remaining(nothing, 0.1, dependence),
        explainable=None,
        not_explainable="Too little data.",
        cautions=("The hinges are left out.",),
    )


@pytest.fixture(scope="module")
def unsure_page(unsure: ClosedLoop) -> Page:
    return Page(report_html(unsure))


def test_the_page_asks_nobody_for_anything(html: str, page: Page) -> None:
    assert "default-src 'none'" in html  # a browser refuses what the checks below might miss
    assert (
        f"script-src {script_hash()}" in html and html.count("<script>") == 1
    )  # it runs the package's own script alone
    html = html.replace(script(), "")
    for _, attributes in page.tags:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            assert (attributes.get(name) or "#").startswith(("data:", "#"))
    for text in (html, *page.pictures()):
        assert not re.search(r"@import|url\((?!\s*[\"']?(#|data:))", text)
        assert not re.search(r"(?:href|src)\s*=\s*[\"'](?:https?:)?//", text)


def test_every_figure_is_well_formed_and_says_what_it_shows(page: Page) -> None:
    pictures = page.pictures()
    for picture in pictures:
        assert ElementTree.fromstring(picture).tag.endswith("svg")
    assert len(pictures) >= 2 + 4 * len(JOINTS)
    assert all(attributes.get("alt") for tag, attributes in page.tags if tag == "img")


def test_the_report_of_a_small_campaign_is_small(html: str) -> None:
    assert len(html) < 2e6


def test_all_sections_stand_in_the_order_of_the_questions(page: Page) -> None:
    assert tuple(a["id"] for tag, a in page.tags if tag == "section") == SECTIONS
    links = {a["href"] for tag, a in page.tags if tag == "a"}
    assert links == {f"#{name}" for name in SECTIONS}


def test_the_report_leads_with_the_finding_and_its_joint_before_and_after(html: str) -> None:
    (finding,) = re.findall(r'<article class="finding">.*?</article>', html, re.DOTALL)
    assert "coulomb friction on" in finding and "<figure" in finding
    # dry friction is a curve over velocity
    assert "before and after, over its velocity" in finding
    assert html.index(finding) < html.index("The data, looked at first")


def test_the_look_at_the_data_stands_in_the_report(found: ClosedLoop, page: Page) -> None:
    assert found.checked is not None
    assert found.checked.verdict in page.text
    assert all(r.file in page.text for r in found.checked.recordings)


def test_what_was_found_appears_with_its_numbers(found: ClosedLoop, page: Page) -> None:
    effect = found.effects[0]
    assert effect.effect.type_name() == "coulomb_friction"
    assert effect.effect.joints == HIDDEN.joints
    assert "coulomb friction" in page.text
    for p in effect.parameters:
        assert f"{p.name} = {measured(p)} {p.unit}" in page.text
    assert p_value(effect.p_value) in page.text
    assert f"{percent(effect.before.relative_error, 2)} → {percent(effect.after.relative_error, 2)}" in page.text
    for errors in (found.before, found.after):
        for role in (errors.validation, errors.identification):
            assert percent(role.relative_error) in page.text
            assert all(number(x) in page.text for x in role.torque_rms)


def test_what_can_be_explained_appears_beside_what_was(found: ClosedLoop, page: Page) -> None:
    assert found.explainable is not None
    assert percent(found.explainable.validation.relative_error) in page.text
    assert f"reach {100 * found.explainable.share:.0f} % of that drop" in page.text
    (bars,) = plots.explainable_by_joint(found).axes
    assert next(text.get_text() for text in bars.get_yticklabels()) == "all"
    heights = [[bar.get_width() for bar in group] for group in bars.containers]
    errors = (found.before.validation, found.after.validation, found.explainable.validation)
    assert [h[0] for h in heights] == pytest.approx([100 * e.relative_error for e in errors])


def test_where_nothing_can_be_explained_the_report_says_so(nothing: ClosedLoop, empty_page: Page) -> None:
    assert nothing.explainable is not None and set(nothing.explainable.forms) == {"none"}
    assert "no better than the declared model" in empty_page.text


def test_where_more_can_be_explained_the_headline_says_so(nothing: ClosedLoop) -> None:
    errors = dataclasses.replace(nothing.before.validation, relative_error=0.0123)
    more = Explainable(errors, 0.4, ("smooth curves", "none"))
    result = dataclasses.replace(nothing, explainable=more, verdict="unexplained")
    assert "reaches 1.2 %, so more can be explained" in headline(result)


def test_where_no_measure_is_known_the_reason_stands_in_the_report(unsure_page: Page) -> None:
    assert "Too little data." in unsure_page.text
    assert "nobody can say that nothing is left" in unsure_page.text


def test_errors_in_motion_appear(found: ClosedLoop, page: Page) -> None:
    assert f"{percent(found.moving.before)} before, {percent(found.moving.after)} after" in page.text


def test_the_headline_is_one_sentence_with_the_finding_and_both_errors(found: ClosedLoop, page: Page) -> None:
    sentence = headline(found)
    assert sentence in page.text
    assert sentence.endswith(".") and ". " not in sentence
    assert "coulomb friction on" in sentence
    assert percent(found.before.validation.relative_error) in sentence
    assert percent(found.after.validation.relative_error) in sentence


def test_the_rivals_of_a_round_appear(found: ClosedLoop, page: Page) -> None:
    assert found.effects[0].rivals
    for rival in found.effects[0].rivals:
        assert rival.effect.type_name().replace("_", " ") in page.text


def test_names_are_escaped_and_read_as_they_are(html: str, page: Page) -> None:
    assert '<b>"1' not in html
    assert JOINTS[1] in page.text


def test_a_known_noise_floor_appears_and_asks_for_no_repeats(found: ClosedLoop, page: Page) -> None:
    assert found.noise_floor is not None
    assert number(found.noise_floor[0]) in page.text
    assert "not known" not in page.text
    assert not any("period_s" in a.what for a in next_measurements(found))


def test_an_unknown_noise_floor_is_called_so_and_asks_for_repeats(nothing: ClosedLoop, empty_page: Page) -> None:
    assert nothing.noise_floor is None
    assert "not known" in empty_page.text
    assert any("period_s" in a.what for a in next_measurements(nothing))


def test_motions_that_repeat_without_a_stated_period_are_told(nothing: ClosedLoop) -> None:
    facts = [dataclasses.replace(r, period_s=2.5) for r in nothing.checked.recordings]
    repeating = dataclasses.replace(nothing, checked=dataclasses.replace(nothing.checked, recordings=tuple(facts)))
    text = Page(report_html(repeating)).text
    assert "the campaign states neither noise nor a period, though motions repeat after 2.5 s" in text
    assert "no recording repeats" not in text and "Give period_s in the campaign file" in text


def test_nothing_missing_is_said_without_a_table_of_effects(nothing: ClosedLoop, empty_page: Page) -> None:
    assert (nothing.verdict, nothing.effects) == ("nothing_missing", ())
    assert tuple(a["id"] for tag, a in empty_page.tags if tag == "section") == SECTIONS
    assert "No effect is missing from the model" in empty_page.text
    assert "No effect was added." in empty_page.text
    assert "The final model has no effects beyond the rigid tree." in empty_page.text


def test_what_remains_is_shown_and_tells_what_to_do(nothing: ClosedLoop, empty_page: Page) -> None:
    dependence = Dependence(JOINTS[0], f"{JOINTS[1]} velocity", 0.4321, 1e-9)
    left = dataclasses.replace(
        nothing,
        verdict="unexplained",
        unexplained=remaining(nothing, 0.0377, dependence),
        last_round=LastRound((), 10, 20),
    )
    page = Page(report_html(left))
    assert "no effect in the catalogue explains it" in page.text
    assert "3.8 %" in page.text and "0.432" in page.text
    assert any(JOINTS[1] in a.what for a in next_measurements(left))
    assert len(page.pictures()) == len(empty_page.pictures()) + 1


def test_a_dependence_on_a_signal_that_is_not_there_is_listed_without_a_figure(
    unsure: ClosedLoop, unsure_page: Page
) -> None:
    assert plots.remaining_dependence(unsure, unsure.unexplained.where[0]) is None
    assert "ambient temperature" in unsure_page.text


def test_a_residual_at_standstill_is_shown_over_time_with_the_rests(nothing: ClosedLoop) -> None:
    dependence = Dependence(JOINTS[0], STANDSTILL, 0.6, 1e-6)
    left = dataclasses.replace(nothing, verdict="unexplained", unexplained=remaining(nothing, 0.1, dependence))
    assert "larger while the robot stands still" in headline(left)
    assert any("start_s" in a.what for a in next_measurements(left))
    figure = plots.remaining_dependence(left, dependence)
    assert figure is not None
    assert "at rest" in figure.axes[0].get_xlabel()


def test_a_residual_that_repeats_with_an_angle_is_shown_over_one_cycle(nothing: ClosedLoop) -> None:
    order = 7.0
    data = []
    for regression, left in nothing.unexplained.data:
        angle = dict(signals(regression))[f"{JOINTS[0]} position"]
        data.append((regression, np.stack([np.sin(order * angle), 0 * angle], axis=1) + 0 * left))
    dependence = Dependence(JOINTS[0], f"{JOINTS[0]} order {order}", 0.9, 1e-9)
    result = dataclasses.replace(nothing, unexplained=Unexplained(0.1, (dependence,), tuple(data)))
    figure = plots.remaining_dependence(result, dependence)
    assert figure is not None
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "mean"]
    part, mean = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    # a mean over one of 32 parts of a cycle lies within its width of the sine at its middle
    assert np.abs(mean - np.sin(2 * np.pi * part)).max() < 2 * np.pi / 32
    assert "part of a cycle" in figure.axes[0].get_xlabel()


def test_bands_in_which_the_error_repeats_are_shaded_in_its_spectrum(nothing: ClosedLoop, empty_page: Page) -> None:
    band = Band(JOINTS[1], 3.0, 6.0, 0.4, 1e-6)
    left = dataclasses.replace(
        nothing, verdict="unexplained", unexplained=Unexplained(0.1, (), nothing.unexplained.data, (band,))
    )
    figure = plots.remaining_bands(left, JOINTS[1])
    (shade,) = figure.axes[0].patches
    assert (shade.get_x(), shade.get_x() + shade.get_width()) == (3.0, 6.0)  # type: ignore[attr-defined]
    page = Page(report_html(left))
    assert len(page.pictures()) == len(empty_page.pictures()) + 1
    assert "3.00 6.00 40.0 %" in page.text


def test_cautions_stand_at_the_head_and_in_the_file(unsure: ClosedLoop, unsure_page: Page) -> None:
    text = unsure_page.text
    assert text.index("Beware. The hinges are left out.") < text.index("What was found, and how sure it is")
    assert closed_loop_json(unsure)["unexplained"]["cautions"] == ["The hinges are left out."]


def test_undetermined_parameters_are_named_and_get_no_value(nothing: ClosedLoop, empty_page: Page) -> None:
    undetermined = [e for e in nothing.model.link_estimates() if e.value is None]
    assert undetermined
    assert measured(undetermined[0]) == "not determined by this data"
    assert empty_page.text.count("–") >= len(undetermined)
    several = [dataclasses.replace(undetermined[0], name=f"torques_{i}") for i in range(1, 10)]
    assert values(several) == ["torques_1 to torques_9: not determined by this data"]


def test_a_joint_that_stands_still_holds_its_share_of_the_error(nothing: ClosedLoop) -> None:
    p = nothing.predictions[0]
    half = np.arange(len(p.torque)) < len(p.torque) // 2
    velocity = np.where(half[:, None], 1.0, 0.0) * np.ones(2)
    after = p.torque - np.where(half[:, None], 1.0, 3.0) * np.ones(2)  # an error of 1 N m moving, 3 N m at rest
    rest = standstill(
        dataclasses.replace(nothing, predictions=(dataclasses.replace(p, velocity=velocity, after=after),))
    )
    assert rest.time_share == pytest.approx((0.5, 0.5))
    assert rest.moving_rms == pytest.approx((1.0, 1.0))
    assert rest.total_share == pytest.approx(0.9)


def test_the_file_appears_whole_or_not_at_all_and_is_the_same_for_the_same_result(
    found: ClosedLoop, html: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.html"
    write_report(found, path)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    whole = path.read_bytes()
    assert whole.startswith(b"<!DOCTYPE html>") and whole.endswith(b"</html>\n")
    assert whole == html.encode()

    def half(self: Path, text: str, **_: object) -> int:
        self.write_bytes(text[:1000].encode())
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_text", half)
    monkeypatch.setattr("rx90b_flex.view.report.report_html", lambda *_: html)
    with pytest.raises(OSError, match="disk full"):
        write_report(found, path)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert path.read_bytes() == whole


def test_a_thinned_line_keeps_its_peaks() -> None:
    time = np.arange(100_000.0)
    y = np.sin(time / 5000)
    y[[123, 45_678]] = 50.0, -40.0
    x, thinned = envelope(time, y, columns=600)
    assert len(x) <= 1202
    assert (thinned.max(), thinned.min()) == (50.0, -40.0)
    assert (np.diff(x) >= 0).all()
    assert (x[0], x[-1]) == (time[0], time[-1])


def test_bins_give_mean_spread_and_range_and_do_not_pile_up_at_rest() -> None:
    rng = np.random.default_rng(0)
    x = np.concatenate([np.zeros(9000), rng.uniform(-1, 1, 3000)])
    binned = plots.Binned(x, 2 * x + 1)
    assert binned.mean == pytest.approx(2 * binned.centre + 1)
    assert (np.diff(binned.centre) > 0).all()
    assert (binned.low <= binned.mean).all() and (binned.mean <= binned.high).all()
    assert (np.abs(binned.centre) < 1e-3).sum() <= 1
    one = plots.Binned(np.zeros(10), np.arange(10.0))
    assert (one.mean, one.std) == (pytest.approx([4.5]), pytest.approx([np.arange(10).std()]))


def test_spectra_show_a_sine_at_its_frequency_with_its_amplitude(nothing: ClosedLoop) -> None:
    p = nothing.predictions[0]
    sine = 0.7 * np.sin(2 * np.pi * 12.0 * p.recording.time)[:, None] * np.ones(2)
    shown = dataclasses.replace(nothing, predictions=(dataclasses.replace(p, after=p.torque - sine),))
    (ax,) = plots.residual_in_frequency(shown, JOINTS[0]).axes
    line = next(item for item in ax.lines if item.get_label() == "error after")
    hz, amplitude = (np.asarray(d, dtype=float) for d in line.get_data())
    assert hz[amplitude.argmax()] == pytest.approx(12.0)
    assert amplitude.max() == pytest.approx(0.7, rel=1e-3)


def test_before_and_after_share_one_scale(found: ClosedLoop) -> None:
    _, before, after = plots.residual_in_time(found, JOINTS[1]).axes
    assert before.get_ylim() == after.get_ylim()
    position, velocity = (
        draw(found, JOINTS[1]).axes[0] for draw in (plots.residual_against_position, plots.residual_against_velocity)
    )
    assert position.get_ylim() == velocity.get_ylim()


def test_every_axis_says_what_it_is_and_in_which_unit(found: ClosedLoop) -> None:
    dependence = Dependence(JOINTS[0], f"{JOINTS[0]} acceleration", 0.3, 1e-5)
    remaining = plots.remaining_dependence(found, dependence)
    assert remaining is not None
    figures = [
        plots.errors_by_joint(found),
        plots.error_by_step(found),
        remaining,
        *(
            draw(found, JOINTS[1])
            for draw in (
                plots.residual_in_time,
                plots.residual_in_frequency,
                plots.residual_against_position,
                plots.residual_against_velocity,
            )
        ),
    ]
    units = re.compile(r"N m|rad|, s\b|Hz|%|effects added")
    for figure in figures:
        assert units.search(figure.axes[-1].get_xlabel())
        for ax in figure.axes:
            assert units.search(ax.get_ylabel()) or ax.get_yticklabels()[0].get_text() == JOINTS[0]
