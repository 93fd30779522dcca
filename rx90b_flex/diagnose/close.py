"""Close the loop: identify the declared model, find what is missing, add it, and say what remains."""

from __future__ import annotations

import dataclasses
import gc
import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from rx90b_flex.compiled.compile import told_of_compiling
from rx90b_flex.diagnose.alternatives import Alternative
from rx90b_flex.diagnose.basics import declared_robot
from rx90b_flex.diagnose.beyond_fitted import beyond_fitted
from rx90b_flex.diagnose.cancelling import cancelling
from rx90b_flex.diagnose.check import Checked, check
from rx90b_flex.diagnose.deflection import GearDeflection, gear_deflections, not_in_torques, with_gears
from rx90b_flex.diagnose.events import Events, events
from rx90b_flex.diagnose.evidence import Band, Dependence, bands, dependences
from rx90b_flex.diagnose.identified import identified_robot
from rx90b_flex.diagnose.kinds import sites_of
from rx90b_flex.diagnose.known_links import if_links_are_off
from rx90b_flex.diagnose.loop import ClosingLoop, Progress, Standing
from rx90b_flex.diagnose.low_pass import beyond_model
from rx90b_flex.diagnose.motor_turns import turns_of_motor, turns_words
from rx90b_flex.diagnose.moving import MovingErrors, TorqueErrors, held_at_first
from rx90b_flex.diagnose.other_friction import OtherFriction, other_friction
from rx90b_flex.diagnose.refused import OfCampaign, RefusedLoop, verdict_despite
from rx90b_flex.diagnose.replayed import ROLES, replayed
from rx90b_flex.diagnose.residual import Errors, RoleErrors, replayed_errors, unlike_words
from rx90b_flex.diagnose.reversals import row_weights
from rx90b_flex.diagnose.search import Search
from rx90b_flex.diagnose.seldom import shown_seldom
from rx90b_flex.diagnose.side_by_side import worth_while
from rx90b_flex.diagnose.slow import ErrorsInTime, Slow, SlowAtRest
from rx90b_flex.diagnose.torque import (
    MOST_A_JOINT,
    MOST_EFFECTS,
    TorqueData,
    TorqueModel,
    TorqueResidual,
    find_added,
    predict,
)
from rx90b_flex.diagnose.torque_units import Torques, sensor_words
from rx90b_flex.diagnose.trial import TorqueTrial
from rx90b_flex.diagnose.unlike_noise import Bursts, Course, unlike_noise
from rx90b_flex.diagnose.verdict import Remains, raised
from rx90b_flex.diagnose.yardstick import Explainable, HeldOut, yardstick
from rx90b_flex.early import check_jobs
from rx90b_flex.effects import Effect
from rx90b_flex.effects.flexibility import stiff_for_want_of_values
from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.files.toml import named_in
from rx90b_flex.identify.least_squares import Estimate, Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.shapes import USUAL
from rx90b_flex.identify.torque_scale import of_model, of_open_size, told_otherwise
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign, Recording, load_campaign

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCHEMA = 1
RIGID_BAND = 1 / 3  # of the first frequency with drives held, up to which a rigid model with more inertia does as well
TOLD_AGAIN = 2  # loops after the first, each by torque constants that the effects found before tell, at the most
RIVALS = 5  # refused trials of a round that a result keeps


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
    rivals: tuple[TorqueTrial, ...] = field(repr=False)
    trial: TorqueTrial = field(repr=False)
    alternatives: tuple[Alternative, ...] = field(default=(), repr=False)

    @property
    def type(self) -> str:
        """Its type, as in a robot file."""
        return self.effect.type_name()

    @property
    def joint(self) -> str | None:
        """Where it acts; None where that is not one joint."""
        return self.joints[0] if len(self.joints) == 1 else None

    @property
    def joints(self) -> tuple[str, ...]:
        """Where it acts."""
        return self.effect.joints

    @property
    def validation_relative_error_before(self) -> float:
        """The number of that name in ``closed_loop.json``."""
        return self.before.relative_error

    @property
    def validation_relative_error_after(self) -> float:
        """The number of that name in ``closed_loop.json``."""
        return self.after.relative_error

    @property
    def p_value(self) -> float:
        """That nothing is there, corrected for all that was tried."""
        return self.trial.p_value

    @property
    def gain_t(self) -> float:
        """Gain on held-out blocks over its standard error."""
        return self.trial.gain_t


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
    taken_out : tuple of TorqueTrial
        Additions that went again, for they raise the error of recordings that were not fitted.
    """

    trials: tuple[TorqueTrial, ...]
    candidates: int
    tests: int
    taken_out: tuple[TorqueTrial, ...] = ()


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
    """Torques of one validation recording, each (N, joints), N m, after the low-pass; and the velocity, rad/s, and rows up to a
    joint's first move.
    """

    recording: Recording
    torque: Array
    before: Array
    after: Array
    velocity: Array
    waiting: Mask


@dataclass(frozen=True, eq=False, repr=False)
class ClosedLoop(OfCampaign):
    """Result of closing the loop; the content of ``closed_loop.json`` as attributes.

    Attributes
    ----------
    before, after : RoleErrors
        Of the declared robot with its identified values, and of the robot that is written.
    noise_floor : tuple of float or None
        Root mean square noise a joint, N m.
    effects : tuple of FoundEffect
        In the order in which they were added.
    verdict : str
        ``nothing_missing``, ``explained``, ``partly_explained``, ``unexplained``; `RefusedLoop` has ``data_fault``.
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
    checked : Checked
        All that the look at the data says; with `despite_faults` also what makes them not usable.
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
    checked: Checked
    last_round: LastRound
    seed: int
    moving: MovingErrors
    explainable: Explainable | None
    not_explainable: str = ""
    fitted: FittedErrors | None = None
    cautions: tuple[str, ...] = ()
    deflection: tuple[GearDeflection, ...] = ()

    @property
    def motor_turns(self) -> tuple[str, ...]:
        """Sentences that effects found repeat with the turns of a motor, where the campaign states the gears."""
        ratios = {j: turns_of_motor(self.campaign.gear_matrix, self.joints, j) for j in self.joints}
        each = ((e, ratios[e.joint], p) for e in self.effects if e.joint in ratios for p in e.parameters)
        said = (turns_words(e.effect.label, str(e.joint), p, r) for e, r, p in each if r and p.name == "order")
        return tuple(text for text in said if text)

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


