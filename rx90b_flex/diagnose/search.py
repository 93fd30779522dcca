"""Try every effect of the catalogue in every place against what a model leaves over."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from rx90b_flex.effects import Effect, Sites, catalogue
from rx90b_flex.effects.motion import Array, Indices, Motion
from rx90b_flex.identify.coloured import residual_spectrum, scatter
from rx90b_flex.identify.least_squares import (
    CORRELATION_S,
    Identification,
    NormalEquations,
    absorbed_each,
    shared_values,
    solve_weighted,
)
from rx90b_flex.identify.regression import Regression

SIGNIFICANCE = 1.0e-3  # of the best trial, after correction for everything that was tried
SMALLEST_GAIN = 0.02  # of the squared error of all joints that an effect touches; less is not worth a name
GAIN_T = 2.0  # held-out gain over its standard error, as `Trial.gain_t` has it
REPLICAS = 3  # held-out blocks that show an effect by themselves, where it is absent from others and gains spread
AS_GOOD = 0.95  # a simpler effect with this part of the best gain is preferred, if blocks cannot tell them apart
JUST_AS_GOOD = 0.99  # and with this part of it, even if they can: the rest is no reason for more parameters
FAMILIES = 4  # laws that are tried on all joints together
FAMILY_GAIN = 10.0  # in a first look, for a joint's effect to be tried as one of a family
MEMBER = 0.01  # p-value, not corrected, of a member
FEWEST_RECORDINGS = 2  # to leave out whole ones in turn
SHAPES_KNOWN = 1.0  # standard deviation of a shape's logarithm before the data: what they leave open must not run away
CARRIED = 0.2  # of its gain an effect keeps where whole recordings are left out, or it is no name for what is missing
PHASE_CARRIED = (
    0.7  # of a line by the clock: phases that differ by more than twenty degrees from recording to recording keep less
)
LEAK = 0.02  # of a recording that is left out as a whole
LOST = 9.0  # times what chance costs a recording that is left out: three standard deviations
LOST_PART = 0.005  # of its squared error, and this much: less is no reason
SIGN_T = 2.0  # a coefficient this many standard deviations beyond its physical bound disqualifies
REFINED = 16  # trials whose shape parameters are refined at the most
FEWEST_REFINED = 6  # and at the least
UNREFINED = 2.0  # a first look at the shapes shows this part of the gain at the least
BEGINNINGS = 3  # of a refinement of several shapes
REFINEMENTS = 15  # steps of a refinement
SETTLED = 1.0e-4  # part of the gain below which another step is not worth while
DIFFERENCE = 1.0e-3  # step of difference quotients by the shape, of how far the best one may lie
BESIDE = 6  # harmonics of a repeating motion on either side of a line that it is compared with
STANDS_OUT = 20.0  # over their median: that of noise, or of what a model lacks, exceeds it once in a million
DETERMINED = 1.0e-5  # part of a column's square that the model must leave for it to count as its own
ROUNDING = 1.0e-6  # of an effect's torque: a coefficient whose part is less is zero
BATCH_BYTES = 64e6


@dataclass(frozen=True, eq=False)
class Trial:
    """One effect, tried in one place.

    Attributes
    ----------
    effect : Effect
        With the values that fit best beside the present model.
    gain : float
        Drop of the weighted squared error on held-out blocks, in units of residual variance.
    block_gains : array, shape (blocks,)
    p_value : float
        That nothing is there, corrected for the number of trials.
    size : int
        Parameters that it adds to the model.
    share : float
        Gain over the squared error of the joints that it touches.
    lawful : bool
        Whether its values are such as it can have, and this data can tell them.
    colour : float
        Variance of its torque's product with the residual, over what white noise would give.
    objection : str
        Why its values are not lawful; empty where they are.
    small : str
        Why it is not worth a name by its own rule (`Effect.too_small`); empty where it is.
    worst : float
        Largest loss on a recording that was left out as a whole, over what chance explains; below one: none.
    carried : float
        Part of the gain on held-out blocks that is left where whole recordings are held out.
    members : tuple of Trial
        Of a family: one law on several joints, one hypothesis. `effect` is then the first member's.
    """

    effect: Effect
    gain: float
    block_gains: Array
    p_value: float
    size: int
    share: float
    lawful: bool
    colour: float = 1.0
    objection: str = ""
    worst: float = 0.0
    carried: float = 1.0
    members: tuple[Trial, ...] = ()
    small: str = ""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What it adds: one effect, or a family's."""
        return tuple(m.effect for m in self.members) or (self.effect,)

    @property
    def gain_t(self) -> float:
        """Mean over standard error of the blocks' gains, as signed roots: an effect that acts much in one block and
        little in others, such as a saturation, differs between them without being less sure.
        """
        roots = np.sign(self.block_gains) * np.sqrt(np.abs(self.block_gains))
        error = roots.std(ddof=1) / np.sqrt(len(roots))
        return float(roots.mean() / error) if error > 0 else np.inf

    @property
    def replicated(self) -> bool:
        """Whether several held-out blocks show it, each beyond its own noise, and what the others lose is within theirs.

        A gain g of an effect that is there has the variance 4 g `colour`. An effect that acts in bursts leaves some blocks
        without a gain; their spread says little of it, but every block that has one is an experiment of its own.
        """
        if self.effect.last_resort:
            return False  # a curve of no known law has nothing but carrying over everywhere to speak for it
        shown = self.block_gains > (2.0 * GAIN_T) ** 2 * self.colour
        lost = -float(np.minimum(self.block_gains, 0.0).sum())
        return bool(shown.sum() >= REPLICAS and lost <= GAIN_T * 2.0 * np.sqrt(max(self.gain, 0.0) * self.colour))

    @property
    def sure_gain(self) -> float:
        """Gain less twice its standard error: what it explains beyond the luck of a few blocks.

        Zero for one that is only `replicated`: it gives way to all that every block shows.
        """
        if self.gain <= 0:
            return self.gain
        sure = self.gain * (1.0 - GAIN_T / max(self.gain_t, 1e-9))
        return max(sure, 0.0) if self.replicated else sure

    @property
    def accepted(self) -> bool:
        """Whether it is significant, holds on data it was not fitted to, is lawful and worth a name."""
        return not self.refusal

    @property
    def refusal(self) -> str:
        """Why it is not accepted, in words; empty where it is."""
        if not self.lawful:
            return self.objection or "its values are not such as it can have"
        if self.p_value >= SIGNIFICANCE:
            return f"chance would do as well (p = {self.p_value:.2g})"
        if self.share <= SMALLEST_GAIN:
            return f"it explains {max(self.share, 0.0):.1%} of the squared error, too little for a name"
        if self.small:
            return self.small
        if not (self.gain_t > GAIN_T or self.replicated):
            return "parts of the data that were held out disagree on it"
        if self.worst > 1.0:
            return "it raises the error of a recording that was left out"
        if self.carried < (PHASE_CARRIED if self.effect.by_clock else CARRIED):
            return f"of its gain {max(self.carried, 0.0):.0%} carries over to recordings that were left out as a whole"
        return ""

    def belongs(self, tests: int) -> bool:
        """Whether it may be one of a family: by itself as likely as a hypothesis that nobody had to search for."""
        return (
            self.lawful
            and self.gain > 0
            and self.share > SMALLEST_GAIN
            and not self.small
            and self.p_value < MEMBER * tests
            and self.worst <= 1.0
        )

    def no_better_than(self, other: Trial) -> bool:
        """Whether held-out blocks cannot tell that this one explains more than the other."""
        if other.gain >= JUST_AS_GOOD * self.gain:
            return True
        difference = self.block_gains - other.block_gains
        spread = difference.std(ddof=1) * np.sqrt(len(difference))
        return bool(other.gain >= AS_GOOD * self.gain and difference.sum() <= GAIN_T * spread)


