"""Pages in a real browser: Chromium without a window, driven by Playwright.

They skip where either is missing, unless CI=true or RX90B_FLEX_BROWSER=required. RX90B_FLEX_SCREENSHOTS names a folder for the
pictures; otherwise they lie in pytest's temporary folder.
"""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from test_report import HIDDEN, NOISE, closed_loop

from rx90b_flex.path import PathOptions, Seam, check_path
from rx90b_flex.robot import load_robot
from rx90b_flex.simulate import Simulation, load_cs8, simulate, straight_line
from rx90b_flex.view import compare, show, show_modes, write_report
from rx90b_flex.view.check_report import write_check_page
from rx90b_flex.view.path_report import write_path_report

SIZE = {"width": 1000, "height": 640}
TELEPHONE = 390  # px wide
ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
NOTEBOOKS = Path(__file__).resolve().parent.parent / "notebooks"
REQUIRED = os.environ.get("CI") == "true" or os.environ.get("RX90B_FLEX_BROWSER") == "required"


def missing(what: str) -> None:
    """Skip, or fail where the browser's tests are asked for."""
    if REQUIRED:
        pytest.fail(f"{what} is missing, and the tests in a browser must run here")
    pytest.skip(f"{what} is missing")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        missing("the Python package playwright")
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        missing("the browser chromium")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, headless=True, args=ARGUMENTS)
        yield started
        started.close()


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    named = os.environ.get("RX90B_FLEX_SCREENSHOTS")
    folder = Path(named) if named else tmp_path_factory.mktemp("screenshots")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture(scope="module")
def run() -> Simulation:
    """The line of section 4.2.2."""
    robot = load_robot("rx90b_3dof")
    return simulate(robot, load_cs8().for_joints(robot.joints), straight_line(robot))


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the report on a loop that was closed, and of the page of its look at the data."""
    folder = tmp_path_factory.mktemp("reports")
    result = closed_loop(folder / "data", [HIDDEN], [NOISE, NOISE])
    write_report(result, folder / "report.html")
    assert result.checked is not None
    write_check_page(result.checked, folder / "check.html")
    return folder


@dataclass
class Opened:
    """A page, and what it asked for and complained of."""

    page: Any
    pictures: Path
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def picture(self, name: str) -> np.ndarray:
        """What it shows, (height, width, 3), also kept as a file."""
        png = self.page.screenshot(path=self.pictures / f"{name}.png")
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)

    def at(self, time: float) -> None:
        """Stop the animation at a time and have it drawn."""
        self.page.evaluate(
            """t => new Promise(done => { viewer.animator.pause(); viewer.animator.seek(t); viewer.animator.display_progress(t);
               requestAnimationFrame(() => requestAnimationFrame(done)); })""",
            time,
        )

    def place(self, *path: str) -> np.ndarray:
        """Where a node of the scene is, m."""
        return np.array(self.page.evaluate("p => viewer.scene_tree.find(p).object.position.toArray()", list(path)))


def harmless(message: Any) -> bool:
    """The software renderer reads pixels back slowly, for the screenshot; meshcat's server has no icon."""
    return "GPU stall" in message.text or message.location.get("url", "").endswith("/favicon.ico")


def opened(browser: Any, url: str, pictures: Path) -> Opened:
    new = Opened(browser.new_page(viewport=SIZE), pictures)
    new.page.set_default_timeout(300_000)  # ms; only a guard: a crowded machine draws slowly
    new.page.on("request", lambda request: new.requests.append(request.url))
    new.page.on("console", lambda m: None if harmless(m) else new.complaints.append(f"{m.type}: {m.text}"))
    new.page.on("pageerror", lambda error: new.complaints.append(str(error)))
    new.page.goto(url)
    return new


