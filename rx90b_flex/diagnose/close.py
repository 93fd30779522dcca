"""Close the loop: identify the declared model, find what is missing, add it, and say what remains."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from rx90b_flex.diagnose.alternatives import Alternative, Comparison, alternatives, compared, swapped
from rx90b_flex.diagnose.check import Checked, check
from rx90b_flex.diagnose.deflection import GearDeflection, gear_deflections, with_gears
from rx90b_flex.diagnose.evidence import Band, Dependence, bands, dependences
from rx90b_flex.diagnose.faults.fault import DataFault
from rx90b_flex.diagnose.identified import identified_robot, with_possible_values
from rx90b_flex.diagnose.moving import MovingErrors, moving_errors
from rx90b_flex.diagnose.refused import RefusedLoop, verdict_despite
from rx90b_flex.diagnose.replayed import ROLES, replayed
from rx90b_flex.diagnose.residual import Errors, ReplayedTorques, RoleErrors, noise_floor
from rx90b_flex.diagnose.reversals import trust
from rx90b_flex.diagnose.search import Search, beside_motion, last_resorts, laws
from rx90b_flex.diagnose.trial import SIGNIFICANCE, TorqueTrial, added, choose
from rx90b_flex.diagnose.verdict import Remains
from rx90b_flex.diagnose.yardstick import Explainable, HeldOut, yardstick
from rx90b_flex.effects import Effect, Sites
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.least_squares import Estimate, Identification, identify
from rx90b_flex.identify.regression import Regression, prepare
from rx90b_flex.identify.torque_scale import resolved
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals import Campaign, Recording, load_campaign

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCHEMA = 1
MOST_EFFECTS = 24  # a loop that adds more than this explains noise
AT_FLOOR = 1.02  # residual over noise floor at which nothing is left to look for
RIGID_BAND = 1 / 3  # of the first frequency with drives held, up to which a rigid model with more inertia does as well
TRIES = 3  # effects of a round that are added for a trial at the most
WORSE = 1.02  # error on the fitted recordings, every row counted, that an addition may leave over the one before
MUCH = 0.1  # of the squared error of the joints it touches: an effect that explains so much, yet not for certain, may have company
PAIRS = 3  # such effects that are tried with company
FEWEST_BLOCKS = 4  # to hold out in turn; with less, the spread of a gain between them says nothing
RIVALS = 5  # refused trials of a round that a result keeps
TRUST_ROUNDS = 2  # fits after which the trust in rows near reversals is kept until the next effect
SAME_TRUST = 0.05  # a change of factors below this is not worth a fit

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was added to the model.

    Attributes
    ----------
    effect : Effect
        With the values of the final model.
    parameters : tuple of Estimate
    before, after : Errors
        Validation errors without and with it, each with everything identified again.
    p_value : float
        That nothing is there, corrected for all that was tried.
    gain_t : float
        Gain on held-out blocks over its standard error.
    rivals : tuple of TorqueTrial
        What else was tried in that round, best first.
    trial : TorqueTrial
        The trial that won that round, in the same units as its rivals.
    alternatives : tuple of Alternative
        What this data cannot tell from it in the final model, each with the experiment that would; best first.
    """

    effect: Effect
    parameters: tuple[Estimate, ...]
    before: Errors
    after: Errors
    p_value: float
    gain_t: float
    rivals: tuple[TorqueTrial, ...]
    trial: TorqueTrial
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True)
class LastRound:
    """The round that added nothing.

    Attributes
    ----------
    trials : tuple of TorqueTrial
        The best of what was tried and refused, best first; empty where the noise floor ended the loop.
    candidates : int
        Effects that can be tried beside the final model: types times places.
    tests : int
        Independent trials that p-values are corrected for.
    """

    trials: tuple[TorqueTrial, ...]
    candidates: int
    tests: int


@dataclass(frozen=True, eq=False)
class Unexplained:
    """What is left after the last effect.

    Attributes
    ----------
    relative_error : float
        On the validation data.
    where : tuple of Dependence
        What it depends on, strongest first.
    data : tuple of (Regression, array of shape (N, joints))
        Where that was looked for: the recordings that were fitted and those that were not, each with what is left, N m;
        rows near reversals less by what the log leaves open there.
    bands : tuple of Band
        Frequencies in which it repeats with the motion, strongest first; empty where no recording repeats.
    """

    relative_error: float
    where: tuple[Dependence, ...]
    data: tuple[tuple[Regression, Array], ...]
    bands: tuple[Band, ...] = ()


