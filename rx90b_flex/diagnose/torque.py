"""Torques over time: the residual of a campaign's recordings, and how a model of them is fitted and judged."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import optimize

from rx90b_flex.diagnose.alternatives import Alternative, Comparison, alternatives, compared, swapped
from rx90b_flex.diagnose.carried import grossly_risen, rise
from rx90b_flex.diagnose.families import sure_together
from rx90b_flex.diagnose.identified import with_possible_values
from rx90b_flex.diagnose.kinds import beside_motion, last_resorts, laws, leaned_on, repeated, rounded
from rx90b_flex.diagnose.loop import Addition, Candidates, Residual, Standing
from rx90b_flex.diagnose.moving import resting_each
from rx90b_flex.diagnose.other_friction import helps_beside_it
from rx90b_flex.diagnose.residual import Errors, ReplayedTorques, RoleErrors, noise_floor, replayed_errors
from rx90b_flex.diagnose.reversals import row_weights
from rx90b_flex.diagnose.search import Search
from rx90b_flex.diagnose.trial import SIGNIFICANCE, TorqueTrial, added, choose, meet
from rx90b_flex.diagnose.turned_over import turned_over_again
from rx90b_flex.effects import Effect, Sites
from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.effects.stand_in import of_usual_shape
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.near_tree import chosen
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.shapes import USUAL
from rx90b_flex.identify.torque_sensors import sensors_to_use
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign

MOST_EFFECTS, MOST_A_JOINT = 24, 3  # and so many a joint, its basics: a loop that adds more than both explains noise
AT_FLOOR = 1.02  # residual over noise floor at which nothing is left to look for
WORSE = 1.02  # error on the fitted recordings, every row counted, that an addition may leave over the one before
# the same of its joints without an effect whose values beside a curve are not those that it was added for
WORSE_UNTOLD = 1.1
MUCH = 0.1  # of the squared error of the joints it touches: an effect that explains so much, yet not for certain, may have company
PAIRS = 3  # such effects that are tried with company
CERTAIN = 2.0  # standard deviations that a value is from zero
# Of what an effect explains, over the part of the rows in which its joints move: below that it explains what they hold at rest
IN_MOTION = 0.2
CHANGED = 0.5  # of its values beside a curve: what changes by more is not what it was taken for
ALIKE = 0.1  # of its torque by which an effect differs from what it stands in for: beside a curve less says nothing
WEIGHT_ROUNDS = 2  # fits after which the weights of rows near reversals are kept until the next effect
SAME_WEIGHTS = 0.05  # a change of factors below this is not worth a fit


@dataclass(frozen=True, eq=False)
class TorqueData:
    """A campaign's recordings in the two forms that the loop needs, to fit and to replay, each prepared once."""

    regression: Regression
    identification: tuple[ReplayedTorques, ...]
    validation: tuple[ReplayedTorques, ...]
    held_out: Regression  # the validation recordings, as for a fit, without torque sensors

    @staticmethod
    def of(robot: Robot, campaign: Campaign) -> TorqueData:
        sensors = sensors_to_use(campaign)
        fitted, own = Regression.and_whole(robot, campaign.identification, campaign.cutoff_hz, sensors)
        held_out, other = Regression.and_whole(robot, campaign.validation, campaign.cutoff_hz, sticking=fitted.sticking)
        replayed, kept = (tuple(ReplayedTorques(fitted.robot, s) for s in whole) for whole in (own, other))
        return TorqueData(fitted, replayed, kept, held_out)

    def fitted_errors(self, model: Identification) -> RoleErrors:
        """With the values as they are."""
        return RoleErrors(self.errors(self.validation, model), self.errors(self.identification, model))

    @cached_property
    def moving(self) -> Mask:
        """Rows of the fit in which each joint moves, shape (N, joints)."""
        rows = self.regression.motors.rows
        velocity = [s.motion.v[:: s.factor][s.kept][:, rows] for s in self.regression.segments]
        return ~np.concatenate(resting_each(velocity))

    def rise(self, without: TorqueModel, added: TorqueModel) -> tuple[str, float] | None:
        """The recording with role validation whose error an addition raises beyond its spread, and how likely chance does that."""
        found = rise(*self._measured, without.validation, added.validation)
        return found and (self.validation[found[0]].recording.name, found[1])

    def grossly_risen(self, without: TorqueModel, added: TorqueModel) -> bool:
        """Whether an addition raises the held-out error so much that no spread excuses it."""
        return grossly_risen(*self._measured, without.validation, added.validation)

    @property
    def _measured(self) -> tuple[list[Array], list[Array], list[float]]:
        """Torques, velocities and rates of the recordings with role validation."""
        runs = self.validation
        return [r.torque for r in runs], [r.velocity for r in runs], [r.recording.sample_rate_hz for r in runs]

    def noise_floor(self, model: Identification, campaign: Campaign) -> Array | None:
        """Of the torque, from what a model leaves: what does not repeat with the motion, but with a clock, is no noise."""
        repeating = [r for r in self.identification if r.recording.period_s is not None]
        return noise_floor(repeating, [r.torque - predict(r, model) for r in repeating], campaign)

    def errors(self, replays: Sequence[ReplayedTorques], model: Identification) -> Errors:
        """On some recordings, with the values as they are."""
        return replayed_errors(replays, [predict(r, model) for r in replays])