@dataclass(frozen=True, eq=False)
class _Shared:
    """Columns of the present model and their products, which all bases have in common."""

    columns: Array  # (joints, N, p): one joint's rows lie together in memory
    target: Array  # (joints, N)
    weight: Array
    blocks: tuple[slice, ...]
    precision: Array  # (p,) inverse variance of coefficients before the data: of shapes, which may change by their size

    @cached_property
    def normal(self) -> NormalEquations:
        return NormalEquations.of(self.columns.transpose(1, 0, 2), self.target.T, self.blocks)


@dataclass(frozen=True, eq=False)
class Base:
    """The present model (perhaps without an effect that a candidate replaces), with all that a trial needs of it."""

    shared: _Shared
    kept: Indices  # places of the base's columns among the shared ones
    prior: Array
    leak: float = 0.0  # part of a block that is held out which a fit to the others sees all the same

    @property
    def weight(self) -> Array:
        """Inverse variance of each joint's residual."""
        return self.shared.weight

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.kept)

    @cached_property
    def grams(self) -> Array:
        """Weighted Gram matrices, shape (blocks, p, p)."""
        whole = np.einsum("j,bjpq->bpq", self.weight, self.shared.normal.gram)
        whole = whole + np.diag(self.shared.precision) / len(whole)
        return whole[:, self.kept[:, None], self.kept]

    @cached_property
    def crosses(self) -> Array:
        return np.einsum("j,bjp->bp", self.weight, self.shared.normal.cross)[:, self.kept]

    @cached_property
    def powers(self) -> Array:
        return self.shared.normal.power @ self.weight

    @cached_property
    def whole(self) -> tuple[Array, Array]:
        """Coefficients and pseudo-inverse on all blocks."""
        theta, inverse, _, _ = solve_weighted(self.grams.sum(axis=0), self.crosses.sum(axis=0), self.prior)
        return theta, inverse

    @cached_property
    def without(self) -> list[tuple[Array, Array]]:
        """Coefficients and pseudo-inverse with each block held out."""
        gram, cross = self.grams.sum(axis=0), self.crosses.sum(axis=0)
        out = []
        for g, c in zip(self.grams, self.crosses, strict=True):
            part = 1.0 - self.leak
            theta, inverse, _, _ = solve_weighted(gram - part * g, cross - part * c, self.prior)
            out.append((theta, inverse))
        return out

    @cached_property
    def held_out(self) -> Array:
        """Weighted squared error on each block when it is held out, shape (blocks,)."""
        parts = zip(self.powers, self.crosses, self.grams, self.without, strict=True)
        return np.array([power - 2 * cross @ theta + theta @ gram @ theta for power, cross, gram, (theta, _) in parts])

    def grouped(self, groups: Sequence[Indices]) -> Base:
        """With blocks put together, of which a fit to the others sees a trace: what they leave open must not run away."""
        normal = self.shared.normal
        gram, cross, power, counts = (
            np.array([x[at].sum(axis=0) for at in groups])
            for x in (normal.gram, normal.cross, normal.power, normal.counts)
        )
        other = dataclasses.replace(self, shared=dataclasses.replace(self.shared), leak=LEAK)
        other.shared.__dict__["normal"] = NormalEquations(gram, cross, power, counts)
        return other

    @cached_property
    def residual(self) -> Array:
        """What the base leaves of the torque, shape (joints, N)."""
        return self.shared.target - self._times(self.whole[0])

    def _times(self, theta: Array) -> Array:
        """The base's columns times coefficients (p,) or (p, k); shape (joints, N) or (joints, N, k)."""
        full = np.zeros((self.shared.columns.shape[2], *theta.shape[1:]))
        full[self.kept] = theta
        return self.shared.columns @ full

    @cached_property
    def squares(self) -> Array:
        """Weighted squared error of each joint on all blocks."""
        return self.weight * (self.residual**2).sum(axis=1)

    def with_base(self, rows: Indices, columns: Array, samples: slice = slice(None)) -> Array:
        """Weighted products of the base's columns with candidate ones (N, rows, k); shape (p, k)."""
        out = np.zeros((self.shared.columns.shape[2], columns.shape[2]))
        for i, j in enumerate(rows):  # none where a candidate has nothing to act on
            out += self.weight[j] * (self.shared.columns[j, samples].T @ columns[samples, i])
        return out[self.kept]

    def products(self, rows: Indices, columns: Array, block: slice) -> tuple[Array, Array, Array]:
        """Weighted products of candidate columns (N, rows, k) on one block: with the base's, the torque, themselves."""
        weight = self.weight[rows]
        c = columns[block]
        y = self.shared.target[rows, block]
        return (
            self.with_base(rows, columns, block),
            np.einsum("j,jn,njk->k", weight, y, c, optimize=True),
            np.einsum("j,njk,njl->kl", weight, c, c, optimize=True),
        )

    def apart(self, rows: Indices, columns: Array) -> Array:
        """What of candidate columns (N, rows, k) the base does not explain, shape (joints, N, k)."""
        _, inverse = self.whole
        out = -self._times(inverse @ self.with_base(rows, columns))
        out[rows] += columns.transpose(1, 0, 2)
        return out

    def projected(self, rows: Indices, columns: Array) -> tuple[Array, Array, Array]:
        """Weighted Gram matrix of candidate columns (N, rows, k) less the base's part, and with it, (k, k); score (k,)."""
        weighted = columns * np.sqrt(self.weight[rows])[:, None]
        flat = weighted.transpose(1, 0, 2).reshape(-1, columns.shape[2])
        own = flat.T @ flat
        with_base = self.with_base(rows, columns)
        return own - with_base.T @ self.whole[1] @ with_base, own, self._score(rows, columns)

    def gains(self, rows: Indices, columns: Array, k: int) -> Array:
        """Drop of the weighted squared error for many candidates of k columns each; (N, rows, M * k) -> (M,)."""
        _, inverse = self.whole
        many = columns.shape[2] // k
        with_base = self.with_base(rows, columns).reshape(-1, many, k)
        shaped = columns.reshape(len(columns), len(rows), many, k)
        own = np.einsum("j,njmk,njml->mkl", self.weight[rows], shaped, shaped)
        left = own - np.einsum("pmk,pml->mkl", with_base, np.tensordot(inverse, with_base, axes=1))
        score = self._score(rows, columns).reshape(many, k)
        return np.array([s @ _solve(a, d, s) for a, d, s in zip(left, own, score, strict=True)])

    def _score(self, rows: Indices, columns: Array) -> Array:
        out = np.zeros(columns.shape[2])
        for i, j in enumerate(rows):
            out += self.weight[j] * (self.residual[j] @ columns[:, i])
        return out