@dataclass(frozen=True)
class FittedErrors:
    """Errors with the fitted values, where those are not the ones that are written: a body must be possible."""

    before: RoleErrors
    after: RoleErrors


@dataclass(frozen=True, eq=False)
class Prediction:
    """Torques of one validation recording, each (N, joints), N m, after the low-pass; and the velocity, rad/s."""

    recording: Recording
    torque: Array
    before: Array
    after: Array
    velocity: Array


@dataclass(frozen=True, eq=False, repr=False)
class ClosedLoop(Showing):
    """Result of closing the loop; the content of ``closed_loop.json`` as attributes.

    Attributes
    ----------
    robot : str
    joints : tuple of str
    before, after : RoleErrors
        Of the declared robot with its identified values, and of the robot that is written.
    noise_floor : tuple of float or None
        Root mean square noise a joint, N m.
    effects : tuple of FoundEffect
        In the order in which they were added.
    verdict : str
        ``nothing_missing``, ``explained``, ``partly_explained``, ``unexplained``.
    unexplained : Unexplained
    model : Identification
        The final model on the identification data.
    declared : Identification
        The declared model on the same data.
    predictions : tuple of Prediction
        One a validation recording.
    source : Robot
        The declared robot, as loaded.
    campaign : Campaign
    last_round : LastRound
    seed : int
    cautions : tuple of str
        What limits how far the result can be trusted, in sentences.
    data_faults : tuple of DataFault
        What the look at the data found; with `despite_faults` also what makes them not usable.
    undeclared_basics : tuple of str
        Effect types that every drive has and no joint declares, although the torques show them.
    checked : Checked or None
        All that the look at the data says.
    moving : MovingErrors
        The validation errors over rows in which the joint moves.
    explainable : Explainable or None
        What a free-form model of the declared model's residual reaches on validation; None where nothing is known of that.
    not_explainable : str
        Why nothing is known; empty otherwise.
    fitted : FittedErrors or None
        Errors with the fitted values, where a robot that can exist has others; `before` and `after` are of the latter.
    deflection : tuple of GearDeflection
        What second encoders show of each gear; empty where there are none.
    """

    robot: str
    joints: tuple[str, ...]
    before: RoleErrors
    after: RoleErrors
    noise_floor: tuple[float, ...] | None
    effects: tuple[FoundEffect, ...]
    verdict: str
    unexplained: Unexplained
    model: Identification
    declared: Identification
    predictions: tuple[Prediction, ...]
    source: Robot
    campaign: Campaign
    last_round: LastRound
    seed: int
    moving: MovingErrors
    explainable: Explainable | None
    not_explainable: str = ""
    fitted: FittedErrors | None = None
    cautions: tuple[str, ...] = ()
    deflection: tuple[GearDeflection, ...] = ()
    data_faults: tuple[DataFault, ...] = ()
    undeclared_basics: tuple[str, ...] = ()
    checked: Checked | None = None

    def plot_residual(self, joint: str, over: str = "velocity") -> Axes:
        """A joint's torque error on the validation recordings before and after.

        Parameters
        ----------
        joint : str
        over : str
            ``velocity``, ``position``, ``time`` or ``frequency``.

        Raises
        ------
        ValueError
            A joint or an axis that is not known.
        """
        from rx90b_flex.view.shown import residual_figure

        return residual_figure(self, joint, over).axes[0]


