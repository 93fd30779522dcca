"""On which side of the gears torques were measured: stated in the campaign file, or worked out."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.faults.look import Look
from rx90b_flex.diagnose.faults.rigid_fit import FLOOR, OUT, PER_JOINT
from rx90b_flex.diagnose.faults.sample import BASICS
from rx90b_flex.diagnose.faults.sizes import far_below, torque_sizes
from rx90b_flex.effects.motion import Mask
from rx90b_flex.signals.data_fault import DataFault

NO_WORSE = 1.1  # squared error without friction and rotor inertia, over that with them, at which they do not show


@dataclass(frozen=True)
class TorqueSide:
    """What the torques are torques of.

    Attributes
    ----------
    stated : str or None
        ``motor``, ``joint`` or ``behind_gear``, as the campaign file has it.
    found : str or None
        What the torques themselves say: ``motor`` where one is far too small for the links, ``behind_gear`` where neither
        friction nor rotor inertia shows in any, else ``joint``; None where nothing could be fitted.
    message : str
        In a sentence; empty where all is as it usually is.
    """

    stated: str | None
    found: str | None
    message: str


NOT_LOOKED_AT = TorqueSide(None, None, "")


def torque_side(
    stated: str | None, look: Look, faults: Sequence[DataFault], moving: Mask, of_open_size: Collection[str] = ()
) -> TorqueSide:
    """Work out the side from a look with every fault mended, and hold it against what is stated.

    Parameters
    ----------
    moving : array of bool, shape (joints,)
    of_open_size : collection of str
        Joints whose torque is a current, its constant to be identified.
    """
    known = {j for f in faults if f.kind == "unrelated" for j in f.joints}.union(of_open_size)
    small = {
        j for f in faults if f.kind == "unit" and f.signal == "torque" and (f.factor or 1.0) < 1.0 for j in f.joints
    }
    small |= {look.sample.joints[k] for k in torque_sizes(look)[1]} - known
    if small:
        whose = "Torques are" if len(small) == len(moving) else f"Torques of {', '.join(sorted(small))} are"
        text = f"{whose} far too small for the links: those of the motors, it seems. State gear_matrix."
        return TorqueSide(stated, "motor", text)
    if not moving.any():
        return TorqueSide(stated, None, "")
    found = "joint" if _drives_show(look, moving) else "behind_gear"
    return TorqueSide(stated, found, _words(stated, found) or far_below(look, known))


def _words(stated: str | None, found: str) -> str:
    if found == "behind_gear" and stated != "behind_gear":
        return (
            "Neither friction nor rotor inertia shows in any torque, as with sensors behind the gears: if they are such, state "
            '[torque] side = "behind_gear", and declare none of both.'
        )
    if found == "joint" and stated == "behind_gear":
        return "Stated as measured behind the gears, yet friction or rotor inertia shows in the torques: are they the motors'?"
    return ""


def _drives_show(look: Look, moving: Mask) -> bool:
    """Whether a moving joint's torque is predicted better with what sits in its drive than with links and offsets alone."""
    links, columns = look.reading.links, look.columns(look.reading).shape[2]
    # a sensor behind the gear has an offset, too
    offsets = links + PER_JOINT * np.arange(len(look.sample.joints)) + BASICS.index("torque_offset")
    without = look.fit_held([c for c in range(links, columns) if c not in offsets], OUT)
    worse = without.error + FLOOR > NO_WORSE * (look.fit().error + FLOOR)
    return bool((worse & moving).any())