def _solve(left: Array, own: Array, score: Array) -> Array:
    """Coefficients of columns that are partly explained by the base; what is wholly explained gets zero."""
    scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
    values, vectors = np.linalg.eigh(left / np.outer(scale, scale))
    kept = values > DETERMINED
    basis = vectors[:, kept]
    return ((basis / values[kept]) @ (basis.T @ (score / scale))) / scale


@dataclass(frozen=True, eq=False)
class Search:
    """Everything that could be missing from an identified model.

    Attributes
    ----------
    model : Identification
    sites : Sites
    last_resort : bool
        Whether to try curves of no known law, and those alone.
    """

    model: Identification
    sites: Sites
    last_resort: bool = False

    @property
    def regression(self) -> Regression:
        """The data, seen by the identified links."""
        return self.model.regression

    @cached_property
    def blocks(self) -> tuple[slice, ...]:
        """Blocks to hold out in turn."""
        return self.regression.blocks()

    @cached_property
    def by_recording(self) -> tuple[Indices, ...]:
        """Which blocks each recording holds."""
        starts = np.array([b.start for b in self.blocks])
        return tuple(np.flatnonzero((starts >= s.start) & (starts < s.stop)) for s in self.regression.spans)

    @cached_property
    def target(self) -> Array:
        """Torque that the model's columns explain, shape (N, joints)."""
        return np.asarray(self.model.residual + self.model.columns @ self.model.theta)

    @cached_property
    def shared(self) -> _Shared:
        """Columns and target in the form that trials use."""
        columns = np.ascontiguousarray(self.model.all_columns.transpose(1, 0, 2))
        shapes = self.model.shapes
        sizes = shapes.per_step(shapes.values(self.model.effects))
        precision = np.concatenate([np.zeros(len(self.model.theta)), SHAPES_KNOWN**-2.0 * sizes**-2.0])
        target = np.ascontiguousarray(self.target.T)
        return _Shared(columns, target, self.model.solution.sigma**-2.0, self.blocks, precision)

    @cached_property
    def present(self) -> Base:
        """The present model as it is."""
        return self.base()

    def base(self, replaced: Effect | None = None, restored: Sequence[Effect] = ()) -> Base:
        """The present model without `replaced`, and with effects beside it that are not in it."""
        model = self.model
        # what shapes may still do to the model's torque counts with its columns: no candidate is credited with that
        theta = np.concatenate([model.theta, np.zeros(len(model.shapes))])
        kept = np.arange(len(theta))
        if replaced is not None:
            index = model.effects.index(replaced)
            first = model.first_column(index)
            elsewhere = np.concatenate([np.zeros(0), *(p for i, p in enumerate(model.shapes.places) if i != index)])
            own = np.setdiff1d(model.shapes.places[index], elsewhere)
            kept = np.setdiff1d(kept, np.r_[first : first + len(replaced.coefficients), len(model.theta) + own])
        if not restored:
            return Base(self.shared, kept, theta[kept])
        more = [self.regression.columns(e).transpose(1, 0, 2) for e in restored]
        columns = np.concatenate([self.shared.columns[:, :, kept], *more], axis=2)
        precision = np.concatenate([self.shared.precision[kept], np.zeros(columns.shape[2] - len(kept))])
        shared = dataclasses.replace(self.shared, columns=np.ascontiguousarray(columns), precision=precision)
        prior = np.concatenate([theta[kept], np.zeros(columns.shape[2] - len(kept))])
        return Base(shared, np.arange(columns.shape[2]), prior)

    @cached_property
    def candidates(self) -> list[tuple[Effect, Effect | None]]:
        """Effects to try, each with the declared effect that it would replace."""
        out: list[tuple[Effect, Effect | None]] = []
        for cls in catalogue().values():
            if cls.last_resort is not self.last_resort:
                continue
            for site in cls.over_time(self.sites):
                effect = site.placed(self.longest)
                if not len(effect.coefficients):
                    continue  # this motion leaves nothing to place
                here = [e for e in self.model.effects if e.place == effect.place]
                if not all(any(e.type_name() == needed for e in here) for needed in cls.needs):
                    continue
                if any(_shuts_out(e, effect) for e in here):
                    continue
                replaced = next((e for e in here if e.type_name() in effect.replaces), None)
                out.append((self._sharing(effect), replaced))
        return out

    @cached_property
    def _shared_values(self) -> dict[tuple[str, ...], float]:
        return shared_values(self.model.effects)

    def _sharing(self, effect: Effect) -> Effect:
        """With the present values of the shapes that it shares with the model's effects."""
        known = [self._shared_values.get(k, np.nan) if k is not None else np.nan for k in effect.shape_keys]
        return effect.with_shape(np.array(known)) if not np.isnan(known).all() else effect

    def free(self, effect: Effect) -> Indices:
        """Places of the shape parameters that a trial is free to choose."""
        return np.array([i for i, k in enumerate(effect.shape_keys) if k not in self._shared_values], dtype=np.intp)

    def _shaped(self, effect: Effect, values: Array) -> Effect:
        """With other values of the free shapes."""
        shape = effect.shape.copy()
        shape[self.free(effect)] = values
        return effect.with_shape(shape)

    def run(self, progress: Callable[[float], None] | None = None) -> list[Trial]:
        """Try all candidates.

        Returns
        -------
        list of Trial
            By gain, largest first; only those worth a closer look have refined shapes and a p-value below 1.
        """
        candidates = self.candidates
        bases: dict[Effect | None, Base] = {None: self.present}
        rough: list[tuple[float, Effect, Base]] = []
        for i, (effect, replaced) in enumerate(candidates):
            base = bases.setdefault(replaced, self.base(replaced)) if replaced is not None else bases[None]
            starts = self._starts(effect)
            if len(starts) == 0:
                continue  # this motion is too small for any of its shapes to show
            looks = sorted(self._over_shapes(effect, starts, base), key=lambda pair: -pair[0])
            best = looks[0]
            self._other_starts[best[1]] = self._apart([e for _, e in looks])[1:]
            # an effect that replaces another starts from a worse base: count only what it adds to the present model
            lost = float(base.squares.sum() - bases[None].squares.sum())
            rough.append((best[0] - lost, best[1], base))
            if progress:
                progress((i + 1) / (len(candidates) + 4))
        rough.sort(key=lambda item: -item[0])
        trials: list[Trial] = []
        for first_look, effect, base in rough[:REFINED]:
            sure = max((t.sure_gain for t in trials if t.accepted), default=0.0)
            if len(trials) >= FEWEST_REFINED and UNREFINED * first_look < sure:
                break  # neither this one nor those behind it can win
            trials.append(self.trial(effect, base, bases[None], self.tests))
        trials += self._families(rough, trials, bases[None])
        return sorted(trials, key=lambda t: -t.gain)

    def _families(
        self, rough: Sequence[tuple[float, Effect, Base]], known: Sequence[Trial], present: Base
    ) -> list[Trial]:
        """One law on several joints, for the types that a first look at all joints together likes best."""
        kinds: dict[type[Effect], list[tuple[float, Effect, Base]]] = {}
        for item in rough:
            kind = type(item[1])
            if kind.on == "joint" and not (kind.repeats or kind.multiplies):
                kinds.setdefault(kind, []).append(item)
        liked = sorted(kinds.values(), key=lambda items: -sum(max(gain, 0.0) for gain, _, _ in items))[:FAMILIES]
        tried = {t.effect.label: t for t in known}
        out = []
        for items in liked:
            found = [
                tried.get(e.label) or self.trial(e, base, present, self.tests)
                for gain, e, base in items
                if gain > FAMILY_GAIN
            ]
            members = tuple(t for t in found if t.belongs(self.tests))
            if len(members) >= max(2, len(self.sites.joints) / 2):
                out.append(family(members, len(kinds)))
        return out

    def present_without(self, effect: Effect) -> list[Effect]:
        """The model's effects without one, which gives its place back to what it stands in for."""
        kept = [e for e in self.model.effects if e is not effect]
        if effect.joints and effect.replaces:
            kind = catalogue()[effect.replaces[0]]
            kept += [e for e in kind.everywhere(self.sites) if e.place == effect.place]
        return kept

    def without(self, effect: Effect) -> Trial:
        """What an effect of the present model is worth: the trial of adding it to the model without it, what it replaces restored."""
        base = self.base(effect)
        restored = [e for e in self.present_without(effect) if e not in self.model.effects]
        present = self.base(effect, [self._sharing(e) for e in restored]) if restored else base
        return self.trial(effect, base, present, self.tests)

    @property
    def sample_s(self) -> float:
        """Time between two samples of the log, s."""
        return 1.0 / self.regression.stretches[0].recording.sample_rate_hz

    @property
    def longest(self) -> Motion:
        """Motion of the longest recording, from which starts and ranges of shapes are taken."""
        return self.regression.longest

    @cached_property
    def longest_lag(self) -> int:
        """Longest correlation of a residual that tests allow for, samples."""
        return int(CORRELATION_S * self.regression.stretches[0].rate_hz)

    @cached_property
    def absorbed(self) -> list[Array]:
        """What the present model's fit took out of each joint's noise."""
        weight = self.model.solution.sigma**-2.0
        return absorbed_each(self.model.all_columns, weight, self.regression.spans, self.longest_lag)

    @cached_property
    def tests(self) -> int:
        """How many independent trials a search makes."""
        return sum(effect.independent_shapes(self.longest) for effect, _ in self.candidates)

    def _starts(self, effect: Effect) -> Array:
        free = self.free(effect)
        if not len(free):
            return np.zeros((1, 0))
        joint = self.regression.joints.index(effect.joints[0]) if effect.joints else 0
        left = self.present.residual[joint]
        stretches = self.regression.stretches
        beside = [(s.sampled, left[span]) for s, span in zip(stretches, self.regression.spans, strict=True)]
        return effect.starts_beside(self.longest, beside, stretches[0].cutoff_hz)[:, free]

    def _over_shapes(self, effect: Effect, starts: Array, base: Base) -> Iterable[tuple[float, Effect]]:
        shaped = [self._shaped(effect, s) if len(s) else effect for s in starts]
        k = len(effect.coefficients)
        per_effect = 8.0 * k * sum(len(s.motion) for s in self.regression.stretches)
        batch = max(1, int(BATCH_BYTES / per_effect))
        for at in range(0, len(shaped), batch):
            part = shaped[at : at + batch]
            rows, columns = self.regression.compact(part, leading=True)
            if len(rows) == 0:
                yield 0.0, part[0]
                continue
            yield from zip(base.gains(rows, columns, k).tolist(), part, strict=True)

    @cached_property
    def _other_starts(self) -> dict[Effect, list[Effect]]:
        """Of effects as a first look likes them best, where else a refinement may begin."""
        return {}

    def _apart(self, looks: Sequence[Effect]) -> list[Effect]:
        """The first of effects that differ in their shapes by more than a refinement's step; one of a single shape stands for all."""
        if len(self.free(looks[0])) < 2:
            return [looks[0]]
        spread = looks[0].shape_spread(self.longest)
        out: list[Effect] = []
        for effect in looks:
            if all((np.abs(effect.shape - e.shape) > spread).any() for e in out):
                out.append(effect)
            if len(out) == BEGINNINGS:
                break
        return out

    def _refined(self, effect: Effect, base: Base) -> Effect:
        """The shapes that gain most: from the best of a first look, and from others where several shapes make valleys."""
        if not len(self.free(effect)):
            return effect
        tried = [self._refined_from(e, base) for e in (effect, *self._other_starts.get(effect, ()))]
        return max(tried, key=lambda pair: pair[0])[1]

    def _refined_from(self, effect: Effect, base: Base) -> tuple[float, Effect]:
        """Gain and shapes by Gauss-Newton steps with everything linear projected out (variable projection)."""
        free = self.free(effect)
        low, high = effect.shape_range(self.longest)[:, free]
        logs = bool((low > 0).all())
        to, back = (np.log, np.exp) if logs else (np.asarray, np.asarray)
        start = np.clip(effect.shape[free], low, high)
        spread = effect.shape_spread(self.longest)[free]
        farthest = spread / start if logs else spread

        def looked_at(x: Array) -> _Look:
            shapes = [np.clip(back(x + step), low, high) for step in np.vstack([0 * x, np.diag(DIFFERENCE * farthest)])]
            rows, columns = self.regression.compact([self._shaped(effect, s) for s in shapes])
            return _Look.at(base, rows, columns, len(effect.coefficients), DIFFERENCE * farthest)

        x = to(start)
        best, damping = looked_at(x), 1e-3
        for _ in range(REFINEMENTS):
            moved = to(np.clip(back(x + np.clip(best.step(damping), -farthest, farthest)), low, high))
            found = looked_at(moved)
            won = found.gain - best.gain
            if won > 0:
                x, best, damping = moved, found, damping / 4
            else:
                damping *= 16
            if abs(won) < SETTLED * max(best.gain, 1.0):
                break
        return best.gain, self._shaped(effect, np.clip(back(x), low, high))

    def trial(self, effect: Effect, base: Base, present: Base, tests: int) -> Trial:
        """Try one effect beside a base, its shape refined; gains count from `present`, p-values for so many tests."""
        effect = self._refined(effect, base)
        k, s = len(effect.coefficients), len(self.free(effect))
        rows, beside = self.regression.compact([effect, *self._neighbours(effect)])
        columns = beside[:, :, :k]
        size = k + s - (present.size - base.size)
        if len(rows) == 0:
            return Trial(effect, 0.0, np.zeros(len(self.blocks)), 1.0, size, 0.0, False)
        per_block = [base.products(rows, columns, block) for block in self.blocks]
        b, y, d = (np.array(part) for part in zip(*per_block, strict=True))
        theta, inverse = base.whole
        left = d.sum(axis=0) - b.sum(axis=0).T @ inverse @ b.sum(axis=0)
        beta = _solve(left, d.sum(axis=0), y.sum(axis=0) - b.sum(axis=0).T @ theta)
        block_gains = present.held_out - self._held_out(base, b, y, d)
        p_value, objection, colour, left_over = self._evidence(effect, base, rows, beside, beta)
        if effect.by_clock and self._follows_motion(base.residual[rows], effect):
            objection = "its line lies among those of the motion itself"
        elif effect.by_clock and len(self.by_recording) < FEWEST_RECORDINGS:
            objection = "one recording cannot tell whether its phase holds in another"
        found = effect.with_coefficients(beta)
        if not objection and not found.possible():
            objection = "its values do not go together with what its torque assumes"
        touched = present.squares[rows].sum()
        gain = float(block_gains.sum())
        return Trial(
            found,
            gain,
            block_gains,
            min(1.0, p_value * tests),
            size,
            gain / touched if touched > 0 else 0.0,
            not objection,
            colour,
            objection,
            *self._left_out(base, present, (b, y, d), len(beta) * colour, gain),
            small=found.too_small(_off_a_joint(present.squares[rows], left_over[rows], gain), self.sample_s),
        )

    def _left_out(
        self, base: Base, present: Base, products: tuple[Array, ...], chance: float, gain: float
    ) -> tuple[float, float]:
        """`worst` and `carried` where whole recordings are left out; nothing against it where there are too few."""
        if len(self.by_recording) < FEWEST_RECORDINGS or gain <= 0:
            return 0.0, 1.0
        b, y, d = (np.array([part[at].sum(axis=0) for at in self.by_recording]) for part in products)
        before = present.grouped(self.by_recording)
        lost = self._held_out(base.grouped(self.by_recording), b, y, d) - before.held_out
        parts = np.array([len(at) for at in self.by_recording]) / len(self.blocks)
        # what a fit to the others costs a recording by chance: as much as it is longer than they are together
        spread = LOST * chance * (1.0 + parts / (1.0 - parts)) + LOST_PART * before.held_out
        return float((lost / np.maximum(spread, 1e-300)).max()), float(-lost.sum() / gain)

    def _follows_motion(self, residual: Array, effect: Effect) -> bool:
        """Whether a line sits among the harmonics of a motion that repeats, and does not stand out of those beside it.

        What the model lacks repeats with the motion, so it has all of these harmonics; a clock of its own has one line.
        Near the motion's own frequencies no data of that motion can tell one from the other.
        """
        (hz,) = effect.shape
        for stretch, span in zip(self.regression.stretches, self.regression.spans, strict=True):
            if stretch.recording.period_s is None:
                continue
            left = residual[:, span]
            harmonics = round(hz * stretch.recording.period_s) + np.arange(-BESIDE, BESIDE + 1)
            harmonics = harmonics[(harmonics > 0) & (harmonics != round(hz * stretch.recording.period_s))]
            lines = np.append(harmonics / stretch.recording.period_s, hz)
            turned = np.exp(-2j * np.pi * np.outer(stretch.time, lines)) * np.hanning(len(stretch.time))[:, None]
            power = (np.abs(left @ turned) ** 2).sum(axis=0)
            if power[-1] < STANDS_OUT * np.median(power[:-1]):
                return True
        return False

    def _neighbours(self, effect: Effect) -> list[Effect]:
        """The effect with each free shape parameter a little larger, then a little smaller."""
        at, steps = effect.shape[self.free(effect)], np.diag(self._shape_steps(effect))
        return [self._shaped(effect, at + sign * step) for step in steps for sign in (1.0, -1.0)]

    def _by_shape(self, effect: Effect, beside: Array, beta: Array) -> Array:
        """Derivative of the effect's torque by its free shapes (N, rows, s) from the columns of its neighbours."""
        samples, rows, _ = beside.shape
        steps = self._shape_steps(effect)
        pairs = beside.reshape(samples, rows, len(steps), 2, len(beta))
        return (pairs[:, :, :, 0] - pairs[:, :, :, 1]) @ beta / (2.0 * steps)

    def _shape_steps(self, effect: Effect) -> Array:
        low = effect.shape_range(self.longest)[0, self.free(effect)]
        at = np.abs(effect.shape[self.free(effect)])
        return 1e-4 * np.maximum(at, np.where(low > 0, 0.0, 1e-3))

    def left_with(self, effect: Effect, base: Base) -> Array:
        """What a base and an effect, its shape as it is, leave together; shape (joints, N)."""
        rows, columns = self.regression.compact([effect])
        if len(rows) == 0:  # this motion does not show it
            return base.residual
        left, own, score = base.projected(rows, columns)
        return base.residual - base.apart(rows, columns) @ _solve(left, own, score)

    def _held_out(self, base: Base, b: Array, y: Array, d: Array) -> Array:
        """Weighted squared error of base and candidate on each block, both fitted to the others."""
        out = np.empty(len(b))
        for i, (theta, inverse) in enumerate(base.without):
            bb, yy, dd = (x.sum(axis=0) - (1.0 - base.leak) * x[i] for x in (b, y, d))
            beta = _solve(dd - bb.T @ inverse @ bb, dd, yy - bb.T @ theta)
            new = theta - inverse @ (bb @ beta)
            out[i] = (
                base.powers[i]
                - 2 * (base.crosses[i] @ new + y[i] @ beta)
                + new @ base.grams[i] @ new
                + 2 * new @ b[i] @ beta
                + beta @ d[i] @ beta
            )
        return out

    def _evidence(
        self, effect: Effect, base: Base, rows: Indices, beside: Array, beta: Array
    ) -> tuple[float, str, float, Array]:
        """Wald test of the coefficients under coloured residuals, why they cannot be what they claim to be, `colour`, and
        the weighted squared error (joints,) that is left.

        They cannot if one lies beyond its physical bound, if a shape parameter ran into the end of its range (the
        effect then plays another one's part), or if with the shapes estimated too nothing of them is certain.
        """
        k = len(beta)
        columns = beside[:, :, :k]
        together = np.concatenate([columns, self._by_shape(effect, beside[:, :, k:], beta)], axis=2)
        own = np.einsum("j,njk,njk->k", base.weight[rows], together, together, optimize=True)
        apart = base.apart(rows, together)
        residual = base.residual - apart[:, :, :k] @ beta
        left_over = base.weight * np.einsum("jn,jn->j", residual, residual)
        residual = residual / np.sqrt(self.regression.share)[:, None]
        apart = apart.transpose(1, 0, 2)
        spans = self.regression.spans
        longest = self.longest_lag
        absorbed = self.absorbed
        spectra = [residual_spectrum(r, spans, a, longest) for r, a in zip(residual, absorbed, strict=True)]
        meat = scatter(apart, base.weight, spectra, spans)
        bread = np.einsum("j,njk,njl->kl", base.weight, apart, apart, optimize=True)
        wald, free, covariance = _wald(bread[:k, :k], meat[:k, :k], own[:k], beta, DETERMINED)
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        shapes = self.free(effect)
        tests = free + len(shapes)
        p_value = float(stats.f.sf(wald / tests, tests, min(s.degrees_of_freedom for s in spectra))) if free else 1.0
        objection = ""
        # what the base explains wholly is left at zero, up to rounding
        size = np.sqrt(np.maximum(own[:k], 1e-300))
        rounding = ROUNDING * np.linalg.norm(beta * size) / size
        wrong = np.flatnonzero(beta < effect.coefficient_bounds - SIGN_T * std - rounding)
        if len(wrong):
            i = wrong[0]
            unit = effect.coefficient_units[i]
            far = abs(beta[i]) / max(std[i], 1e-300)
            objection = (
                f"its {effect.coefficient_names[i]} would be {beta[i]:.3g} {unit}, {far:.0f} std of the wrong sign"
            )
        elif len(shapes) and not effect.coefficients_follow:
            _, _, whole = _wald(bread, meat, own, np.r_[beta, np.zeros(len(shapes))], 1e-12)
            certain = beta @ np.linalg.pinv(whole[:k, :k], rcond=1e-10, hermitian=True) @ beta
            if not certain > SIGN_T**2 * k:
                objection = "with its shape open too, nothing of it is certain"
        objection = self._at_bound(effect) or objection
        white = float(beta @ bread[:k, :k] @ beta)
        return p_value, objection, float(beta @ meat[:k, :k] @ beta) / white if white > 0 else 1.0, left_over

    def _at_bound(self, effect: Effect) -> str:
        """Which shape ran into an end of what this log can tell, in words; empty where none did."""
        shapes = self.free(effect)
        low, high = effect.shape_range(self.longest)[:, shapes]
        at = effect.shape[shapes]
        names = [effect.shape_names()[i] for i in shapes]
        keys = [effect.shape_keys[i] for i in shapes]
        for name, key, x, a, b in zip(names, keys, at, low, high, strict=True):
            if (
                x <= 1.01 * a and key is None
            ):  # what effects share is as sharp as can be, and no reason against one of them
                return f"at its bound: this log does not resolve a {name} below {a:.3g}"
            if x >= 0.99 * b:
                return f"at its bound: this log does not hold a {name} beyond {b:.3g}"
        return ""