def close_loop(
    source: str | os.PathLike[str] | Campaign,
    *,
    robot: Robot | str | os.PathLike[str] | None = None,
    basics: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
    despite_faults: bool = False,
    jobs: int | None = None,
) -> ClosedLoop | RefusedLoop:
    """Find what measured torques hold that the declared model does not, and trace it to effects.

    The declared model is identified on the identification recordings. Then, in rounds: every effect of the
    catalogue is tried in every place against the residual; the one with the largest significant gain on held-out
    blocks is added; everything is identified again; what a later effect made needless is taken out. Effects on other
    joints that pass again beside it are added in the same round.

    Parameters
    ----------
    source : path or Campaign
        Campaign file.
    robot : Robot, or what `load_robot` takes, optional
        In place of the one that the campaign names.
    basics : bool
        Whether drive inertia, dry and viscous friction and an offset are declared on every joint of the campaign that lacks them.
    seed : int
        Of the permutation test for what remains.
    progress : callable, optional
        Called with a message and a fraction.
    despite_faults : bool
        Whether to go on where the look at the data (`rx90b_flex.check`) found them not usable. Otherwise the result then is a
        `RefusedLoop` with verdict ``data_fault``.
    jobs : int, optional
        Processes that try candidates beside each other; with any number the result is the same. Where not given, one a core for a log
        that is long enough on a machine with cores enough to be worth them, else one.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it, or that `jobs` is no number of processes.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> result = rf.close_loop("campaign.toml")
    >>> [found.effect.label for found in result.effects]
    ['elbow.torque_offset']
    >>> result.after.validation.relative_error < result.before.validation.relative_error
    True
    """
    if jobs is not None:
        check_jobs(jobs)
    # many products of small matrices: threads would wait for each other longer than they work
    tell = _rising(progress or (lambda _text, _part: None))
    with (
        threadpool_limits(limits=1, user_api="blas"),
        _imports_set_aside(),
        told_of_compiling(lambda: tell("compiling, once on this machine", 0.0)),
    ):
        campaign = source if isinstance(source, Campaign) else load_campaign(Path(source))
        _check_torques(campaign)
        closed = _closed(campaign, declared_robot(campaign, basics, robot), seed, tell, despite_faults, jobs)
        return closed if isinstance(closed, RefusedLoop) else _with_second_encoders(closed)


