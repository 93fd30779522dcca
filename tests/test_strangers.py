"""A stranger follows the guides: each file of theirs is used everywhere, and a package that is broken is named and left out."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import rx90b_flex

GUIDES = Path(rx90b_flex.__file__).parent / "docs" / "guides"
STUDIES = Path(__file__).parents[1] / "benchmarks"
BROKEN = "raise RuntimeError('built for another version')\n"


def printed(guide: str, language: str, number: int = 0) -> str:
    """A block of a guide, as it stands there."""
    text = (GUIDES / f"{guide}.md").read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)[number]


def install(folder: Path, name: str, source: str, points: str) -> Path:
    """A package of somebody else's: one module and the entry points that its pyproject.toml would make."""
    (folder / f"{name}.py").write_text(source, encoding="utf-8")
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    lines = re.sub(r'\[project\.entry-points\."(.*?)"\]', r"[\1]", points).replace('"', "")
    (info / "entry_points.txt").write_text(lines, encoding="utf-8")
    return folder


def python(code: str, at: Path, packages: Path | None = None, place: tuple[str, Path] | None = None) -> str:
    """What a process of its own prints; `place`: a folder of the package to which the files of another folder belong."""
    paths = [str(packages or ""), str(Path(rx90b_flex.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    begin = f"import {place[0]} as place; place.__path__.append({str(place[1])!r})\n" if place else ""
    done = subprocess.run(
        [sys.executable, "-c", begin + code], cwd=at, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in paths if p)},
    )  # fmt: skip
    return f"{done.returncode}\n{done.stdout}{done.stderr}"


def command(words: str, at: Path, packages: Path | None = None, place: tuple[str, Path] | None = None) -> str:
    """Exit status and all that a command prints."""
    code = f"import sys; sys.argv = {['rx90b-flex', *words.split()]!r}; from rx90b_flex.cli import main; main()"
    return python(code, at, packages, place)


# ---- effects --------------------------------------------------------------------------------------------------------

EFFECTS = "rx90b_flex.effects"
TYPE = "cubic_friction"


@pytest.fixture(scope="module", params=["one file of the folder", "another package"])
def effect(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """Where the guide's effect is: a file beside the package's own, or a package with an entry point."""
    folder = tmp_path_factory.mktemp("effect")
    if request.param == "another package":
        points = printed("new_effect", "toml")
        return {"packages": install(folder, "fluid_friction", printed("new_effect", "python"), points)}
    (folder / "cubic_friction.py").write_text(printed("new_effect", "python"), encoding="utf-8")
    return {"place": (EFFECTS, folder)}


def test_an_effect_is_in_the_catalogue_its_page_and_the_gallery(effect, tmp_path):
    code = f"""
import sys
from pathlib import Path
from rx90b_flex.effects import catalogue
sys.path.insert(0, {str(GUIDES.parent)!r})
import effect_pages, effect_pictures
cls = catalogue()[{TYPE!r}]
page = effect_pages.page(cls)
assert all("## " + heading in page for heading in effect_pages.HEADINGS) and "A cubic parabola" in page
assert "({TYPE}.md)" in effect_pages.index() and "{TYPE}.png" in effect_pages.gallery([{TYPE!r}])
assert effect_pictures.save(cls, Path("picture.png"))
"""
    assert python(code, tmp_path, **effect) == "0\n"
    assert (tmp_path / "picture.png").stat().st_size > 1000


def test_an_effect_is_a_force_of_a_robot_file(effect, tmp_path):
    (tmp_path / "robot.toml").write_text(
        f'urdf = "example-robot-data:ur10"\n[[effects]]\ntype = "{TYPE}"\njoint = "elbow_joint"\ncoefficient = 2.0\n'
    )
    code = """
import numpy as np, rx90b_flex as rf
robot = rf.load_robot("robot.toml")
plain = robot.with_effects([])
v = np.array([0.1, 0.2, 1.5, 0.1, 0.1, 0.1])
torque = robot.inverse_dynamics(0 * v, v, 0 * v)
np.testing.assert_allclose(torque - plain.inverse_dynamics(0 * v, v, 0 * v), [0, 0, 2 * 1.5**3, 0, 0, 0], atol=1e-9)
np.testing.assert_allclose(robot.regressor(0 * v, v, 0 * v) @ robot.parameters, torque, atol=1e-9)
damping = robot.linearize(0 * v, v).D[2, 2] - plain.linearize(0 * v, v).D[2, 2]
assert abs(damping - 2 * 3 * 1.5**2) < 1e-6
"""
    assert python(code, tmp_path, **effect) == "0\n"


@pytest.mark.slow
def test_the_demonstration_hides_an_effect_and_finds_it(effect, tmp_path):
    told = command(f"demo --hidden {TYPE} --seed 2 --out found", tmp_path, **effect)
    assert told.startswith("0\n") and f"What had been hidden: {TYPE}" in told
    found = json.loads((tmp_path / "found" / "closed_loop.json").read_text())
    assert [e["type"] for e in found["effects"]] == [TYPE]
    report = (tmp_path / "found" / "report.html").read_text(encoding="utf-8")
    assert TYPE.replace("_", " ") in report.lower()
    assert f'type = "{TYPE}"' in (tmp_path / "found" / "robot.toml").read_text()
    assert command("simulate found/robot.toml --harmonics --out run", tmp_path, **effect).startswith("0\n")
    assert (tmp_path / "run" / "tip.csv").is_file()


@pytest.mark.slow
def test_the_study_hides_an_effect(effect, tmp_path):
    code = f"""
import sys, runpy
sys.path.insert(0, {str(STUDIES)!r})
sys.argv = "closing_the_loop.py --out rows.jsonl --studies hidden --types {TYPE} --strengths 10 --hidden-runs 1 --jobs 1".split()
runpy.run_path({str(STUDIES / "closing_the_loop.py")!r}, run_name="__main__")
"""
    assert python(code, tmp_path, **effect).startswith("0\n")
    (row,) = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert [h["type"] for h in row["hidden"]] == [TYPE]
    assert [(f["type"], f["joints"]) for f in row["found"]] == [(TYPE, row["hidden"][0]["joints"])]


POINT = f"[{EFFECTS}]\n{TYPE} = broken_friction:CubicFriction\n"
GOOD = printed("new_effect", "python")


@pytest.mark.parametrize(
    ("source", "why"),
    [
        (BROKEN, "RuntimeError: built for another version"),
        ("CubicFriction = 3\n", "3 is no class of effects"),
        (GOOD.replace("def column_slope", "def another_slope"), "CubicFriction lacks column_slope"),
        (GOOD.replace("class Cubic", "class Coulomb") + "\nCubicFriction = CoulombFriction\n", "'coulomb_friction' already"),
    ],
)  # fmt: skip
def test_a_broken_package_of_effects_is_named_and_left_out(source, why, tmp_path):
    packages = install(tmp_path, "broken_friction", source, POINT)
    (tmp_path / "plain.toml").write_text('urdf = "example-robot-data:ur10"\n')
    (tmp_path / "asks.toml").write_text(
        f'urdf = "example-robot-data:ur10"\n[[effects]]\ntype = "{TYPE}"\njoint = "elbow_joint"\n'
    )
    works = command("export plain.toml --format urdf --out a.urdf", tmp_path, packages)
    refused = command("export asks.toml --format urdf --out b.urdf", tmp_path, packages)
    assert works.startswith("0\n") and refused.startswith("2\n")
    last = refused.splitlines()[-1]
    assert f"unknown effect type '{TYPE}'" in last and "package broken_friction 1.0" in last and why in last
    for told in (works, refused):
        assert "Traceback" not in told
        assert all(line.startswith("rx90b-flex: ") for line in told.splitlines() if "broken_friction" in line)


def test_an_error_in_a_package_of_effects_names_the_package(tmp_path):
    source = GOOD.replace("return np.asarray(v**3)", "return v.no_such_thing")
    packages = install(tmp_path, "broken_friction", source, POINT)
    told = command(f"demo --hidden {TYPE} --out found", tmp_path, packages)
    last = told.splitlines()[-1]
    assert told.startswith("70\n") and "a fault of package broken_friction 1.0" in last and "Traceback" not in told