@dataclass(frozen=True, eq=False)
class _Data:
    """A campaign's recordings in the two forms that the loop needs: to fit, and to replay."""

    regression: Regression
    identification: tuple[ReplayedTorques, ...]
    validation: tuple[ReplayedTorques, ...]

    @staticmethod
    def of(robot: Robot, campaign: Campaign) -> _Data:
        regression = Regression.of(robot, campaign.identification, campaign.cutoff_hz)

        def replays(recordings: Sequence[Recording]) -> tuple[ReplayedTorques, ...]:
            rigid = regression.robot
            return tuple(ReplayedTorques(rigid, prepare(rigid, r, campaign.cutoff_hz, thin=False)) for r in recordings)

        return _Data(regression, replays(campaign.identification), replays(campaign.validation))

    def errors(self, model: Identification) -> RoleErrors:
        """Of the robot that is written: with values that a robot can have."""
        return self.fitted_errors(with_possible_values(model))

    def fitted_errors(self, model: Identification) -> RoleErrors:
        """With the values as they are."""
        return RoleErrors(self._errors(self.validation, model), self._errors(self.identification, model))

    def if_not_possible(
        self, declared: Identification, model: Identification, before: RoleErrors, after: RoleErrors
    ) -> FittedErrors | None:
        """Errors with the fitted values; None where they are those of robots that can exist."""
        fitted = FittedErrors(self.fitted_errors(declared), self.fitted_errors(model))
        return None if (fitted.before, fitted.after) == (before, after) else fitted

    def predictions(self, before: Identification, after: Identification) -> tuple[Prediction, ...]:
        """Of the validation recordings, with the values as they are."""
        return tuple(
            Prediction(r.recording, r.torque, predict(r, before), predict(r, after), r.velocity)
            for r in self.validation
        )

    def noise_floor(self, model: Identification, campaign: Campaign) -> Array | None:
        """Of the torque, from what a model leaves: what does not repeat with the motion, but with a clock, is no noise."""
        repeating = [r for r in self.identification if r.recording.period_s is not None]
        return noise_floor(repeating, [r.torque - predict(r, model) for r in repeating], campaign)

    def _errors(self, replays: Sequence[ReplayedTorques], model: Identification) -> Errors:
        return Errors.of([r.torque for r in replays], [predict(r, model) for r in replays])


def predict(replay: ReplayedTorques, model: Identification) -> Array:
    """Torque of an identified model on a recording, shape (N, joints), N m."""
    return replay.predict(model.effects, model.link_parameters)


def close_loop(
    source: str | os.PathLike[str] | Campaign,
    *,
    robot: Robot | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    despite_faults: bool = False,
) -> ClosedLoop | RefusedLoop:
    """Find what measured torques hold that the declared model does not, and trace it to effects.

    The declared model is identified on the identification recordings. Then, in rounds: every effect of the
    catalogue is tried in every place against the residual; the one with the largest significant gain on held-out
    blocks is added; everything is identified again; what a later effect made needless is taken out.

    Parameters
    ----------
    source : path or Campaign
        Campaign file.
    robot : Robot, optional
        In place of the one that the campaign names.
    seed : int
        Of the permutation test for what remains.
    progress : callable, optional
        Called with a message and a fraction.
    despite_faults : bool
        Whether to go on where the look at the data (`rx90b_flex.check`) found them not usable. Otherwise the result then is a
        `RefusedLoop` with verdict ``data_fault``.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> result = rf.close_loop("campaign.toml")
    >>> [found.effect.label for found in result.effects]
    ['elbow.torque_offset']
    >>> result.after.validation.relative_error < result.before.validation.relative_error
    True
    """
    # many products of small matrices: threads would wait for each other longer than they work
    with threadpool_limits(limits=1, user_api="blas"):
        closed = _closed(source, robot, seed, _rising(progress or (lambda _text, _part: None)), despite_faults)
        return closed if isinstance(closed, RefusedLoop) else _with_second_encoders(closed)


def _with_second_encoders(result: ClosedLoop) -> ClosedLoop:
    """The result with the flexibilities that second encoders show, its errors those of the robot that has them."""
    gears = gear_deflections(result.source, result.campaign, result.model)
    result = dataclasses.replace(result, deflection=gears)
    if not any(g.parameters for g in gears):
        return result
    robot = with_gears(identified_robot(result.source, result.model, result.joints), gears)
    torques = {role: replayed(robot, result.campaign, role) for role in ROLES}
    after = RoleErrors(*(Errors.of([r.torque for r, _ in x], [t for _, t in x]) for x in torques.values()))
    found = tuple(
        FoundEffect(
            g.effect,
            g.parameters,
            result.after.validation,
            after.validation,
            g.trial.p_value,
            g.trial.gain_t,
            (),
            g.trial,
        )
        for g in gears
        if g.effect is not None and g.trial is not None
    )
    predictions = tuple(
        dataclasses.replace(p, after=t) for p, (_, t) in zip(result.predictions, torques["validation"], strict=True)
    )
    named = {"unexplained": "partly_explained", "nothing_missing": "explained"} if found else {}
    return dataclasses.replace(
        result,
        after=after,
        effects=(*result.effects, *found),
        verdict=named.get(result.verdict, result.verdict),
        predictions=predictions,
        moving=_moving(predictions),
        explainable=result.explainable and result.explainable.of(result.before.validation, after.validation),
        unexplained=dataclasses.replace(result.unexplained, relative_error=after.validation.relative_error),
    )