@contextmanager
def _imports_set_aside() -> Iterator[None]:
    """What is loaded so far lives on: Python need not look through all of it each time that it looks for what does not."""
    if gc.get_freeze_count():
        yield  # others set theirs aside, and only all of it can be taken back
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _with_second_encoders(result: ClosedLoop) -> ClosedLoop:
    """The result with the flexibilities that second encoders show, its errors those of the robot that has them."""
    model = result.model
    shown = any(r.link_position is not None for r in result.campaign.recordings)
    if model.links_near and shown:  # what passes the gears is asked of the recordings alone
        model = identify(model.regression, model.effects, fit_links=True, start=model, links_near=0.0)
    gears = gear_deflections(result.source, result.campaign, model)
    if not any(g.parameters for g in gears):
        return dataclasses.replace(result, deflection=gears)
    robot = identified_robot(result.source, result.model, result.joints)
    flexible = _with_gears(result, robot, gears)
    if flexible.after.told.validation.relative_error > result.before.told.validation.relative_error:
        return _with_gears(result, robot, tuple(not_in_torques(g) for g in gears))
    return flexible


def _with_gears(result: ClosedLoop, identified: Robot, gears: tuple[GearDeflection, ...]) -> ClosedLoop:
    result, robot = dataclasses.replace(result, deflection=gears), with_gears(identified, gears)
    if robot.effects == identified.effects:
        return result
    torques = {role: replayed(robot, result.campaign, role) for role in ROLES}
    after = RoleErrors(*(replayed_errors(*zip(*x, strict=True)) for x in torques.values()))
    found = tuple(
        FoundEffect(g.effect, g.parameters, result.after.validation, after.validation, (), g.trial)
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
    campaign: Campaign,
    declared: Robot,
    seed: int,
    tell: Progress,
    despite_faults: bool,
    jobs: int | None,
) -> ClosedLoop | RefusedLoop:
    tell("reading", 0.0)
    with named_in(campaign.path, "joints"):
        declared.restricted(campaign.joints)
    torques = Torques.of(campaign, declared)
    data = torques.data(declared)
    tell("looking at the data", 0.02)
    checked = check(of_open_size(torques.campaign, torques.constants), robot=declared)
    if not (checked.usable or despite_faults):
        return RefusedLoop(checked, declared, torques.campaign)
    tell("identifying the declared model", 0.05)
    ended = _looped(declared, data, torques, checked, frozenset(), jobs, tell)
    open_scale = of_model(torques.constants)
    for _ in range(TOLD_AGAIN if open_scale else 0):
        again = Torques.of(campaign, ended.robot_but_gains(open_scale))
        if not (ended.gains(open_scale) or told_otherwise(torques.constants, again.constants)):
            break
        tell("once more, by the torque constants that what was found tells", 0.1)
        torques = again
        del data, ended  # a long log has no room for two
        data = torques.data(declared)
        ended = _looped(declared, data, torques, checked, open_scale, jobs, tell)
    return ended.result(
        seed,
        checked,
        (
            *(c.message for c in torques.constants if c.source != "stated"),
            *torques.calibrated,
            # of hinges without a value `_cautions` tells more
            *stiff_for_want_of_values(e for e in declared.effects if "bend_1" not in e.traits.virtual),
            *ended.stopped,
            *filter(None, [checked.torque_side.message]),
        ),
        tell,
    )


