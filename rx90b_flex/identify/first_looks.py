"""Columns that a search's first looks ask for in every round, kept from one to the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rx90b_flex.effects import Effect
from rx90b_flex.effects.motion import Array, Indices

KEPT_BYTES = 5e7  # of columns kept for a search's next round


@dataclass(eq=False)
class _KeptColumns:
    rows: Indices
    columns: NDArray[np.float32]
    asked: bool = True  # since the last round was over


FirstColumns = list[tuple[Effect, _KeptColumns | None]]


@dataclass(frozen=True, eq=False)
class FirstLooks:
    """Columns of one motion, by effects whose columns depend on motion alone."""

    _known: dict[Effect, _KeptColumns] = field(default_factory=dict)

    def clear(self) -> None:
        """Give all of it back."""
        self._known.clear()

    def round_over(self) -> None:
        """Give back what this round did not ask for, such as shapes that followed what another model left."""
        for effect in [e for e, kept in self._known.items() if not kept.asked]:
            del self._known[effect]
        for kept in self._known.values():
            kept.asked = False

    @property
    def known(self) -> set[Effect]:
        """Effects whose columns are kept."""
        return set(self._known)

    def since(self, known: set[Effect]) -> FirstColumns:
        """Effects that were asked for since the last round was over, with those columns that were not known before."""
        return [(e, None if e in known else kept) for e, kept in self._known.items() if kept.asked]

    def take(self, asked: FirstColumns) -> None:
        """What another process asked for and made."""
        for effect, new in asked:
            if new is not None:
                self._keep({effect: new})
            elif effect in self._known:
                self._known[effect].asked = True

    def columns(
        self, effects: Sequence[Effect], make: Callable[[Sequence[Effect]], tuple[Indices, Array]]
    ) -> tuple[Indices, Array]:
        """Columns (N, rows, sum of k) of effects in one place side by side, and these rows; what is not known is made."""
        found = {e: self._known[e] for e in effects if e in self._known}
        new = [e for e in dict.fromkeys(effects) if e not in found]
        for kept in found.values():
            kept.asked = True
        if new:
            rows, columns = make(new)
            ends = np.cumsum([len(e.coefficients) for e in new])[:-1]
            parts = np.split(columns.astype(np.float32), ends, axis=2)
            made = {e: _KeptColumns(rows, part) for e, part in zip(new, parts, strict=True)}
            self._keep(made)
            found |= made
        together = found[effects[0]].rows
        return together, np.concatenate([found[e].columns for e in effects], axis=2, dtype=float)

    def _keep(self, new: dict[Effect, _KeptColumns]) -> None:
        """As far as there is room: all that is known will be asked for again, and none of it is worth more than what is new."""
        held = sum(k.columns.nbytes for k in self._known.values())
        if held + sum(k.columns.nbytes for k in new.values()) <= KEPT_BYTES:
            self._known.update(new)