# Pairs of texts that lie on each other, as strings, by more than a quarter of their height; but for meshcat's own folded controls.
OVERLAPS = """() => {
  const boxes = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), range = document.createRange();
  while (walker.nextNode()) {
    const node = walker.currentNode, parent = node.parentElement;
    const shown = parent.checkVisibility({visibilityProperty: true}) && !parent.closest("script, style, option, .dg");
    if (!shown || !node.data.trim()) continue;
    range.selectNodeContents(node);
    for (const r of range.getClientRects()) if (r.width > 3 && r.height > 3) boxes.push({node, r});
  }
  boxes.sort((a, b) => a.r.top - b.r.top);
  const found = new Set();
  boxes.forEach((a, i) => {
    for (let k = i + 1; k < boxes.length && boxes[k].r.top < a.r.bottom; k++) {
      const b = boxes[k], wide = Math.min(a.r.right, b.r.right) - Math.max(a.r.left, b.r.left);
      const high = Math.min(a.r.bottom, b.r.bottom) - b.r.top;
      if (a.node !== b.node && wide > 3 && high > 0.25 * Math.min(a.r.height, b.r.height))
        found.add(a.node.data.trim().slice(0, 40) + " | " + b.node.data.trim().slice(0, 40));
    }
  });
  return [...found];
}"""


def check_reads_well(page: Opened) -> None:
    """No text lies on another, no page is wider than the window, none complains; on a screen and on a telephone."""
    for width in (SIZE["width"], TELEPHONE):
        page.page.set_viewport_size({"width": width, "height": SIZE["height"]})
        page.page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert page.page.evaluate(OVERLAPS) == [], width
        assert page.page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), width
    page.page.set_viewport_size(SIZE)
    assert page.complaints == []


def asked_outside(page: Opened, url: str) -> list[str]:
    """Requests but for the page itself and what it carries in itself."""
    return [r for r in page.requests if r != url and not r.startswith(("data:", "blob:"))]


def yellow(picture: np.ndarray) -> int:
    """Pixels of the RX90B's arm."""
    r, g, b = picture[170:-60].transpose(2, 0, 1)  # below the legend
    return int(np.count_nonzero((r > 150) & (g > 0.6 * r) & (b < 0.62 * g)))


def purple(picture: np.ndarray) -> int:
    """Pixels of the trail's darker half, which nothing else has."""
    r, g, b = picture[170:-60].transpose(2, 0, 1)
    return int(np.count_nonzero((b > 90) & (g < 0.6 * b) & (r > 1.2 * g + 20)))


def check_moving(page: Opened, name: str) -> None:
    """Robot and trail are there, and the robot moves from picture to picture."""
    page.page.wait_for_function("window.MeshCat && viewer.animator.duration > 0")
    page.at(0.0)
    first, place = page.picture(f"{name}_start"), page.place("view", "run", "robot", "link_3")
    page.at(1.0)
    middle, later = page.picture(f"{name}_middle"), page.place("view", "run", "robot", "link_3")
    for picture in (first, middle):
        assert yellow(picture) > 3000 and purple(picture) > 300
    assert np.linalg.norm(later - place) > 0.3  # m: the line is 1.7 m long, its middle is at 1 s
    assert np.count_nonzero(np.abs(first - middle).max(axis=2) > 40) > 5000


@pytest.mark.slow
def test_the_page_of_a_run_shows_robot_and_trail_moves_and_asks_for_nothing(
    browser: Any, run: Simulation, tmp_path: Path, pictures: Path
) -> None:
    url = show(run).save_html(tmp_path / "run.html").as_uri()
    page = opened(browser, url, pictures)
    page.page.wait_for_function("viewer.animator.playing && viewer.animator.time > 0")
    check_moving(page, "run")
    assert asked_outside(page, url) == [] and page.complaints == []
    assert page.page.locator("#legend").bounding_box()["width"] > 100

    # play, pause and speed
    clock = "viewer.animator.time"
    page.page.select_option("#speed", "0.25")
    assert page.page.evaluate("viewer.animator.mixer.timeScale") == 0.25
    before = page.page.evaluate(clock)
    page.page.click("#play")
    page.page.wait_for_function(f"Math.abs({clock} - {before}) > 0.01")
    page.page.click("#play")
    page.page.wait_for_function("!viewer.animator.playing")
    stopped = page.page.evaluate(clock)
    page.page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert page.page.evaluate(clock) == stopped
    page.page.close()