def _looped(
    declared: Robot,
    data: TorqueData,
    torques: Torques,
    checked: Checked,
    open_scale: frozenset[str],
    jobs: int | None,
    tell: Progress,
) -> _Ended:
    """The loop, in which torques of an open scale have no gain."""
    sites = dataclasses.replace(sites_of(declared, torques.campaign.joints), open_scale=open_scale)
    gains = frozenset(j for f in checked.data_faults if f.kind == "torque_gain" and f.usable for j in f.joints)
    residual = TorqueResidual(
        data,
        torques.campaign,
        sites,
        declared.inertial_parameters == "fitted",
        gains - open_scale,
        worth_while(jobs, data.regression.torque.size),
    )
    loop = ClosingLoop(residual, tell, MOST_EFFECTS + MOST_A_JOINT * len(sites.joints))
    standing = loop.run()
    return _Ended(declared, residual, standing, loop.declared, loop.stopped(standing))


@dataclass(frozen=True, eq=False)
class _Ended:
    """The loop's end: the declared robot, its data, where the loop stands, the declared model, and what is said of a limit."""

    source: Robot
    residual: TorqueResidual
    standing: Standing[TorqueModel, TorqueTrial]
    declared: TorqueModel
    stopped: tuple[str, ...]

    def gains(self, joints: Collection[str]) -> list[Effect]:
        """Gains of some joints' torques that were added."""
        added = find_added(self.standing.model, self.standing.steps)
        return [e for e in added if e.traits.multiplies and set(e.joints) <= set(joints)]

    def robot_but_gains(self, joints: Collection[str]) -> Robot:
        """The rigid robot, with all that was found but these."""
        gains, model = self.gains(joints), self.standing.model.identified
        return model.regression.robot.with_effects(e for e in model.effects if e not in gains)

    def result(self, seed: int, checked: Checked, constants: tuple[str, ...], tell: Progress) -> ClosedLoop:
        """With what remains, and how much could be explained at all."""
        residual, standing, campaign = self.residual, self.standing, self.residual.campaign
        declared, model = self.declared.identified, standing.model.identified
        before, after = self.declared.errors, standing.model.errors
        floor = residual.data.noise_floor(model, campaign)
        tell("looking at what remains", 0.95)
        search = residual.search(standing.model)
        effects, last_round = self._found(search), self._last_round(search)
        for regression in (residual.data.regression, declared.regression, model.regression):
            regression.forget(first_looks=True)
        held_out = residual.data.held_out.weighted(row_weights(residual.data.held_out, model))
        fitted = model.regression.motors, model.residual[:, : len(campaign.joints)]
        left, predictions = (fitted, (held_out, model.residual_on(held_out))), self._predictions()
        where, seldom = dependences(left, seed), shown_seldom(*left)
        cautions = _cautions(self.source, campaign)
        links_off, in_doubt = if_links_are_off(residual, standing, after.told.validation.relative_error)
        tell("asking how much can be explained at all", 0.97)
        explainable = self._explainable(held_out, predictions, floor)
        known, beyond = explainable if isinstance(explainable, Explainable) else None, self._beyond_model()
        doubtful = bool(cautions) or in_doubt or (floor is None and bool(beyond))
        errors = _errors(predictions, campaign.joints)
        happened = events(errors, _remembering(model.effects))
        odd, drifts = [e for e in happened if not e.held_by], _no_noise(errors, campaign.cutoff_hz, happened)
        spread, found = np.concatenate([p.torque for p in predictions]).std(axis=0), bool(standing.steps)
        scaled = {j for e in model.effects if e.traits.multiplies for j in e.joints}
        rest = (where, doubtful, spread, odd, bool(drifts or seldom), self._curved)
        remains = Remains(campaign.joints, found, before, after, floor, known, *rest)
        tell("done", 1.0)
        return ClosedLoop(
            before,
            after,
            None if floor is None else tuple(float(x) for x in floor),
            effects,
            verdict_despite(remains.verdict, checked, scaled),
            Unexplained(after.validation.relative_error, where, left, bands(left)),
            model,
            declared,
            predictions,
            self.source,
            campaign,
            checked,
            last_round,
            seed,
            _moving(predictions),
            known,
            "" if known else str(explainable),
            self._if_not_possible(),
            (
                *cautions,
                *links_off,
                *constants,
                *beyond,
                *self._said(predictions),
                *([] if remains.nothing else self._happened(happened, known)),
                *(s.words for s in seldom),
                *(s.words for s in self._frictions(left)),
                *(s.words for s in drifts if floor is None or remains.left),
            ),
        )

    def _happened(self, held_out: Sequence[Events], known: Explainable | None) -> Iterator[str]:
        """What is said of short times with much of the error, held out and fitted."""
        campaign, after = self.residual.campaign, self.standing.model.errors
        follows = known.less_of(campaign.joints, after.validation.told) if known else []
        yield from (e.words(e.joint in follows) for e in held_out)
        model = self.standing.model.identified
        fitted = events(_errors_fitted(campaign, model), _remembering(model.effects))
        yield from (e.words(False) for e in fitted if not e.held_by)

    def _frictions(self, left: tuple[tuple[Regression, Array], ...]) -> Iterator[OtherFriction]:
        """Recordings whose friction is not the model's, for the residuals of both roles."""
        roles = self.residual.campaign.identification, self.residual.campaign.validation
        for recordings, (regression, residual) in zip(roles, left, strict=True):
            yield from other_friction(
                self.standing.model.identified, [r.name for r in recordings], regression, residual
            )

    @property
    def _curved(self) -> list[str]:
        """Joints to which a curve of no known law was added."""
        named = [s.trial.effect for s in self.standing.steps]
        return [j for e in named if e.traits.last_resort for j in e.joints]

    def _explainable(
        self, held_out: Regression, predictions: Sequence[Prediction], floor: Array | None
    ) -> Explainable | str:
        """What a free form leaves of the declared model's error, or why none says."""
        compared_with = [HeldOut(p.torque, p.before, p.waiting) for p in predictions]
        after = self.standing.model.errors.validation
        return yardstick(self.declared.possible, held_out.weighted(None), compared_with, after, floor)

    def _beyond_model(self) -> tuple[str, ...]:
        """That a low-pass would serve a log which has none."""
        if self.residual.campaign.cutoff_hz is not None or self.residual.at_floor(self.standing.model):
            return ()
        replays, model = self.residual.data.identification, self.standing.model.possible
        predicted = [predict(r, model) for r in replays]
        rates = [r.recording.sample_rate_hz for r in replays]
        found = beyond_model([r.torque for r in replays], predicted, rates)
        so = " Without one nothing is called explained." if self.standing.steps else ""
        return () if found is None else (found.words + so,)

    def _said(self, predictions: Sequence[Prediction]) -> tuple[str, ...]:
        """What signals and recordings ask to be said."""
        declared, model = self.declared.identified, self.standing.model.identified
        words = sensor_words(declared, model), _held_words(model), self._beyond_fitted(), _before_moves(predictions)
        added, held_out = find_added(self.standing.model, self.standing.steps), self.residual.data.held_out
        before, after = self.declared.errors, self.standing.model.errors
        return (
            *(text for each in words for text in each),
            *cancelling(model, added, held_out),
            *(text for e in model.effects if (text := e.caution())),
            *raised(self.residual.campaign.joints, before.validation, after.validation),
            *self._unlike(predictions),
        )

    def _unlike(self, predictions: Sequence[Prediction]) -> tuple[str, ...]:
        """Whether one recording, fitted or held out, was made otherwise than the others."""
        fitted, model = self.residual.data.identification, self.standing.model.possible
        names = [*(r.recording.file_name for r in fitted), *(p.recording.file_name for p in predictions)]
        torque = [*(r.torque for r in fitted), *(p.torque for p in predictions)]
        return unlike_words(names, torque, [*(predict(r, model) for r in fitted), *(p.after for p in predictions)])

    def _beyond_fitted(self) -> tuple[str, ...]:
        """Where what is left is error of extrapolation."""
        data, model = self.residual.data, self.standing.model
        fitted, held_out = (
            {"positions": np.concatenate([r.position for r in x]), "speeds": np.concatenate([r.velocity for r in x])}
            for x in (data.identification, data.validation)
        )
        left = [r.torque - predicted for r, predicted in zip(data.validation, model.validation, strict=True)]
        told = np.where(np.concatenate([r.waiting for r in data.validation]), 0.0, np.concatenate(left))
        return beyond_fitted(self.residual.campaign.joints, fitted, held_out, told)

    def _last_round(self, search: Search) -> LastRound:
        refused = sorted((t for t in self.standing.refused if not t.members), key=lambda t: -t.gain)
        return LastRound(tuple(refused[: 2 * RIVALS]), len(search.candidates), search.tests, self.standing.taken_out)

    def _if_not_possible(self) -> FittedErrors | None:
        """Errors with the fitted values; None where they are those of robots that can exist."""
        models = self.declared, self.standing.model
        fitted = FittedErrors(*(m.fitted_errors for m in models))
        return None if (fitted.before, fitted.after) == tuple(m.errors for m in models) else fitted

    def _predictions(self) -> tuple[Prediction, ...]:
        """Of the validation recordings."""
        each = zip(self.residual.data.validation, self.declared.validation, self.standing.model.validation, strict=True)
        return tuple(
            Prediction(r.recording, r.torque, before, after, r.velocity, r.waiting) for r, before, after in each
        )

    def _found(self, search: Search) -> tuple[FoundEffect, ...]:
        model = self.standing.model
        out = []
        steps = self.standing.steps
        for step, effect in zip(steps, find_added(model, steps), strict=True):
            out.append(
                FoundEffect(
                    effect,
                    search.model.estimates(search.model.effects.index(effect)),
                    step.before.validation,
                    step.after.validation,
                    step.rivals[:RIVALS],
                    step.trial,
                    self.residual.alternatives(search, model, step),
                )
            )
        return tuple(out)