def _rising(tell: Progress) -> Progress:
    """Fractions that never go back: how many rounds there will be is not known before."""
    highest = 0.0

    def told(text: str, part: float) -> None:
        nonlocal highest
        highest = max(highest, part)
        tell(text, highest)

    return told


def _closed(
    source: str | os.PathLike[str] | Campaign, robot: Robot | None, seed: int, tell: Progress, despite_faults: bool
) -> ClosedLoop | RefusedLoop:
    campaign = source if isinstance(source, Campaign) else load_campaign(Path(source))
    if not campaign.validation:
        raise ValueError(
            f"{campaign.path}: no recording has role 'validation'; errors are counted on data that was not fitted"
        )
    for recording in campaign.recordings:
        if not recording.torque.any():
            raise ValueError(
                f"{recording.source or recording.name}: every torque is zero; errors have no size to go by"
            )
    tell("reading", 0.0)
    declared_robot = load_robot(campaign.robot_source) if robot is None else robot
    _check_joints(campaign, declared_robot)
    campaign, constants = resolved(campaign, declared_robot)
    data = _Data.of(declared_robot, campaign)
    if len(data.regression.blocks()) < FEWEST_BLOCKS:
        seconds = sum(r.duration_s for r in campaign.identification)
        raise ValueError(
            f"{campaign.path}: the recordings with role 'identification' last {seconds:.3g} s in all; "
            f"{FEWEST_BLOCKS} s or more are needed, for parts of them are held out"
        )
    tell("looking at the data", 0.02)
    checked = check(campaign, robot=declared_robot)
    if not (checked.usable or despite_faults):
        return RefusedLoop.of(checked, declared_robot, campaign)
    fit_links = declared_robot.inertial_parameters == "fitted"
    tell("identifying the declared model", 0.05)
    declared = trusting(data.regression, identify(data.regression, data.regression.robot.effects, fit_links=fit_links))
    before = data.errors(declared)
    sites = Sites(declared_robot.rigid().restricted(campaign.joints).joints, declared_robot.tip_frame)
    gains = frozenset(j for f in checked.data_faults if f.kind == "torque_gain" for j in f.joints)
    rounds = _Rounds(data, campaign, sites, fit_links, tell, gains)
    outcome = rounds.settled(rounds.run(declared, before))
    model, after = outcome.model, outcome.errors
    floor = data.noise_floor(model, campaign)
    tell("looking at what remains", 0.95)
    held_out = Regression.of(declared_robot, campaign.validation, campaign.cutoff_hz)
    held_out = held_out.trusting(trust(held_out, model))
    left = ((model.regression, model.residual), (held_out, model.residual_on(held_out)))
    where = dependences(left, seed)
    cautions = _cautions(declared_robot, campaign)
    shown = with_possible_values(declared)
    predictions = data.predictions(shown, with_possible_values(model))
    tell("asking how much can be explained at all", 0.97)
    compared_with = [HeldOut(p.torque, p.before) for p in predictions]
    explainable = yardstick(shown, held_out.trusting(None), compared_with, after.validation)
    known = explainable if isinstance(explainable, Explainable) else None
    spread = np.concatenate([p.torque for p in predictions]).std(axis=0)
    remains = Remains(campaign.joints, bool(outcome.steps), before, after, floor, known, where, bool(cautions), spread)
    search = Search(model, sites)
    last_round = LastRound(outcome.refused, len(search.candidates), search.tests)
    tell("done", 1.0)
    return ClosedLoop(
        declared_robot.name,
        campaign.joints,
        before,
        after,
        None if floor is None else tuple(float(x) for x in floor),
        _found(outcome.steps, search, before),
        verdict_despite(remains.verdict, checked, {j for e in model.effects if e.multiplies for j in e.joints}),
        Unexplained(after.validation.relative_error, where, left, bands(left)),
        model,
        declared,
        predictions,
        declared_robot,
        campaign,
        last_round,
        seed,
        _moving(predictions),
        known,
        "" if known else str(explainable),
        data.if_not_possible(declared, model, before, after),
        (*cautions, *(c.message for c in constants)),
        data_faults=checked.data_faults,
        undeclared_basics=checked.undeclared_basics,
        checked=checked,
    )


