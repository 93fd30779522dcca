"""Torque constants of motors whose current was logged: from a payload, links or a torque sensor that is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.identify.bilinear import CurrentProducts, gains_and_coefficients
from rx90b_flex.identify.coloured import residual_spectra
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.identify.least_squares import CORRELATION_S, Identification, identify
from rx90b_flex.identify.normal_equations import NormalEquations, Solution, fit_weighted
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.torque_sensors import sensor_gain, sensors_to_use
from rx90b_flex.identify.uncertainty import absorbed_each, coloured_covariance
from rx90b_flex.robot import Robot
from rx90b_flex.signals import Campaign

TOLD = 0.5  # standard deviation of a constant, part of it, up to which it is told
ACROSS = 1e-3  # part of a direction that the data do not determine, up to which a ratio of constants is across it
ROUNDS = 4  # fits of shapes to torques by the constants that the fit before told
SETTLED = 0.1  # of its standard deviation, by which no constant changes in the last of them
OTHERWISE = 0.5  # of its standard deviation, by which another model's constant is another one
FAR = 100.0  # times the median of a first guess: constants of one robot are not that far apart


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
    relative_to : joint to whose constant that of this one has a `ratio`, where that is all that is told.
    ratio, ratio_std : with its standard deviation.
    """

    joint: str
    value: float | None
    std: float | None
    source: str
    message: str
    relative_to: str | None = None
    ratio: float | None = None
    ratio_std: float | None = None