def _check_torques(campaign: Campaign) -> None:
    if not campaign.validation:
        raise ValueError(
            f"{campaign.path}: no recording has role 'validation'; errors are counted on data that was not fitted"
        )
    for recording in campaign.recordings:
        if not recording.torque.any():
            raise ValueError(
                f"{recording.source or recording.name}: every torque is zero; errors have no size to go by"
            )


def _errors(predictions: Sequence[Prediction], joints: Sequence[str]) -> TorqueErrors:
    names, rates = zip(*((p.recording.name, p.recording.sample_rate_hz) for p in predictions), strict=True)
    torque, left, velocity = zip(*((p.torque, p.torque - p.after, p.velocity) for p in predictions), strict=True)
    return TorqueErrors(joints, names, rates, torque, left, velocity)


def _errors_fitted(campaign: Campaign, model: Identification) -> TorqueErrors:
    """The same of the recordings that the model was fitted to, in the rows of its fit."""
    regression, joints, names = model.regression.motors, campaign.joints, [r.name for r in campaign.identification]
    of_each = ((s.rate_hz, s.torque, s.velocity, s.kept.start / s.rate_hz) for s in regression.segments)
    rates, torque, velocity, begins = zip(*of_each, strict=True)
    left = [model.residual[span, : len(joints)] for span in regression.spans]
    return TorqueErrors(joints, names, rates, torque, left, velocity, begins, "in the recordings that were fitted")


