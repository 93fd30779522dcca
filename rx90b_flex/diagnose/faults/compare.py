"""Hypotheses about the data compete with each other and with no fault."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rx90b_flex.diagnose.faults.carried import carried_motors
from rx90b_flex.diagnose.faults.columns_in_one import exchanged_in_one, rates_in_one, units_in_one, zeros_in_one
from rx90b_flex.diagnose.faults.gains import small_gain, torque_gains
from rx90b_flex.diagnose.faults.in_one import other_loads, reversed_in_one, scaled_in_one
from rx90b_flex.diagnose.faults.kinematics import a_little_off, axes, lengths, mountings, zeros
from rx90b_flex.diagnose.faults.look import Hypothesis, Look
from rx90b_flex.diagnose.faults.rates import sample_rates
from rx90b_flex.diagnose.faults.ratios import angle_scales, gear_ratios
from rx90b_flex.diagnose.faults.rigid_fit import FLOOR, IMPOSSIBLE, NEAR, RigidFit
from rx90b_flex.diagnose.faults.sample import Reading
from rx90b_flex.diagnose.faults.shifts import shifted
from rx90b_flex.diagnose.faults.signs import reversed_axes, reversed_positions, reversed_torques
from rx90b_flex.diagnose.faults.swapped import swapped
from rx90b_flex.diagnose.faults.units import other_units, outside
from rx90b_flex.effects.motion import Array, Mask

# in the order in which one is believed where several do equally well
KINDS: tuple[Callable[[Look], Iterator[Hypothesis]], ...] = (
    reversed_torques, swapped, other_units, shifted, reversed_positions, reversed_in_one, exchanged_in_one, units_in_one,
    torque_gains, scaled_in_one, other_loads, zeros, zeros_in_one, reversed_axes, carried_motors, gear_ratios, angle_scales, axes,
    lengths, sample_rates, rates_in_one, mountings,
)  # fmt: skip
# a joint's zero parallel to its neighbours' axes is taken up by free links, but not by those of the URDF
ON_POSES = (
    reversed_positions, zeros, zeros_in_one, reversed_axes, carried_motors, gear_ratios, angle_scales, axes, mountings,
)  # fmt: skip
BY_LINKS = (*ON_POSES, lengths, sample_rates)  # compared with these links, too
# believed by them alone: other lengths are much like masses that are a little off
BY_LINKS_ALONE = (*ON_POSES, sample_rates)
EXCHANGES = (swapped, exchanged_in_one)
RATIOS = (gear_ratios, angle_scales)
# looked at where errors are small, too: what is on torques alone, and a few per cent of an angle leave no large ones
AT_SMALL_ERRORS = (reversed_torques, torque_gains, shifted, sample_rates, *RATIOS, zeros_in_one)
# not looked for beside what drives may lack: that takes up a few per cent of an angle, and fitted to the other recordings it says
# little of one that goes further
NOT_BESIDE = (*RATIOS, scaled_in_one, zeros_in_one, rates_in_one)
GAIN = 1.0  # of the summed log error: a joint's squared error falls to 37 %, or several joints' a little less each
MODEST = 0.5  # the same where the joints that gain end with a small error: a good model does not gain by chance
SMALL = 0.15**2
GAINING = 0.9  # of its squared error before: a joint that gains
TIE = 0.15  # within which the earlier kind is believed
OF_KNOWN = 0.5  # weight of the gain with the URDF's links: they may be off
CREDIBLE = 0.3**2  # squared error with the URDF's links in every joint, below which they are worth a look
FAIR = 0.45**2  # squared error up to which a tree explains a joint for which it does far better, all the time
GAIN_KNOWN = 2.0  # with these links, of a pose: a joint's squared error falls to a seventh
# of a joint's log error, that what its drive lacks takes: from there on faults are looked for beside it, too
LACKING = 1.0
STEADY = 4.0  # Student's t of the gains of the rows that are held out in turn: a fault is there all the time, chance now and then
LARGE, STEADY_LARGE = 2.0, 2.0  # the same of gains that are hardly chance in a log that is long enough
LOSS = 0.15  # that the fit with free links may lose at the same time
THIN = 3  # rows of a first look at every hypothesis: one in so many
SECOND_LOOKS = 2  # of each kind, at all rows and with the factor refined
# gain with free links of a first look: below it neither the URDF's links nor what a drive may lack bring a fault to be believed
HOPELESS = -1.0
PROMISING = 0.3  # of the best gain of a first look, and this much of the log error itself
MOST = 4  # faults that are looked for behind one another
# squared relative errors of every joint, with the links fitted and with the URDF's, at which the positions go together with the
# torques: both need to hold, for free links take up a wrong zero or rate
GOOD, GOOD_KNOWN = 0.08**2, 0.15**2


@dataclass(frozen=True, eq=False)
class Found:
    """A hypothesis that does better than no fault, with the fits without and with it."""

    hypothesis: Hypothesis
    std: float | None
    before: RigidFit
    after: RigidFit


def faults_of(look: Look) -> tuple[tuple[Found, ...], Look]:
    """Faults of columns, units, times and kinematics, one behind the other, and the look with them mended."""
    found: list[Found] = []
    for _ in range(MOST):
        best = _best(look) or _beside_effects(look)
        if best is None:
            break
        found.append(best)
        look = dataclasses.replace(look, reading=best.hypothesis.reading)
    return tuple(found), look


@dataclass(frozen=True)
class _Gain:
    """What a hypothesis gains: with the links fitted, and with those of the URDF, where these are worth a look.

    `possible` is the part of `fitted` that comes of friction and inertias which no body has, and of what is evident; `steady` is
    Student's t of what the rows gain that are held out in turn; links of the URDF that are off do not count against what goes
    `by_free_links`.
    """

    fitted: float
    known: float
    credible: bool
    possible: float
    steady: float
    by_free_links: bool = False

    @property
    def total(self) -> float:
        known = max(self.known, 0.0) if self.by_free_links else self.known
        return self.fitted + (OF_KNOWN * known if self.credible else 0.0)


_Refined = tuple[_Gain, int, Hypothesis, float | None]  # with the rank of its kind, and its factor's standard deviation


class _Bases:
    """A look and its fits without any fault, from whose errors a first look at those with one takes its weights."""

    def __init__(self, look: Look, first: bool = False) -> None:
        self.look, self.fitted, self.known = look, look.fit(), look.fit_of_known_links()
        self.near = (self.fitted, self.known) if first else (None, None)

    def free(self, hypothesis: Hypothesis) -> RigidFit:
        """The fit of a hypothesis with free links."""
        return self.look.fit(hypothesis.reading, self.near[0])

    def fitted_gain(self, hypothesis: Hypothesis, free: RigidFit) -> float:
        return self._gained(self.fitted, free) + hypothesis.evident

    def _gained(self, before: RigidFit, after: RigidFit) -> float:
        return _errors(before) - _errors(after) + self._possible(before, after)

    def _possible(self, before: RigidFit, after: RigidFit) -> float:
        """None beside other effects: there basic friction and inertia are a part of a joint's, whose sign says nothing."""
        if self.look.with_effects:
            return 0.0
        return IMPOSSIBLE * float(before.impossible.sum() - after.impossible.sum())

    def gain(self, hypothesis: Hypothesis, free: RigidFit | None = None) -> _Gain:
        free = free or self.free(hypothesis)
        known = self.look.fit_of_known_links(hypothesis.reading, self.near[1])
        credible = bool((known.error < CREDIBLE).all())
        folds = self.fitted.scores - free.scores
        if credible and hypothesis.by_links:
            folds = folds + OF_KNOWN * (self.known.scores - known.scores)
        return _Gain(
            self.fitted_gain(hypothesis, free),
            self._gained(self.known, known),
            credible,
            self._possible(self.fitted, free) + hypothesis.evident,
            _students_t(folds),
            not hypothesis.by_links,
        )

    def sure(self, hypothesis: Hypothesis) -> float:
        """What a hypothesis gains over the best fit without it: free links fit worse than the URDF's where these are nearly right."""
        return self._best(self.look.reading) - self._best(hypothesis.reading) + hypothesis.evident

    def _best(self, reading: Reading) -> float:
        look, links = self.look, range(reading.links)
        fits = look.fit(reading), look.fit_held(links, NEAR, reading), look.fit_of_known_links(reading)
        return min(_errors(f) if look.with_effects else f.score for f in fits)

    def gaining(self, hypothesis: Hypothesis) -> Array:
        """Squared errors with a hypothesis of the joints whose error it brings down."""
        after = self.look.fit(hypothesis.reading).error
        return after[after < GAINING * self.fitted.error]

    def links_instead(self, hypothesis: Hypothesis, gaining: Mask) -> bool:
        """Whether links that the robot file calls known would explain without the fault what it explains, if they were free.

        Where the fault brings the `gaining` joints to a small error that free links do not fall below, it is believed.
        """
        if self.look.reading.robot.inertial_parameters != "known":
            return False
        free, after = self.look.fit_of_free_links(), self.look.fit(hypothesis.reading)
        better = np.log((after.error + FLOOR) / (free.error + FLOOR))[gaining].sum() > TIE
        if not (better or (after.error[gaining] > SMALL).any()):
            return False
        return free.score - self.look.fit_of_free_links(hypothesis.reading).score < MODEST


