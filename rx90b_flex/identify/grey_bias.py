"""What separates the response of a moving robot from a grey box's model: smooth errors, and how they weigh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.frequency_response import ComplexArray


@dataclass(frozen=True, eq=False)
class GreyBias:
    """Smooth errors of a model, as random functions of frequency: the covariance of whitened errors is ``1 + Q diag(s^2) Q^H``."""

    directions: ComplexArray  # Q, (F * n*n, K), orthonormal
    shrink: Array  # 1 - 1 / sqrt(1 + s^2), (K,)

    def white(self, errors: ComplexArray) -> ComplexArray:
        """Errors or slopes (F * n*n, ...) brought to unit variance."""
        inside = self.directions.conj().T @ errors
        return errors - self.directions @ (self.shrink[:, None] * inside if errors.ndim == 2 else self.shrink * inside)


def bias_functions(
    whitener: ComplexArray, hz: Array, model: ComplexArray, friction: ComplexArray, reach_hz: float
) -> tuple[ComplexArray, ComplexArray]:
    """Whitened functions whose random sums are errors of independent entries, as large as |model| (F, n, n), and of frictions.

    A joint's friction torque acts on all drives alike whatever brings it about, so that its error is a column of the derivative by
    its slope, (joints, F, n, n), on its own for each input. They stay alike over `reach_hz`. Returns two arrays
    (F * n*n, K).
    """
    values, vectors = np.linalg.eigh(np.exp(-0.5 * ((hz[:, None] - hz) / reach_hz) ** 2))
    basis = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, values > 1e-3 * values[-1]]
    lines, entries = len(hz), model[0].size
    own = np.abs(model).reshape(lines, entries, 1, 1) * np.eye(entries)[:, :, None] * basis[:, None, None, :]
    inputs = friction[..., None] * np.eye(model.shape[-1])  # (joints, F, n, n, n): by the last, one column each
    shared = np.moveaxis(inputs, 0, -1).reshape(lines, entries, -1)[..., None] * basis[:, None, None, :]
    first, second = ((whitener @ f.reshape(lines, entries, -1)).reshape(lines * entries, -1) for f in (own, shared))
    return first, second


def bias_of(model: ComplexArray, friction: ComplexArray, sizes: tuple[float, float]) -> GreyBias:
    """Of `bias_functions`, as large as the sizes of the model's and of the frictions' error say."""
    functions = np.concatenate([sizes[0] * model, sizes[1] * friction], axis=1)
    directions, s, _ = np.linalg.svd(functions, full_matrices=False)
    return GreyBias(directions, 1.0 - 1.0 / np.sqrt(1.0 + s**2))
