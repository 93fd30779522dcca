"""Claims about the documentation: effect types have their pages, examples load, commands exist, no warning when it is built."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from rx90b_flex.cli import app
from rx90b_flex.effects import catalogue, effect_from_table

DOCS = Path(__file__).resolve().parent.parent / "rx90b_flex" / "docs"
sys.path.insert(0, str(DOCS))
import effect_pages  # noqa: E402
import effect_pictures  # noqa: E402

# The vocabulary that robot files and reports rely on.
TYPES = (
    "drive_inertia",
    "torque_offset",
    "coulomb_friction",
    "viscous_friction",
    "viscous_power_friction",
    "stribeck_friction",
    "asymmetric_friction",
    "load_friction",
    "friction_drift",
    "presliding_friction",
    "joint_spring",
    "gravity_spring",
    "base_tilt",
    "payload",
    "joint_coupling",
    "gear_ripple",
    "transmission_error",
    "backlash",
    "drive_flexibility",
    "joint_flexibility",
    "base_flexibility",
    "stiffness_hardening",
    "motor_saturation",
    "torque_delay",
    "resolver_error",
    "line_interference",
)
PAGES = sorted(path for path in DOCS.rglob("*.md") if path.parent.name != "effects")


@pytest.mark.parametrize("name", sorted({*TYPES, *catalogue()}))
def test_effect_type_has_its_page(name: str) -> None:
    cls = catalogue()[name]
    page = effect_pages.page(cls)
    for heading in ("Parameters", *effect_pages.HEADINGS):
        body = page.split(f"## {heading}\n")[1].split("\n## ")[0]
        assert len(body.split()) > 3, heading
    for parameter, p in cls.parameters().items():
        assert re.search(rf"^\| `{parameter}`.*\| {re.escape(p.unit)} \|", page, re.MULTILINE)
    text = page.split("## Told from")[1].split("\n## ")[0]
    assert set(re.findall(r"\((\w+)\.md\)", text)) or name == "torque_delay", "it names a neighbour"


@pytest.mark.parametrize("name", TYPES)
def test_example_on_the_page_is_an_effect_that_a_robot_file_may_hold(name: str) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", effect_pages.page(catalogue()[name]), re.DOTALL)
    (table,) = tomllib.loads(block)["effects"]
    effect = effect_from_table(table, "page", ["joint_2", "joint_5", "joint_6"], ["tool0"])
    assert effect.type_name() == name


def test_names_in_effects_docstrings_are_effect_types() -> None:
    for cls in catalogue().values():
        for section in effect_pages.text_of(cls).sections:
            for name in re.findall(r"(?<!`)`(\w+)`(?!`)", section):
                assert name in catalogue(), f"{cls.__name__}: {name}"


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_the_gallery_draws_what_an_effect_leaves_in_a_residual(name: str) -> None:
    figure = effect_pictures.draw(catalogue()[name])
    if figure is None:  # it hardens a torsion, and is nothing beside a rigid drive
        assert catalogue()[name].traits.needs
        return
    lines = [np.asarray(line.get_ydata(), dtype=float) for ax in figure.axes for line in ax.lines]
    assert all(np.isfinite(y).all() for y in lines) and np.ptp(lines[0]) > 0
    if len(figure.axes) == 1:  # with it and without it
        assert not np.allclose(*lines, rtol=0.1)


def test_friction_shows_over_velocity_and_a_spring_over_the_angle() -> None:
    for name, signal in (
        ("viscous_power_friction", "velocity"),
        ("joint_spring", "angle"),
        ("drive_inertia", "acceleration"),
    ):
        figure = effect_pictures.draw(catalogue()[name])
        assert figure is not None and signal in figure.axes[1].get_xlabel()


def test_catalogue_leads_to_every_page() -> None:
    index = effect_pages.index()
    for name in catalogue():
        assert f"[`{name}`]({name}.md)" in index


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_commands_and_toml_in_a_page_are_real(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    commands = get_command(app).commands  # type: ignore[attr-defined]
    for name, rest in re.findall(r"rx90b-flex ([a-z-]+)([^\n`]*)", text):
        options = {option for parameter in commands[name].params for option in parameter.opts}
        assert {*re.findall(r"--[a-z-]+", rest)} <= {*options, "--help"}, name
    for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL):
        tomllib.loads(block)


def test_every_name_in_the_api_reference_is_there() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    for kind, name in re.findall(r"\.\. auto(\w+):: (\S+)", pages):
        if kind == "module":
            importlib.import_module(name)
        else:
            module, _, attribute = name.rpartition(".")
            assert getattr(importlib.import_module(module), attribute).__doc__, name


@pytest.mark.slow
def test_documentation_builds_without_warning(tmp_path: Path) -> None:
    for package in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(package, reason="the extra `docs` is not installed")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", str(tmp_path / "doctrees"), str(DOCS)]
    done = subprocess.run([*build, str(tmp_path / "html")], capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    for name in catalogue():
        assert (tmp_path / "html" / "effects" / f"{name}.html").exists()


def test_every_benchmark_stands_once_in_their_list() -> None:
    folder = DOCS.parents[1] / "benchmarks"
    named = re.findall(r"^\| `(\w+\.py)", (folder / "README.md").read_text(), re.MULTILINE)
    assert sorted(named) == sorted(p.name for p in folder.glob("*.py"))