def _off_a_joint(before: Array, after: Array, gain: float) -> float:
    """Part of the root mean square error that an effect takes off the joint for which it does most.

    Parameters
    ----------
    before, after : array, shape (joints,)
        Weighted squared errors on all rows, of the joints that it touches.
    gain : float
        On held-out blocks, over all of them: joints share in it as they do in the drop on all rows.
    """
    drop = before - after
    whole = float(drop.sum())
    shares = gain * drop / (whole * np.maximum(before, 1e-300)) if whole > 0 else np.zeros(1)
    return float(1.0 - np.sqrt(np.clip(1.0 - shares.max(), 0.0, 1.0)))


def _shuts_out(present: Effect, new: Effect) -> bool:
    """Whether an effect of the model leaves no room for another one in its place; a freer form of its own type may replace it."""
    if type(present) is type(new) or present.type_name() == new.type_name():
        return not new.repeats and (type(present) is type(new) or new.type_name() not in new.replaces)
    return new.type_name() in present.replaces


@dataclass(frozen=True, eq=False)
class _Look:
    """A candidate at one shape: its gain, and the normal equations of its torque's derivatives by the shape."""

    gain: float
    gram: Array  # (s, s), of what neither the base nor the candidate's own columns explain
    score: Array  # (s,)

    @staticmethod
    def at(base: Base, rows: Indices, columns: Array, k: int, steps: Array) -> _Look:
        """From columns (N, rows, (1 + s) k): at the shape, and a step further in each of its parameters."""
        if len(rows) == 0:
            return _Look(0.0, np.eye(len(steps)), np.zeros(len(steps)))
        left, own, score = base.projected(rows, columns)
        beta = _solve(left[:k, :k], own[:k, :k], score[:k])
        # derivatives as combinations of the columns: what is left of them needs no second look at the data
        further = np.zeros((columns.shape[2], len(steps)))
        further[:k] = -beta[:, None] / steps
        for i, step in enumerate(steps):
            further[k * (i + 1) : k * (i + 2), i] = beta / step
        mixed = left[:k] @ further
        taken = np.array([_solve(left[:k, :k], own[:k, :k], m) for m in mixed.T]).T
        return _Look(
            float(score[:k] @ beta),
            further.T @ left @ further - mixed.T @ taken,
            further.T @ score - taken.T @ score[:k],
        )

    def step(self, damping: float) -> Array:
        """Levenberg's step of the shape parameters."""
        size = np.diag(self.gram)
        damped = self.gram + damping * np.diag(np.where(size > 0, size, 1.0))
        return np.asarray(np.linalg.lstsq(damped, self.score, rcond=None)[0])