def predict(replay: ReplayedTorques, model: Identification) -> Array:
    """Torque of an identified model on a recording, shape (N, joints), N m."""
    return replay.predict(model.effects, model.link_parameters)


@dataclass(frozen=True, eq=False)
class TorqueModel:
    """An identified model, and its errors on all recordings."""

    identified: Identification
    data: TorqueData

    @property
    def effects(self) -> tuple[Effect, ...]:
        return tuple(self.identified.effects)

    @cached_property
    def possible(self) -> Identification:
        """With values that a robot can have, which are those that are written."""
        return with_possible_values(self.identified)

    @cached_property
    def validation(self) -> list[Array]:
        """Torques that it predicts of the recordings with role validation, each (N, joints), N m."""
        return [predict(r, self.possible) for r in self.data.validation]

    @property
    def fitted_errors(self) -> RoleErrors:
        """With the fitted values."""
        fitted, written = self.identified, self.possible
        same = fitted.effects == written.effects and np.array_equal(fitted.link_parameters, written.link_parameters)
        return self.errors if same else self.data.fitted_errors(fitted)

    @cached_property
    def errors(self) -> RoleErrors:
        """Of the robot that is written."""
        on_validation = replayed_errors(self.data.validation, self.validation)
        return RoleErrors(on_validation, self.data.errors(self.data.identification, self.possible))

    @property
    def told(self) -> RoleErrors:
        """The same but for rows before joints first move, which say nothing."""
        return self.errors.told


