"""A kind of data that the package does not know, closed as `docs/guides/new_residual.md` says: joints turned by dead weights."""

from __future__ import annotations

import json

import numpy as np
import pytest

from rx90b_flex.diagnose import Change, TableResidual, close_residual

JOINTS = ("shoulder", "elbow", "wrist")
LENGTHS = np.array([0.45, 0.45, 0.1])  # m, of a planar arm from the vertical
STIFFNESS = np.array([8.0e4, 3.0e4, 1.0e4])  # N m/rad, declared
STD = 2e-6  # rad, of a measured turn
NOISE = 1e-3  # a model error that is stated


def load(angles: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Torque of weights at the tip about each joint, (tests, joints), N m."""
    reach = LENGTHS * np.sin(np.cumsum(angles, axis=1))
    return 9.81 * mass[:, None] * np.cumsum(reach[:, ::-1], axis=1)[:, ::-1]


def turned(torque: np.ndarray, stiffness: np.ndarray = STIFFNESS, gap: np.ndarray | None = None) -> np.ndarray:
    """Turn of each joint under load, rad: its spring's, and half of the gap that a load takes up."""
    half = 0.5 * np.sign(torque) * (np.zeros(3) if gap is None else gap)
    return torque / stiffness + half


class DeadWeights(TableResidual):
    """Turns of joints under known loads; what may be missing is another stiffness or a backlash of each."""

    def __init__(self, torque: np.ndarray, turns: np.ndarray, std: float) -> None:
        super().__init__(turns.ravel(), np.full(turns.size, std), NOISE)
        self.torque = torque

    @property
    def changes(self) -> tuple[Change, ...]:
        return CHANGES

    def predict(self, changes: tuple[Change, ...], x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        springs = self.torque / STIFFNESS
        out, slopes = springs.copy(), np.zeros((*springs.shape, len(x)))
        for k, (change, value) in enumerate(zip(changes, np.exp(x), strict=True)):
            j = JOINTS.index(change.place)
            if change.adds:
                part = 0.5 * value * np.sign(self.torque[:, j])
                slopes[:, j, k] = part
            else:
                part = springs[:, j] / value - springs[:, j]
                slopes[:, j, k] = -springs[:, j] / value
            out[:, j] += part
        return out.ravel(), slopes.reshape(out.size, len(x))


def another_stiffness(joint: str) -> Change:
    starts = np.log([[0.6], [1.6]])
    return Change("joint_spring", joint, False, ("stiffness",), ("N m/rad",), starts, np.zeros(1), 1.0)


def backlash(joint: str) -> Change:
    start = np.log([[1e-4]])
    return Change("backlash", joint, True, ("gap",), ("rad",), start, start[0], 2.0)


CHANGES = tuple(make(joint) for make in (another_stiffness, backlash) for joint in JOINTS)


def measured(seed: int, factor: tuple[float, float, float] = (1, 1, 1), gap: tuple[float, float, float] = (0, 0, 0)):
    rng = np.random.default_rng(seed)
    angles, mass = rng.uniform(-1.5, 1.5, (24, 3)), rng.uniform(5.0, 20.0, 24)
    torque = load(angles, mass)
    turns = turned(torque, STIFFNESS * factor, np.array(gap))
    return torque, turns + STD * rng.standard_normal(turns.shape)


def closed(torque: np.ndarray, turns: np.ndarray):
    return close_residual(DeadWeights(torque, turns, STD))


@pytest.mark.parametrize("seed", range(5))
def test_where_nothing_is_hidden_nothing_is_found(seed):
    result = closed(*measured(seed))
    assert (result.verdict, result.found, result.refused) == ("nothing_missing", (), ())


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("hidden", "label", "value"),
    [
        ({"factor": (1, 0.7, 1)}, "elbow.stiffness", 0.7),
        ({"factor": (1.05, 1, 1)}, "shoulder.stiffness", 1.05),
        ({"gap": (0, 0, 1e-4)}, "wrist.backlash", 1e-4),
    ],
)
def test_a_hidden_change_is_found_with_its_value(hidden, label, value, seed):
    result = closed(*measured(seed, **hidden))
    assert ([f.change.label for f in result.found], result.verdict) == ([label], "explained")
    (found,) = result.found
    assert abs(found.values[0] - value) < 4 * found.stds[0]
    assert found.stds[0] < 0.05 * value


def test_two_changes_of_one_joint_are_told_apart():
    result = closed(*measured(0, factor=(1, 0.7, 1), gap=(0, 2e-4, 0)))
    assert {f.change.label for f in result.found} == {"elbow.stiffness", "elbow.backlash"}
    assert result.verdict == "explained"


def test_what_no_change_explains_is_not_called_explained():
    """A spring that stiffens with load."""
    torque, turns = measured(0)
    turns = turns + 2e-5 * np.sin(torque / 5.0)
    assert closed(torque, turns).verdict in ("unexplained", "partly_explained")


def test_what_was_found_can_be_written():
    content = json.loads(json.dumps(closed(*measured(0, gap=(0, 0, 1e-4))).as_json(), allow_nan=False))
    assert content["verdict"] == "explained"
    (effect,) = content["effects"]
    assert (effect["type"], effect["place"], effect["change"]) == ("backlash", "wrist", "added")
    assert list(effect["parameters"]) == ["gap"]


def test_numbers_without_standard_deviations_are_refused():
    torque, turns = measured(0)
    with pytest.raises(ValueError, match="above 0"):
        DeadWeights(torque, turns, 0.0)
