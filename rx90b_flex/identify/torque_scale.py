"""Torque constants of motors whose current was logged: from a payload, links or a torque sensor that is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.motion import Array
from rx90b_flex.identify.coloured import residual_spectra
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.identify.least_squares import CORRELATION_S, Identification, identify
from rx90b_flex.identify.normal_equations import NormalEquations, Solution, fit_weighted
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.torque_sensors import sensor_gain, sensors_to_use
from rx90b_flex.identify.uncertainty import absorbed_each, coloured_covariance
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign

ROUNDS = 30  # of Gauss-Newton steps
SETTLED = 1.0e-9  # relative change of the constants below which they end


@dataclass(frozen=True)
class TorqueConstant:
    """A motor's torque constant at the joint.

    Attributes
    ----------
    joint : str
    value : N m/A (N/A where the joint slides); None where nothing known fixes the scale.
    std : its standard deviation; zero for one that was stated.
    source : "stated", "torque sensor", "model" or "not determined".
    message : in a sentence.
    """

    joint: str
    value: float | None
    std: float | None
    source: str
    message: str


def resolved(campaign: Campaign, robot: Robot) -> tuple[Campaign, tuple[TorqueConstant, ...]]:
    """A campaign whose torques are in N m, and the constants that made them so.

    Constants that the campaign leaves out are identified: a joint's own torque sensor tells its constant directly; else the
    model does where something known fixes the scale (links that are known, a payload that is stated, joints whose torque is
    known). Where nothing does, the constants of the joints are right among each other at most, and said to be not determined.

    Parameters
    ----------
    campaign : Campaign
    robot : Robot
        As declared.
    """
    stated = campaign.torque_constants
    if stated is None:
        return campaign, ()
    found: dict[str, TorqueConstant] = {}
    units = dict(zip(campaign.joints, (f"{u.force}/A" for u in robot.units_of(campaign.joints)), strict=True))
    sensed = sensors_to_use(campaign)
    for joint, value in zip(campaign.joints, stated, strict=True):
        if value is not None:
            found[joint] = TorqueConstant(
                joint, value, 0.0, "stated", f"Torque constant of {joint}: {value:g} {units[joint]}, as stated."
            )
        elif joint in sensed and (told := sensor_gain(campaign.identification, joint)) is not None:
            words = (
                f"Torque constant of {joint}: {told[0]:.4g} ± {told[1]:.2g} {units[joint]}, told by its torque sensor."
            )
            found[joint] = TorqueConstant(joint, *told, "torque sensor", words)
    known = _scaled(campaign, {j: c.value for j, c in found.items() if c.source == "torque sensor" and c.value})
    scales = {j: c.value for j, c in found.items() if c.value is not None}
    missing = [j for j in campaign.joints if j not in found]
    if missing:
        for constant, scale in _from_model(known, robot, missing):
            found[constant.joint], scales[constant.joint] = constant, scale
    done = dataclasses.replace(
        _scaled(known, {j: scales[j] for j in missing}), torque_constants=tuple(scales[j] for j in campaign.joints)
    )
    return done, tuple(found[j] for j in campaign.joints)


def _scaled(campaign: Campaign, factors: dict[str, float]) -> Campaign:
    """With the torques of some joints multiplied."""
    by = np.array([factors.get(j, 1.0) for j in campaign.joints])
    runs = tuple(dataclasses.replace(r, torque=r.torque * by) for r in campaign.recordings)
    return dataclasses.replace(campaign, recordings=runs)


# ---- the model ------------------------------------------------------------------------------------------------------


def _from_model(campaign: Campaign, robot: Robot, joints: Sequence[str]) -> list[tuple[TorqueConstant, float]]:
    """Constants that make one model fit all joints, and the scales to go on with where they are not determined."""
    regression = Regression.of(robot, campaign.identification, campaign.cutoff_hz)
    model = identify(
        regression, regression.robot.effects, fit_links=robot.inertial_parameters == "fitted", with_covariance=False
    )
    places = [campaign.joints.index(j) for j in joints]
    fit = _Bilinear(regression, model, places)
    gains, solution, columns, rest = fit.solved()
    sure = solution.determined[-len(joints) :] & (np.abs(gains) > 0.0)
    std = np.sqrt(np.maximum(np.diag(fit.covariance(solution, columns, rest))[-len(joints) :], 0.0))
    out = []
    units = [f"{u.force}/A" for u in robot.units_of(joints)]
    for joint, gain, spread, known, unit in zip(joints, gains, std, sure, units, strict=True):
        value = 1.0 / gain
        if known and abs(gain) > 2.0 * spread:
            error = float(spread / gain**2)
            words = f"Torque constant of {joint}: {value:.4g} ± {error:.2g} {unit}, told by what is known of the load."
            out.append((TorqueConstant(joint, float(value), error, "model", words), float(value)))
            continue
        words = (
            f"The torque constant of {joint} is not determined: nothing known fixes the scale of its torque. A payload of known "
            "mass in one of two recordings, links that are known or a torque sensor would; masses and torques hold up to that factor."
        )
        out.append((TorqueConstant(joint, None, None, "not determined", words), float(value)))
    return out


@dataclass(frozen=True, eq=False)
class _Bilinear:
    """Currents as gains (A per N m) times the model's torque: ``i_j = g_j (known_j + X_j theta)``, linear in each of the two."""

    regression: Regression
    model: Identification
    places: Sequence[int]

    @property
    def precision(self) -> Array:
        """Inverse covariance of theta and gains before the data, shape (p + gains, p + gains)."""
        p = len(self.model.theta)
        return np.pad(self.model.precision[:p, :p], (0, len(self.places)))

    def solved(self) -> tuple[Array, Solution, Array, Array]:
        """Gains, the last linear solution, its columns and the residual."""
        logged = np.concatenate([s.torque for s in self.regression.segments])
        known = logged - self.regression.torque  # what stated payloads take
        if not self.model.links_fitted:
            known = known + self.regression.link_torque(self.model.link_parameters)
        x = self.model.columns
        gains, theta = self._start(x, logged, known)
        p = x.shape[2]
        whole = (slice(0, len(logged)),)
        for _ in range(ROUNDS):
            all_gains = np.ones(logged.shape[1])
            all_gains[list(self.places)] = gains
            torque = known + x @ theta
            columns = np.zeros((*logged.shape, p + len(self.places)))
            columns[:, :, :p] = x * all_gains[:, None]
            for k, j in enumerate(self.places):
                columns[:, j, p + k] = torque[:, j]
            at = np.concatenate([theta, gains])
            rest = logged - torque * all_gains
            normal = NormalEquations.of(columns, rest + columns @ at, whole)
            solution = fit_weighted(normal, at, precision=self.precision)
            step = solution.theta - at
            theta, gains = theta + step[:p], gains + step[p:]
            if np.abs(step[p:] / gains).max() < SETTLED:
                break
        return gains, solution, columns, rest

    def _start(self, x: Array, logged: Array, known: Array) -> tuple[Array, Array]:
        """From ``0 = known + X theta - constant * current``, linear in the constants, one of them held where nothing is known."""
        p = x.shape[2]
        columns = np.concatenate([x, np.zeros((*logged.shape, len(self.places)))], axis=2)
        target = logged - known
        for k, j in enumerate(self.places):
            columns[:, j, p + k] = -logged[:, j]
            target[:, j] = -known[:, j]
        prior = np.concatenate([np.zeros(p), np.ones(len(self.places))])
        found = fit_weighted(NormalEquations.of(columns, target, (slice(0, len(logged)),)), prior, self._sizes(logged))
        constants = np.where(np.abs(found.theta[p:]) > 1e-9, found.theta[p:], 1.0)
        return 1.0 / constants, found.theta[:p]

    def _sizes(self, logged: Array) -> Array:
        return np.maximum(np.sqrt((logged**2).mean(axis=0)), 1e-12)

    def covariance(self, solution: Solution, columns: Array, rest: Array) -> Array:
        """Of theta and gains, allowing for coloured residuals."""
        spans = self.regression.spans
        longest = int(CORRELATION_S * self.regression.segments[0].rate_hz)
        by_joint = ColumnsByJoint.of_dense(np.arange(columns.shape[2]), columns.transpose(1, 0, 2))
        absorbed = absorbed_each(by_joint, self.precision, solution.sigma**-2.0, spans, longest)
        spectra = residual_spectra(np.ascontiguousarray(rest.T), spans, absorbed, longest)
        return coloured_covariance(by_joint, self.precision, solution.sigma, spectra, spans)