@dataclass(frozen=True, eq=False)
class TorqueResidual(Residual[TorqueModel, TorqueTrial]):
    """Measured torques less those of an identified model.

    Attributes
    ----------
    data : TorqueData
    campaign : Campaign
    sites : Sites
        Where effects can be.
    fit_links : bool
        Whether the links' inertial parameters are fitted, too.
    gains : frozenset of str
        Joints whose torque has another gain, as the look at the data found.
    jobs : int
        Processes that look at candidates.
    """

    data: TorqueData
    campaign: Campaign
    sites: Sites
    fit_links: bool
    gains: frozenset[str] = frozenset()
    jobs: int = 1

    def declared(self) -> TorqueModel:
        return self._beginning

    @cached_property
    def _beginning(self) -> TorqueModel:
        regression = self.data.regression
        model = reweighted(regression, identify(regression, regression.robot.effects, fit_links=self.fit_links))
        model = self._near_tree(model)
        held = [self._held_if_untold(model, e) for e in model.effects]
        if any(a is not b for a, b in zip(held, model.effects, strict=True)):
            again = identify(model.regression, held, fit_links=self.fit_links, start=model)
            model = reweighted(regression, again)
        return TorqueModel(model, self.data)

    def _held_if_untold(self, model: Identification, effect: Effect) -> Effect:
        """A declared effect, its shapes of usual value held where the data tells less of them than what is usual."""
        stated = next(e for e in self.data.regression.robot.effects if e.label == effect.label)
        held = of_usual_shape(effect, stated)
        if held is None:
            return effect
        names = {name for name, p in held.shape_parameters.items() if p.held}
        found = [e for e in model.estimates(model.effects.index(effect)) if e.name in names]
        told = all(e.value is not None and e.std is not None and e.std < USUAL * abs(e.value) for e in found)
        return effect if told and not Search(model, self.sites).at_bound(effect) else held

    def signature(self, model: TorqueModel, trial: TorqueTrial | None = None) -> Hashable:
        """Types, places and numbers of shapes; of effects that may stand twice in one place, the shapes too, to a tenth."""
        effects = _with(model, trial.effects if trial else ())
        return frozenset((e.type_name(), e.place, len(e.shape), rounded(e)) for e in effects)

    def candidates(self, standing: Standing[TorqueModel, TorqueTrial]) -> Sequence[Candidates]:
        if standing.steps and self.at_floor(standing.model):
            return (Candidates(beside_motion, in_pairs=False, told=False),)
        # more than a few periodic effects in a place are a series of something else, as long as a curve may still be it
        return Candidates(laws), Candidates(last_resorts, in_pairs=False), Candidates(repeated, in_pairs=False)

    def trials(
        self,
        model: TorqueModel,
        some: Candidates,
        told: Callable[[float], None],
        company_of: TorqueTrial | None = None,
    ) -> list[TorqueTrial]:
        return self.search(model, some.kinds).run(told, company_of.effect if company_of else None)

    def search(self, model: TorqueModel, kinds: Callable[[type[Effect]], bool] = laws) -> Search:
        """Everything that could be missing from a model."""
        new = Search(model.identified, self.sites, kinds, self.jobs, self.gains)
        for latest in self._searches:
            if latest.model is new.model:
                new = latest if latest.kinds is kinds else new.after(latest)
        self._searches[:] = [new]
        return new

    def choose(self, trials: Sequence[TorqueTrial]) -> TorqueTrial | None:
        # first the data: of torques with another gain only the ratio shows, and the look at the data says whose it is
        gains = [t for t in trials if t.effect.traits.multiplies and set(t.effect.joints) <= self.gains]
        return choose(gains) or choose(trials)

    def joined(self, model: TorqueModel, trial: TorqueTrial) -> TorqueModel:
        return self._identified(_with(model, trial.effects), model, trial.effects)

    def settled(self, model: TorqueModel) -> TorqueModel:
        return TorqueModel(reweighted(self.data.regression, model.identified), self.data)

    def _near_tree(self, model: Identification) -> Identification:
        """A model of free links, these as near the tree's values as blocks of the log like it that are left out."""
        if not model.links_fitted:
            return model
        links, shared = model.regression.robot.link_parameters, self.search(TorqueModel(model, self.data)).shared
        about_tree = shared.normal.about(np.pad(links, (0, len(shared.precision) - len(links))))
        near = chosen(about_tree, model.solution.sigma, shared.precision, links)
        if not near:
            return model
        other = identify(model.regression, model.effects, fit_links=True, start=model, links_near=near)
        return reweighted(self.data.regression, other)

    def refit(self, model: TorqueModel, trial: TorqueTrial) -> tuple[TorqueModel | None, TorqueTrial]:
        new = self.joined(model, trial)
        if not _helps(new, model):
            return None, self.fallen(trial, "with everything fitted again it does not help")
        if not all(_physical(find(new, e)) for e in trial.effects):
            return None, self.fallen(trial, "with everything fitted again it has a value that it cannot have")
        new = self.settled(new)
        if text := self._lost(new, trial):
            return None, self.fallen(trial, text)
        end = self._at_end(new, trial)
        if end and (plainer := self._plainer(new, trial)):
            return self.refit(model, plainer)
        if end:
            return None, dataclasses.replace(trial, lawful=False, objection=end)
        if self._at_rest_alone(new, model):
            text = "what it explains lies at rest, where friction holds what nobody knows, and not in motion"
            return None, self.fallen(trial, text)
        if self.spoils(new, model) or self._explains_nothing(trial.effects, new.told, model.told):
            return None, self.fallen(
                trial, "it helps where rows count in full, and spoils more near reversals, where they count less"
            )
        return new, trial

    def _lost(self, model: TorqueModel, trial: TorqueTrial) -> str:
        """Why a trial falls in a model that was fitted with it, in words; empty where it does not."""
        worth = self.worth(model, trial) if len(trial.effects) == 1 else None
        if worth is not None and (worth.p_value > SIGNIFICANCE or worth.small):
            return worth.small or "with everything fitted again next to nothing of it is left"
        return self.unsure(model, trial)

    def _at_end(self, model: TorqueModel, trial: TorqueTrial) -> str:
        """Which of its shapes ran into an end of its range, in words; empty where none did."""
        return next((text for e in trial.effects if (text := self.search(model).at_bound(find(model, e)))), "")

    def unsure(self, model: TorqueModel, trial: TorqueTrial) -> str:
        found = [find(model, e) for e in trial.effects]
        if not any(self._is_sure(model, e) for e in found):
            return "with everything fitted again none of its values is certain"
        unknown = [_unknown(model.identified, e) for e in found]
        return f"this log does not tell its {unknown[0]}" if all(unknown) else ""

    def _is_sure(self, model: TorqueModel, effect: Effect) -> bool:
        """Whether any of its values is, or all of it beside frictions that differ between recordings: to a fit these are noise."""
        search = self.search(model)
        return _certain(model.identified, effect) or (search.frictions_differ and search.without(effect).accepted)

    def _not_missed(self, model: TorqueModel, steps: Sequence[Addition[TorqueTrial]]) -> Addition[TorqueTrial] | None:
        """The first addition with a name that is not possible, or of which a model tells no value, or quite another one, or hardly
        another torque than that of what it stands in for, and without which it fits as well.
        """
        for step, named in zip(steps, find_added(model, steps), strict=True):
            if named.traits.last_resort:
                continue
            if not _physical(named):
                return step
            untold = not self._is_sure(model, named) or _untold(model.identified, step.trial.effect, named)
            if not (untold or self.search(model).restored(named)):
                continue
            less = self._less(model, named)
            if not (untold or self._differs_little(less[0], model, named)):
                continue
            # a value that is another one tells nothing, though a few per cent more are left of its own joints
            room = [WORSE_UNTOLD if untold and j in named.joints else WORSE for j in self.campaign.joints]
            rms, before = (np.array(m.told.identification.torque_rms) for m in (less[0], model))
            if (rms <= room * before).all():
                self._lesser[:] = [(model, step.trial, less)]
                return step
        return None

    def _differs_little(self, less: TorqueModel, model: TorqueModel, named: Effect) -> bool:
        """Whether what came back in the place of a named effect has much the same torque."""
        gone = {(type(e), e.place) for e in model.effects}
        back = [e for e in less.effects if e.place == named.place and (type(e), e.place) not in gone]
        columns = self.data.regression.columns
        torque = columns(named) @ named.known_coefficients()
        return bool(back) and _alike(
            torque, sum((columns(e) @ e.known_coefficients() for e in back), np.zeros_like(torque))
        )

    def _plainer(self, model: TorqueModel, trial: TorqueTrial) -> TorqueTrial | None:
        """A trial with those shapes held at what is usual that ran into an end of their range; None where there are none to hold."""
        search = self.search(model)

        def held(one: TorqueTrial) -> TorqueTrial:
            effect = find(model, one.effect)
            usual = of_usual_shape(effect) if search.at_bound(effect) else None
            return one if usual is None else dataclasses.replace(one, effect=usual)

        members = tuple(held(m) for m in trial.members)
        new = dataclasses.replace(held(trial), members=members)
        return new if any(a is not b for a, b in zip(new.effects, trial.effects, strict=True)) else None

    def fallen(self, trial: TorqueTrial, why: str) -> TorqueTrial:
        return dataclasses.replace(trial, objection=why)

    def errors_of(self, model: TorqueModel) -> RoleErrors:
        return model.errors

    def findings(self, trial: TorqueTrial) -> list[TorqueTrial]:
        """A family's members, of which was asked together what was asked of it; a declared effect that was left out for a while
        is none.
        """
        told = [
            dataclasses.replace(t, p_value=min(t.p_value, trial.p_value), of_family=bool(trial.members))
            for t in trial.members or (trial,)
        ]
        return [t for t in told if t.label not in self._declared]

    def holds(self, model: TorqueModel, trial: TorqueTrial) -> bool:
        return any(type(e) is type(trial.effect) and e.place == trial.effect.place for e in model.effects)

    def spoils(self, new: TorqueModel, old: TorqueModel) -> bool:
        """On the recordings that were fitted, every row counted, by more than chance would explain; or gains there at rest alone."""
        after, before = (m.told.identification.relative_error for m in (new, old))
        return after > WORSE * before or self._at_rest_alone(new, old)

    def hopeful(self, trials: Sequence[TorqueTrial]) -> list[TorqueTrial]:
        """Where a lawful effect explains much, what keeps it from being sure is no noise; of several with one torque the first."""
        some = [t for t in self._new(trials) if t.lawful and t.share > MUCH][:PAIRS]
        torques = [self.data.regression.columns(t.effect) @ t.effect.known_coefficients() for t in some]
        return [t for i, t in enumerate(some) if not any(_alike(torques[i], other) for other in torques[:i])]

    def apart(
        self,
        trials: Sequence[TorqueTrial],
        new: TorqueModel,
        old: TorqueModel,
        beside: Sequence[TorqueTrial] = (),
    ) -> list[TorqueTrial]:
        """Single effects on joints where nothing was added, that take no other's place and scale no torque; none of a type that was
        tried as a family, which comes with the next round.
        """
        families = {type(t.effect) for t in trials if t.members}
        before = {(type(e), e.place) for e in old.effects}
        more = [e for e in new.effects if (type(e), e.place) not in before] + [e for t in beside for e in t.effects]
        alone = [t for t in trials if not t.members and t.effect.joints and not t.effect.traits.multiplies]
        alone = [t for t in alone if type(t.effect) not in families and not any(meet(t.effect, e) for e in more)]
        if alone and new is not old and self.at_floor(new):  # where nothing is left of a motion, nothing is looked for
            alone = [t for t in alone if beside_motion(type(t.effect))]
        out = []
        for t in alone:
            here = {e.type_name() for e in new.effects if e.place == t.effect.place}
            if here.isdisjoint(t.effect.traits.stands_for):
                out.append(t)
        return out

    def together(self, model: TorqueModel, trials: Sequence[TorqueTrial]) -> TorqueModel | None:
        effects = [e for t in trials for e in t.effects]
        if any(e.traits.coefficients_follow for e in effects):
            return None  # drives that twist: a long descent, which is not gone with what may fall
        new = self._identified(_with(model, effects), model, effects)
        if not (_helps(new, model) and all(_physical(find(new, e)) for e in effects)):
            return None
        new = self.settled(new)
        stays = not any(self._lost(new, t) or self._at_end(new, t) for t in trials)
        touching = (self._explains_nothing(t.effects, new.told, model.told) for t in trials)
        return new if stays and not self.spoils(new, model) and not any(touching) else None

    def errors_along(self, old: TorqueModel, new: TorqueModel, trials: Sequence[TorqueTrial]) -> list[RoleErrors]:
        """Those between are the new model's on joints that were touched so far, and the old one's on others."""
        out, touched = [old.errors], set[str]()
        for trial in trials[:-1]:
            touched |= {j for e in trial.effects for j in e.joints}
            out.append(old.errors.partly(new.errors, [j in touched for j in self.campaign.joints]))
        return [*out, new.errors]

    def once_more(self, model: TorqueModel, trial: TorqueTrial) -> TorqueTrial:
        search = self.search(model)
        return search.trial(trial.effect, search.present, search.present, search.tests)

    def once_fitted(self, half: TorqueModel, first: TorqueTrial) -> TorqueTrial:
        fitted = self.worth(half, first)
        return dataclasses.replace(fitted, p_value=max(fitted.p_value, first.p_value))

    def companion(self, half: TorqueModel, first: TorqueTrial, beside: Sequence[TorqueTrial]) -> TorqueTrial | None:
        second = choose(self._new(beside))
        # as many pairs might have been tried as there are trials
        if second is None or second.p_value * self.search(half).tests > SIGNIFICANCE:
            return None
        stands_in = len(added([first.effect], second.effect)) < 2
        return None if stands_in else second

    def worth(self, model: TorqueModel, trial: TorqueTrial) -> TorqueTrial:
        return self.search(model).without(find(model, trial.effect))

    def needless(
        self, standing: Standing[TorqueModel, TorqueTrial], latest: int, everywhere: bool = True
    ) -> Addition[TorqueTrial] | None:
        """The first of those before the latest; of several latest also one that does not belong to their family.

        A curve of no known law makes nothing needless that has a name, but for what has no certain value beside it. What shares no
        joint with the latest has little to do with them.
        """
        steps = standing.steps
        older = len(steps) - latest
        newer = [s.trial.effect for s in steps[older:]]
        if any(e.traits.last_resort for e in newer):
            beside = [s for s in steps[:older] if any(meet(s.trial.effect, e) for e in newer)]
            return self._not_missed(standing.model, beside)
        search = self.search(standing.model)

        added_ones = find_added(standing.model, steps)

        def worth(i: int) -> TorqueTrial:
            return search.without(added_ones[i])

        for i, step in enumerate(steps):
            newest, effect = i >= older, added_ones[i]
            if not _physical(effect):
                return step  # whatever stands on it: a robot file cannot hold it
            if (newest and latest == 1) or leaned_on(effect, standing.model.effects):
                continue
            if not (newest or everywhere or any(meet(effect, e) for e in newer)):
                continue
            if search.at_bound(effect):
                return step  # which is why it would not be added now
            joints = len(self.sites.joints)
            if not (worth(i).accepted or (worth(i).belongs and (newest or sure_together(i, steps, worth, joints)))):
                return step
        return None

    def without(
        self, standing: Standing[TorqueModel, TorqueTrial], step: Addition[TorqueTrial]
    ) -> tuple[TorqueModel, list[TorqueTrial]]:
        for known, taken_out, less in self._lesser:
            if known is standing.model and taken_out is step.trial:
                self._lesser.clear()
                return less
        return self._less(standing.model, find_added(standing.model, standing.steps)[standing.steps.index(step)])

    def _less(self, model: TorqueModel, effect: Effect) -> tuple[TorqueModel, list[TorqueTrial]]:
        search = self.search(model)
        # a curve beside it may have to bend for both
        left = [e.penalised(None) if e.place == effect.place else e for e in search.present_without(effect)]
        less = self._identified(left, model)
        names = {r.label for r in search.restored(effect)} - self._declared
        back = []
        for simpler in [e for e in less.effects if e.label in names]:
            again = self.search(less).without(simpler)
            if again.accepted:
                back.append(again)
            else:
                less = self._identified([e for e in less.effects if e is not simpler], less)
        return less, back

    def instead(self, model: TorqueModel, step: Addition[TorqueTrial]) -> tuple[TorqueTrial, TorqueModel] | None:
        named = find(model, step.trial.effect)
        if named.traits.last_resort:
            return self._law_instead(model, named)
        better = [c for c in self.compared(model, step) if c.rival_wins]
        if not better:
            return None
        best = min(better, key=lambda c: c.behind)
        effects = swapped(model.effects, named, best, self.search(model))
        new = self._identified(effects, model, best.rival.effects)
        return (best.rival, new) if _weighted_better(new, model) and not self.spoils(new, model) else None

    def _law_instead(self, model: TorqueModel, curve: Effect) -> tuple[TorqueTrial, TorqueModel] | None:
        """What has a law and leaves as little as a curve in its place: other causes, in the model by now, may have hidden it."""
        less = self._less(model, curve)[0]
        best = self.choose(self.search(less).run(company_of=curve))
        if best is None:
            return None
        new, found = self.refit(less, best)
        if new is None:
            return None
        after, before = (np.array(m.told.identification.torque_rms) for m in (new, model))
        return (found, new) if (after <= WORSE * before).all() else None

    def burden(self, standing: Standing[TorqueModel, TorqueTrial]) -> tuple[Addition[TorqueTrial], TorqueTrial] | None:
        """Of the additions after which the held-out error was larger than before, the one that raises it most surely; where all
        together leave more than the declared model does, or one grossly more than there was without it, the one without which
        least is left.

        What did no harm before another one was taken out does none after, where the two have no joint in common.
        """
        worst: tuple[float, Addition[TorqueTrial], str] | None = None
        gross = False
        gone = [t.effect for t in standing.taken_out[-1:]]
        harmless = [t for t in self._harmless if not any(meet(t.effect, e) for e in gone)]
        self._harmless[:] = harmless
        for step in standing.steps:
            if step.after.told.validation.relative_error <= step.before.told.validation.relative_error:
                continue
            if any(step.trial is t for t in harmless):
                continue
            model, back = self.without(standing, step)
            found = self._spoiled(standing.model, step.trial.effect, model)
            if found is None and self.data.grossly_risen(model, standing.model):
                gross = True
            elif found is None:
                self._harmless.append(step.trial)
            elif worst is None or found[0] < worst[0]:
                self._lesser[:] = [(standing.model, step.trial, (model, back))]
                worst = found[0], step, found[1]
        if worst is None:
            worst = self._too_much(standing, gross)
        if worst is None:
            return None
        _, step, why = worst
        return step, dataclasses.replace(step.trial, lawful=False, objection=why)

    def _spoiled(self, model: TorqueModel, added: Effect, without: TorqueModel) -> tuple[float, str] | None:
        """How likely chance raises the held-out error as an addition does, and what is said of it; None where it does no harm."""
        less, more = (m.told.validation for m in (without, model))
        if not more.worse_than(less):
            return None
        little = more.relative_error < WORSE * less.relative_error
        if little and helps_beside_it(model.identified, without.identified, self.data.held_out):
            return None
        between = f"{less.relative_error:.4f} -> {more.relative_error:.4f}"
        found = self.data.rise(without, model)
        if found is not None:
            return found[1], f"it raises the error of {found[0]}, which was not fitted: {between}"
        declared = [e.label for e in self.search(model).restored(find(model, added)) if e.label in self._declared]
        if not declared:
            return None
        return 1.0, f"the declared {', '.join(declared)} in its place leaves less of what was not fitted: {between}"

    def _too_much(
        self, standing: Standing[TorqueModel, TorqueTrial], gross: bool
    ) -> tuple[float, Addition[TorqueTrial], str] | None:
        """Of additions with which more is held out than without any, or grossly more than without one: the error without it, the
        addition, and why it goes.
        """
        before, after = self._beginning.told.validation, standing.model.told.validation
        worse = after.worse_than(before)
        if not (worse or gross):
            return None
        lesser = [(standing.model, s.trial, self.without(standing, s)) for s in standing.steps]
        errors = [model.told.validation.relative_error for _, _, (model, _) in lesser]
        best = int(np.argmin(errors))
        self._lesser[:] = [lesser[best]]
        declared, now = (e.relative_error for e in (before, after))
        if worse:
            why = (
                f"what was added left more than the declared model where it was not fitted: {declared:.4f} -> {now:.4f}"
            )
            return errors[best], standing.steps[best], f"{why}; {errors[best]:.4f} without it"
        why = f"it raises the error of what was not fitted: {errors[best]:.4f} -> {now:.4f}"
        return errors[best], standing.steps[best], why

    def compared(self, model: TorqueModel, step: Addition[TorqueTrial]) -> list[Comparison]:
        """An addition against each of its rivals that is worth it, in its place in a model."""
        key = (model, step.trial)
        if key not in self._comparisons:
            named = find(model, step.trial.effect)
            self._comparisons[key] = compared(self.search(model), named, step.trial, step.rivals)
        return self._comparisons[key]

    def alternatives(self, search: Search, model: TorqueModel, step: Addition[TorqueTrial]) -> tuple[Alternative, ...]:
        """What the data cannot tell from an addition."""
        return alternatives(search, find(model, step.trial.effect), self.compared(model, step))

    @cached_property
    def _harmless(self) -> list[TorqueTrial]:
        """Of additions, what raises no error that was not fitted, as far as it was asked."""
        return []

    @cached_property
    def _searches(self) -> list[Search]:
        return []

    @cached_property
    def _lesser(self) -> list[tuple[TorqueModel, TorqueTrial, tuple[TorqueModel, list[TorqueTrial]]]]:
        """The model without the addition that did most harm, which is what comes next: model, trial, and what `without` found."""
        return []

    @cached_property
    def _comparisons(self) -> dict[tuple[TorqueModel, TorqueTrial], list[Comparison]]:
        return {}

    def _explains_nothing(self, effects: Sequence[Effect], new: RoleErrors, old: RoleErrors) -> bool:
        """Whether every joint that effects touch does worse on the recordings that were fitted, every row counted."""
        joints = self.campaign.joints
        touched = {j for e in effects for j in e.joints} or set(joints)
        pairs = zip(joints, new.identification.torque_rms, old.identification.torque_rms, strict=True)
        return all(after > before for joint, after, before in pairs if joint in touched)

    def _at_rest_alone(self, new: TorqueModel, old: TorqueModel) -> bool:
        """Whether what new effects explain in the joints that they touch lies at rest, on the recordings that were fitted.

        There dry friction holds what nobody knows, and rests are few: a ripple, say, goes through all that they hold. Friction that
        remembers is what acts at rest; of anything else motion shows its part.
        """
        more = Counter((type(e), e.place) for e in new.effects if not e.traits.remembers)
        more.subtract((type(e), e.place) for e in old.effects)
        added_to = [e.joints for e in new.effects if more[type(e), e.place] > 0]
        if not added_to:
            return False
        touched = {j for joints in added_to for j in joints or self.campaign.joints}
        columns = [i for i, joint in enumerate(self.campaign.joints) if joint in touched]
        weights = new.identified.regression.row_weights
        before, after = (m.identified.residual[:, columns] ** 2 for m in (old, new))
        drop = before - after if weights is None else (before - after) * weights[:, columns] ** 2
        moving = self.data.moving[:, columns]
        return bool((drop * moving).sum() < IN_MOTION * moving.mean() * drop.sum())

    def _new(self, trials: Sequence[TorqueTrial]) -> list[TorqueTrial]:
        """Single effects that the robot does not declare."""
        return [t for t in trials if not t.members and t.effect.label not in self._declared]

    @property
    def _declared(self) -> frozenset[str]:
        return frozenset(e.label for e in self.data.regression.robot.effects)

    def _identified(self, effects: Sequence[Effect], start: TorqueModel, new: Sequence[Effect] = ()) -> TorqueModel:
        """With the rows weighted as they are in the model to compare with.

        A declared effect that goes beyond what it can be beside `new` ones is not there: the shapes are fitted again without it.
        """
        regression = self.data.regression.weighted(start.identified.regression.row_weights)

        def fitted(effects: Sequence[Effect], start: TorqueModel) -> TorqueModel:
            model = identify(regression, effects, fit_links=self.fit_links, start=start.identified)
            return TorqueModel(turned_over_again(regression, model, start.identified), self.data)

        model = fitted(effects, start)
        gone = [e for e in model.identified.impossible() if e.label in self._declared - {n.label for n in new}]
        if not gone:
            return model
        other = fitted([e for e in model.effects if e not in gone], model)
        after, before = (m.told.identification.relative_error for m in (other, model))
        return other if after < before else model

    def at_floor(self, model: TorqueModel) -> bool:
        """Whether no more than the noise between repeats of a motion is left."""
        floor = self.data.noise_floor(model.identified, self.campaign)
        if floor is None:
            return False
        return bool((np.array(model.told.identification.torque_rms) <= AT_FLOOR * floor).all())