def _beside_effects(look: Look) -> Found | None:
    """The same beside what drives may have and the robot file lacks, where that explains most of what a joint leaves: it hides
    faults.
    """
    beside = look.beside
    if not beside.tells():
        return None
    less = np.log((look.fit().error + FLOOR) / (beside.fit().error + FLOOR))
    return _best(beside) if min(less.max(), less.sum()) > LACKING else None


def _best(look: Look) -> Found | None:
    bases = _Bases(look)
    well = (bases.fitted.error < GOOD).all() and (bases.known.error < GOOD_KNOWN).all()
    everything = bool(not well or bases.fitted.impossible.any() or outside(look, 1.0).any())
    promising = _promising(look, everything)
    finals = [(bases.gain(h), rank, h) for _, rank, h in promising]
    # what has a factor is compared at its best one; what falls far behind cannot be brought to win by it
    best = max((gain.total for gain, *_ in finals), default=0.0)
    refined: list[_Refined] = []
    for gain, rank, hypothesis in finals:
        if gain.total > PROMISING * max(best, MODEST):
            better, std = look.refined(hypothesis, OF_KNOWN if gain.credible and hypothesis.by_links else 0.0)
            # a factor within its own standard deviation is not told
            if better.factor is None or abs(better.factor - better.neutral) >= max(better.smallest, std or 0.0):
                refined.append((bases.gain(better), rank, better, std))
    refined = _one_ratio(refined)
    least = max((gain.total for gain, *_ in refined), default=0.0) - TIE
    accepted = [
        r for r in refined if _accepted(bases, *r[:3]) or (r[0].total >= least and _accepted_by_links(bases, *r[:3]))
    ]
    beside = look.beside
    while accepted:
        top = max(gain.total for gain, *_ in accepted)
        alike = [r for r in accepted if r[0].total >= top - TIE]
        best_one = min(alike, key=lambda r: (r[1], _plain(look, r[2]), -r[0].total))
        gain, _, chosen, std = best_one
        if not _in_doubt(bases, beside, best_one):
            others = [h for g, _, h, _ in accepted if g.total >= gain.total - MODEST]
            return Found(_or_else(chosen, others), std, bases.fitted, look.fit(chosen.reading))
        accepted.remove(best_one)
    return None