def _remembering(effects: Sequence[Effect]) -> dict[str, str]:
    return {j: e.type_name() for e in effects if e.traits.remembers for j in e.joints}


def _no_noise(
    errors: TorqueErrors, cutoff_hz: float | None, happened: Sequence[Events]
) -> tuple[Slow | SlowAtRest | Course | Bursts, ...]:
    """What of held-out errors is too slow for noise, or comes in bursts that are no single events."""
    in_time = ErrorsInTime.of(errors, cutoff_hz)
    slow, at_rest = in_time.slow(), in_time.at_rest()
    known = {x.joint for x in slow} | {x.joint for x in happened if not x.held_by}
    others = [x for x in unlike_noise(errors) if x.joint not in known]
    return (*slow, *([] if at_rest is None else [at_rest]), *others)


def _before_moves(predictions: Sequence[Prediction]) -> tuple[str, ...]:
    said = held_at_first(*zip(*((p.torque, p.after, p.waiting) for p in predictions), strict=True))
    return (said,) if said else ()


def _moving(predictions: Sequence[Prediction]) -> MovingErrors:
    return MovingErrors.of(*zip(*((p.torque, p.before, p.after, p.velocity) for p in predictions), strict=True))


def _cautions(robot: Robot, campaign: Campaign) -> tuple[str, ...]:
    """Where the rigid band that torques over time are held against ends below what the campaign keeps."""
    hinges = [e for e in robot.effects if "bend_1" in e.traits.virtual]
    if not hinges:
        return ()
    if not all(e.known for e in hinges):
        return (
            f"Not all of the {len(hinges)} hinges that {robot.name} declares have a value: those without are left out, for torques "
            "over time are held against a rigid tree, and it is not known from which frequency on they bend.",
        )
    flexible = [e for e in robot.effects if e.traits.virtual and e.known]
    loads = [e for e in robot.effects if e.traits.part == "links" and e.known]
    column = {joint: i for i, joint in enumerate(campaign.joints)}
    angles = np.concatenate([r.position for r in campaign.identification]).mean(axis=0)
    pose = np.array([angles[column[j]] if j in column else 0.0 for j in robot.joints])
    small = robot.with_effects([*flexible, *loads])  # what sits on the drives does not move with them locked
    first = float(small.linearize(small.input_matrix @ pose).with_drives_locked_hz()[0])
    top = campaign.cutoff_hz or campaign.sample_rate_hz / 2
    if top <= RIGID_BAND * first:
        return ()
    return (
        f"The {len(hinges)} hinges that {robot.name} declares are taken as declared. Its links first swing at {first:.2g} Hz with "
        f"all drives held, and this campaign keeps what is below {top:.3g} Hz. From a third of it on what is left depends on the "
        "declared damping and on how the log began, and may be given another name, such as a delay; a low-pass at "
        f"{RIGID_BAND * first:.2g} Hz, or frequency responses, would tell.",
    )


def _held_words(model: Identification) -> tuple[str, ...]:
    """What these recordings do not tell of effects' shapes, so that it is held at a usual or stated value; a line a value."""
    held: dict[tuple[str, float], list[str]] = {}
    for e in model.effects:
        for (name, p), x in zip(e.shape_parameters.items(), e.shape, strict=True):
            if p.held:
                held.setdefault((name, float(x)), []).append(e.label)
    return tuple(
        f"{', '.join(labels)}: these recordings do not tell {'its' if len(labels) == 1 else 'their'} {name}, which is held at "
        f"{value:g}; intervals count it as known to a factor of {np.exp(USUAL):.2g}."
        for (name, value), labels in held.items()
    )
