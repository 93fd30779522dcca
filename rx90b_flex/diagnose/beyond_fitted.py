"""Whether what is left of held-out torques lies where no fitted recording was: at other positions or speeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90b_flex.effects.motion import Array

LARGE = 0.5  # of a joint's squared error: so much at positions or speeds that were not fitted is worth a word
TIMES = 4.0  # mean squared error there over that elsewhere, at the least


def beyond_fitted(
    joints: Sequence[str], fitted: dict[str, Array], held_out: dict[str, Array], left: Array
) -> tuple[str, ...]:
    """Cautions about joints whose error is one of extrapolation, one a joint.

    Parameters
    ----------
    joints : sequence of str
    fitted, held_out : dict of arrays (N, joints) and (M, joints)
        Of all recordings of a role, by what is compared: ``positions``, ``speeds``.
    left : array, shape (M, joints)
        Torque error on the held-out ones, N m (N).
    """
    out = []
    for j, joint in enumerate(joints):
        squares = left[:, j] ** 2
        for what, values in held_out.items():
            low, high = fitted[what][:, j].min(), fitted[what][:, j].max()
            outside = (values[:, j] < low) | (values[:, j] > high)
            if not outside.any() or outside.all():
                continue
            there, elsewhere = np.sqrt(squares[outside].mean()), np.sqrt(squares[~outside].mean())
            times = there / max(elsewhere, 1e-300)
            if squares[outside].sum() > LARGE * squares.sum() and times > np.sqrt(TIMES):
                out.append(
                    f"Held out, {joint} reaches {what} that no fitted recording has, in {outside.mean():.0%} of the samples: "
                    f"errors there are {times:.0f} times those elsewhere. What was fitted says little of that."
                )
                break
    return tuple(out)