def _plain(look: Look, hypothesis: Hypothesis) -> int:
    """How many joints differ from the others by it, which is what a joint that tells nothing leaves open."""
    among = len(hypothesis.joints)
    return min(among, len(look.sample.joints) - among)


def _in_doubt(bases: _Bases, beside: Look, refined: _Refined) -> bool:
    """Whether the gain is as large without a fault once a drive may have what the robot file lacks.

    Columns in another order, or one factor of an angle, that leave no larger errors than these effects, which have dozens, are
    believed all the same.
    """
    gain, rank, chosen, _ = refined
    after, bare = bases.look.fit(chosen.reading), beside.fit()
    if IMPOSSIBLE * float((bases.fitted.driven - after.driven).sum()) + chosen.evident >= GAIN:
        return False  # no effect makes friction drive a joint
    without = gain.fitted >= MODEST and bare.score - beside.fit(chosen.reading).score < MODEST
    if KINDS[rank] not in (*RATIOS, *EXCHANGES):
        return without
    gaining = after.error < GAINING * bases.fitted.error
    less = np.log((after.error + FLOOR) / (bare.error + FLOOR))[gaining].sum() > TIE
    return bool(without and less) or (KINDS[rank] in RATIOS and _as_well(bases.look, chosen))


def _one_ratio(refined: list[_Refined]) -> list[_Refined]:
    """Which joint's angle it is, and whether its torque goes with it, free links tell: the URDF's masses may be off."""
    ratios = sorted((r for r in refined if KINDS[r[1]] in RATIOS), key=lambda r: -r[0].fitted)
    others = [r for r in refined if KINDS[r[1]] not in RATIOS]
    if not ratios:
        return others
    gain, rank, best, std = ratios[0]
    if any(h.joints == best.joints and g.fitted > gain.fitted - TIE for g, _, h, _ in ratios[1:]):
        other = "its torque is right" if best.signal == "all" else "its torque is that much too small"
        best = dataclasses.replace(best, text=f"{best.text} Or {other}: these data do not tell which of the two.")
    return [*others, (gain, rank, best, std)]


