"""The moving robot: what is drawn where, what the page holds, and what the command does with what it is given."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import umsgpack

import rx90b_flex as rf
from rx90b_flex import cli
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import load_campaign
from rx90b_flex.simulate import Simulation, load_cs8, simulate, straight_line
from rx90b_flex.simulate.command import write_run
from rx90b_flex.view import Run, View, compare, scene, show, show_modes
from rx90b_flex.view.command import read_run, run_of, serve_until_interrupted, view_of

POSE = (0.3, 1.2, -0.4)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("rx90b_3dof")


@pytest.fixture(scope="module")
def run(robot: Robot) -> Simulation:
    """The line of section 4.2.2."""
    controller = load_cs8().for_joints(robot.joints)
    return simulate(robot, controller, straight_line(robot))


@pytest.fixture(scope="module")
def shown(run: Simulation) -> View:
    return show(run, magnify=100.0)


def commands(view: View) -> list[dict[str, Any]]:
    return [umsgpack.unpackb(command.packed) for command in view.commands]


def tracks(view: View, path: str) -> dict[str, np.ndarray]:
    """Values of the animation of one node, (frames, 3) or (frames, 4)."""
    clip = next(c["clip"] for c in commands(view)[-1]["animations"] if c["path"] == path)
    return {t["name"]: np.array([key["value"] for key in t["keys"]]) for t in clip["tracks"]}


def object_of(view: View, path: str) -> dict[str, Any]:
    return next(c["object"] for c in commands(view) if c["type"] == "set_object" and c["path"] == path)


def vertices(view: View, path: str, name: str = "position") -> np.ndarray:
    packed = object_of(view, path)["geometries"][0]["data"]["attributes"][name]["array"]
    return np.frombuffer(packed.data, dtype=np.float32).reshape(-1, 3)


# ---- geometry -------------------------------------------------------------------------------------------------


def test_without_deformation_the_flexible_robot_stands_where_the_rigid_one_does(robot: Robot) -> None:
    links = [s.link for s in scene.shapes(robot)]
    q = scene.magnified(robot, np.full((1, robot.model.nv), 0.2), 0.0)
    assert np.array_equal(q @ robot.input_matrix, np.full((1, 3), 0.2))
    np.testing.assert_allclose(
        scene.frame_poses(robot.model, q, links),
        scene.frame_poses(robot.tree, np.full((1, 3), 0.2), links),
        atol=1e-12,  # m and of rotation entries of size 1: rounding along the chain
    )


def test_the_factor_multiplies_how_far_the_tip_bends(robot: Robot) -> None:
    rng, factor, size = np.random.default_rng(0), 50.0, 1e-6
    bent = np.where(
        robot.input_matrix.any(axis=1), robot.input_matrix @ POSE, size * rng.uniform(-1, 1, robot.model.nv)
    )
    q = np.stack([scene.magnified(robot, bent, f) for f in (0.0, 1.0, factor)])
    rest, once, often = scene.frame_poses(robot.model, q, [robot.tip_frame])[:, 0, :3, 3]
    # second order: each of the nine angles turns at most the arm's length of 1.5 m
    np.testing.assert_allclose(often - rest, factor * (once - rest), atol=1.5 * (9 * factor * size) ** 2)


def test_the_trail_is_coloured_by_the_true_distance_of_the_tip(run: Simulation, shown: View) -> None:
    seen = Run.of(run)
    assert seen.deviation_mm is not None
    np.testing.assert_allclose(seen.deviation_mm, np.linalg.norm(run.tip_deviation_mm, axis=1), atol=1e-9)
    # magnified a hundred times in place, not at all in colour
    colours = np.unique(vertices(shown, "/view/run/trail", "color"), axis=0)
    wanted = scene.colours_of(seen.deviation_mm, float(seen.deviation_mm.max()))
    distance = np.abs(colours[:, None] - wanted[None]).max(axis=2)
    assert len(colours) > 50 and distance.min(axis=1).max() < 1e-6  # float32


def test_the_drawn_tip_runs_along_the_trail(run: Simulation, shown: View, robot: Robot) -> None:
    trail = vertices(shown, "/view/run/trail").reshape(-1, 8, 3).mean(axis=1)  # the middle of each ring
    last = scene.shapes(robot)[-1].link
    moved = tracks(shown, f"/view/run/robot/{last}")[".position"]
    q = scene.magnified(robot, run.q, 100.0)
    ends = scene.frame_poses(robot.model, q, [last, robot.tip_frame])
    assert np.linalg.norm(ends[0, 1, :3, 3] - trail[0]) < 1e-6
    np.testing.assert_allclose(moved[0], ends[0, 0, :3, 3], atol=1e-6)
    np.testing.assert_allclose(moved[-1], ends[-1, 0, :3, 3], atol=1e-6)


def test_the_animation_takes_as_long_as_the_run(run: Simulation, shown: View) -> None:
    for clip in commands(shown)[-1]["animations"]:
        keys = clip["clip"]["tracks"][0]["keys"]
        assert keys[-1]["time"] / clip["clip"]["fps"] == pytest.approx(run.time[-1], abs=0.5 / clip["clip"]["fps"])


def test_a_tube_keeps_its_distance_from_its_path() -> None:
    t = np.linspace(0, 6, 200)
    path = np.stack([np.cos(t), np.sin(t), 0.1 * t], axis=1)
    made = scene.tube(path, 0.01, np.zeros((200, 3)))
    away = made.vertices.reshape(200, 8, 3) - path[:, None]
    np.testing.assert_allclose(np.linalg.norm(away, axis=2), 0.01, rtol=1e-4)  # float32 of sizes about 1
    assert made.faces.max() == len(made.vertices) - 1


def test_a_robot_without_shapes_gets_sticks_that_end_at_its_joints() -> None:
    robot = load_robot("example-robot-data:ur5")
    bare = dataclasses.replace(robot, urdf=re.sub(r"<visual>.*?</visual>", "", robot.urdf, flags=re.S))
    q = np.array([[0.3, -0.8, 1.1, 0.2, 0.5, 0.1]])
    data = bare.tree.createData()
    pin.framesForwardKinematics(bare.tree, data, q[0])
    centres = [data.oMi[j].translation for j in range(1, 7)]
    balls = [s for s in scene.shapes(bare) if type(s.geometry).__name__ == "Sphere"]
    at = scene.frame_poses(bare.tree, q, [s.link for s in balls])[0]
    found = [(pose @ s.placement)[:3, 3] for pose, s in zip(at, balls, strict=True)]
    np.testing.assert_allclose(found, centres, atol=1e-12)
    sticks = [s for s in scene.shapes(bare) if type(s.geometry).__name__ == "Cylinder"]
    for stick in sticks:
        pose = scene.frame_poses(bare.tree, q, [stick.link])[0, 0] @ stick.placement
        ends = [pose @ [0, sign * 0.5 * stick.geometry.height, 0, 1] for sign in (-1, 1)]
        places = np.array([[0, 0, 0], *centres, data.oMf[bare.tree.getFrameId(bare.tip_frame)].translation])
        assert all(np.linalg.norm(places - end[:3], axis=1).min() < 1e-9 for end in ends)


def test_a_robot_with_meshes_shows_them() -> None:
    shapes = scene.shapes(load_robot("example-robot-data:ur10"))
    assert len(shapes) >= 7 and all(type(s.geometry).__name__ == "TriangularMeshGeometry" for s in shapes)


# ---- modes ----------------------------------------------------------------------------------------------------


def test_modes_keep_the_ratio_of_their_frequencies_and_tell_them(robot: Robot) -> None:
    view = show_modes(robot, POSE, count=3)
    free = robot.with_effects([e for e in robot.effects if not e.traits.is_friction])
    hz = free.linearize(robot.input_matrix @ POSE).modes().frequencies_hz
    elastic = free.linearize(robot.input_matrix @ POSE).frequencies_hz(elastic_only=True)[3]
    hz = hz[hz > 0.5 * elastic][:3]
    swings = []
    for number in (1, 2, 3):
        moved = tracks(view, f"/view/mode_{number}/robot/link_3")[".position"]
        spectrum = np.abs(np.fft.rfft(moved[:-1] - moved[:-1].mean(axis=0), axis=0)).sum(axis=1)
        swings.append(int(spectrum.argmax()))  # whole swings in the loop
    # each is rounded to a whole number
    np.testing.assert_allclose(
        np.array(swings) / swings[0], hz / hz[0], atol=(0.5 + 0.5 * hz.max() / hz[0]) / swings[0]
    )


@pytest.mark.parametrize(
    ("name", "pose", "count", "message"),
    [
        ("rx90b_rigid", None, 6, "nothing in it bends"),
        ("rx90b_3dof", (0.0,), 6, "pose has shape (1,)"),
        ("rx90b_3dof", None, 0, "count is 0"),
    ],
)
def test_modes_that_cannot_be_shown_are_refused(name: str, pose: Any, count: int, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        show_modes(load_robot(name), pose, count=count)


# ---- pages ----------------------------------------------------------------------------------------------------


def test_a_page_names_no_address_and_appears_whole(shown: View, tmp_path: Path) -> None:
    path = shown.save_html(tmp_path / "run.html")
    text = path.read_text(encoding="utf-8")
    # an XML namespace is a name, not an address
    assert set(re.findall(r"https?://[\w./-]+", text)) <= {"http://www.w3.org/1999/xhtml"}
    assert text.count("</script>") == 3 and 'id="legend" src="data:image/png;base64,' in text
    assert [p.name for p in tmp_path.iterdir()] == ["run.html"]


def test_before_and_after_stand_apart_under_one_scale(run: Simulation, shown: View) -> None:
    better = Run("better", run.robot, run.time, 0.999 * run.q, run.recording.reference_position)
    view = compare(run, better)
    paths = [c["path"] for c in commands(view)]
    assert "/view/labels/before" in paths and "/view/labels/after" in paths
    apart = vertices(view, "/view/after/reference")[0] - vertices(view, "/view/before/reference")[0]
    assert apart[1] > 1.7  # m: more than the line is long, so that they do not run into each other
    one = shown.notes[0]
    assert any(one.split(": ", 1)[1] in note for note in view.notes)


@pytest.mark.slow
def test_a_live_cell_frames_the_server(shown: View) -> None:
    assert re.search(r'<iframe src="http://127\.0\.0\.1:\d+/static/"', shown.cell().data)


def test_a_notebook_cell_holds_the_whole_page(shown: View) -> None:
    cell = shown._repr_html_()
    assert cell.startswith("<iframe srcdoc=") and "<script" not in cell  # escaped into the frame


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"beside": 5}, TypeError, r"^beside is 5; expected a run or the path of one$"),
        ({"tip": "x"}, ValueError, r"^unknown tip frame 'x' for robot rx90b"),
        ({"recording": "x"}, ValueError, r"^recording is 'x'; a run is one motion, of its own robot: expected none$"),
        ({"pose_deg": [0, 0, 0]}, ValueError, r"^pose_deg is \[0, 0, 0\]; a run is one motion"),
        ({"flexible": True}, ValueError, r"^flexible is True; a run is one motion"),
    ],
)
def test_what_a_run_has_no_use_for_is_refused(
    run: Simulation, options: dict[str, Any], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        rf.view(run, **options)


def test_the_tip_of_a_run_may_be_another_frame(run: Simulation) -> None:
    assert (
        run_of(run, None, "link_2").robot.tip_frame == "link_2" and run_of(run, None, None).robot.tip_frame == "tool0"
    )
    assert rf.view(run, tip="link_2").title == rf.view(run).title


def test_what_is_nothing_to_show_is_refused(run: Simulation) -> None:
    for source in (None, 5):
        with pytest.raises(TypeError, match=f"^source is {source}; expected a robot, a run or the path of one$"):
            rf.view(source)  # type: ignore[arg-type]
    for options in ({"recording": "x"}, {"beside": run}):
        with pytest.raises(ValueError, match="a robot's mode shapes are no run: expected none"):
            rf.view(run.robot, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("magnify", [-1.0, float("nan")])
def test_a_factor_below_zero_is_refused(run: Simulation, magnify: float) -> None:
    with pytest.raises(ValueError, match="magnify"):
        show(run, magnify=magnify)


# ---- the command ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(run: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run")
    write_run(run, path)
    return path


def call(*arguments: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["rx90b-flex", "view", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return int(end.value.code or 0)  # type: ignore[arg-type]


def test_a_simulated_run_comes_back_with_its_deformations(run: Simulation, folder: Path) -> None:
    read = read_run(str(folder))
    np.testing.assert_array_equal(read.q, run.q)
    assert read.deforms and read.robot.coordinates == run.robot.coordinates


def test_a_campaign_without_coordinates_is_shown_by_its_drive_angles(folder: Path, tmp_path: Path) -> None:
    for path in folder.iterdir():
        if path.name != "state.parquet":
            (tmp_path / path.name).write_bytes(path.read_bytes())
    read = read_run(str(tmp_path / "campaign.toml"))
    measured = load_campaign(tmp_path / "campaign.toml").recordings[0].position
    np.testing.assert_array_equal(read.q @ read.robot.input_matrix, measured)
    assert not read.deforms


def test_a_recording_in_another_order_of_joints_is_the_same_motion(run: Simulation) -> None:
    recording, turned = run.recording, [2, 0, 1]
    assert recording.reference_position is not None
    other = dataclasses.replace(
        recording,
        joints=tuple(recording.joints[k] for k in turned),
        position=recording.position[:, turned],
        torque=recording.torque[:, turned],
        velocity=None,
        reference_velocity=None,
        reference_position=recording.reference_position[:, turned],
        link_position=recording.position[:, turned] + 0.01,
    )
    one, two = Run.of_recording(recording, run.robot), Run.of_recording(other, run.robot)
    drives = run.robot.input_matrix
    np.testing.assert_array_equal(two.q @ drives, one.q @ drives)
    np.testing.assert_array_equal(two.reference, one.reference)
    torsion = run.robot.coordinates.index("joint_2:torsion")
    np.testing.assert_allclose(two.q[:, torsion], 0.01, rtol=1e-12)
    with pytest.raises(ValueError, match="is of joints"):
        Run.of_recording(recording, load_robot("rx90b_4dof"))


def test_the_command_writes_pages(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(folder, "--out", tmp_path / "new" / "run.html", monkeypatch=monkeypatch) == 0
    assert "mm at most" in capsys.readouterr().out
    both = ("--beside", folder, "--magnify", 20, "--out", tmp_path / "both.html")
    assert call(folder, *both, monkeypatch=monkeypatch) == 0
    given = ("--pose", "0,90,0", "--count", 1, "--out", tmp_path / "modes.html")
    assert call("rx90b_3dof", *given, monkeypatch=monkeypatch) == 0
    assert "Slowed down" in capsys.readouterr().out
    for name in ("new/run.html", "both.html", "modes.html"):
        assert (tmp_path / name).stat().st_size > 500_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("rx90b_3dof", "--beside", "FOLDER"), "no run and no campaign"),
        (("rx90b_9dof",), "unknown robot 'rx90b_9dof'"),
        (("rx90b_rigid",), "nothing in it bends"),
        (("nothing_there", "--modes"), "unknown robot"),
        (("FOLDER", "--recording", "no"), "no recording 'no'; it has line"),
        (("FOLDER", "--magnify", "-2"), "--magnify is -2"),
        (("FOLDER", "--pose", "1"), "--pose is of mode shapes"),
        (("rx90b_3dof", "--modes", "--pose", "0,a,0"), "--pose is '0,a,0'"),
        (("rx90b_3dof", "--modes", "--pose", "0,1"), "one a joint"),
        (("EMPTY",), "no campaign.toml in it"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    message: str,
) -> None:
    (tmp_path / "empty").mkdir()
    places = {"FOLDER": str(folder), "EMPTY": str(tmp_path / "empty")}
    out = tmp_path / "view.html"
    assert call(*(places.get(a, a) for a in arguments), "--out", out, monkeypatch=monkeypatch) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and message in lines[0]
    assert not out.exists()


def test_serving_ends_with_its_server(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url, new: opened.append(url))
    told: list[str] = []

    def interrupt() -> None:
        raise KeyboardInterrupt

    serve_until_interrupted(view_of(str(folder)), told.append, interrupt)
    assert opened == told and told[0].startswith("http://127.0.0.1:")
