"""Close the loop: identify the declared model, find what is missing, add it, and say what remains."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rx90b_flex.diagnose.evidence import Dependence, dependences
from rx90b_flex.diagnose.residual import Errors, Replay, noise_floor
from rx90b_flex.diagnose.search import Search, Trial, added, choose
from rx90b_flex.effects import Effect, Sites
from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.least_squares import Estimate, Identification, identify
from rx90b_flex.identify.regression import Regression, prepare
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import Campaign, Recording, load_campaign

SCHEMA = 1
MOST_EFFECTS = 24  # a loop that adds more than this explains noise
AT_FLOOR = 1.02  # residual over noise floor at which nothing is left to look for
RIVALS = 5  # refused trials of a round that a result keeps
NEAR_FLOOR = 1.2  # residual over noise floor above which something is called unexplained

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
    rivals : tuple of Trial
        What else was tried in that round, best first.
    trial : Trial
        The trial that won that round, in the same units as its rivals.
    """

    effect: Effect
    parameters: tuple[Estimate, ...]
    before: Errors
    after: Errors
    p_value: float
    gain_t: float
    rivals: tuple[Trial, ...]
    trial: Trial


@dataclass(frozen=True)
class LastRound:
    """The round that added nothing.

    Attributes
    ----------
    trials : tuple of Trial
        The best of what was tried and refused, best first; empty where the noise floor ended the loop.
    candidates : int
        Effects that can be tried beside the final model: types times places.
    tests : int
        Independent trials that p-values are corrected for.
    """

    trials: tuple[Trial, ...]
    candidates: int
    tests: int


@dataclass(frozen=True)
class Unexplained:
    """What is left after the last effect: its size on the validation data, and what it depends on."""

    relative_error: float
    where: tuple[Dependence, ...]


@dataclass(frozen=True)
class RoleErrors:
    """Errors of one model on both roles."""

    validation: Errors
    identification: Errors


@dataclass(frozen=True, eq=False)
class Prediction:
    """Torques of one validation recording, each (N, joints), N m, after the low-pass; and the velocity, rad/s."""

    recording: Recording
    torque: Array
    before: Array
    after: Array
    velocity: Array


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Result of closing the loop; the content of ``closed_loop.json`` as attributes.

    Attributes
    ----------
    robot : str
    joints : tuple of str
    before, after : RoleErrors
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


@dataclass(frozen=True, eq=False)
class _Data:
    """A campaign's recordings in the two forms that the loop needs: to fit, and to replay."""

    regression: Regression
    identification: tuple[Replay, ...]
    validation: tuple[Replay, ...]

    @staticmethod
    def of(robot: Robot, campaign: Campaign) -> _Data:
        regression = Regression.of(robot, campaign.identification, campaign.cutoff_hz)

        def replays(recordings: Sequence[Recording]) -> tuple[Replay, ...]:
            rigid = regression.robot
            return tuple(Replay(rigid, prepare(rigid, r, campaign.cutoff_hz, thin=False)) for r in recordings)

        return _Data(regression, replays(campaign.identification), replays(campaign.validation))

    def errors(self, model: Identification) -> RoleErrors:
        return RoleErrors(self._errors(self.validation, model), self._errors(self.identification, model))

    def _errors(self, replays: Sequence[Replay], model: Identification) -> Errors:
        return Errors.of([r.torque for r in replays], [predict(r, model) for r in replays])


def predict(replay: Replay, model: Identification) -> Array:
    """Torque of an identified model on a recording, shape (N, joints), N m."""
    return replay.predict(model.effects, model.link_parameters)