def _as_well(look: Look, ratio: Hypothesis) -> bool:
    """Whether a zero or a length of the URDF that is a little off, or a gain of the torque, does as well as another angle's scale."""
    thin = look.thinned(THIN)
    least = thin.fit(ratio.reading).score + TIE
    others = (*a_little_off(thin), *(small_gain(thin, joint) for joint in ratio.joints))
    return any(thin.fit(thin.refined(h)[0].reading).score < least for h in others)


def _or_else(chosen: Hypothesis, alike: list[Hypothesis]) -> Hypothesis:
    """With what else of the same joints could have the wrong sign or place, as far as the data tell."""
    same = (chosen.kind, set(chosen.joints))
    others = [h for h in alike if (h.kind, set(h.joints)) == same and h.signal != chosen.signal]
    if chosen.kind not in ("reversed_sign", "swapped_columns") or not others:
        return chosen
    other = {"torque": "torque", "motor_position": "position"}.get(others[0].signal or "", "position and torque")
    return dataclasses.replace(chosen, text=f"{chosen.text} Or the {other}: these data do not tell which of the two.")


def _promising(look: Look, everything: bool) -> list[tuple[float, int, Hypothesis]]:
    """The best of each kind at a part of the rows, as (gain, rank of the kind, hypothesis)."""
    bases = _Bases(look.thinned(THIN), first=True)
    out: list[tuple[float, int, Hypothesis]] = []
    for rank, kind in enumerate(KINDS):
        if not (everything or kind in AT_SMALL_ERRORS) or (look.with_effects and kind in NOT_BESIDE):
            continue
        tried = []
        for number, h in enumerate(kind(bases.look)):
            key = look.reading, rank, number, h.joints, h.factor
            if look.with_effects and look.first_gains.get(key, 0.0) < HOPELESS:
                continue
            free = bases.free(h)
            fitted = bases.fitted_gain(h, free)
            if not look.with_effects:
                look.first_gains[key] = fitted
            if fitted > HOPELESS:
                tried.append((bases.gain(h, free).total if kind in BY_LINKS else fitted, rank, h))
        tried.sort(key=lambda t: -t[0])
        out += [t for t in tried[:SECOND_LOOKS] if t[0] > PROMISING]
    highest = max((gain for gain, *_ in out), default=0.0)
    return [t for t in out if t[0] >= PROMISING * highest]


def _accepted(bases: _Bases, gain: _Gain, rank: int, hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis does so much better than no fault that chance and missing effects do not explain it."""
    if not _conceivable(bases, gain, hypothesis):
        return False
    gaining, sure = bases.gaining(hypothesis), min(gain.fitted, bases.sure(hypothesis))
    if sure >= MODEST and not (gaining > SMALL).any():
        return True
    # another tree may explain a little more of torques that neither explains
    fair = FAIR if gain.fitted >= LARGE and gain.steady >= STEADY else CREDIBLE
    return sure >= GAIN and not (KINDS[rank] in (*ON_POSES, lengths) and (gaining > fair).any())


def _accepted_by_links(bases: _Bases, gain: _Gain, rank: int, hypothesis: Hypothesis) -> bool:
    """The same with the links of the URDF, where free links take up as much without a fault."""
    if KINDS[rank] not in BY_LINKS_ALONE or not _conceivable(bases, gain, hypothesis):
        return False
    return gain.credible and gain.known >= GAIN_KNOWN and gain.fitted > -LOSS


def _conceivable(bases: _Bases, gain: _Gain, hypothesis: Hypothesis) -> bool:
    """Whether the gain is no chance, its joints go with it, and free links would not do as well."""
    large = gain.fitted >= LARGE and bases.look.tells()
    if gain.steady < (STEADY_LARGE if large else STEADY) and gain.possible < GAIN:
        return False
    after = bases.look.fit(hypothesis.reading).error
    own = [bases.look.sample.joints.index(j) for j in hypothesis.joints]
    if own and np.median(after[own]) > hypothesis.far:
        return False
    return not bases.links_instead(hypothesis, after < GAINING * bases.fitted.error)


def _errors(fit: RigidFit) -> float:
    """The score without what is impossible."""
    return fit.score - IMPOSSIBLE * float(fit.impossible.sum())


def _students_t(values: Array) -> float:
    """The mean over its standard error."""
    spread = float(values.std(ddof=1))
    return float(values.mean() * np.sqrt(len(values)) / max(spread, 1e-9))
