"""Whether added effects mostly cancel: then their sum is told, and their own values are not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rx90b_flex.effects import Effect
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.regression import Regression

TIMES = 2.0  # the torque of what was added to a joint together, that each of two is at the least


def cancelling(model: Identification, added: Sequence[Effect], held_out: Regression) -> Iterator[str]:
    """One caution a joint on which they do, from the torques' changes on recordings that were not fitted.

    Parameters
    ----------
    model : Identification
    added : sequence of Effect
        Of the model's effects, those that a search added; of those that multiply a torque, or act on it, nothing is said.
    held_out : Regression
    """
    some = [e for e in added if e.traits.in_dynamics and not e.traits.multiplies and e.known]
    seen = held_out.with_model(model.link_parameters, model.effects)
    parts: dict[int, list[tuple[Effect, np.ndarray]]] = {}
    for effect, (rows, columns) in zip(some, seen.each(some, once=True), strict=True):
        torque = columns @ effect.known_coefficients()
        for j, row in enumerate(rows.tolist()):
            parts.setdefault(row, []).append((effect, torque[:, j]))
    for row, each in sorted(parts.items()):
        if row >= len(seen.joints):
            continue
        together = float(np.sum([torque for _, torque in each], axis=0).std())
        sizes = [(effect.label, float(torque.std())) for effect, torque in each]
        unit = seen.robot.force_unit((seen.joints[row],))
        large = [f"{name} ({size:.3g} {unit} rms)" for name, size in sizes if size > TIMES * together]
        if len(large) > 1:
            yield (
                f"On {seen.joints[row]}, {' and '.join(large)} mostly cancel: together they change its torque by {together:.3g} "
                f"{unit} rms. Their own values and standard deviations say little, their sum does: a law that the catalogue does not "
                "have may stand behind them."
            )
