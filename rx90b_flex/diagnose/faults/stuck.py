"""Joints that do not move, or whose position stands still in the log while the joint goes on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rx90b_flex.diagnose.faults.at_rest import UNEXPLAINED, AtRest
from rx90b_flex.diagnose.faults.coarse import Coarse, Stretch
from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.effects.motion import Array, Indices, Mask
from rx90b_flex.signals import Recording
from rx90b_flex.signals.data_fault import DataFault

NEVER = 1e-3  # rad or m in all: noise and the play of a brake
HARDLY = 0.02  # rad or m: too little for a parameter to stand out of friction
FROZEN_S = 0.3  # the same number for so long
FEWEST = 12  # samples
MOVING = 0.05  # of a joint's largest step from sample to sample, with which it moves
NOTHING = 0.6  # of the samples in which a joint moves: a torque that is zero in more of them is none that was measured
JUMP = 8.0  # times the usual step at the end of such a segment, and times the usual length of a torque's
USUAL_RUN = 0.9  # of the stretches in which a torque keeps a value are shorter: with a coarse torque there are many
MOST = 0.8  # of a torque's stretch in which the joint moves
CHANGES = 0.5  # of the steps in motion: so many change a torque with noise,
TURNS = 0.5  # and of these go back: two thirds are usual
LONGEST = 20  # such stretches of a column that are looked at
SWINGS = 0.2  # of the same torque's standard deviation in other recordings: more than noise


def moves(recordings: Sequence[Recording]) -> Array:
    """Range of each joint over all recordings, shape (joints,), rad."""
    return range_of([r.position for r in recordings])


def range_of(signals: Sequence[Array]) -> Array:
    """Range of each column of recordings' signals, each (N, joints), over all of them, (joints,)."""
    return np.max([x.max(axis=0) for x in signals], axis=0) - np.min([x.min(axis=0) for x in signals], axis=0)


def not_measured(recordings: Sequence[Recording]) -> Mask:
    """Joints whose torque is one value throughout, or zero in most of their motion, shape (joints,): friction alone is not."""
    step = [np.abs(np.diff(r.position, axis=0)) for r in recordings]
    least = MOVING * np.max([x.max(axis=0) for x in step], axis=0)
    moved, torque = np.concatenate([x > least for x in step]), [r.torque for r in recordings]
    nothing = moved & (np.concatenate([x[1:] for x in torque]) == 0.0)
    return np.asarray((nothing.sum(axis=0) > NOTHING * moved.sum(axis=0)) | (range_of(torque) == 0.0))


def moves_within(recordings: Sequence[Recording]) -> Array:
    """The largest range of each joint in a recording, shape (joints,), rad: it may stand elsewhere in each."""
    return np.max([np.ptp(r.position, axis=0) for r in recordings], axis=0)


def stuck(recordings: Sequence[Recording], errors: Array, at_rest: AtRest) -> Iterator[DataFault]:
    """Joints that never move: held, by their torque's relative error under the rigid model (joints,) or by what a joint at rest may
    leave, or their sensor stands.
    """
    moved = (errors >= UNEXPLAINED) & at_rest.moved()
    for joint, reach, went in zip(recordings[0].joints, moves(recordings), moved, strict=True):
        if reach > NEVER:
            continue
        cure = (
            "but its torque is not that of a joint at rest: check the sensor and its column"
            if went
            else "it is taken as held; its own parameters are not told"
        )
        message = f"{joint} never moves in the log (by {reach:.2g} rad in all): {cure}."
        yield DataFault("stuck", "motor_position", (joint,), message, usable=not went)


def stuck_in_one(recordings: Sequence[Recording], look: Look, at_rest: AtRest) -> Iterator[DataFault]:
    """Joints whose position keeps one number all through a recording, while their torque swings as that of none at rest does."""
    swing = np.array([x.std(axis=0) for x in (look.measured()[span] for span in look.sample.spans)])
    moved = at_rest.moved_in()
    for i, recording in enumerate(recordings):
        for k, joint in enumerate(recording.joints):
            elsewhere = np.delete(swing[:, k], i).max(initial=0.0)
            still = np.ptp(recording.position[:, k]) == 0.0 and any(
                np.ptp(r.position[:, k]) > NEVER for r in recordings
            )
            if still and swing[i, k] > SWINGS * elsewhere and moved[i, k]:
                message = (
                    f"{recording.file_name}: the position of {joint} keeps one number all through, but its torque is not that of a "
                    "joint at rest: its sensor stood, or the column is not its; leave the recording out."
                )
                yield DataFault("stuck", "motor_position", (joint,), message)