def _alike(torque: Array, other: Array) -> bool:
    """Whether another torque differs little from one."""
    return bool(np.linalg.norm(torque - other) < ALIKE * np.linalg.norm(torque))


def _with(model: TorqueModel, new: Sequence[Effect]) -> tuple[Effect, ...]:
    effects = model.effects
    for effect in new:
        effects = added(effects, effect)
    return effects


def reweighted(regression: Regression, model: Identification) -> Identification:
    """The same model fitted with the weights that it gives each row, which its smaller residual may change once more."""
    for _ in range(WEIGHT_ROUNDS):
        known = row_weights(regression, model)
        before = model.regression.row_weights
        if np.abs(known - (1.0 if before is None else before)).max() < SAME_WEIGHTS:
            break
        model = identify(regression.weighted(known), model.effects, fit_links=model.links_fitted, start=model)
    return model


def _helps(new: TorqueModel, old: TorqueModel) -> bool:
    """Whether the error became smaller, or the weighted one did."""
    return new.identified.relative_error < old.identified.relative_error or _weighted_better(new, old)


def _weighted_better(new: TorqueModel, old: TorqueModel) -> bool:
    """Whether the log-likelihood of white residuals grew: one joint may gain what another does not lose."""
    return bool(np.log(new.identified.solution.sigma).sum() < np.log(old.identified.solution.sigma).sum() - 1e-6)


