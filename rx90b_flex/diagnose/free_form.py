"""Free forms of a residual: smooth curves fitted by ridge regression, and boosted trees, each judged on parts held out.

A free form names nothing. It says how much of a residual follows from the motion at all, on parts of the data that it was
not fitted to: the measure for models that do name something.

Source: A. E. Hoerl, R. W. Kennard, "Ridge regression", Technometrics 12(1), 1970; J. H. Friedman, "Greedy function
approximation: a gradient boosting machine", Annals of Statistics 29(5), 2001, with the histograms of scikit-learn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import linalg
from threadpoolctl import threadpool_limits

from rx90b_flex.effects.motion import Array, Indices

PENALTIES = np.geomspace(1e-5, 1.0, 6)  # of a ridge, over the samples fitted, for columns of variance one
LEAST_GAIN = 0.01  # of the squared residual; what gains less by another family of columns is left out
SURE = 0.5  # standard errors that are taken off a gain, so that of many families none enters by luck
SPREAD = 12  # segments of equal length whose gains tell the standard error
CONSTANT = 1e-6  # standard deviation over largest value, below which a column is constant
TREES = 60  # boosted at the most
LEAVES = 8
SMALLEST_LEAF = 20
LEARNING_RATE = 0.1
NO_FORM = "none"


@dataclass(frozen=True, eq=False)
class FreeForm:
    """A free form of one joint's residual.

    Attributes
    ----------
    name : str
        ``none``, ``smooth curves`` or ``boosted trees``.
    held_out : array, shape (N,)
        What it says of each sample of the fit when that sample's part was held out, N m.
    elsewhere : array, shape (M,)
        What it says of other samples, fitted to all N, N m.
    """

    name: str
    held_out: Array
    elsewhere: Array

    def error(self, residual: Array) -> float:
        """Squared error on the parts held out."""
        return float(((residual - self.held_out) ** 2).sum())


@dataclass(frozen=True, eq=False)
class Families:
    """Columns of smooth curves by families: of each its values for the fit, (N, k), and what asks for those elsewhere, (M, k)."""

    here: Mapping[str, Array]
    there: Callable[[str], Array]
    samples_there: int


def best_form(
    families: Families, signals: tuple[Array, Array] | None, residual: Array, layouts: Sequence[Indices]
) -> FreeForm:
    """The free form with the smallest error on parts held out; the one that says zero where none has a gain.

    Parameters
    ----------
    families : Families
        Columns of the smooth curves.
    signals : pair of array, shapes (N, s) and (M, s), or None
        What the trees see; None: there are none.
    residual : array, shape (N,)
        N m.
    layouts : sequence of array, shape (N,)
        The part of each sample, in one or more ways to part the data; parts are held out in turn.
    """
    nothing = FreeForm(NO_FORM, np.zeros(len(residual)), np.zeros(families.samples_there))
    curves = smooth_curves(families, residual, layouts)
    best = nothing if curves is None else min(nothing, curves, key=lambda form: form.error(residual))
    trees = None if signals is None else boosted_trees(signals, residual, layouts[0], best.error(residual))
    return trees or best


def sure_gain(before: Array, after: Array) -> float:
    """Drop of squared errors (N,) in all, less `SURE` times the standard error that its spread over time gives it."""
    edges = np.linspace(0, len(before), SPREAD + 1).astype(int)[:-1]
    gains = np.add.reduceat(before - after, edges)
    return float(gains.sum() - SURE * gains.std(ddof=1) * np.sqrt(SPREAD))


# ---- smooth curves ------------------------------------------------------------------------------------------


def smooth_curves(families: Families, residual: Array, layouts: Sequence[Indices]) -> FreeForm | None:
    """Sum of families of columns by ridge regression, families taken in one by one while parts held out gain by it.

    Where there are several layouts, the mean of what each chooses: one recording can be parted in many ways, and the
    choice should not hang on one. None where no family has a gain.
    """
    table = _Table.of(families, residual)
    found = [_chosen(table, layout) for layout in layouts]
    if not any(f.names for f in found):
        return None
    return FreeForm(
        "smooth curves",
        np.mean([f.held_out for f in found], axis=0),
        np.mean([table.there(f.names) @ f.theta for f in found], axis=0),
    )


@dataclass(frozen=True, eq=False)
class _Table:
    """Columns of all families side by side, of variance one, and a constant at the end."""

    here: Array  # (N, p)
    residual: Array
    places: Mapping[str, Indices]
    families: Families

    @staticmethod
    def of(families: Families, residual: Array) -> _Table:
        here, places, at = [], {}, 0
        for name, x in families.here.items():
            own = _of_variance_one(x, x)
            here.append(own)
            places[name] = np.arange(at, at + own.shape[1])
            at += own.shape[1]
        return _Table(np.hstack([*here, np.ones((len(residual), 1))]), residual, places, families)

    def there(self, names: Sequence[str]) -> Array:
        """Columns of some families elsewhere, brought to scale as those of the fit, and the constant."""
        parts = [_of_variance_one(self.families.there(n), self.families.here[n]) for n in names]
        return np.hstack([*parts, np.ones((self.families.samples_there, 1))])

    def columns(self, names: Sequence[str]) -> Indices:
        """Places of some families' columns and of the constant."""
        return np.concatenate([*(self.places[n] for n in names), [self.here.shape[1] - 1]])


