"""A generator of wrong inputs: one file of a set that works is altered, or one option; and what may come of it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import linear_campaign
import numpy as np
import pandas as pd
from hypothesis import strategies as st
from scipy.io import savemat
from test_cli import write_campaign
from test_importers import lerobot
from test_measured_stiffness import write_poses, write_test

from rx90b_flex.robot import load_robot, robots_folder

TOKENS = (
    "", "0", "-1", "1e400", "-1e308", "nan", "inf", "9" * 400, "1_000", "١", "[]", "[[]]", "{}", "true", '"x"', '""', "'", '"', "é",
    "\0", "[/bold]", "../..", "x" * 300, "1979-05-27", "0x10", "1,2", "#", "=", "\t", "None", "<", "&",
)  # fmt: skip
NUMBERS = (
    "0",
    "-1",
    "nan",
    "inf",
    "-inf",
    "1e-300",
    "1e300",
    "1e9",
    "",
    "x",
    "1_000",
    "9" * 400,
    "1,1",
    "0,90,0",
    "3.5",
    "[/bold]",
)
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")
WORDS = (
    "",
    "x",
    "joint_1",
    "joint_1,joint_1",
    ",",
    "[/bold]",
    "rx90b",
    "é",
    "x" * 300,
    "x" * 5000,
    "/dev/null",
    "..",
    "torque=",
    "=",
)

PATH = """unit = "mm"
points = [[500, -10, 350], [500, 10, 350]]
speed_mm_s = 100.0
acceleration = 1.0
corner = "stop"
blend_mm = 5.0
orientation = "free"
start_deg = [-11.3, 34.4, 68.8]
robot = "rx90b_3dof"
"""
MODES = """joints = ["joint_1"]
[[pose]]
angles_deg = { joint_2 = 90.0 }
resonance = { hz = [20.0, 30.0], std_hz = [0.1, 0.1] }
antiresonance.joint_1 = { hz = [15.0], std_hz = [0.1] }
"""
CASCADE = "controller_rate_hz = 2000.0\n" + "".join(
    f"""[[cascade]]