@pytest.mark.slow
def test_the_served_page_shows_the_same(browser: Any, run: Simulation, pictures: Path) -> None:
    visualizer = show(run).serve()
    try:
        page = opened(browser, visualizer.url(), pictures)
        check_moving(page, "served")
        assert all(r.startswith("http://127.0.0.1:") for r in asked_outside(page, visualizer.url()))
        assert page.complaints == []
        page.page.close()
    finally:
        visualizer.window.server_proc.terminate()


@pytest.mark.slow
def test_a_notebook_s_cell_plays_without_a_server(
    browser: Any, run: Simulation, tmp_path: Path, pictures: Path
) -> None:
    page = tmp_path / "cell.html"
    page.write_text(
        f"<!DOCTYPE html><meta charset='utf-8'><title>cell</title>{show(run)._repr_html_()}", encoding="utf-8"
    )
    cell = opened(browser, page.as_uri(), pictures)
    frame = cell.page.frames[1]
    frame.wait_for_function("viewer.animator.playing && viewer.animator.time > 0.02")
    frame.evaluate("viewer.animator.pause()")
    assert yellow(cell.picture("cell")) > 1000
    assert [r for r in asked_outside(cell, page.as_uri()) if r != "about:srcdoc"] == [] and cell.complaints == []
    cell.page.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["modes", "compare"])
def test_pages_of_modes_and_of_before_and_after_open_without_a_request(
    browser: Any, run: Simulation, tmp_path: Path, pictures: Path, name: str
) -> None:
    made = show_modes(run.robot, (0.0, 1.57, 0.0), count=2) if name == "modes" else compare(run, run)
    url = made.save_html(tmp_path / f"{name}.html").as_uri()
    page = opened(browser, url, pictures)
    page.page.wait_for_function("viewer.animator.playing && viewer.animator.time > 0")
    page.at(0.6)
    picture = page.picture(name)
    half = picture.shape[1] // 2
    assert yellow(picture[:, :half]) > 1000 and yellow(picture[:, half:]) > 1000  # one on either side
    assert asked_outside(page, url) == [] and page.complaints == []
    page.page.close()


def test_the_report_opens_without_a_request(browser: Any, reports: Path, pictures: Path) -> None:
    report = reports / "report.html"
    page = opened(browser, report.as_uri(), pictures)
    images = "[...document.images].map(i => i.complete && i.naturalWidth > 0)"
    shown = page.page.evaluate(images)
    assert shown and all(shown)
    page.picture("report")
    assert asked_outside(page, report.as_uri()) == [] and page.complaints == []
    assert page.page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    page.page.close()