def _of_variance_one(columns: Array, fitted: Array) -> Array:
    """Columns (M, k), less the means of those of the fit (N, k) and over their standard deviations, as far as these vary."""
    std = fitted.std(axis=0)
    moves = std > CONSTANT * np.abs(fitted).max(axis=0)
    return np.asarray((columns - fitted.mean(axis=0))[:, moves] / std[moves])


@dataclass(frozen=True, eq=False)
class _Parted:
    """A table's normal equations, apart for each part that is held out."""

    table: _Table
    parts: Indices

    @cached_property
    def spans(self) -> list[slice]:
        """Rows of each part: parts follow each other."""
        edges = np.flatnonzero(np.diff(self.parts, prepend=self.parts[0] - 1))
        return [slice(int(a), int(b)) for a, b in pairwise([*edges, len(self.parts)])]

    @cached_property
    def grams(self) -> Array:
        return np.stack([x.T @ x for x in (self.table.here[s] for s in self.spans)])

    @cached_property
    def crosses(self) -> Array:
        return np.stack([self.table.here[s].T @ self.table.residual[s] for s in self.spans])


@dataclass(frozen=True, eq=False)
class _Ridge:
    """Some families fitted under the penalty that parts held out prefer."""

    names: tuple[str, ...]
    theta: Array
    held_out: Array
    squares: Array  # (N,): of the error where held out


def _chosen(table: _Table, parts: Indices) -> _Ridge:
    """Families taken in one by one, the surest gain first."""
    parted = _Parted(table, parts)
    residual = table.residual
    least = LEAST_GAIN * float((residual**2).sum())
    best = _Ridge((), np.zeros(1), np.zeros(len(residual)), residual**2)
    while True:
        trials = [_ridge(parted, (*best.names, name)) for name in table.places if name not in best.names]
        if not trials:
            return best
        gain, trial = max(((sure_gain(best.squares, t.squares), t) for t in trials), key=lambda pair: pair[0])
        if gain <= least:
            return best
        best = trial


def _ridge(parted: _Parted, names: tuple[str, ...]) -> _Ridge:
    table, used = parted.table, parted.table.columns(names)
    grams = parted.grams[:, used[:, None], used]
    crosses = parted.crosses[:, used]
    gram, cross, rows = grams.sum(axis=0), crosses.sum(axis=0), len(table.residual)
    held_out = np.empty((len(PENALTIES), rows))
    for span, g, c in zip(parted.spans, grams, crosses, strict=True):
        count = rows - (span.stop - span.start)
        here = table.here[span][:, used]
        for i, penalty in enumerate(PENALTIES):
            held_out[i, span] = here @ _penalised(gram - g, cross - c, penalty * count)
    squares = (table.residual - held_out) ** 2
    best = int(squares.sum(axis=1).argmin())
    theta = _penalised(gram, cross, PENALTIES[best] * rows)
    return _Ridge(names, theta, held_out[best], squares[best])


def _penalised(gram: Array, cross: Array, penalty: float) -> Array:
    regular = gram.copy()
    regular.flat[:: len(gram) + 1] += penalty
    # LAPACK itself: around matrices this small SciPy's own functions take longer than it does
    _, theta, failed = linalg.lapack.dposv(regular, cross)
    if failed:
        raise np.linalg.LinAlgError("normal equations under a penalty are not positive definite")
    return np.asarray(theta)


# ---- boosted trees ------------------------------------------------------------------------------------------


def boosted_trees(
    signals: tuple[Array, Array], residual: Array, parts: Indices, error: float = np.inf
) -> FreeForm | None:
    """As many trees as parts held out ask for; None where they have no gain, or no smaller an error there than the given one."""
    # imported where it is used: it takes longer to load than most commands run
    from sklearn.ensemble import HistGradientBoostingRegressor

    def grown(x: Array, y: Array, trees: int) -> HistGradientBoostingRegressor:
        model = HistGradientBoostingRegressor(
            learning_rate=LEARNING_RATE,
            max_iter=trees,
            max_leaf_nodes=LEAVES,
            min_samples_leaf=SMALLEST_LEAF,
            l2_regularization=1.0,
            early_stopping=False,
            random_state=0,
        )
        return model.fit(x, y)

    here, elsewhere = signals
    held_out, left = np.empty((TREES, len(residual))), np.zeros(TREES)
    with threadpool_limits(limits=1):  # threads wait for each other longer than they work on so few samples
        for part in np.unique(parts):
            out = parts == part
            for i, said in enumerate(grown(here[~out], residual[~out], TREES).staged_predict(here[out])):
                held_out[i, out] = said
            left += ((residual[out] - held_out[:, out]) ** 2).sum(axis=1)
            if left.min() >= error:
                return None  # whatever they do on the other parts
        squares = (residual - held_out) ** 2
        best = int(squares.sum(axis=1).argmin())
        if squares[best].sum() >= error or sure_gain(residual**2, squares[best]) <= LEAST_GAIN * (residual**2).sum():
            return None
        said = np.asarray(grown(here, residual, best + 1).predict(elsewhere), dtype=float)
    return FreeForm("boosted trees", held_out[best], said)