name = "joint_{number}"
position_loop = 30.0
velocity_loop = {velocity}
integral_time_s = 0.05
torque_limit = 450.0
velocity_filters = [{{ type = "low_pass", frequency_hz = 300.0 }}]
torque_filters = [{{ type = "notch", frequency_hz = 60.0, damping = 0.5, depth = 0.1 }}]
"""
    for number, velocity in ((1, 1500.0), (2, 1500.0), (3, 500.0))
)
WEIGHTS = """robot = "rx90b_4dof"
[[test]]
coordinate = "joint_2:torsion"
file = "weights.csv"
frame = "tool0"
angles_deg = [0, 90]
"""


def write_inputs(folder: Path) -> None:
    """Files of every kind that the commands read, each as it should be."""
    campaign = write_campaign(folder)
    log = pd.read_csv(folder / "log_1.csv")
    log.to_parquet(folder / "log.parquet")
    savemat(folder / "log.mat", {name: log[name].to_numpy() for name in log})
    (folder / "path.toml").write_text(PATH)
    (folder / "points.csv").write_text("x,y,z\n0.5,-0.01,0.35\n0.5,0.01,0.35\n")
    (folder / "modes.toml").write_text(MODES)
    time = np.arange(20) / 100.0
    rows = "".join(f"{t:.2f},{0.01 * np.sin(t):.6f}\n" for t in time)
    (folder / "swing.csv").write_text("time,joint_1\n" + rows)
    assert campaign.name == "campaign.toml"
    places = "".join(f"0.5,{y:.4f},0.35\n" for y in np.linspace(-0.01, 0.01, 30))
    (folder / "measured.csv").write_text("x,y,z\n" + places)
    shutil.copy(robots_folder() / "cs8.toml", folder / "controller.toml")
    (folder / "cascade.toml").write_text(CASCADE)
    write_test(folder, "weights", 1e5, 1.0, np.random.default_rng(0))
    (folder / "weights.toml").write_text(WEIGHTS)
    write_poses(folder, load_robot("rx90b_4dof"), "joint_4", 30)
    lerobot(folder)
    arm = linear_campaign.viscous_robot()
    runs = linear_campaign.recordings_at(
        arm, linear_campaign.BENT[0], np.random.default_rng(0), realisations=2, noise=1e-4
    )
    (folder / "periodic").mkdir()
    linear_campaign.write(folder / "periodic", arm, runs)


@dataclass(frozen=True)
class Call:
    """A command that works, the files that it reads, and its options with values of each kind."""

    words: tuple[str, ...]
    files: tuple[str, ...]
    options: tuple[tuple[str, tuple[str, ...]], ...] = ()
    out: str = "out"


def _numbers(*options: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple((option, NUMBERS) for option in options)


_OF_A_CAMPAIGN = ("campaign.toml", "robot_declared.toml", "two_joints.urdf", "log_1.csv", "log_2.csv")
_FLEXIBLE = ("periodic/robot.toml", "periodic/robot.urdf")
_ROBOT = ("robot_declared.toml", "two_joints.urdf")
_IMPORT = (
    *_numbers("--rate", "--gear", "--offset"),
    *(("--joints", WORDS), ("--columns", WORDS), ("--topic", WORDS), ("--format", WORDS)),
)
_ONE_RUN = ("--no-correct", "--no-contributions")
_PATH = (*_numbers("--tolerance-mm", "--speed-mm-s", "--iterations", "--jobs"), ("--robot", WORDS))
_VIEW = (*_numbers("--pose", "--count", "--magnify"), ("--tip", WORDS), ("--beside", WORDS))
_FRF = (
    *_numbers(
        "--low-hz",
        "--high-hz",
        "--mains-hz",
        "--link-mass-std",
        "--bending-alike-std",
        "--seed",
        "--jobs",
        "--modes",
        "--start-hz",
    ),
    ("--delays", WORDS),
)
_EPISODE = "data/chunk-000/episode_000000.parquet"
_PERIODIC = tuple(f"periodic/{name}" for name in ("campaign.toml", "robot.toml", "run_001_2_minus.parquet"))
_SIMULATE = _numbers("--torque-noise", "--position-noise", "--velocity-noise", "--periods", "--seed")
_EXCITE = (
    *_numbers("--pose", "--peak", "--low-hz", "--high-hz", "--period-s", "--speed", "--swings"),
    *(
        (option, tuple(x for x in NUMBERS if x != "1_000")) for option in ("--realisations", "--periods")
    ),  # a right one, of minutes
    *(("--joints", WORDS), ("--matrix", WORDS), ("--by", WORDS)),
)
_BY_REFERENCE = ("--by", "reference", "--speed-peak", "0.2", "--rate-hz", "500")
IDENTIFY = Call(("identify", "campaign.toml"), _OF_A_CAMPAIGN, (("--estimator", WORDS),))
CALLS = (
    *(IDENTIFY,) * 6,
    *(
        Call(("import", log, "--robot", "robot_declared.toml"), (log, *_ROBOT), _IMPORT)
        for log in ("log_1.csv", "log_1.csv", "log.parquet", "log.mat")
    ),
    Call(("import", _EPISODE, "--robot", "rx90b_3dof"), (_EPISODE, "meta/info.json"), _IMPORT),
    *(Call(("flexify", "robot_declared.toml"), _ROBOT, (("--torsion", WORDS), ("--bending", WORDS)), "out.urdf"),) * 2,
    Call(("check-path", "path.toml", *_ONE_RUN), ("path.toml",), _PATH),
    Call(("check-path", "points.csv", "--speed-mm-s", "100", "--robot", "rx90b_3dof", *_ONE_RUN), ("points.csv",)),
    Call(("check-path", "path.toml", "--measured", "measured.csv"), ("measured.csv", "path.toml")),
    Call(("simulate", "rx90b_3dof", "--trajectory", "swing.csv"), ("swing.csv",), _SIMULATE),
    Call(
        ("simulate", "rx90b", "--trajectory", "swing.csv", "--controller", "controller.toml"),
        ("controller.toml", "swing.csv"),
    ),
    Call(
        ("simulate", "rx90b_3dof", "--trajectory", "swing.csv", "--controller", "cascade.toml"),
        ("cascade.toml",),
    ),
    Call(("excite", "rx90b_3dof", "--realisations", "1", "--periods", "1"), (), _EXCITE),
    Call(
        ("excite", "rx90b_3dof", *_BY_REFERENCE, "--realisations", "1", "--periods", "1"),
        (),
        (*_numbers("--speed-peak", "--rate-hz"), *_EXCITE),
    ),
    Call(
        (
            "excite",
            "rx90b_3dof",
            "--by",
            "both",
            "--controller",
            "cascade.toml",
            "--realisations",
            "1",
            "--periods",
            "1",
        ),
        ("cascade.toml",),
        _numbers("--speed-peak", "--rate-hz"),
    ),
    Call(("frf", "campaign.toml", "--no-replay"), _OF_A_CAMPAIGN, _numbers("--low-hz", "--high-hz", "--mains-hz")),
    Call(("close-loop", "modes.toml", "--robot", "rx90b_3dof"), ("modes.toml",), _numbers("--model-error")),
    Call(("check", "campaign.toml"), _OF_A_CAMPAIGN),
    Call(("view", "periodic/robot.toml"), _FLEXIBLE, _VIEW, "out.html"),
    Call(("view", "robot_declared.toml", "--flexible"), _ROBOT, _VIEW, "out.html"),
    Call(("view", "campaign.toml"), _OF_A_CAMPAIGN, (("--recording", WORDS), *_VIEW), "out.html"),
    Call(("static", "weights.toml"), ("weights.toml", "weights.csv")),
    Call(("camera", "camera.toml"), ("camera.toml", "markers.csv")),
    *(
        Call(("export", "periodic/robot.toml", "--format", kind), _FLEXIBLE, (("--format", WORDS),), f"out.{kind}")
        for kind in ("urdf", "mjcf", "sdf")
    ),
)
# those that take seconds where what is wrong does no harm
SLOW_CALLS = (
    Call(("close-loop", "campaign.toml"), _OF_A_CAMPAIGN, _numbers("--seed", "--model-error")),
    Call(("frf", "periodic/campaign.toml", "--no-replay", "--jobs", "1"), _PERIODIC, _FRF),
)


@dataclass(frozen=True)
class Case:
    """A call with one thing wrong: a file (its name, and what is done to it) or an option."""

    call: Call
    file: str | None
    change: Callable[[Path], None] | None
    words: tuple[str, ...]
    told: str

    def __repr__(self) -> str:
        return f"{' '.join(self.call.words)} {' '.join(self.words)[:200]} [{self.told[:200]}]"


def _rewritten(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def _removed(path: Path) -> None:
    path.unlink()


def _a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _a_dangling_link(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere")


@st.composite
def changes(draw: st.DrawFn, source: Path) -> tuple[Callable[[Path], None], str]:
    """Something that is done to a file, and in words."""
    content = source.read_bytes()
    kind = draw(
        st.sampled_from(["token", "token", "token", "number", "number", "column", "line", "cut", "bytes", "other"])
    )
    if kind == "other":
        return draw(
            st.sampled_from([(_removed, "removed"), (_a_folder, "a folder"), (_a_dangling_link, "a dangling link")])
        )
    try:
        lines = content.decode().split("\n")
    except UnicodeDecodeError:
        kind = kind if kind in ("cut", "bytes") else "bytes"
    if kind == "cut":
        at = draw(st.integers(0, len(content) - 1))
        return (lambda path: _rewritten(path, content[:at])), f"cut at {at}"
    if kind == "bytes":
        altered = bytearray(content)
        for at in draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=20)):
            altered[at] = draw(st.integers(0, 255))
        return (lambda path: _rewritten(path, bytes(altered))), "bytes altered"
    row = draw(st.integers(0, min(len(lines), 40) - 1))
    if kind == "column" and source.suffix == ".csv":
        value, column = draw(st.sampled_from(NUMBERS)), draw(st.integers(0, lines[0].count(",")))
        cells = [line.split(",") for line in lines]
        changed = [lines[0], *(",".join([*c[:column], value, *c[column + 1 :]]) for c in cells[1:])]
        how = f"column {column + 1} all {value!r}"
    elif kind in ("number", "column") and (found := list(NUMBER.finditer(lines[row]))):
        one, value = draw(st.sampled_from(found)), draw(st.sampled_from(NUMBERS))
        how = f"{one[0]} becomes {value!r}"
        changed = [*lines[:row], lines[row][: one.start()] + value + lines[row][one.end() :], *lines[row + 1 :]]
    elif kind == "line":
        how = draw(st.sampled_from(["twice", "gone", "moved"]))
        changed = (
            lines[:row]
            + ([lines[row]] * 2 if how == "twice" else [])
            + lines[row + 1 :]
            + ([lines[row]] if how == "moved" else [])
        )
    else:
        token = draw(st.sampled_from(TOKENS))
        for mark in draw(st.permutations(["=", ",", '"'])):
            if mark in lines[row]:
                parts = lines[row].split(mark)
                parts[draw(st.integers(0, len(parts) - 1))] = token
                how, changed = f"{mark} {token!r}", [*lines[:row], mark.join(parts), *lines[row + 1 :]]
                break
        else:
            how, changed = repr(token), [*lines[:row], token, *lines[row + 1 :]]
    return (lambda path: _rewritten(path, "\n".join(changed).encode())), f"line {row + 1}: {how}"


@st.composite
def cases(draw: st.DrawFn, inputs: Path, calls: Sequence[Call] = CALLS) -> Case:
    """A case of one of the calls, from files that lie in `inputs`."""
    call = draw(st.sampled_from(calls))
    if call.options and (not call.files or draw(st.integers(0, 2)) == 0):
        option, values = draw(st.sampled_from(call.options))
        value = draw(st.sampled_from(values))
        return Case(call, None, None, (f"{option}={value}",), "")
    file = draw(st.sampled_from(call.files))
    change, told = draw(changes(inputs / file))
    return Case(call, file, change, (), f"{file}: {told}")


def laid_out(case: Case, inputs: Path, folder: Path) -> None:
    """The files of a case in a folder."""
    shutil.copytree(inputs, folder)
    if case.file is not None and case.change is not None:
        case.change(folder / case.file)
