"""Which joints' drives stick at a reversal, so that their friction goes over while they stand still."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from rx90b_flex.effects.friction import CoulombFriction, StribeckFriction
from rx90b_flex.effects.motion import Array, Held, Mask, Motion
from rx90b_flex.effects.reversal import Resolution

if TYPE_CHECKING:
    from rx90b_flex.identify.regression import Regression

TURNOVERS = (2e-4, 1e-3, 5e-3, 2e-2)  # rad/s, within which friction may turn over
FADES = (0.02, 0.1, 0.5)  # of the joint's speed, over which it may fade
RIDGE = 1e-12  # of the columns' size: what a motion does not tell apart
SHOWN = 0.01  # of a pause, behind the low-pass
BLOCKS, MOST = 4, 3  # of the samples: each predicted by the others, and so many of them better


def drives_that_stick(regression: Regression) -> tuple[Held, ...]:
    """Joints whose torques are predicted better by friction that goes over in sticks than by one that the speed shows all the time.

    Either may fade with speed, and turns over within the best of some speeds; beside it stand the links, viscous friction and drive
    inertia. What friction does at other speeds must not tell how it goes over. At turns most of some blocks are predicted better by
    the others, and all of them together; where drives also pause on their way, what they hold then is asked beside that.
    """
    held = regression if regression.excerpt is None else regression.excerpt[0]
    turns = held.with_sticking(tuple((j, "turn") for j in held.joints))
    shown = held.with_sticking(())
    out: list[Held] = []
    for joint in held.joints:
        if not any(_sticks(s.motion, joint) for s in turns.segments):
            continue
        smooth, pauses = _smooth(held, joint), _pauses(held, joint)
        at_turns, by_speed = (_least(r, joint, smooth, ~pauses) for r in (turns, shown))
        if at_turns.sum() < by_speed.sum() and (at_turns < by_speed).sum() >= MOST:
            out.append((joint, "turn"))
            whole, but_pauses = (_least(r, joint, smooth, pauses | True).sum() for r in (held, turns))
            if whole <= but_pauses:  # the same where these recordings show none
                out.append((joint, "pause"))
    return tuple(out)


def _sticks(motion: Motion, joint: str) -> bool:
    return motion.stuck is not None and not np.isnan(motion.stuck[:, motion.coordinates.joints.index(joint)]).all()


def _pauses(regression: Regression, joint: str) -> Mask:
    """Rows (N,) that show what a joint's drive holds where it pauses and goes on as it was."""
    place = regression.robot.layout.joints.index(joint)
    return np.concatenate(
        [np.abs(s.brought(s.motion.pauses[:, place].astype(float))) > SHOWN for s in regression.segments]
    )


def _smooth(regression: Regression, joint: str) -> Array:
    """Columns (N, k) of what a joint's torque has beside dry friction."""
    place, at = regression.joints.index(joint), regression.robot.layout.index(joint)
    links = regression.links_in(place)
    own = [
        s.brought(np.stack([s.motion.v[:, at], s.motion.a[:, at], np.ones(len(s.motion))], axis=1))
        for s in regression.segments
    ]
    return np.hstack([links[:, links.any(axis=0)], np.concatenate(own)])


def _dry(regression: Regression, joint: str, turnover: float) -> Array:
    """Columns (N, k) of dry friction: some that stays at all speeds, some that fades."""
    speed = max(Resolution.of(s.motion.joint(joint)).speed for s in regression.segments)
    fading = [
        StribeckFriction(joint=joint, torque=1.0, velocity=part * speed, power=1.0, turnover=turnover) for part in FADES
    ]
    _, columns = regression.compact([CoulombFriction(joint=joint, torque=1.0, turnover=turnover), *fading])
    return np.asarray(columns[:, 0])


def _least(regression: Regression, joint: str, smooth: Array, told: Mask) -> Array:
    """What `_left` of some rows, with the turn-over that leaves least."""
    torque = regression.torque[told, regression.joints.index(joint)]
    return min((_left(torque, smooth[told], _dry(regression, joint, w)[told]) for w in TURNOVERS), key=np.sum)


def _left(torque: Array, smooth: Array, dry: Array) -> Array:
    """Squared torque of each block that columns (N, k) and those of dry friction, fitted to the others, leave."""
    columns = np.column_stack([smooth, dry])
    columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    blocks = [slice(int(a), int(b)) for a, b in pairwise(np.linspace(0, len(torque), BLOCKS + 1))]
    grams = np.array([columns[b].T @ columns[b] for b in blocks])
    rights = np.array([columns[b].T @ torque[b] for b in blocks])
    out = np.zeros(BLOCKS)
    for i, block in enumerate(blocks):
        gram, right = grams.sum(axis=0) - grams[i], rights.sum(axis=0) - rights[i]
        theta = np.linalg.solve(gram + RIDGE * np.eye(len(gram)), right)
        out[i] = np.sum((torque[block] - columns[block] @ theta) ** 2)
    return out