def _moving(predictions: Sequence[Prediction]) -> MovingErrors:
    return moving_errors(*zip(*((p.torque, p.before, p.after, p.velocity) for p in predictions), strict=True))


def _cautions(robot: Robot, campaign: Campaign) -> tuple[str, ...]:
    """Where the rigid band that torques over time are held against ends below what the campaign keeps."""
    hinges = [e for e in robot.effects if e.virtual and e.on_rigid_tree() is None]
    if not hinges:
        return ()
    left_out = (
        f"The {len(hinges)} hinges that {robot.name} declares are left out: torques over time are held against its rigid "
        "tree. "
    )
    loads = [e for e in robot.effects if e.part == "links" and e.known]
    if not all(e.known for e in hinges):
        return (f"{left_out}Not all of them have a value, so it is not known from which frequency on they bend.",)
    column = {joint: i for i, joint in enumerate(campaign.joints)}
    angles = np.concatenate([r.position for r in campaign.identification]).mean(axis=0)
    pose = np.array([angles[column[j]] if j in column else 0.0 for j in robot.joints])
    small = robot.with_effects([*hinges, *loads])  # what sits on the drives does not move with them locked
    first = float(small.linearize(small.input_matrix @ pose).with_drives_locked_hz()[0])
    top = campaign.cutoff_hz or campaign.sample_rate_hz / 2
    if top <= RIGID_BAND * first:
        return ()
    return (
        f"{left_out}They bend from about a third of {first:.2g} Hz, where its links first swing with all drives held, and "
        f"this campaign keeps what is below {top:.3g} Hz. What they do in between may be given another name, such as a delay; "
        f"a low-pass at {RIGID_BAND * first:.2g} Hz, or frequency responses, would tell.",
    )


def _check_joints(campaign: Campaign, robot: Robot) -> None:
    try:
        robot.restricted(campaign.joints)
    except ValueError as error:
        raise ValueError(f"{campaign.path}: joints: {error}") from None


@dataclass(frozen=True, eq=False)
class _Step:
    """One addition: the trial that won, what it beat, and the errors with everything identified again.

    In the end also how the rivals do in its place in the final model.
    """

    trial: TorqueTrial
    rivals: tuple[TorqueTrial, ...]
    errors: RoleErrors
    compared: tuple[Comparison, ...] = ()
    before: RoleErrors | None = None  # where several effects were added as one


@dataclass(frozen=True, eq=False)
class _Outcome:
    """Where the loop stands: model, its errors, what was added, and the best trials of a round that added nothing."""

    model: Identification
    errors: RoleErrors
    steps: tuple[_Step, ...]
    refused: tuple[TorqueTrial, ...]

    def with_steps(self, *new: _Step) -> tuple[_Step, ...]:
        """The steps and new ones; what a new effect stands in for is no longer in the model, even if an earlier round added it."""
        kept = list(self.steps)
        for step in new:
            kept = [s for s in kept if added([s.trial.effect], step.trial.effect)[0] is s.trial.effect]
        return (*kept, *new)


