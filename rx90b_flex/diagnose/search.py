"""Try every effect of the catalogue in every place against what a model leaves over."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import linalg, stats

from rx90b_flex.diagnose.base import (
    DETERMINED,
    Base,
    SharedColumns,
    parameters_told,
    penalised_wald,
    solve_beside,
    wald,
)
from rx90b_flex.diagnose.clock_lines import follows_motion
from rx90b_flex.diagnose.families import FAMILIES, family
from rx90b_flex.diagnose.kinds import crowded, laws, repeated, rounded_off, shuts_out
from rx90b_flex.diagnose.other_friction import with_changes
from rx90b_flex.diagnose.refinement import LookAtShape, Refinement
from rx90b_flex.diagnose.rough import Rough
from rx90b_flex.diagnose.side_by_side import SideBySide
from rx90b_flex.diagnose.trial import (
    AS_GOOD,
    SMALLEST_GAIN,
    TorqueTrial,
    gain_of_chance,
    meet,
    off_a_joint,
    shows_by_itself,
    too_faint,
)
from rx90b_flex.effects import Effect, LeftOver, Sites, catalogue
from rx90b_flex.effects.effect import of_motion_alone, shared_shapes
from rx90b_flex.effects.motion import Array, Indices, Motion
from rx90b_flex.effects.stand_in import as_beside, of_usual_shape
from rx90b_flex.identify.coloured import Spectrum, residual_spectra, scatter
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.identify.first_looks import FirstColumns
from rx90b_flex.identify.first_shapes import shared_values
from rx90b_flex.identify.least_squares import (
    BEYOND,
    CORRELATION_S,
    Identification,
    identify,
)
from rx90b_flex.identify.penalty import prior_precision, smoothed
from rx90b_flex.identify.regression import Regression
from rx90b_flex.levenberg import Damping, lowest

FAMILY_GAIN = 10.0  # in a first look, for a joint's effect to be tried as one of a family
FEWEST_RECORDINGS = 2  # to leave out whole ones in turn
PARTS = 3  # of a single recording, left out in turn instead
SHAPES_KNOWN = 1.0  # standard deviation of a shape's logarithm before the data: what they leave open must not run away
LOST = 9.0  # times what chance costs a recording that is left out: three standard deviations
LOST_PART = 0.005  # of its squared error, and this much: less is no reason
REFINED = 16  # trials whose shape parameters are refined at the most
FEWEST_REFINED = 6  # and at the least
UNREFINED = 2.0  # a first look at the shapes shows this part of the gain at the least
BEGINNINGS = 3  # of a refinement of several shapes
REFINEMENTS = 15  # looks of a refinement
REFINING = Damping(rise=16.0, fall=4.0)
DIFFERENCE = 1.0e-3  # step of difference quotients by the shape, of how far the best one may lie
MANY = 4  # shapes of a candidate, from which on a glimpse of the log says first whether all of it is worth a look
WORTH_A_FIT = 0.5  # p-value of a gain in a bent torque, below which the fit with it may tell another
FAINT_PART = 1.0e-2  # of the power of a candidate's columns beside the base: in a joint with less, it hardly changes the residual
ROUNDING = 1.0e-6  # of an effect's torque: a coefficient whose part is less is zero
BATCH_BYTES = 6e6  # of columns that are looked at together
BASES_BYTES = 5e7  # of residuals that bases have which are kept


@dataclass(frozen=True, eq=False)
class Search:
    """Everything that could be missing from an identified model.

    Attributes
    ----------
    model : Identification
    sites : Sites
    kinds : callable
        Which types are tried; `laws` unless something else is given.
    jobs : int
        Processes.
    gains : frozenset of str
        Joints whose torque has another gain, as the look at the data found.
    """

    model: Identification
    sites: Sites
    kinds: Callable[[type[Effect]], bool] = laws
    jobs: int = 1
    gains: frozenset[str] = frozenset()

    def after(self, other: Search) -> Search:
        """This one with what another one has worked out of the same model."""
        names = ("blocks", "longest_parts", "shared", "present", "_bases", "_worths")
        self.__dict__.update({name: other.__dict__[name] for name in names if name in other.__dict__})
        return self

    @property
    def regression(self) -> Regression:
        """The data, seen by the identified links."""
        return self.model.regression

    @cached_property
    def blocks(self) -> tuple[slice, ...]:
        """Blocks to hold out in turn."""
        return self.regression.blocks()

    @cached_property
    def longest_parts(self) -> tuple[Indices, ...]:
        """Which blocks each recording holds; of a single one its first, middle and last blocks."""
        starts = np.array([b.start for b in self.blocks])
        if len(self.regression.spans) < FEWEST_RECORDINGS:
            return tuple(np.array_split(np.arange(len(starts)), PARTS))
        return tuple(np.flatnonzero((starts >= s.start) & (starts < s.stop)) for s in self.regression.spans)

    @cached_property
    def shared(self) -> SharedColumns:
        """Columns, and the torque that they explain beyond what penalties pull them to, in the form that trials use."""
        model, shapes = self.model, self.model.shapes
        sizes = shapes.per_step(shapes.values(model.effects))
        of_shapes = np.concatenate([np.zeros(len(model.theta)), SHAPES_KNOWN**-2.0 * sizes**-2.0])
        # what shapes may still do to the model's torque counts with its columns: no candidate is credited with that
        theta = np.concatenate([model.theta, np.zeros(len(shapes))]) - model.centre
        target = np.ascontiguousarray(model.residual.T + model.derivatives.times(theta))
        links, weight = model.first_column(0) if model.links_fitted else 0, model.solution.sigma**-2.0
        columns, of_changes = with_changes(model, len(theta))
        precision = linalg.block_diag(model.precision + np.diag(of_shapes), of_changes)
        theta = np.concatenate([theta, np.zeros(len(of_changes))])
        return SharedColumns(columns, target, weight, self.blocks, precision, theta, links)

    @property
    def frictions_differ(self) -> bool:
        """Whether candidates are held against frictions that are free to differ between recordings."""
        return len(self.shared.precision) > len(self.model.precision)

    @cached_property
    def present(self) -> Base:
        """The present model as it is."""
        return self._base(None, ())

    def base(self, replaced: Effect | None = None, restored: Sequence[Effect] = ()) -> Base:
        """The present model without `replaced`, and with effects beside it that are not in it; the latest ones are kept."""
        known, key = self._bases, (replaced, tuple(restored))
        if key == (None, ()):
            return self.present
        if key not in known:
            if 8 * self.shared.target.size * len(known) > BASES_BYTES:
                del known[next(iter(known))]
            known[key] = self._base(*key)
        return known[key]

    @cached_property
    def _bases(self) -> dict[tuple[Effect | None, tuple[Effect, ...]], Base]:
        return {}

    def _base(self, replaced: Effect | None, restored: Sequence[Effect]) -> Base:
        model = self.model
        spare, theta = self.shared.spare
        kept = np.setdiff1d(np.arange(len(theta)), spare)
        if replaced is not None:
            index = model.effects.index(replaced)
            first = model.first_column(index)
            elsewhere = np.concatenate([np.zeros(0), *(p for i, p in enumerate(model.shapes.places) if i != index)])
            own = np.setdiff1d(model.shapes.places[index], elsewhere)
            kept = np.setdiff1d(kept, np.r_[first : first + len(replaced.coefficients), len(model.theta) + own])
        if not restored:
            return Base(self.shared, kept, theta[kept])
        present = self.shared.columns.kept(kept, len(theta))
        ends = len(kept) + np.cumsum([0, *(len(e.coefficients) for e in restored)])
        places = [np.arange(a, b) for a, b in pairwise(ends)]
        parts = [(at, *self.regression.compact([e])) for at, e in zip(places, restored, strict=True)]
        more = ColumnsByJoint.of(parts, *self.shared.target.shape)
        none = np.zeros(ends[-1] - len(kept))
        shared = dataclasses.replace(
            self.shared,
            columns=present.beside(more),
            precision=linalg.block_diag(self.shared.precision[np.ix_(kept, kept)], prior_precision(restored)),
            theta=np.concatenate([theta[kept], none]),
        )
        return Base(shared, np.arange(ends[-1]), shared.theta)

    @property
    def seen_sites(self) -> Sites:
        """Places, with the motion of every recording."""
        return dataclasses.replace(self.sites, motions=tuple(s.motion for s in self.regression.segments))

    @cached_property
    def candidates(self) -> list[tuple[Effect, Effect | None]]:
        """Effects to try, each with the declared effect that it would replace."""
        out: list[tuple[Effect, Effect | None]] = []
        for cls in catalogue().values():
            if not self.kinds(cls):
                continue
            for effect in cls.everywhere(self.seen_sites):
                if not len(effect.coefficients):
                    continue  # this motion leaves nothing to place
                here = [e for e in self.model.effects if e.place == effect.place]
                if effect.traits.needs and not any(e.type_name() in effect.traits.needs for e in here):
                    continue
                if any(shuts_out(e, effect) for e in here):
                    continue
                if rounded_off(effect, here):
                    continue
                if crowded(effect, here) is not (self.kinds is repeated):
                    continue
                new = as_beside(effect, here)
                if new is None:
                    continue
                replaced = next((e for e in here if e.type_name() in new.traits.stands_for), None)
                out.append((self._sharing(new), replaced))
        return out

    @cached_property
    def _shared_values(self) -> dict[tuple[str, ...], float]:
        return shared_values(self.model.effects)

    def _sharing(self, effect: Effect) -> Effect:
        """With the present values of the shapes that it shares with the model's effects."""
        known = [self._shared_values.get(k, np.nan) if k is not None else np.nan for k in shared_shapes(effect)]
        return effect.with_shape(np.array(known)) if not np.isnan(known).all() else effect

    def free(self, effect: Effect) -> Indices:
        """Places of the shape parameters that a trial is free to choose."""
        named = zip(shared_shapes(effect), effect.shape_parameters.values(), strict=True)
        return np.array(
            [i for i, (k, p) in enumerate(named) if not (p.held or k in self._shared_values)], dtype=np.intp
        )

    def _shaped(self, effect: Effect, values: Array, free: Indices | None = None) -> Effect:
        """With other values of the free shapes, or of some of them."""
        shape = effect.shape.copy()
        shape[self.free(effect) if free is None else free] = values
        return effect.with_shape(shape)

    def run(
        self, progress: Callable[[float], None] | None = None, company_of: Effect | None = None
    ) -> list[TorqueTrial]:
        """Try all candidates and families of them; of the company of an effect, single ones that share a joint with it.

        What shares none is beside that effect about what it was without it.

        Returns
        -------
        list of TorqueTrial
            By gain, largest first; only those worth a closer look have refined shapes and a p-value below 1.
        """
        with SideBySide(self._ready(), self.jobs) as beside:
            rough = self._rough(beside, progress, company_of)
            tried: dict[tuple[type[Effect], str], TorqueTrial] = {}
            # a first look at a gain sees a torque that is bent for want of it: its rank among others says little
            bent = [r for r in rough[REFINED:] if r.effect.traits.multiplies and r.gain > FAMILY_GAIN]
            ranked = [*filter(self._may_matter, rough[:REFINED]), *bent]
            # for company all pairs might have been tried; else the first are told anyway
            chance = gain_of_chance(self.tests ** (1 if company_of is None else 2)) / UNREFINED
            first = ranked[: FEWEST_REFINED if company_of is None else 0]
            ranked = [r for r in ranked if r in first or r.effect.traits.multiplies or r.gain > chance]
            found = beside.each(Search._tried, ranked)
            for item in ranked:
                if len(tried) >= FEWEST_REFINED and UNREFINED * item.gain < _sure(tried.values()):
                    break  # neither this one nor those behind it can win
                tried[type(item.effect), item.effect.label] = next(found)
            # nor what a first look at the model's torque says of a gain that the data asked for: that torque is bent for want of it
            said = [r.effect for r in rough if r.effect.traits.multiplies and set(r.effect.joints) <= self.gains]
            more = [self._fitted(e) for e in said if (type(e), e.label) not in tried]
            trials = [*tried.values(), *more, *(self._families(rough, tried, beside) if company_of is None else [])]
        self.regression.round_over()
        return sorted(trials, key=lambda t: -t.gain)

    def _ready(self) -> Search:
        """With what all processes ask for, and the candidates, of which some may be defined in this one alone."""
        if self.jobs > 1:
            _ = self.candidates, self.present.whole, self.present.held_out, self.tests
        return self

    def _rough(
        self, beside: SideBySide[Search], progress: Callable[[float], None] | None, company_of: Effect | None
    ) -> list[Rough]:
        """First looks at candidates, the best first."""
        every = enumerate(self.candidates)
        numbers = [i for i, (e, _) in every if company_of is None or meet(e, company_of)]
        rough: list[tuple[int, Rough]] = []
        for done, (part, columns) in enumerate(beside.all(Search._first_looks, numbers), start=1):
            rough += part
            if beside.elsewhere:
                self.regression.take_first_looks(columns)
            if progress:
                progress(max(len(rough), done) / (len(numbers) + 4))
        self.regression.forget_pieces()
        self.regression.forget_long()
        # in their order where they gain the same
        return [item for _, item in sorted(rough, key=lambda pair: (-pair[1].gain, pair[0]))]

    def _first_looks(self, numbers: list[int]) -> tuple[list[tuple[int, Rough]], list[FirstColumns]]:
        """At some of the candidates, as numbers and what was seen, and columns that the next round may ask for again.

        Nothing of a candidate for none of whose shapes this motion is large enough.
        """
        known = self.regression.known_first_looks() if self.jobs > 1 else []
        out = []
        for number in numbers:
            effect, replaced = self.candidates[number]
            starts = self._starts(effect, replaced)
            if len(starts):
                base = self.base(replaced)
                # an effect that replaces another starts from a worse base: count only what it adds to the present model
                lost = float(base.squares.sum() - self.present.squares.sum()) if replaced is not None else 0.0
                rough = Rough(effect, replaced, starts, lost)
                out.append((number, self._looked(rough, self._glimpsed(effect, starts))))
        return out, self.regression.first_looks_since(known) if known else []

    def _may_matter(self, item: Rough) -> bool:
        """Whether its first look leaves it open that an effect explains enough of a joint that it acts on for a name."""
        rows = zip((*self.regression.joints, *self.regression.sensors), self.present.squares, strict=True)
        least = min((x for joint, x in rows if joint in item.effect.joints), default=0.0)
        return item.effect.traits.multiplies or UNREFINED * item.gain > SMALLEST_GAIN * least

    def _families(
        self,
        rough: Sequence[Rough],
        tried: Mapping[tuple[type[Effect], str], TorqueTrial],
        beside: SideBySide[Search],
    ) -> list[TorqueTrial]:
        """One law on several joints, for the types that a first look at all joints together likes best.

        Gains add up where each acts on a joint of its own: what one twisting drive does to all joints, another explains too.
        """
        kinds: dict[type[Effect], list[Rough]] = {}
        for item in rough:
            kind = type(item.effect)
            of_all_joints = kind.traits.multiplies or kind.traits.coefficients_follow
            if kind.traits.on == "joint" and kind.traits.of_make and not of_all_joints:
                kinds.setdefault(kind, []).append(item)
        sums = {kind: sum(max(item.gain, 0.0) for item in items) for kind, items in kinds.items()}
        liked = sorted(kinds, key=lambda kind: -sums[kind])[:FAMILIES]
        sure = _sure(tried.values())
        fewest = max(2, len(self.sites.joints) / 2)
        out = []
        for kind in liked:
            if UNREFINED * sums[kind] < sure:
                break  # neither this one nor those behind it can win
            # the weakest first: it tells soonest that they are too few
            left = [item for item in reversed(kinds[kind]) if item.gain > FAMILY_GAIN and self._may_matter(item)]
            new = beside.each(Search._tried, [r for r in left if (kind, r.effect.label) not in tried])
            members: list[TorqueTrial] = []
            for behind, item in zip(range(len(left), 0, -1), left, strict=True):
                if len(members) + behind < fewest:
                    break
                found = tried.get((kind, item.effect.label)) or next(new)
                members = [found, *members] if found.belongs else members
            if len(members) >= fewest:
                out.append(family(members, len(self.sites.joints), len(kinds)))
        return out

    def _tried(self, item: Rough) -> TorqueTrial:
        """The trial of what was looked at, by more than a glimpse."""
        closer = self._looked(item, False) if item.glimpsed else item
        base = self.base(item.replaced)
        found = self.trial(closer.effect, base, self.present, self.tests, closer.elsewhere)
        self.regression.forget_long()
        return self._fitted(item.effect) if item.effect.traits.multiplies and found.p_value < WORTH_A_FIT else found

    def _fitted(self, effect: Effect) -> TorqueTrial:
        """The trial of an effect that scales the model's torque, which a fit without it has bent: about the fit with it."""
        known = self.model
        model = identify(
            self.regression,
            [*known.effects, effect],
            fit_links=known.links_fitted,
            start=known,
            with_covariance=False,
        )
        beside = Search(model, self.sites, self.kinds)
        found = beside.without(model.effects[-1])
        if found.gain <= 0.0:
            return found  # held-out blocks are better off without it, even where it had its say in all the rest
        weighted = dataclasses.replace(beside.shared, weight=self.shared.weight)
        new = dataclasses.replace(beside.present, shared=weighted)
        block_gains = self.present.held_out - new.held_out
        gain = float(block_gains.sum())
        lost = np.zeros(0)
        if len(found.lost):
            lost = new.grouped(self.longest_parts).held_out - self.present.grouped(self.longest_parts).held_out
        touched = self.present.squares[self.regression.joints.index(effect.joints[0])]
        return dataclasses.replace(found, gain=gain, block_gains=block_gains, share=gain / touched, lost=lost)

    def _looked(self, item: Rough, glimpsed: bool) -> Rough:
        """With the best of its shapes and what that gains, by a glimpse of the log or a first look at it."""
        base = self.base(item.replaced)
        looks = sorted(self._over_shapes(item.effect, item.starts, base, glimpsed), key=lambda pair: -pair[0])
        gain, best = looks[0]
        elsewhere = () if glimpsed else tuple(self._apart(looks)[1:])
        return replace(item, effect=best, gain=gain - item.lost, glimpsed=glimpsed, elsewhere=elsewhere)

    def _glimpsed(self, effect: Effect, starts: Array) -> bool:
        """Whether a glimpse comes before a first look: where that has to work many columns out anew in every round."""
        return len(starts) >= MANY and not (effect.traits.by_clock or of_motion_alone(effect))

    def present_without(self, effect: Effect) -> list[Effect]:
        """The model's effects without one, which gives its place back to what it stands in for."""
        return [*(e for e in self.model.effects if e is not effect), *self.restored(effect)]

    def restored(self, effect: Effect) -> list[Effect]:
        """What comes back where an effect is taken out, with the shapes that explain most there."""
        if not (effect.joints and effect.traits.stands_for):
            return []
        kinds = [catalogue()[name] for name in effect.traits.stands_for]
        of_each = ([e for e in k.everywhere(self.sites) if type(e) is k and e.place == effect.place] for k in kinds)
        own: list[Effect] = next(filter(None, of_each), [])  # the first that is searched for as it stands in files
        here = [e for e in own if e not in self.model.effects]
        base = self.base(effect)
        return [self._best(e, base) if len(self.free(e)) else e for e in map(self._sharing, here)]

    def _best(self, effect: Effect, base: Base) -> Effect:
        """With the shapes that gain most."""
        looks = max(self._over_shapes(effect, self._starts(effect), base), key=lambda pair: pair[0])
        return self._refined(looks[1], base)

    def without(self, effect: Effect) -> TorqueTrial:
        """What an effect of the present model is worth: the trial of adding it to the model without it, what it replaces restored."""
        key = effect, self.kinds
        if key not in self._worths:
            base, restored = self.base(effect), self.restored(effect)
            present = self.base(effect, restored) if restored else base
            self._worths[key] = self.trial(effect, base, present, self.tests)
            self.regression.forget_long()
        return self._worths[key]

    @cached_property
    def _worths(self) -> dict[tuple[Effect, Callable[[type[Effect]], bool]], TorqueTrial]:
        return {}

    @property
    def sample_s(self) -> float:
        """Time between two samples of the log, s."""
        return 1.0 / self.regression.segments[0].recording.sample_rate_hz

    @property
    def longest(self) -> Motion:
        """Motion of the longest recording, from which starts and ranges of shapes are taken."""
        return self.regression.longest

    @cached_property
    def longest_lag(self) -> int:
        """Longest correlation of a residual that tests allow for, samples."""
        return int(CORRELATION_S * self.regression.segments[0].rate_hz)

    @cached_property
    def tests(self) -> int:
        """How many independent trials a search makes."""
        out = sum(effect.independent_shapes(self.longest) for effect, _ in self.candidates)
        self.regression.forget_long()
        return out

    def _starts(self, effect: Effect, replaced: Effect | None = None) -> Array:
        free = self.free(effect)
        if not len(free):
            return np.zeros((1, 0))
        joint = self.regression.joints.index(effect.joints[0]) if effect.joints else 0
        residual = self.present.residual[joint]
        segments = self.regression.segments
        each = [(s.sampled, residual[span]) for s, span in zip(segments, self.regression.spans, strict=True)]
        search = effect.shape_search(self.longest, LeftOver(each, segments[0].cutoff_hz, replaced))
        starts = search.starts[:, free]
        return np.vstack([starts, self._mixed(effect, starts)]) if search.mixes else starts

    def _mixed(self, effect: Effect, starts: Array) -> Array:
        """Mean of starts, weighted with what each has where all are fitted side by side, (1, s); none where that is out of range."""
        regression, base, _ = self._looked_at(effect, self.present, self._glimpsed(effect, starts))
        rows, columns = regression.compact([self._shaped(effect, s) for s in starts], leading=True)
        none = np.zeros((0, starts.shape[1]))
        if len(rows) == 0:
            return none
        each = solve_beside(*base.projected(rows, columns))
        low, high = effect.shape_range(self.longest)[:, self.free(effect)]
        mean = each @ starts / total if (total := each.sum()) > 0.0 else low - 1.0
        return mean[None] if ((low <= mean) & (mean <= high)).all() else none

    def _over_shapes(
        self, effect: Effect, starts: Array, base: Base, glimpsed: bool = False
    ) -> Iterable[tuple[float, Effect]]:
        shaped = [self._shaped(effect, s) if len(s) else effect for s in starts]
        k = len(effect.coefficients)
        regression, base, times = self._looked_at(effect, base, glimpsed)
        per_effect = 8.0 * k * sum(len(s.motion) for s in regression.segments)
        batch = max(1, int(BATCH_BYTES / per_effect))
        for at in range(0, len(shaped), batch):
            part = shaped[at : at + batch]
            rows, columns = regression.compact(part, leading=True)
            if len(rows) == 0:
                yield 0.0, part[0]
                continue
            yield from zip((times * base.gains(rows, columns, k)).tolist(), part, strict=True)

    def _looked_at(self, effect: Effect, base: Base, glimpsed: bool) -> tuple[Regression, Base, float]:
        """What a first look is taken at, an excerpt of a long log or fewer samples, a base on it, and how much longer the whole is.

        A line's frequency shows over the whole time only.
        """
        pieces = self.regression.excerpt or (self.regression.glimpse if glimpsed else None) or self.regression.halved
        if pieces is None or effect.traits.by_clock:
            return self.regression, base, 1.0
        regression, samples = pieces
        shared = base.shared, len(samples)
        if shared not in self._excerpts:
            self._excerpts[shared] = base.shared.at(samples)
        key = (*shared, tuple(base.kept))
        if key not in self._bases_of_excerpts:
            self._bases_of_excerpts[key] = dataclasses.replace(base, shared=self._excerpts[shared])
        return regression, self._bases_of_excerpts[key], len(self.regression) / len(samples)

    @cached_property
    def _excerpts(self) -> dict[tuple[SharedColumns, int], SharedColumns]:
        return {}

    @cached_property
    def _bases_of_excerpts(self) -> dict[tuple[SharedColumns, int, tuple[int, ...]], Base]:
        return {}

    def _apart(self, looks: Sequence[tuple[float, Effect]]) -> list[tuple[float, Effect]]:
        """The first of effects that differ in their shapes by more than a refinement's step; one of a single shape stands for all."""
        if len(self.free(looks[0][1])) < 2:
            return [looks[0]]
        spread = self._reach(looks[0][1])
        out: list[tuple[float, Effect]] = []
        for gain, effect in looks:
            if all((np.abs(effect.shape - e.shape) > spread).any() for _, e in out):
                out.append((gain, effect))
            if len(out) == BEGINNINGS:
                break
        return out

    def _refined(self, effect: Effect, base: Base) -> Effect:
        """The shapes that gain most."""
        return self._valleys(effect, base)[0]

    def _valleys(self, effect: Effect, base: Base, elsewhere: Sequence[tuple[float, Effect]] = ()) -> list[Effect]:
        """The same, and behind them those that gain hardly less: from all starts of a first look where shapes make valleys."""
        free = self.free(effect)
        if not len(free):
            return [effect]
        tried = [self._refined_from(effect, base, free)]
        for gain, other in elsewhere:
            if UNREFINED * gain > AS_GOOD * max(known for known, _ in tried):  # else it cannot win
                tried.append(self._refined_from(other, base, free))
        # one that ran into an end of its range explains a little more by playing another effect's part
        tried.sort(key=lambda pair: -pair[0] * (AS_GOOD if self.at_bound(pair[1]) else 1.0))
        (most, best), *less = tried
        others = [e for gain, e in less if gain >= AS_GOOD * most]
        if not self.at_bound(best):
            return [best, *others]
        # beside what is wrong elsewhere a power may run anywhere: with its usual value it is tried, with all else it is fitted again
        usual = {i: p.start for i, p in enumerate(effect.shape_parameters.values()) if p.usual}
        held = np.array([i for i in free if i in usual], dtype=np.intp)
        if len(held) in (0, len(free)):
            return [best, *others]
        plainer = self._shaped(effect, np.array([usual[i] for i in held]), held)
        _, plain = self._refined_from(plainer, base, np.setdiff1d(free, held))
        return [best if self.at_bound(plain) else plain, *others]

    def _reach(self, effect: Effect) -> Array:
        """How far the best shape may lie from an effect's, shape (s,)."""
        return effect.shape_search(self.longest).reach(effect.shape)

    def _refined_from(self, effect: Effect, base: Base, free: Indices) -> tuple[float, Effect]:
        """Gain and some of the shapes by Gauss-Newton steps with everything linear projected out (variable projection)."""
        low, high = effect.shape_range(self.longest)[:, free]
        logs = bool((low > 0).all())
        to, back = (np.log, np.exp) if logs else (np.asarray, np.asarray)
        start = np.clip(effect.shape[free], low, high)
        spread = self._reach(effect)[free]
        farthest = spread / start if logs else spread

        def looked_at(x: Array) -> LookAtShape:
            shapes = [np.clip(back(x + step), low, high) for step in np.vstack([0 * x, np.diag(DIFFERENCE * farthest)])]
            rows, columns = self.regression.compact([self._shaped(effect, s, free) for s in shapes])
            return LookAtShape.at(base, rows, columns, len(effect.coefficients), DIFFERENCE * farthest)

        def moved(x: Array, step: Array) -> Array:
            return np.asarray(to(np.clip(back(x + np.clip(step, -farthest, farthest)), low, high)))

        end = lowest(Refinement(to(start), looked_at, moved), REFINEMENTS, REFINING)
        return end.look.gain, self._shaped(effect, np.clip(back(end.x), low, high), free)

    def trial(
        self,
        effect: Effect,
        base: Base,
        present: Base,
        tests: int,
        elsewhere: Sequence[tuple[float, Effect]] = (),
    ) -> TorqueTrial:
        """Try one effect beside a base, its shape refined; gains count from `present`, p-values for so many tests.

        Where it cannot have the values that fit best, others are tried that fit hardly worse, then those shapes held that have a
        usual value.
        """
        valleys = self._valleys(effect, base, elsewhere)
        found = self._trial(valleys[0], base, present, tests)
        for shaped in valleys[1:] if not found.lawful else ():
            other = self._trial(shaped, base, present, tests)
            if other.lawful:
                return other
        plainer = None if found.lawful else of_usual_shape(effect)
        if plainer is None:
            return found
        other = self._trial(self._best(plainer, base), base, present, tests)
        return other if other.lawful else found

    def _trial(self, effect: Effect, base: Base, present: Base, tests: int) -> TorqueTrial:
        """Of an effect with its shape as it is."""
        k, s = len(effect.coefficients), len(self.free(effect))
        rows, beside = self.regression.compact([effect, *self._neighbours(effect)])
        columns = beside[:, :, :k]
        size = k + s - (present.size - base.size)
        if len(rows) == 0:
            return TorqueTrial(effect, 0.0, np.zeros(len(self.blocks)), 1.0, size, 0.0, False)
        per_block = [base.products(rows, columns, block) for block in self.blocks]
        b, y, d = (np.array(part) for part in zip(*per_block, strict=True))
        theta, inverse = base.whole
        left = d.sum(axis=0) - b.sum(axis=0).T @ inverse @ b.sum(axis=0)
        if effect.penalty is not None:
            effect = smoothed(
                effect, d.sum(axis=0), lambda e: float(base.held_out_beside(b, y, d, prior_precision([e])).sum())
            )
        before = prior_precision([effect])
        used = parameters_told(left, d.sum(axis=0), before)
        size += round(used) - k
        beta = solve_beside(left, d.sum(axis=0), y.sum(axis=0) - b.sum(axis=0).T @ theta, before)
        block_gains = present.held_out - base.held_out_beside(b, y, d, before)
        # one that takes another's place and adds no parameter is there if it tells something beside that one, too
        known, also = base, beta
        if size <= 0:
            known = present
            left, own, score = present.projected(rows, columns)
            also = solve_beside(left, own, score, before)
        p_value, objection, colour, left_over = self._evidence(effect, known, rows, beside, also)
        if effect.traits.by_clock and follows_motion(self.regression, base.residual[rows], float(effect.shape[0])):
            objection = "its line lies among those of the motion itself"
        elif effect.traits.by_clock and len(self.regression.spans) < FEWEST_RECORDINGS:
            objection = "one recording cannot tell whether its phase holds in another"
        found = effect.with_coefficients(beta)
        if not objection and not found.possible():
            objection = "its values do not go together with what its torque assumes"
        touched = present.squares[rows].sum()
        gain = float(block_gains.sum())
        return TorqueTrial(
            found,
            gain,
            block_gains,
            min(1.0, p_value * tests),
            size,
            gain / touched if touched > 0 else 0.0,
            not objection,
            colour,
            objection,
            *self._left_out(base, present, (b, y, d), before, used * colour, gain),
            small=found.too_small(
                off_a_joint(present.squares[rows], left_over[rows], gain), self.sample_s, self.longest
            )
            or too_faint(columns @ beta, self.regression.torque[:, rows]),
            acting=int((d @ beta @ beta > shows_by_itself(colour)).sum()),
            left=float(left_over[rows].sum()),
            alone=min(1.0, p_value * effect.independent_shapes(self.longest)),
        )

    def _left_out(
        self, base: Base, present: Base, products: tuple[Array, ...], precision: Array, chance: float, gain: float
    ) -> tuple[Array, Array]:
        """`lost` and `by_chance` where whole recordings, or parts of a single one, are left out; nothing if it is short."""
        if (len(self.blocks) < 2 * PARTS and len(self.regression.spans) < FEWEST_RECORDINGS) or gain <= 0:
            return np.zeros(0), np.zeros(0)
        b, y, d = (np.array([part[at].sum(axis=0) for at in self.longest_parts]) for part in products)
        before = present.grouped(self.longest_parts)
        lost = base.grouped(self.longest_parts).held_out_beside(b, y, d, precision) - before.held_out
        parts = np.array([len(at) for at in self.longest_parts]) / len(self.blocks)
        # what a fit to the others costs a recording by chance: as much as it is longer than they are together
        spread = LOST * chance * (1.0 + parts / (1.0 - parts)) + LOST_PART * before.held_out
        return lost, spread

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
        return base.residual - base.apart(rows, columns) @ solve_beside(left, own, score, prior_precision([effect]))

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
        own = base.weight[rows] @ (together**2).sum(axis=0)
        apart = base.apart(rows, together)
        residual = base.residual - apart[:, :, :k] @ beta
        left_over = base.weight * np.einsum("jn,jn->j", residual, residual)
        residual = residual / np.sqrt(self.regression.share)[:, None]
        apart = apart.transpose(1, 0, 2)
        spectra = self._spectra(residual, base.weight[:, None] * np.einsum("njk,njk->jk", apart, apart))
        spans = self.regression.spans
        meat = scatter(apart, base.weight, spectra, spans)
        flat = (apart * np.sqrt(base.weight)[:, None]).reshape(-1, apart.shape[2])
        bread = flat.T @ flat
        before = prior_precision([effect])
        tested = bread[:k, :k], meat[:k, :k], own[:k]
        statistic, free, covariance = (
            penalised_wald(*tested, before, beta) if before.any() else wald(*tested, beta, DETERMINED)
        )
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        shapes = self.free(effect)
        tests = free + len(shapes)
        p_value = (
            float(stats.f.sf(statistic / tests, tests, min(s.degrees_of_freedom for s in spectra))) if free else 1.0
        )
        objection = ""
        # what the base explains wholly is left at zero, up to rounding
        size = np.sqrt(np.maximum(own[:k], 1e-300))
        rounding = ROUNDING * np.linalg.norm(beta * size) / size
        named = list(effect.coefficient_parameters.items())
        wrong = np.flatnonzero(beta < np.array([p.lower for _, p in named]) - BEYOND * std - rounding)
        if len(wrong):
            i = wrong[0]
            name, parameter = named[i]
            far = abs(beta[i]) / max(std[i], 1e-300)
            objection = f"its {name} would be {beta[i]:.3g} {parameter.unit}, {far:.0f} std of the wrong sign"
        elif len(shapes) and not effect.traits.coefficients_follow:
            _, _, whole = wald(bread, meat, own, np.r_[beta, np.zeros(len(shapes))], 1e-12)
            certain = beta @ np.linalg.pinv(whole[:k, :k], rcond=1e-10, hermitian=True) @ beta
            if not certain > BEYOND**2 * k:
                objection = "with its shape open too, nothing of it is certain"
        objection = self.at_bound(effect) or objection
        white = float(beta @ bread[:k, :k] @ beta)
        return p_value, objection, float(beta @ meat[:k, :k] @ beta) / white if white > 0 else 1.0, left_over

    def _spectra(self, residual: Array, power: Array) -> tuple[Spectrum, ...]:
        """Of a residual (joints, N) with a candidate whose columns beside the base have so much `power` (joints, k) in each joint.

        Where that is little, the candidate leaves what the model does.
        """
        spectra = list(self.model.spectra)
        some = np.flatnonzero((power >= FAINT_PART * power.sum(axis=0)).any(axis=1))
        absorbed = [self.model.absorbed[j] for j in some]
        for j, own in zip(
            some, residual_spectra(residual[some], self.regression.spans, absorbed, self.longest_lag), strict=True
        ):
            spectra[j] = own
        return tuple(spectra)

    def at_bound(self, effect: Effect) -> str:
        """Which shape ran into an end of what this log can tell, in words; empty where none did."""
        shapes = self.free(effect)
        low, high = effect.shape_range(self.longest)[:, shapes]
        at = effect.shape[shapes]
        named = list(effect.shape_parameters.items())
        for (name, p), x, a, b in zip((named[i] for i in shapes), at, low, high, strict=True):
            if x <= 1.01 * a and not (p.shared or p.least_will_do):  # what effects share may be as sharp as can be
                return f"at its bound: this log does not resolve a {name} below {a:.3g}"
            if x >= 0.99 * b:
                return f"at its bound: this log does not hold a {name} beyond {b:.3g}"
        return ""


def _sure(trials: Iterable[TorqueTrial]) -> float:
    """What the best of those that may be added gains at the least."""
    return max((t.sure_gain for t in trials if t.accepted), default=0.0)