def _wald(bread: Array, meat: Array, own: Array, beta: Array, tolerance: float) -> tuple[float, int, Array]:
    """Wald statistic of the determined combinations of coefficients, their number, and the covariance.

    `own` (k,) are the squares of the candidate's columns before the base took its part: what is left of one is judged
    against that, so that a column which the base explains wholly does not come back as rounding.
    """
    scale = np.sqrt(np.maximum(own, 1e-300))
    values, vectors = np.linalg.eigh(bread / np.outer(scale, scale))
    kept = values > tolerance
    basis = vectors[:, kept] / scale[:, None]
    inverse = (basis / values[kept]) @ basis.T
    covariance = inverse @ meat @ inverse
    along = vectors[:, kept] * scale[:, None]
    combined = along.T @ beta
    statistic = combined @ np.linalg.pinv(along.T @ covariance @ along, rcond=1e-10, hermitian=True) @ combined
    return float(statistic), int(kept.sum()), covariance


def family(members: Sequence[Trial], kinds: int) -> Trial:
    """Several trials as one: gains add up, and Fisher's method puts their p-values together; `kinds` families were tried."""
    chance = -2.0 * float(np.log(np.maximum([m.p_value for m in members], 1e-300)).sum())
    gain = float(sum(m.gain for m in members))
    touched_squares = sum(m.gain / m.share for m in members)
    return dataclasses.replace(
        members[0],
        gain=gain,
        block_gains=np.sum([m.block_gains for m in members], axis=0),
        p_value=min(1.0, kinds * float(stats.chi2.sf(chance, 2 * len(members)))),
        size=sum(m.size for m in members),
        share=gain / touched_squares,
        colour=max(m.colour for m in members),
        worst=max(m.worst for m in members),
        carried=sum(m.carried * m.gain for m in members) / gain,
        members=tuple(members),
    )


def choose(trials: Sequence[Trial]) -> Trial | None:
    """The trial to add: the largest sure held-out gain, or a simpler one that the data cannot tell from it."""
    accepted = [t for t in trials if t.accepted]
    if not accepted:
        return None
    best = max(accepted, key=lambda t: (t.sure_gain, t.gain))
    as_good = [t for t in accepted if t is best or (t.size <= best.size and best.no_better_than(t))]
    # where one block outweighs the others no gain is sure: of those that explain it alike, the one that they show too
    return min(as_good, key=lambda t: (t.size, -t.sure_gain, -t.gain_t))


def added(effects: Sequence[Effect], new: Effect) -> tuple[Effect, ...]:
    """The list of effects with a new one, which takes the place of what it replaces."""
    kept = [e for e in effects if not (e.place == new.place and e.type_name() in new.replaces)]
    return (*kept, new)