@dataclass(frozen=True, eq=False)
class _Rounds:
    """The loop itself."""

    data: _Data
    campaign: Campaign
    sites: Sites
    fit_links: bool
    tell: Progress
    gains: frozenset[str] = frozenset()  # joints whose torque has another gain, as the look at the data found

    def run(self, declared: Identification, before: RoleErrors) -> _Outcome:
        """Add effects until nothing more is significant, or the noise floor is reached. No model is visited twice."""
        outcome = _Outcome(declared, before, (), ())
        visited = {_signature(declared.effects)}
        while len(outcome.steps) < MOST_EFFECTS and len(visited) < 2 * MOST_EFFECTS:
            model, number = outcome.model, len(outcome.steps)
            done = 0.1 + 0.8 * (1.0 - 0.8**number)
            told = partial(self._tell_part, f"trying effects, round {number + 1}", done)
            at_floor = bool(outcome.steps) and self._at_floor(outcome)
            trials = list(Search(model, self.sites, beside_motion if at_floor else laws).run(told))
            more = self._one_more(outcome, trials, done, visited)
            if at_floor and more is None:
                return outcome
            more = more or self._two_together(outcome, trials, done, visited)
            if more is None:
                curves = Search(model, self.sites, last_resorts).run()
                more = self._one_more(outcome, curves, done, visited)
                trials = sorted([*trials, *curves], key=lambda t: -t.gain)
            if more is None:
                return dataclasses.replace(outcome, refused=tuple(t for t in trials if not t.members)[: 2 * RIVALS])
            outcome = more
            visited.add(_signature(outcome.model.effects))
        return outcome

    def _one_more(
        self, outcome: _Outcome, trials: list[TorqueTrial], done: float, visited: set[_Signature]
    ) -> _Outcome | None:
        """With the best addition that still helps once everything is fitted again; None where none does.

        One whose shape then runs into an end of what the log tells stays among the `trials`, with that as its objection.
        """
        model, left = outcome.model, list(trials)
        for _ in range(TRIES):
            # first the data: of torques with another gain only the ratio shows, and the look at the data says whose it is
            best = choose([t for t in left if t.effect.multiplies and set(t.effect.joints) <= self.gains]) or choose(
                left
            )
            if best is None:
                return None
            left.remove(best)
            effects = model.effects
            for effect in best.effects:
                effects = added(effects, effect)
            if _signature(effects) in visited:
                continue
            self.tell(
                f"adding {best.effect.label}" + (f" and {len(best.members) - 1} alike" if best.members else ""), done
            )
            candidate = self._identified(effects, model, best.effects)
            if candidate.relative_error >= model.relative_error and not _weighted_better(candidate, model):
                continue
            fitted = [_find(candidate.effects, e) for e in best.effects]
            if not all(_physical(e) for e in fitted):
                continue  # fitted with all the rest, it has values that it cannot have
            candidate = trusting(self.data.regression, candidate)
            fitted = [_find(candidate.effects, e) for e in best.effects]
            ends = [text for e in fitted if (text := Search(candidate, self.sites).at_bound(e))]
            if ends:
                trials[trials.index(best)] = dataclasses.replace(best, lawful=False, objection=ends[0])
                continue
            errors = self.data.errors(candidate)
            if _spoils(errors, outcome.errors) or self._explains_nothing(best.effects, errors, outcome.errors):
                continue  # it helps where rows count, and spoils more where they do not
            singles = best.members or (best,)
            rivals = tuple(t for t in trials if not t.members and t not in singles)
            # what was asked of a family was asked of all its members together
            told = [dataclasses.replace(t, p_value=min(t.p_value, best.p_value)) for t in singles]
            # a declared effect that was left out for a while is no finding
            new = [t for t in told if t.effect.label not in self._declared]
            steps = tuple(_Step(t, rivals, errors, before=outcome.errors) for t in new)
            more = self._pruned(_Outcome(candidate, errors, outcome.with_steps(*steps), ()), len(steps))
            if _signature(more.model.effects) not in visited and not _spoils(more.errors, outcome.errors):
                return more
        return None

    def _two_together(
        self, outcome: _Outcome, trials: Sequence[TorqueTrial], done: float, visited: set[_Signature]
    ) -> _Outcome | None:
        """Two additions where neither is sure alone, each in the other's residual; None where no two are sure together.

        Worth a try where a lawful effect explains much: what keeps it from being sure is then no noise.
        """
        for first in [t for t in self._new(trials) if t.lawful and t.share > MUCH][:PAIRS]:
            self.tell(f"trying effects beside {first.effect.label}", done)
            half = self._identified(added(outcome.model.effects, first.effect), outcome.model, first.effects)
            search = Search(half, self.sites)
            beside = search.run()
            second = choose(self._new(beside))
            # as many pairs might have been tried as there are trials
            if second is None or second.p_value * search.tests > SIGNIFICANCE:
                continue
            if len(added([first.effect], second.effect)) < 2:
                continue  # one stands in for the other
            whole = trusting(
                self.data.regression, self._identified(added(half.effects, second.effect), half, second.effects)
            )
            again = Search(whole, self.sites).without(_find(whole.effects, first.effect))
            if not again.accepted:
                continue
            steps = (
                _Step(again, tuple(t for t in trials if t is not first and not t.members), self.data.errors(half)),
                _Step(second, tuple(t for t in beside if t is not second and not t.members), self.data.errors(whole)),
            )
            more = self._pruned(_Outcome(whole, steps[-1].errors, outcome.with_steps(*steps), ()))
            if _signature(more.model.effects) not in visited and not _spoils(more.errors, outcome.errors):
                return more
        return None

    def _explains_nothing(self, effects: Sequence[Effect], new: RoleErrors, old: RoleErrors) -> bool:
        """Whether every joint that effects touch does worse on the recordings that were fitted, every row counted."""
        joints = self.campaign.joints
        touched = {j for e in effects for j in e.joints} or set(joints)
        pairs = zip(joints, new.identification.torque_rms, old.identification.torque_rms, strict=True)
        return all(after > before for joint, after, before in pairs if joint in touched)

    def _new(self, trials: Sequence[TorqueTrial]) -> list[TorqueTrial]:
        """Single effects that the robot does not declare."""
        return [t for t in trials if not t.members and t.effect.label not in self._declared]

    @property
    def _declared(self) -> frozenset[str]:
        return frozenset(e.label for e in self.data.regression.robot.effects)

    def _tell_part(self, text: str, done: float, fraction: float) -> None:
        self.tell(text, done + 0.15 * (0.9 - done) * fraction)

    def _identified(
        self, effects: Sequence[Effect], start: Identification, new: Sequence[Effect] = ()
    ) -> Identification:
        """With the rows weighted as they are in the model to compare with.

        A declared effect that goes beyond what it can be beside `new` ones is not there: the shapes are fitted again without it.
        """
        regression = self.data.regression.trusting(start.regression.trust)
        model = identify(regression, effects, fit_links=self.fit_links, start=start)
        gone = [e for e in model.impossible() if e.label in self._declared - {n.label for n in new}]
        if not gone:
            return model
        kept = [e for e in model.effects if e not in gone]
        other = identify(regression, kept, fit_links=self.fit_links, start=model)
        better = (
            self.data.errors(other).identification.relative_error
            < self.data.errors(model).identification.relative_error
        )
        return other if better else model

    def _at_floor(self, outcome: _Outcome) -> bool:
        floor = self.data.noise_floor(outcome.model, self.campaign)
        if floor is None:
            return False
        return bool((np.array(outcome.errors.identification.torque_rms) <= AT_FLOOR * floor).all())

    def settled(self, outcome: _Outcome) -> _Outcome:
        """Give an effect its look-alike's name where that explains more, now that everything else is in the model."""
        first = outcome.model
        search = Search(first, self.sites)
        looked_at: list[list[Comparison]] = []
        for step in outcome.steps:
            named = _find(outcome.model.effects, step.trial.effect)
            looked_at.append(compared(search, named, step.trial, step.rivals))
            better = [c for c in looked_at[-1] if c.rival_wins]
            if not better:
                continue
            best = min(better, key=lambda c: c.behind)
            self.tell(f"comparing {named.label} with {best.rival.effect.label}", 0.92)
            model = self._identified(
                swapped(outcome.model.effects, named, best, search), outcome.model, best.rival.effects
            )
            if not _weighted_better(model, outcome.model):
                continue
            errors = self.data.errors(model)
            if _spoils(errors, outcome.errors):
                continue
            # the loser is a rival from now on
            rivals_of_winner = (step.trial, *(t for t in step.rivals if t.effect is not best.rival.effect))
            new = dataclasses.replace(step, trial=best.rival, rivals=rivals_of_winner)
            steps = [new if s is step else s for s in outcome.steps]
            steps[-1] = dataclasses.replace(steps[-1], errors=errors)
            outcome = dataclasses.replace(outcome, model=model, errors=errors, steps=tuple(steps))
            search = Search(model, self.sites)
        if search.model is not first:
            looked_at = [
                compared(search, _find(outcome.model.effects, s.trial.effect), s.trial, s.rivals) for s in outcome.steps
            ]
        steps = [dataclasses.replace(s, compared=tuple(c)) for s, c in zip(outcome.steps, looked_at, strict=True)]
        return dataclasses.replace(outcome, steps=tuple(steps))

    def _pruned(self, outcome: _Outcome, latest: int = 1) -> _Outcome:
        """Take out what the latest effects made needless, and those of a family that turn out not to belong to it.

        A curve of no known law makes nothing needless that has a name.
        """
        if any(s.trial.effect.last_resort for s in outcome.steps[len(outcome.steps) - latest :]):
            return outcome
        model = outcome.model
        search = Search(model, self.sites)
        for i, step in enumerate(outcome.steps):
            newest = i >= len(outcome.steps) - latest
            if newest and latest == 1:
                continue
            effect = _find(model.effects, step.trial.effect)
            worth = search.without(effect)
            if worth.accepted or (newest and worth.belongs(search.tests)):
                continue
            self.tell(f"taking out {effect.label}", 0.1 + 0.8 * (1.0 - 0.8 ** len(outcome.steps)))
            kept = [s for s in outcome.steps if s is not step]
            model = self._identified(search.present_without(effect), model)
            back = [e for e in model.effects if e.label in {r.label for r in search.restored(effect)} - self._declared]
            for simpler in back:
                # what it stands in for is a finding by itself, or none
                again = Search(model, self.sites).without(simpler)
                if again.accepted:
                    kept.insert(i, dataclasses.replace(step, trial=again))
                else:
                    model = self._identified([e for e in model.effects if e is not simpler], model)
            if not kept:
                return outcome
            errors = self.data.errors(model)
            kept[-1] = dataclasses.replace(kept[-1], errors=errors)
            return self._pruned(_Outcome(model, errors, tuple(kept), ()), max(1, latest - newest))
        return outcome


