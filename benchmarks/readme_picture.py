"""Draw the README's pictures: the magnified robot on its line, and the demonstration's residual before and after.

python benchmarks/readme_picture.py              # both; the robot needs Chromium and Playwright (extra `test`)
python benchmarks/readme_picture.py residual
"""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import rx90b_flex as rf
from rx90b_flex.demo import make_demonstration
from rx90b_flex.view import plots

FOLDER = Path(__file__).resolve().parent.parent / ".readme"
SIZE = {"width": 1100, "height": 700}
PART = {"x": 0, "y": 0, "width": 1100, "height": 640}
MOMENT_S = 1.85  # braking, with the arm stretched out
MAGNIFY = 200.0
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def draw_residual() -> None:
    """Close the loop on the demonstration with Stribeck friction hidden and save the residual against velocity."""
    with TemporaryDirectory() as folder:
        result = rf.close_loop(make_demonstration(3, "stribeck_friction").write(Path(folder)))
    joint = result.effects[0].effect.joints[0]
    plots.residual_against_velocity(result, joint).savefig(FOLDER / "residual.png", dpi=150)


def draw_robot() -> None:
    """Simulate the line of figure 4.6 and save one moment of its view, deformations magnified."""
    from PIL import Image
    from playwright.sync_api import sync_playwright

    from rx90b_flex.simulate import load_cs8, simulate, straight_line
    from rx90b_flex.view import show

    robot = rf.load_robot("rx90b_4dof")
    run = simulate(robot, load_cs8(), straight_line(robot))
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        page_file = show(run, magnify=MAGNIFY).save_html(Path(folder) / "run.html")
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(ARGUMENTS))
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(300_000)  # ms; a guard only, for a crowded machine
        page.goto(page_file.as_uri())
        page.wait_for_function("window.MeshCat && viewer.animator.duration > 0")
        page.evaluate(
            """t => new Promise(done => { viewer.animator.pause(); viewer.animator.seek(t); viewer.animator.display_progress(t);
               document.getElementById("text").open = false;
               for (const x of document.querySelectorAll("#bar, .dg")) x.style.display = "none";
               requestAnimationFrame(() => requestAnimationFrame(done)); })""",
            MOMENT_S,
        )
        png = page.screenshot(clip=PART)
        browser.close()
    Image.open(io.BytesIO(png)).convert("RGB").save(FOLDER / "robot.png", optimize=True)


def main() -> None:
    """Draw what is asked for, both pictures where nothing is."""
    FOLDER.mkdir(exist_ok=True)
    asked = sys.argv[1:] or ["robot", "residual"]
    for name in asked:
        {"robot": draw_robot, "residual": draw_residual}[name]()


if __name__ == "__main__":
    main()