def _physical(effect: Effect) -> bool:
    """Whether every single value that a robot file would hold lies above its lower bound, and all go together."""
    values = ((getattr(effect, p.attribute), p.lower) for p in effect.parameters().values())
    return effect.possible() and all(x is None or bool((np.atleast_1d(x) >= low).all()) for x, low in values)


def _certain(model: Identification, effect: Effect) -> bool:
    """Whether any value of an effect is more than its uncertainty; shapes, which are never zero, only where they are all that it
    has: of a drive that twists its stiffness. Without values its torque tells.
    """
    if effect.penalty is not None:
        return True  # of a curve no single value is certain, where a neighbour may have a part of it
    shapes = effect.shape_parameters
    known = [
        (e.name, abs(e.value) > CERTAIN * e.std)
        for e in model.estimates(model.effects.index(effect))
        if e.value is not None and e.std is not None
    ]
    told = [] if effect.traits.coefficients_follow else [sure for name, sure in known if name not in shapes]
    told = told or [sure for name, sure in known if not (name in shapes and shapes[name].held)]
    return not told or any(told)


def _untold(model: Identification, before: Effect, now: Effect) -> bool:
    """Whether no value of an effect is known, or they are not what they were before."""
    if all(e.value is None for e in model.estimates(model.effects.index(now))):
        return True
    if _unknown(model, now):
        return True
    # their size: a phase turns with the order
    sizes = np.linalg.norm(before.coefficients), np.linalg.norm(now.coefficients)
    alike = len(before.coefficients) == len(now.coefficients)
    return alike and bool(abs(sizes[1] - sizes[0]) > CHANGED * sizes[0])