_Signature = frozenset[tuple[str, tuple[str, ...], tuple[int, ...]]]


def _signature(effects: Sequence[Effect]) -> _Signature:
    """What tells two models apart: types and places; of those that may stand twice in one place, the shapes too, to a tenth."""

    def shape(effect: Effect) -> tuple[int, ...]:
        return (
            tuple(np.round(10.0 * np.log(np.abs(effect.shape) + 1e-9)).astype(int).tolist()) if effect.repeats else ()
        )

    return frozenset((e.type_name(), e.place, shape(e)) for e in effects)


def trusting(regression: Regression, model: Identification) -> Identification:
    """The same model fitted with the trust that it has in each row, which its smaller residual may change once more."""
    for _ in range(TRUST_ROUNDS):
        known = trust(regression, model)
        before = model.regression.trust
        if np.abs(known - (1.0 if before is None else before)).max() < SAME_TRUST:
            break
        model = identify(regression.trusting(known), model.effects, fit_links=model.links_fitted, start=model)
    return model


def _weighted_better(new: Identification, old: Identification) -> bool:
    """Whether the log-likelihood of white residuals grew: one joint may gain what another does not lose."""
    return bool(np.log(new.solution.sigma).sum() < np.log(old.solution.sigma).sum() - 1e-6)


