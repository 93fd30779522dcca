"""A stranger follows the guides: each file of theirs is used everywhere, and a package that is broken is named and left out."""

from __future__ import annotations

import json
import re
from pathlib import Path

import fresh_process
import independent as ind
import numpy as np
import pytest

import rx90b_flex
from rx90b_flex.effects import catalogue
from rx90b_flex.effects.trials import why_not
from rx90b_flex.signals import load_campaign

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
    begin = f"import {place[0]} as place; place.__path__.append({str(place[1])!r})\n" if place else ""
    return fresh_process.python(begin + code, at, [packages] if packages else [])


def commands(*lines: str, at: Path, packages: Path | None = None, place: tuple[str, Path] | None = None) -> list[str]:
    """Of each command, in one process: exit status and all that it prints."""
    code = f"""
import contextlib, io, sys
from rx90b_flex.cli import main
for line in {lines!r}:
    sys.argv = ["rx90b-flex", *line.split()]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            main()
        except SystemExit as end:
            status = end.code or 0
    print(status, out.getvalue() + err.getvalue(), sep="\\n", end="\\0")
"""
    status, told = python(code, at, packages, place).split("\n", 1)
    assert status == "0", told
    return told.split("\0")[:-1]


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


def test_an_effect_is_in_the_catalogue_its_page_and_the_gallery_and_a_force_of_a_robot_file(effect, tmp_path):
    (tmp_path / "robot.toml").write_text(
        f'urdf = "example-robot-data:ur10"\n[[effects]]\ntype = "{TYPE}"\njoint = "elbow_joint"\ncoefficient = 2.0\n'
    )
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
    assert (tmp_path / "picture.png").stat().st_size > 1000


@pytest.mark.slow
def test_the_demonstration_hides_an_effect_and_finds_it(effect, tmp_path):
    told, run = commands(
        f"demo --hidden {TYPE} --seed 2 --out found",
        "simulate found/robot.toml --harmonics --out run",
        at=tmp_path,
        **effect,
    )
    assert told.startswith("0\n") and f"What had been hidden: {TYPE}" in told
    found = json.loads((tmp_path / "found" / "closed_loop.json").read_text())
    assert [e["type"] for e in found["effects"]] == [TYPE]
    report = (tmp_path / "found" / "report.html").read_text(encoding="utf-8")
    assert TYPE.replace("_", " ") in report.lower()
    assert f'type = "{TYPE}"' in (tmp_path / "found" / "robot.toml").read_text()
    assert run.startswith("0\n") and (tmp_path / "run" / "tip.csv").is_file()


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
        ("CubicFriction = 3\n", "3 is no subclass of rx90b_flex.effects.effect.Effect"),
        (GOOD.replace("def law", "def another_law"), "CubicFriction lacks law"),
        (GOOD.replace("class Cubic", "class Coulomb") + "\nCubicFriction = CoulombFriction\n", "'coulomb_friction' already"),
        ("import sys; sys.exit(3)\n" + GOOD, "SystemExit: 3"),
        (GOOD.replace("@dataclass(frozen=True, kw_only=True)", "@dataclass"), "cannot inherit non-frozen dataclass"),
        (GOOD.replace("LawEffect)", "LawEffect, behind_geer=True)"), "unknown key 'behind_geer'"),
        (GOOD.replace("@dataclass(frozen=True, kw_only=True)\n", ""), "CubicFriction is no dataclass, coefficient no parameter"),
        (GOOD.replace('linear("N m (s/rad)^3", lower=0.0, rank=FRICTION)', "None"), "CubicFriction declares no parameter"),
        (GOOD.replace('"N m (s/rad)^3"', "5"), "the unit of coefficient is 5; expected a text"),
        (GOOD.replace("(x, rate, parameters, out)", "(x, rate)"), "law takes (x, rate); expected (x, rate, parameters, out)"),
        (GOOD.replace("    @staticmethod\n", ""), "CubicFriction.law is a function; expected a @staticmethod"),
        (GOOD.replace("out[0] = ", "out[0] = float('nan') * "), "law writes nan to out[0] at x = 0.0, rate = 0.0; expected a number"),
        (GOOD.replace("= parameters[0] *", "= parameters[0] ** 2 *"), "law: its torque is not linear in coefficient"),
        (GOOD.replace("3.0 *", "-30.0 *"), "out[2], the slope of its torque by the rate, is -3.015"),
        (GOOD.replace("out[0] = ", "out[0] = 1.0 if rate > 0 else "), "CubicFriction.law ends with ValueError"),
    ],
)  # fmt: skip
def test_a_broken_package_of_effects_is_named_and_left_out(source, why, tmp_path):
    packages = install(tmp_path, "broken_friction", source, POINT)
    (tmp_path / "plain.toml").write_text('urdf = "example-robot-data:ur10"\n')
    (tmp_path / "asks.toml").write_text(
        f'urdf = "example-robot-data:ur10"\n[[effects]]\ntype = "{TYPE}"\njoint = "elbow_joint"\n'
    )
    works, refused = commands(
        "export plain.toml --format urdf --out a.urdf",
        "export asks.toml --format urdf --out b.urdf",
        at=tmp_path,
        packages=packages,
    )
    assert works.startswith("0\n") and refused.startswith("2\n")
    last = refused.splitlines()[-1]
    assert f"unknown effect type '{TYPE}'" in last and "package broken_friction 1.0" in last and why in last
    for told in (works, refused):
        assert "Traceback" not in told
        assert all(line.startswith("rx90b-flex: ") for line in told.splitlines() if "broken_friction" in line)


