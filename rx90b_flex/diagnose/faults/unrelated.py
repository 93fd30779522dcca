"""Torques that have nothing to do with the motion."""

from __future__ import annotations

from collections.abc import Sequence

from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.signals.data_fault import DataFault

NOTHING = 0.9  # squared held-out error over the variance: 1 is what a constant leaves
NOTHING_SEEN = 0.5  # the same on the rows that were fitted: where more of it goes, the motion is too short to tell


def unrelated(joints: Sequence[str], error: Array, seen: Array, moving: Mask, constant: Mask) -> list[DataFault]:
    """Moving joints whose torque the rigid model with friction predicts no better than a constant would.

    Parameters
    ----------
    error : array, shape (joints,)
        Squared held-out error over the torque's variance, everything else mended.
    seen : array, shape (joints,)
        The same of a fit to these very rows.
    moving, constant : array of bool, shape (joints,)
        Joints that move; joints whose torque was not measured (`not_measured`).
    """
    strange = (error > NOTHING) & (seen > NOTHING_SEEN) & ~constant
    found = (
        (
            constant,
            "is zero in most of the motion, or one value throughout: was it measured? Without such joints in `joints` the others "
            "can be used.",
        ),
        (
            strange,
            "has nothing to do with the motion (nothing of it can be predicted from position): check that the columns are torques, "
            "and of the same run.",
        ),
    )
    out = []
    for chosen, what in found:
        names = tuple(j for j, here in zip(joints, chosen & moving, strict=True) if here)
        if names:
            out.append(DataFault("unrelated", "torque", names, f"The torque of {', '.join(names)} {what}"))
    return out