def resolved(campaign: Campaign, robot: Robot) -> tuple[Campaign, tuple[TorqueConstant, ...]]:
    """A campaign whose torques are in N m, and the constants that made them so.

    Constants that the campaign leaves out are identified: a joint's own torque sensor tells its constant directly; else the
    model does where something known fixes the scale (links that are known, a payload that is stated, joints whose torque is
    known). Where nothing does, they are said to be not determined; their ratios follow from links that several joints move, and
    with these ratios about a mean of 1 the torques go on.

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
    known = scaled(campaign, {j: c.value for j, c in found.items() if c.source == "torque sensor" and c.value})
    scales = {j: c.value for j, c in found.items() if c.value is not None}
    missing = [j for j in campaign.joints if j not in found]
    if missing:
        for constant, scale in _from_model(known, robot, missing):
            found[constant.joint], scales[constant.joint] = constant, scale
    done = dataclasses.replace(
        scaled(known, {j: scales[j] for j in missing}), torque_constants=tuple(scales[j] for j in campaign.joints)
    )
    return done, tuple(found[j] for j in campaign.joints)


def of_model(constants: Sequence[TorqueConstant]) -> frozenset[str]:
    """Joints whose constants are neither stated nor told by a torque sensor: as good as the model that told them."""
    return frozenset(c.joint for c in constants if c.source in ("model", "not determined"))


def told_otherwise(constants: Sequence[TorqueConstant], other: Sequence[TorqueConstant]) -> bool:
    """Whether another model tells constants, or ratios of such as are not determined, that are not those by which torques went."""
    for before, now in zip(constants, other, strict=True):
        for old, new, std in ((before.value, now.value, now.std), (before.ratio, now.ratio, now.ratio_std)):
            if (old is None) is not (new is None):
                return True
            if old is not None and new is not None and abs(new - old) > OTHERWISE * (std or 0.0):
                return True
    return False


def of_open_size(campaign: Campaign, constants: Sequence[TorqueConstant]) -> Campaign:
    """What `resolved` gives, with those constants left out that nothing fixed: the size of such torques says nothing of the data."""
    if campaign.torque_constants is None:
        return campaign
    told = {c.joint for c in constants if c.value is not None}
    stated = zip(campaign.joints, campaign.torque_constants, strict=True)
    return dataclasses.replace(campaign, torque_constants=tuple(x if j in told else None for j, x in stated))


def scaled(campaign: Campaign, factors: dict[str, float]) -> Campaign:
    """With the torques of some joints multiplied."""
    by = np.array([factors.get(j, 1.0) for j in campaign.joints])
    runs = tuple(dataclasses.replace(r, torque=r.torque * by) for r in campaign.recordings)
    return dataclasses.replace(campaign, recordings=runs)


# ---- the model ------------------------------------------------------------------------------------------------------


def _from_model(campaign: Campaign, robot: Robot, joints: Sequence[str]) -> list[tuple[TorqueConstant, float]]:
    """Constants that make one model fit all joints, and the scales to go on with where they are not determined."""
    fit, together, scales = _told(campaign, robot, joints)
    units = [f"{u.force}/A" for u in robot.units_of(joints)]
    sure = fit.sure
    out = []
    for k, (joint, unit) in enumerate(zip(joints, units, strict=True)):
        value = float(1.0 / fit.gains[k])
        if sure[k]:
            error = float(fit.std[k] / fit.gains[k] ** 2)
            words = f"Torque constant of {joint}: {value:.4g} ± {error:.2g} {unit}, told by what is known of the load."
            out.append((TorqueConstant(joint, value, error, "model", words), scales[k]))
            continue
        words = (
            f"The torque constant of {joint} is not determined: nothing known fixes the scale of its torque. A payload of known "
            "mass in one of two recordings, links that are known or a torque sensor would; masses and torques hold up to that factor."
        )
        open_one = TorqueConstant(joint, None, None, "not determined", words)
        if together.told[k]:
            ratio = float(fit.gains[together.reference] / fit.gains[k])
            spread = abs(ratio) * float(together.spread[k])
            other = joints[together.reference]
            words += f" It is {ratio:.3g} ± {spread:.1g} times that of {other}, as the links ask for that both move."
            open_one = TorqueConstant(joint, None, None, "not determined", words, other, ratio, spread)
        out.append((open_one, scales[k]))
    return out


def _told(campaign: Campaign, robot: Robot, joints: Sequence[str]) -> tuple[_Gains, _Together, list[float]]:
    """Gains of joints, what of the rest they tell together, and constants to go on with.

    Shapes, such as the speed at which friction turns over, are those of a model that was fitted to torques by the constants of the
    round before; of the first round these are in amperes, beside a payload in N m. What such shapes are off, the constants are, too.
    """
    regression = Regression.of(robot, campaign.identification, campaign.cutoff_hz)
    places, fit_links = [campaign.joints.index(j) for j in joints], robot.inertial_parameters == "fitted"
    scales = [1.0] * len(joints)
    for _ in range(ROUNDS):
        before, factors = np.array(scales), np.ones(len(campaign.joints))
        factors[places] = before
        seen = regression.with_torques_times(factors)
        model = identify(seen, seen.robot.effects, fit_links=fit_links, with_covariance=False)
        fit = _Bilinear(seen, model, places).solved().of_torques_times(before)
        together = _Together.of(fit, ~fit.sure)
        scales = _scales(fit, together)
        spread = np.where(fit.sure, fit.std / np.abs(fit.gains), np.where(together.told, together.spread, np.inf))
        if (np.abs(np.array(scales) / before - 1.0) <= SETTLED * spread).all():
            break
    return fit, together, scales


def _scales(fit: _Gains, together: _Together) -> list[float]:
    """Constants to go on with: of what nothing tells the mean of what is told, of ratios alone about that mean."""
    values, sure, ratios = 1.0 / fit.gains, fit.sure, together.told.copy()
    typical = float(np.exp(np.log(np.abs(values[sure])).mean())) if sure.any() else 1.0
    out = np.where(sure, values, typical)
    if ratios.any():
        ratios[together.reference] = True
        out[ratios] = typical * values[ratios] / np.exp(np.log(np.abs(values[ratios])).mean())
    return [float(x) for x in out]


@dataclass(frozen=True, eq=False)
class _Gains:
    """Gains of the joints whose constants are left out, with their covariance (g, g) and what the data do not determine.

    `null` has directions of the logarithms of the gains, (g, m): differences that are across them are determined.
    """

    gains: Array
    covariance: Array
    determined: Mask
    null: Array

    def of_torques_times(self, factors: Array) -> _Gains:
        """Those of the torques before these were multiplied by factors (g,)."""
        covariance = self.covariance / np.outer(factors, factors)
        return dataclasses.replace(self, gains=self.gains / factors, covariance=covariance)

    @property
    def std(self) -> Array:
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def sure(self) -> Mask:
        """Whether each is told by itself, at twice its standard deviation."""
        return np.asarray(self.determined & (np.abs(self.gains) * TOLD > self.std))


@dataclass(frozen=True, eq=False)
class _Together:
    """Constants that links which several joints move tell relative to one of them.

    Attributes
    ----------
    reference : int
    told : array of bool, shape (g,)
        All but the reference.
    spread : array, shape (g,)
        Standard deviation of the logarithm of each one over the reference's.
    """

    reference: int
    told: Mask
    spread: Array

    @staticmethod
    def of(fit: _Gains, some: Mask) -> _Together:
        """By the reference that tells most of them, and of equally many best."""
        n = len(fit.gains)
        relative = fit.covariance / np.outer(fit.gains, fit.gains)
        own = np.diag(relative)
        found = []
        for k in np.flatnonzero(some).tolist():
            spread = np.sqrt(np.maximum(own + own[k] - 2.0 * relative[k], 0.0))
            apart = np.eye(n) - np.eye(n)[k]
            told = some & (spread < TOLD) & (np.linalg.norm(apart @ fit.null, axis=1) < ACROSS)
            told[k] = False
            found.append(_Together(k, told, spread))
        nothing = _Together(0, np.zeros(n, dtype=bool), np.zeros(n))
        return min(found, key=lambda t: (-t.told.sum(), float(t.spread[t.told].sum())), default=nothing)


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

    def solved(self) -> _Gains:
        """Gains and coefficients that leave the smallest errors of the currents."""
        logged = np.concatenate([s.torque for s in self.regression.segments])
        known = logged - self.regression.torque  # what stated payloads take
        if not self.model.links_fitted:
            known = known + self.regression.link_torque(self.model.link_parameters)
        x = self.model.columns
        p = x.shape[2]
        products = CurrentProducts.of(x, known, logged, self.precision[:p, :p])
        all_gains, theta, _ = gains_and_coefficients(products, self._starts(x, logged, known), self.places)
        gains = all_gains[list(self.places)]
        torque = known + x @ theta
        columns = np.zeros((*logged.shape, p + len(self.places)))
        columns[:, :, :p] = x * all_gains[:, None]
        for k, j in enumerate(self.places):
            columns[:, j, p + k] = torque[:, j]
        at, rest = np.concatenate([theta, gains]), logged - torque * all_gains
        normal = NormalEquations.of(columns, rest + columns @ at, (slice(0, len(logged)),))
        solution = fit_weighted(normal, at, precision=self.precision)
        covariance = self._covariance(solution, columns, rest)[p:, p:]
        null = (solution.null / solution.scale[:, None])[p:] / gains[:, None]
        length = np.linalg.norm(null, axis=0)
        null = null[:, length > 0.0] / length[length > 0.0]
        return _Gains(gains, covariance, solution.determined[p:], null)

    def _starts(self, x: Array, logged: Array, known: Array) -> list[Array]:
        """All one; and where something is known what fits best in torques: of its size, and of its sign, too."""
        ones = np.ones(logged.shape[1])
        if not known.any() and len(self.places) == len(ones):
            return [ones]
        at = list(self.places)
        linear = self._linear(x, logged, known)
        size = np.median(np.abs(linear))
        sane = np.where(np.abs(np.log(np.abs(linear) / size)) < np.log(FAR), linear, size)
        starts = [ones]
        for constants in (np.abs(sane), sane):
            start = ones.copy()
            start[at] = 1.0 / constants
            starts.append(start)
        return starts

    def _linear(self, x: Array, logged: Array, known: Array) -> Array:
        """Constants from ``0 = known + X theta - constant * current``, linear in them."""
        p = x.shape[2]
        columns = np.concatenate([x, np.zeros((*logged.shape, len(self.places)))], axis=2)
        target = logged - known
        for k, j in enumerate(self.places):
            columns[:, j, p + k] = -logged[:, j]
            target[:, j] = -known[:, j]
        prior = np.concatenate([np.zeros(p), np.ones(len(self.places))])
        found = fit_weighted(NormalEquations.of(columns, target, (slice(0, len(logged)),)), prior, self._sizes(logged))
        return np.where(np.abs(found.theta[p:]) > 1e-9, found.theta[p:], 1.0)

    def _sizes(self, logged: Array) -> Array:
        return np.maximum(np.sqrt((logged**2).mean(axis=0)), 1e-12)

    def _covariance(self, solution: Solution, columns: Array, rest: Array) -> Array:
        """Of theta and gains, allowing for coloured residuals."""
        spans = self.regression.spans
        longest = int(CORRELATION_S * self.regression.segments[0].rate_hz)
        by_joint = ColumnsByJoint.of_dense(np.arange(columns.shape[2]), columns.transpose(1, 0, 2))
        absorbed = absorbed_each(by_joint, self.precision, solution.sigma**-2.0, spans, longest)
        spectra = residual_spectra(np.ascontiguousarray(rest.T), spans, absorbed, longest)
        return coloured_covariance(by_joint, self.precision, solution.sigma, spectra, spans)