def test_an_error_in_a_package_of_effects_names_the_package(tmp_path):
    source = GOOD + "\n    def basis(self, at):\n        return at.no_such_thing\n"
    packages = install(tmp_path, "broken_friction", source, POINT)
    (told,) = commands(f"demo --hidden {TYPE} --out found", at=tmp_path, packages=packages)
    last = told.splitlines()[-1]
    assert told.startswith("70\n") and "a fault of package broken_friction 1.0" in last and "Traceback" not in told


@pytest.mark.parametrize("kind", sorted(catalogue()))
def test_no_law_of_the_catalogue_is_refused(kind):
    assert why_not(catalogue()[kind]) == ""


# ---- log formats ----------------------------------------------------------------------------------------------------


def jsonl(path: Path) -> Path:
    """Ten seconds of an arm of two joints; its URDF lies beside the log."""
    arm, rng = ind.two_joints(path.parent), np.random.default_rng(1)
    m = ind.harmonics(rng, 2, period_s=10.0, rate_hz=100.0)
    torque = arm.torque(m) + ind.white(rng, len(m.time), (0.1, 0.05))
    names = ["time", "q1", "q2", "tau1", "tau2"]
    rows = np.column_stack([m.time, m.q, torque]).tolist()
    path.write_text("".join(json.dumps(dict(zip(names, row, strict=True))) + "\n" for row in rows), encoding="utf-8")
    return path