def test_text_on_text_is_seen(browser: Any, tmp_path: Path, pictures: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text("<!DOCTYPE html><p>one line</p><p style='margin-top: -1.8em'>another</p>", encoding="utf-8")
    spoilt = opened(browser, page.as_uri(), pictures)
    assert spoilt.page.evaluate(OVERLAPS) == ["one line | another"]
    spoilt.page.close()


def test_report_and_check_page_read_well_also_unfolded(browser: Any, reports: Path, pictures: Path) -> None:
    for name in ("report", "check"):
        page = opened(browser, (reports / f"{name}.html").as_uri(), pictures)
        check_reads_well(page)
        page.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
        check_reads_well(page)
        page.page.close()


def test_a_line_zooms_where_it_is_dragged_and_comes_back(browser: Any, reports: Path, pictures: Path) -> None:
    page = opened(browser, (reports / "report.html").as_uri(), pictures)
    figures = page.page.locator("figure.zoom")
    assert figures.count() == page.page.locator("figure.zoom.drawn").count() > 0
    figure = page.page.locator("#residuals figure.zoom").first
    figure.scroll_into_view_if_needed()
    at = figure.locator(".u-over").first.bounding_box()

    def drawn() -> bytes:
        page.page.mouse.move(1, 1)
        return figure.screenshot()

    whole = drawn()
    y = at["y"] + 0.5 * at["height"]
    page.page.mouse.move(at["x"] + 0.3 * at["width"], y)
    page.page.mouse.down()
    page.page.mouse.move(at["x"] + 0.5 * at["width"], y, steps=5)
    page.page.mouse.up()
    page.page.mouse.move(at["x"] + 0.4 * at["width"], y)
    # what lies under the pointer: its time, and each line's value
    assert float(figure.locator(".legend .at").inner_text()) == pytest.approx(0.38 * 6.0, abs=0.5)
    assert figure.locator(".legend b").first.inner_text() != ""
    assert drawn() != whole
    page.page.mouse.dblclick(at["x"] + 0.4 * at["width"], y)
    assert drawn() == whole
    page.page.emulate_media(media="print")
    assert figure.locator("img").is_visible() and not figure.locator(".plots").is_visible()
    assert page.complaints == []
    page.page.close()


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1000, 640), (1400, 900)])
def test_the_viewer_s_words_cover_neither_the_robot_nor_each_other(
    browser: Any, run: Simulation, tmp_path: Path, pictures: Path, size: tuple[int, int]
) -> None:
    page = opened(browser, show(run).save_html(tmp_path / "run.html").as_uri(), pictures)
    page.page.set_viewport_size({"width": size[0], "height": size[1]})
    page.page.reload()
    page.page.wait_for_function("window.MeshCat && viewer.animator.duration > 0")
    assert page.page.evaluate(OVERLAPS) == []
    box = page.page.locator("#about").bounding_box()
    page.page.evaluate("document.getElementById('about').style.visibility = 'hidden'")
    for time in (0.0, 1.0):
        page.at(time)
        top, left = round(box["y"]), round(box["x"])
        under = page.picture("under")[top : top + round(box["height"]), left : left + round(box["width"])]
        r, g, b = under.transpose(2, 0, 1)
        assert np.count_nonzero((r > 150) & (g > 0.6 * r) & (b < 0.62 * g)) == 0
    assert page.complaints == []
    page.page.close()


@pytest.mark.slow
def test_a_notebook_as_html_reads_well_bends_and_zooms(browser: Any, tmp_path: Path, pictures: Path) -> None:
    try:
        from nbconvert import HTMLExporter
    except ImportError:
        missing("the Python package nbconvert")
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOKS / "flexible_model.ipynb", as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell('rf.simulate("rx90b_3dof", "line")'))
    NotebookClient(notebook, timeout=600).execute()
    # other templates ask the network for what shows formulas
    html, _ = HTMLExporter(template_name="basic").from_notebook_node(notebook)
    path = tmp_path / "notebook.html"
    path.write_text(f"<!DOCTYPE html><meta charset='utf-8'><title>notebook</title>{html}", encoding="utf-8")
    page = opened(browser, path.as_uri(), pictures)
    assert page.page.locator("figure.zoom.drawn").count() == 1
    page.picture("notebook")
    assert page.page.evaluate(OVERLAPS) == [] and page.complaints == []
    assert [r for r in asked_outside(page, path.as_uri()) if r != "about:srcdoc"] == []
    page.page.close()


def test_the_report_of_a_path_opens_without_a_request(browser: Any, tmp_path: Path, pictures: Path) -> None:
    robot = load_robot("rx90b_3dof")
    seam = Seam("seam", np.array([[0.55, -0.01, 0.35], [0.55, 0.01, 0.35]]), speed=0.1, start=np.deg2rad([0, 34, 69]))
    report = tmp_path / "report.html"
    write_path_report(
        check_path(seam, robot, load_cs8().for_joints(robot.joints), PathOptions(contributions=False)), report
    )
    page = opened(browser, report.as_uri(), pictures)
    shown = page.page.evaluate("[...document.images].map(i => i.complete && i.naturalWidth > 0)")
    assert len(shown) == 3 and all(shown)
    page.picture("path_report")
    assert asked_outside(page, report.as_uri()) == [] and page.complaints == []
    assert page.page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    page.page.close()