def _spoils(new: RoleErrors, old: RoleErrors) -> bool:
    """Whether a robot does worse on the recordings that were fitted, every row counted, than chance would explain."""
    return new.identification.relative_error > WORSE * old.identification.relative_error


def _physical(effect: Effect) -> bool:
    """Whether every single value that a robot file would hold lies above its lower bound."""
    values = ((getattr(effect, p.attribute), p.lower) for p in effect.parameters().values())
    return all(x is None or bool((np.atleast_1d(x) >= low).all()) for x, low in values)


def _find(effects: Sequence[Effect], like: Effect) -> Effect:
    """The identified form of an effect that was added: same type and place, nearest shape."""
    same = [e for e in effects if type(e) is type(like) and e.place == like.place]
    return min(same, key=lambda e: float(np.abs(e.shape - like.shape).sum()) if len(e.shape) else 0.0)


def _found(steps: Sequence[_Step], search: Search, before: RoleErrors) -> tuple[FoundEffect, ...]:
    out = []
    last = before
    model = search.model
    for step in steps:
        effect = _find(model.effects, step.trial.effect)
        out.append(
            FoundEffect(
                effect,
                model.estimates(model.effects.index(effect)),
                (step.before or last).validation,
                step.errors.validation,
                step.trial.p_value,
                step.trial.gain_t,
                step.rivals[:RIVALS],
                step.trial,
                alternatives(search, effect, step.compared),
            )
        )
        last = step.errors
    return tuple(out)