def _unknown(model: Identification, effect: Effect) -> str:
    """The value without which an effect's name means nothing, and which is less than its standard deviation; empty: none."""
    telling = {name for name, p in effect.shape_parameters.items() if p.telling}
    if not telling:
        return ""
    values = {e.name: e for e in model.estimates(model.effects.index(effect)) if e.name in telling}
    return next(
        (n for n, e in values.items() if e.value is not None and e.std is not None and abs(e.value) < e.std), ""
    )


def find(model: TorqueModel, like: Effect) -> Effect:
    """The identified form of an effect that was added: same type and place, nearest shape."""
    return find_each(model, [like])[0]


def find_added(model: TorqueModel, steps: Sequence[Addition[TorqueTrial]]) -> list[Effect]:
    """The same of additions, each its own."""
    return find_each(model, [s.trial.effect for s in steps])


def find_each(model: TorqueModel, likes: Sequence[Effect]) -> list[Effect]:
    """Of several that were added; of those with one type and place each another one, the nearest shapes in all."""
    out: list[Effect] = list(likes)
    for kind, place in dict.fromkeys((type(e), e.place) for e in likes):
        mine = [i for i, e in enumerate(likes) if type(e) is kind and e.place == place]
        same = [e for e in model.effects if type(e) is kind and e.place == place]
        apart = np.array([[np.abs(e.shape - likes[i].shape).sum() for e in same] for i in mine])
        nearest = apart.argmin(axis=1)
        of_which, own = optimize.linear_sum_assignment(apart)
        nearest[of_which] = own
        for i, at in zip(mine, nearest, strict=True):
            out[i] = same[at]
    return out