def close_loop(
    source: str | os.PathLike[str] | Campaign, *, robot: Robot | None = None, seed: int = 0, progress: Progress | None = None
) -> ClosedLoop:
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

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it.
    """
    tell = progress or (lambda _text, _part: None)
    campaign = source if isinstance(source, Campaign) else load_campaign(Path(source))
    if not campaign.validation:
        raise ValueError(f"{campaign.path}: no recording has role 'validation'; errors are counted on data that was not fitted")
    tell("reading", 0.0)
    declared_robot = load_robot(campaign.robot_source) if robot is None else robot
    _check_joints(campaign, declared_robot)
    data = _Data.of(declared_robot, campaign)
    fit_links = declared_robot.inertial_parameters == "fitted"
    tell("identifying the declared model", 0.05)
    declared = identify(data.regression, data.regression.robot.effects, fit_links=fit_links)
    before = data.errors(declared)
    floor = noise_floor(data.identification, [r.torque - predict(r, declared) for r in data.identification], campaign)
    sites = Sites(declared_robot.rigid().restricted(campaign.joints).joints, declared_robot.tip_frame)
    rounds = _Rounds(data, sites, fit_links, floor, tell)
    model, steps, refused = rounds.run(declared, before)
    after = steps[-1].errors if steps else before
    tell("looking at what remains", 0.95)
    where = dependences(model.regression, model.residual, seed)
    verdict = _verdict(len(steps), after, floor, where)
    predictions = tuple(
        Prediction(r.recording, r.torque, predict(r, declared), predict(r, model), r.velocity) for r in data.validation
    )
    search = Search(model, sites)
    last_round = LastRound(refused, len(search.candidates()), search.tests)
    tell("done", 1.0)
    return ClosedLoop(
        declared_robot.name,
        campaign.joints,
        before,
        after,
        None if floor is None else tuple(float(x) for x in floor),
        _found(steps, model, before),
        verdict,
        Unexplained(after.validation.relative_error, where),
        model,
        declared,
        predictions,
        declared_robot,
        campaign,
        last_round,
        seed,
    )


def _check_joints(campaign: Campaign, robot: Robot) -> None:
    try:
        robot.restricted(campaign.joints)
    except ValueError as error:
        raise ValueError(f"{campaign.path}: joints: {error}") from None


@dataclass(frozen=True, eq=False)
class _Step:
    """One addition: the trial that won, what it beat, and the errors with everything identified again."""

    trial: Trial
    rivals: tuple[Trial, ...]
    errors: RoleErrors


@dataclass(frozen=True, eq=False)
class _Rounds:
    """The loop itself."""

    data: _Data
    sites: Sites
    fit_links: bool
    floor: Array | None
    tell: Progress

    def run(self, declared: Identification, before: RoleErrors) -> tuple[Identification, list[_Step], tuple[Trial, ...]]:
        """The final model, what was added, and the best trials of the round that added nothing."""
        model, errors = declared, before
        steps: list[_Step] = []
        while len(steps) < MOST_EFFECTS and not self._at_floor(errors):
            done = 0.1 + 0.8 * (1.0 - 0.8 ** len(steps))

            def part(fraction: float, done: float = done) -> None:
                self.tell(f"trying effects, round {len(steps) + 1}", done + 0.15 * (0.9 - done) * fraction)

            trials = Search(model, self.sites).run(part)
            best = choose(trials)
            if best is None:
                return model, steps, tuple(trials[:RIVALS])
            self.tell(f"adding {best.effect.label}", done)
            candidate = identify(
                self.data.regression, added(model.effects, best.effect), fit_links=self.fit_links, start=model
            )
            if candidate.relative_error >= model.relative_error and not _weighted_better(candidate, model):
                return model, steps, tuple(trials[:RIVALS])
            model = candidate
            errors = self.data.errors(model)
            rivals = tuple(t for t in trials if t is not best)[:RIVALS]
            steps.append(_Step(best, rivals, errors))
            model, errors, steps = self._pruned(declared, model, errors, steps)
        return model, steps, ()

    def _at_floor(self, errors: RoleErrors) -> bool:
        if self.floor is None:
            return False
        return bool((np.array(errors.identification.torque_rms) <= AT_FLOOR * self.floor).all())

    def _pruned(
        self, declared: Identification, model: Identification, errors: RoleErrors, steps: list[_Step]
    ) -> tuple[Identification, RoleErrors, list[_Step]]:
        """Take out what a later effect made needless."""
        for step in steps[:-1]:
            effect = _find(model.effects, step.trial.effect)
            if effect.replaces or Search(model, self.sites).without(effect).accepted:
                continue
            self.tell(f"taking out {effect.label}", 0.9)
            kept = [e for e in model.effects if e is not effect]
            model = identify(self.data.regression, kept, fit_links=self.fit_links, start=model)
            errors = self.data.errors(model)
            steps = [s for s in steps if s is not step]
        return model, errors, steps


def _weighted_better(new: Identification, old: Identification) -> bool:
    """Whether the log-likelihood of white residuals grew: one joint may gain what another does not lose."""
    return bool(np.log(new.solution.sigma).sum() < np.log(old.solution.sigma).sum() - 1e-6)


def _find(effects: Sequence[Effect], like: Effect) -> Effect:
    """The identified form of an effect that was added: same type and place, nearest shape."""
    same = [e for e in effects if type(e) is type(like) and e.place == like.place]
    return min(same, key=lambda e: float(np.abs(e.shape - like.shape).sum()) if len(e.shape) else 0.0)


def _found(steps: Sequence[_Step], model: Identification, before: RoleErrors) -> tuple[FoundEffect, ...]:
    out = []
    last = before
    for step in steps:
        effect = _find(model.effects, step.trial.effect)
        out.append(
            FoundEffect(
                effect,
                model.estimates(model.effects.index(effect)),
                last.validation,
                step.errors.validation,
                step.trial.p_value,
                step.trial.gain_t,
                step.rivals,
                step.trial,
            )
        )
        last = step.errors
    return tuple(out)


def _verdict(additions: int, after: RoleErrors, floor: Array | None, where: Sequence[Dependence]) -> str:
    if floor is None:
        left = bool(where)
    else:
        left = bool((np.array(after.identification.torque_rms) > NEAR_FLOOR * floor).any())
    if additions:
        return "partly_explained" if left else "explained"
    return "unexplained" if left else "nothing_missing"