PLACES = [
    pytest.param(False, id="one file of the folder"),
    pytest.param(True, id="another package", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("other", PLACES)
def test_a_log_format_is_imported(other, tmp_path):
    jsonl(tmp_path / "run.jsonl")
    source, folder = printed("new_log_format", "python"), tmp_path / "theirs"
    folder.mkdir()
    (folder / "json_lines.py").write_text(source, encoding="utf-8")
    where: dict[str, object] = {"place": ("rx90b_flex.signals.readers", folder)}
    if other:
        (folder / "json_lines.py").unlink()
        where = {"packages": install(folder, "json_logs", source, printed("new_log_format", "toml"))}
    words = "import run.jsonl --robot two_joints.urdf --out data --format csv"
    (tmp_path / "bad.jsonl").write_text("{")
    told, bad = commands(words, "import bad.jsonl --robot two_joints.urdf --out worse", at=tmp_path, **where)
    assert told.startswith("0\n") and "1000 lines of JSON" in told
    recordings = load_campaign(tmp_path / "data" / "campaign.toml").recordings
    logged = [json.loads(line) for line in (tmp_path / "run.jsonl").read_text().splitlines()]
    for name, field in (("q", "position"), ("tau", "torque")):
        got = np.concatenate([getattr(r, field) for r in recordings])
        np.testing.assert_allclose(got, [[row[f"{name}1"], row[f"{name}2"]] for row in logged], rtol=1e-12)
    status, said = bad.splitlines()
    assert status == "2" and said.startswith("rx90b-flex: bad.jsonl: cannot be read: ")


def test_a_broken_package_of_readers_is_named_and_left_out(tmp_path):
    jsonl(tmp_path / "run.jsonl")
    table = [json.loads(line) for line in (tmp_path / "run.jsonl").read_text().splitlines()]
    lines = [",".join(table[0]), *(",".join(map(str, row.values())) for row in table)]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    packages = install(tmp_path, "json_logs", BROKEN, printed("new_log_format", "toml"))
    works, refused = commands(
        "import run.csv --robot two_joints.urdf --out data",
        "import run.jsonl --robot two_joints.urdf --out worse",
        at=tmp_path,
        packages=packages,
    )
    why = "package json_logs 1.0: rx90b_flex.readers 'jsonl': RuntimeError: built for another version"
    assert works.startswith("0\n") and f"rx90b-flex: warning: {why}" in works
    assert refused.startswith("2\n") and f"run.jsonl: unknown kind of file; {why}" in refused.splitlines()[-1]
    assert "Traceback" not in works + refused


@pytest.mark.parametrize(
    ("was", "now", "why"),
    [
        ("return log_of", "log_of", "read returned None; expected a Log"),
        ("dtype=float)", "dtype=float)[:, :3]", "read returned values of shape (1000, 3) for 5 names; expected (rows, 5)"),
    ],
)  # fmt: skip
def test_a_reader_that_returns_too_little_is_named(was, now, why, tmp_path):
    jsonl(tmp_path / "run.jsonl")
    source = printed("new_log_format", "python").replace(was, now)
    if "None" not in why:
        source = source.replace("log_of(path, names", "Log(path, tuple(names)")
    packages = install(tmp_path, "json_logs", source, printed("new_log_format", "toml"))
    (told,) = commands("import run.jsonl --robot two_joints.urdf --out data", at=tmp_path, packages=packages)
    line = f"rx90b-flex: run.jsonl: cannot be read: package json_logs 1.0: rx90b_flex.readers 'jsonl': {why}"
    assert told.startswith("2\n" + line)


# ---- estimators -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("other", PLACES)
def test_an_estimator_identifies(other, tmp_path):
    """Tukey's biweight, of which the guide has the influence function, is the fixed point of its own weights."""
    arm, rng = ind.two_joints(tmp_path), np.random.default_rng(2)
    m = ind.harmonics(rng, 2, period_s=10.0, rate_hz=100.0)
    noise = ind.white(rng, len(m.time), (0.1, 0.05))
    noise[rng.random(noise.shape) < 0.05] += 8.0
    ind.write_files(
        tmp_path, arm, [{"type": "viscous_friction", "joint": j} for j in ("shoulder", "elbow")],
        [ind.run(arm, "identification", m, [lambda m, load: m.v * (3.0, 1.5)], noise)], known=True,
    )  # fmt: skip
    source, folder = printed("new_estimator", "python"), tmp_path / "theirs"
    folder.mkdir()
    (folder / "biweight.py").write_text(source, encoding="utf-8")
    where: dict[str, object] = {"place": ("rx90b_flex.identify.estimators", folder)}
    if other:
        (folder / "biweight.py").unlink()
        where = {"packages": install(folder, "robust_statistics", source, printed("new_estimator", "toml"))}
    (told,) = commands("identify campaign.toml --estimator biweight --despite-faults --out found", at=tmp_path, **where)
    assert told.startswith("0\n") and "Estimated by biweight" in told
    written = json.loads((tmp_path / "found" / "identification.json").read_text())
    assert written["estimator"] == "biweight"
    values = {p["name"]: p for p in written["parameters"] if p["value"] is not None}
    for joint, true in (("shoulder", 3.0), ("elbow", 1.5)):
        found = values[f"{joint}.viscous_friction.coefficient"]
        assert abs(found["value"] - true) < 3.0 * found["std"] < 0.1 * true


def test_a_broken_package_of_estimators_is_named_and_left_out(tmp_path):
    packages = install(tmp_path, "robust_statistics", BROKEN, printed("new_estimator", "toml"))
    (tmp_path / "campaign.toml").write_text("")
    works, refused = commands(
        "identify campaign.toml --estimator huber --out found",
        "identify campaign.toml --estimator biweight --out found",
        at=tmp_path,
        packages=packages,
    )
    why = "package robust_statistics 1.0: rx90b_flex.estimators 'biweight': RuntimeError: built for another version"
    assert refused.startswith("2\n") and f"--estimator is 'biweight'; {why}" in refused.splitlines()[-1]
    assert f"rx90b-flex: warning: {why}" in works and "campaign.toml: " in works.splitlines()[-1]
    assert "Traceback" not in works + refused


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("    def identify(self, regression, effects, *, fit_links):\n        return None\n", "identify returned None; expected"),
        ("    def influence(self, u):\n        return None\n", "influence returned None; expected ("),
        ("    def influence_slope(self, u):\n        return u[:-1]\n", "influence_slope returned an array of shape ("),
    ],
)  # fmt: skip
def test_an_estimator_that_returns_too_little_is_named(source, why, tmp_path):
    arm, rng = ind.two_joints(tmp_path), np.random.default_rng(2)
    m = ind.harmonics(rng, 2, period_s=10.0, rate_hz=100.0)
    ind.write_files(
        tmp_path, arm, [{"type": "viscous_friction", "joint": "elbow"}],
        [ind.run(arm, "identification", m, [lambda m, load: m.v * (3.0, 1.5)], 0.1 * ind.white(rng, len(m.time), (0.1, 0.05)))],
        known=True,
    )  # fmt: skip
    begin = "from rx90b_flex.identify.estimators.huber import Huber\n\nclass Biweight(Huber):\n"
    packages = install(tmp_path, "robust_statistics", begin + source, printed("new_estimator", "toml"))
    (told,) = commands(
        "identify campaign.toml --estimator biweight --despite-faults --out found", at=tmp_path, packages=packages
    )
    line = "rx90b-flex: --estimator is 'biweight'; package robust_statistics 1.0: rx90b_flex.estimators 'biweight': "
    assert told.startswith("2\n" + line + why)