def frozen(recordings: Sequence[Recording], coarse: Coarse | None = None) -> Iterator[DataFault]:
    """Positions that keep the same number for a while and then jump to where the joint has gone; torques that keep it in motion, but
    for those in coarse steps that may.
    """
    held = _held_torques(recordings, coarse)
    for i, recording in enumerate(recordings):
        need = _need(recording)
        for k, joint in enumerate(recording.joints):
            found = (
                (
                    "motor_position",
                    f"the position of {joint} stands still",
                    "then jumps",
                    _lost(recording.position[:, k], need),
                ),
                (
                    "torque",
                    f"the torque of {joint} keeps one value",
                    "the joint moves on",
                    [r.start + 1 for r in held if (r.recording, r.column) == (i, k)],
                ),
            )
            for signal, what, but, rows in found:
                if rows:
                    message = (
                        f"{recording.file_name}: {what} from row {rows[0]} on and {but}: samples were lost; leave the part out "
                        "(start_s, end_s)."
                    )
                    yield DataFault("stuck", signal, (joint,), message, rows=tuple(rows[:20]))


def _need(recording: Recording) -> int:
    """Samples of the shortest stretch."""
    return max(FEWEST, round(FROZEN_S * recording.sample_rate_hz))


def _held_torques(recordings: Sequence[Recording], coarse: Coarse | None) -> list[Stretch]:
    """Stretches in which a torque keeps one value while its joint moves on, and not for its resolution."""
    held, in_doubt = [], []
    for i, recording in enumerate(recordings):
        need = _need(recording)
        for k, (torque, position) in enumerate(zip(recording.torque.T, recording.position.T, strict=True)):
            if coarse is not None and coarse.steps[k] > 0.0 and not _noisy(torque, position):
                runs = [Stretch(i, k, *rows) for rows in _held(torque, position, need, seldom=False)]
                # if the longest may, others may
                in_doubt += sorted(runs, key=lambda r: r.start - r.end)[:LONGEST]
            else:
                held += [Stretch(i, k, *rows) for rows in _held(torque, position, need)]
    may = coarse.may_keep(in_doubt) if coarse is not None else set()
    return sorted([*held, *(r for r in in_doubt if r not in may)])


def _noisy(torque: Array, position: Array) -> bool:
    """Whether a torque goes to and fro from sample to sample by more than its steps: it does not keep a value by chance."""
    change = np.diff(torque)[_in_motion(position)]
    product = change[1:] * change[:-1]
    turns = product[product != 0.0] < 0.0
    return bool(turns.any() and turns.mean() > TURNS and (change != 0.0).mean() > CHANGES)


def _in_motion(position: Array) -> Mask:
    speed = np.abs(np.diff(position))
    return np.asarray(speed > MOVING * speed.max())


def _runs(x: Array) -> tuple[Indices, Indices]:
    """First and last steps of all that keep one value, counted from 0."""
    edges = np.flatnonzero(np.diff(np.diff(x) == 0.0, prepend=False, append=False))
    return edges[::2], edges[1::2]


def _lost(position: Array, need: int) -> list[int]:
    """First rows, counted from 1, of positions that stand so long and then jump."""
    starts, ends = _runs(position)
    steps = np.diff(position)
    jump = np.abs(np.append(steps, 0.0))[ends]
    # a joint at rest leaves slowly; one whose sensor stood is somewhere else at the next sample
    usual = np.quantile(np.abs(steps), 0.99)
    lost = (ends - starts >= need) & (jump > JUMP * usual) & (usual > 0.0)
    return [int(start) + 1 for start in starts[lost]]


def _held(torque: Array, position: Array, need: int, seldom: bool = True) -> list[tuple[int, int]]:
    """First and last rows, counted from 0, of a torque that keeps one value so long in motion, and `seldom` for long otherwise; zero
    or its largest value is another's.
    """
    starts, ends = _runs(torque)
    if not len(starts):
        return []
    before = np.concatenate([[0], np.cumsum(_in_motion(position))])
    moved = (before[ends] - before[starts]) / (ends - starts)
    usual = np.quantile(ends - starts, USUAL_RUN) if seldom and len(starts) > FEWEST else 1.0
    value = torque[starts]
    known = (value == 0.0) | (value == torque.max()) | (value == torque.min())
    held = (ends - starts >= max(need, JUMP * usual)) & (moved > MOST) & ~known
    return [(int(start), int(end)) for start, end in zip(starts[held], ends[held], strict=True)]


def no_excitation(recordings: Sequence[Recording]) -> list[DataFault]:
    """Joints that move too little to tell anything; all of them, and the data are of no use."""
    reach, fitted = moves(recordings), moves([r for r in recordings if r.role == "identification"] or recordings)
    names = recordings[0].joints
    if (fitted < HARDLY).all():
        message = f"No joint moves by more than {fitted.max():.2g} rad in what is fitted: record a motion that uses their range."
        return [DataFault("no_excitation", None, names, message)]
    hardly = tuple(j for j, r in zip(names, reach, strict=True) if NEVER < r < HARDLY)
    if not hardly:
        return []
    message = f"{', '.join(hardly)} hardly move(s) (less than {HARDLY:g} rad): what only these tell is not told."
    return [DataFault("no_excitation", None, hardly, message, usable=True)]
