"""Linear least squares of all parameters of the flexible model, with every coordinate measured (section 4.2).

The equations of motion are linear in the parameters, ``y = A p + rho`` (4.2): one equation a coordinate and sample, on
the left the drive torque in a drive's row and zero in a hinge's. A's columns are divided by a first guess of the
parameters, its rows multiplied by weights, and the singular value decomposition ``A = U S V'`` (4.4) is cut off where
what is left is noise. The first columns V1 of V span the essential parameter space: of two parameter vectors only the
projections ``V1 V1' p`` (4.8) can be compared.

All that is measured passes the same linear-phase low-passes on its way into A and into y, so that they drop out; only
what they do to products of fast signals stays. Eighth-order differences at 250 Hz are far off at 110 Hz (2.8 rad a
sample). But the log holds nothing above its Nyquist frequency, so it is interpolated to a multiple of its rate,
differentiated there, and the finished equations are brought back.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.export import with_parameters
from rx90b_flex.identify.coloured import parzen
from rx90b_flex.identify.least_squares import Estimate
from rx90b_flex.identify.physical import ConsistentParameters, consistent_parameters
from rx90b_flex.robot import Robot
from rx90b_flex.signals.filters import differentiate, resample

if TYPE_CHECKING:
    from rx90b_flex.simulate import CS8, Simulation

LOG_RATE_HZ = 250.0  # section 4.2.2
UPSAMPLING = 8  # of the log, before differences; friction that turns within a millisecond asks for it, not they
PASSED = 0.8  # part of the Nyquist frequency up to which `resample` is flat
EDGE_S = 0.3  # left out at both ends of a log, where the filters continue it
CORRELATION_S = 0.25  # longest correlation of the residuals that covariances allow for
HUBER = 1.345  # standard deviations; beyond them a residual counts linearly (95 % as efficient as least squares on normal noise)
ROUNDING = 1e-9  # singular values below this part of the largest are exact dependences
OWN_SHARE = 0.999  # a parameter whose unit vector lies in the essential space to this part is told by itself


# ---- what is measured -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FullLog:
    """Every coordinate and the drive torques, sampled together.

    Attributes
    ----------
    rate_hz : float
    q : array, shape (N, n), rad
    torque : array, shape (N, joints), N m
    """

    rate_hz: float
    q: Array
    torque: Array

    def __post_init__(self) -> None:
        if self.q.ndim != 2 or self.torque.ndim != 2 or len(self.q) != len(self.torque):
            raise ValueError(f"q has shape {self.q.shape} and torque {self.torque.shape}; expected (N, n), (N, joints)")

    def downsampled(self, rate_hz: float = LOG_RATE_HZ) -> FullLog:
        """The same at another rate, everything through one anti-alias filter (stops at the new Nyquist frequency)."""
        q, torque = (resample(x, self.rate_hz, rate_hz) for x in (self.q, self.torque))
        return FullLog(rate_hz, q, torque)

    def part(self, start_s: float, end_s: float) -> FullLog:
        """The samples from start to end, of which there must be some."""
        rows = slice(round(start_s * self.rate_hz), round(end_s * self.rate_hz))
        return dataclasses.replace(self, q=self.q[rows], torque=self.torque[rows])

    def with_noise(self, q: float | Array, torque: float | Array, rng: np.random.Generator) -> FullLog:
        """White noise of these standard deviations (one, or one a column) added to every sample."""
        noisy = (x + s * rng.standard_normal(x.shape) for x, s in ((self.q, q), (self.torque, torque)))
        return FullLog(self.rate_hz, *noisy)


def logs_everything(controller: CS8) -> CS8:
    """The controller with a log at its own rate, for `full_log`."""
    return dataclasses.replace(controller, log_rate_hz=controller.controller_rate_hz)


def full_log(simulation: Simulation) -> FullLog:
    """What an ideal camera and the controller would log of a simulation, at the controller's rate.

    Drive angles and torques as the controller sees them (resolution of resolver and current, noise), hinges exactly.

    Parameters
    ----------
    simulation : Simulation
        Made with ``raw=True`` by the controller of `logs_everything`.
    """
    raw = simulation.raw
    if raw is None or len(raw.position) != len(simulation.q):
        raise ValueError("the simulation has no log at the controller's rate: use logs_everything(...) and raw=True")
    drives = np.argmax(simulation.robot.input_matrix, axis=0)
    q = simulation.q.copy()
    q[:, drives] = raw.position
    return FullLog(raw.rate_hz, q, raw.torque)


# ---- equations --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of motion of every coordinate over time, linear in the parameters (equations 4.1 and 4.2).

    Attributes
    ----------
    robot : Robot
    columns : array, shape (N, n, p)
        Of `robot.parameter_names`.
    force : array, shape (N, n), N m
        Drive torque in the drives' rows, zero in the hinges'.
    rate_hz : float
    spans : tuple of slice
        Samples of each log.
    """

    robot: Robot
    columns: Array
    force: Array
    rate_hz: float
    spans: tuple[slice, ...]

    @staticmethod
    def of(robot: Robot, logs: Sequence[FullLog], upsampling: int = UPSAMPLING, edge_s: float = EDGE_S) -> Equations:
        """Differentiate logs of one rate (central differences of eighth order) and put up the equations.

        Their rate is `PASSED` times the logs', whose low-pass is flat up to its Nyquist frequency: in the flank of a filter, what a
        moving robot makes of a signal and what the filter does to it do not commute.

        Parameters
        ----------
        robot : Robot
            Shape parameters of its effects are used as they are.
        logs : sequence of FullLog
            Already without anything above their Nyquist frequency (`FullLog.downsampled`).
        upsampling : int
            Rate of differences and products over the logs'; 1 differentiates the log itself, as the source does.
        edge_s : float
            Left out at both ends of each log.

        Raises
        ------
        ValueError
            Logs of another robot or of different rates, or too short.
        """
        n, joints = robot.model.nv, len(robot.joints)
        rate = logs[0].rate_hz * (PASSED if upsampling > 1 else 1.0) if logs else 0.0
        if not logs or any(log.rate_hz != logs[0].rate_hz for log in logs):
            raise ValueError(f"{len(logs)} logs of {[log.rate_hz for log in logs]} Hz; expected one rate")
        parts, forces = [], []
        for log in logs:
            if log.q.shape[1] != n or log.torque.shape[1] != joints:
                raise ValueError(
                    f"a log holds {log.q.shape[1]} coordinates and {log.torque.shape[1]} torques; "
                    f"expected {n} and {joints} for {robot.name}"
                )
            columns, force = _equations(robot, log, upsampling)
            edge = round(edge_s * rate)
            if len(force) <= 2 * edge + 8:
                raise ValueError(f"a log of {len(log.q)} samples is too short: {edge_s:g} s at either end are left out")
            kept = slice(edge, len(force) - edge)
            parts.append(columns[kept])
            forces.append(force[kept])
        ends = np.cumsum([0, *(len(f) for f in forces)])
        spans = tuple(slice(int(a), int(b)) for a, b in pairwise(ends))
        return Equations(robot, np.concatenate(parts), np.concatenate(forces), rate, spans)

    def residual(self, parameters: Array) -> Array:
        """What a parameter vector leaves over, shape (N, n), N m."""
        return self.force - self.columns @ parameters


def _equations(robot: Robot, log: FullLog, upsampling: int) -> tuple[Array, Array]:
    """Columns (N, n, p) and forces (N, n) of one log, at the equations' rate."""
    rate = upsampling * log.rate_hz
    q = resample(log.q, log.rate_hz, rate)
    torque = resample(log.torque, log.rate_hz, rate)
    columns = robot.regressor(q, differentiate(q, rate), differentiate(q, rate, derivative=2))
    force = torque @ robot.input_matrix.T
    if upsampling == 1:
        return columns, force
    flat = columns.reshape(len(q), -1)
    used = np.flatnonzero(flat.any(axis=0))
    wanted = PASSED * log.rate_hz
    brought = resample(flat[:, used], rate, wanted)
    out = np.zeros((len(brought), flat.shape[1]))
    out[:, used] = brought
    return out.reshape(-1, *columns.shape[1:]), resample(force, rate, wanted)


# ---- fit --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CoordinatesFit:
    """Essential parameters by truncated singular value decomposition.

    Attributes
    ----------
    equations : Equations
    start : array, shape (p,)
        First guess; columns are scaled by it, and it stays where the data says nothing.
    weights : array, shape (N, n)
        That the equations were multiplied by.
    scale : array, shape (p,)
        Parameter = scale * scaled parameter.
    singular_values : array, shape (p,), descending
    directions : array, shape (p, p)
        V, right singular vectors as columns, in scaled parameters.
    gain : array, shape (p, p)
        U'A V: S, unless U belongs to instruments.
    contributions : array, shape (p,)
        U'y: what each direction explains of the weighted forces.
    noise : array, shape (p, p)
        Covariance of the contributions through the residuals' noise, which may be coloured.
    unexplained : float
        Norm of the weighted residual with all directions.
    dimension : int
        Of the essential space: number of directions kept.
    parameters : array, shape (p,)
        ``p_E`` of (4.7) in the essential space, `start` in the rest.
    covariance : array, shape (p, p)
        Of the essential part of `parameters`.
    """

    equations: Equations
    start: Array
    weights: Array
    scale: Array
    singular_values: Array
    directions: Array
    gain: Array
    contributions: Array
    noise: Array
    unexplained: float
    dimension: int
    parameters: Array
    covariance: Array

    @cached_property
    def residual_norms(self) -> Array:
        """Norm of the weighted residual with 0 to p directions, shape (p + 1,): figure 4.4, solid line.

        Exact without instruments.
        """
        left = np.r_[np.cumsum(self.contributions[::-1] ** 2)[::-1], 0.0]
        return np.sqrt(self.unexplained**2 + left)

    @cached_property
    def noise_norm(self) -> float:
        """Norm of the noise, estimated: what the residual of the true parameters would have (figure 4.4, dashed line).

        The residual of all directions and what the directions took up of the noise.
        """
        return float(np.sqrt(self.unexplained**2 + np.trace(self.noise)))

    def norm_of(self, parameters: Array) -> float:
        """Norm of the weighted residual of a parameter vector."""
        return float(np.linalg.norm(self.weights * self.equations.residual(parameters)))

    def essential(self, parameters: Array) -> Array:
        """Projection of a parameter vector on the essential space, shape (p,) (equation 4.8)."""
        kept = self.directions[:, : self.dimension]
        return np.asarray(self.scale * (kept @ (kept.T @ (parameters / self.scale))))

    def errors_by_dimension(self, true: Array) -> Array:
        """Largest difference from true parameters in the essential space of 1 to p directions, shape (p,): figure 4.5.

        Over the scale of each parameter, so that units do not matter. Without instruments only.
        """
        error = self.contributions / np.maximum(self.singular_values, ROUNDING * self.singular_values[0])
        error -= self.directions.T @ (true / self.scale)
        return np.abs(np.cumsum(self.directions * error, axis=1)).max(axis=0)

    @property
    def std(self) -> Array:
        """Standard deviations of the essential part of the parameters, shape (p,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def determined(self) -> Mask:
        """Whether each parameter is told by itself, not only in combination with others, shape (p,)."""
        share = (self.directions[:, : self.dimension] ** 2).sum(axis=1)
        return np.asarray(share > OWN_SHARE)

    def estimates(self) -> tuple[Estimate, ...]:
        """Every parameter with its standard deviation; None where the data does not tell it by itself."""
        out = []
        for entry, value, std, told in zip(
            self.equations.robot.parameter_entries, self.parameters, self.std, self.determined, strict=True
        ):
            known = float(value) if told else None
            out.append(Estimate(entry.name, known, float(std) if told else None, entry.unit))
        return tuple(out)

    @cached_property
    def information(self) -> Array:
        """Of the data on all parameters, shape (p, p): the inverse of a covariance, were none cut off.

        The directions beyond the essential space count here too: what moves far along them leaves more than noise.
        """
        told = self.directions[:, : self.rank] / self.scale[:, None]
        gain, noise = self.gain[: self.rank, : self.rank], self.noise[: self.rank, : self.rank]
        return np.asarray(told @ gain.T @ np.linalg.solve(noise, gain) @ told.T)

    @property
    def rank(self) -> int:
        """Number of directions that are no exact dependences."""
        return _rank(self.singular_values)

    @property
    def robot(self) -> Robot:
        """The robot with the estimated parameters, whether or not its links could exist."""
        return with_parameters(self.equations.robot, self.parameters, allow_inconsistent=True)

    def consistent(self, pull: float = 1e-2) -> tuple[Robot, ConsistentParameters]:
        """The robot with links that can exist and effects within their bounds, pulled to `start`; all moved together.

        The second result tells how far the parameters went for it: its `p_value` is below 0.05 where they left their
        confidence region of 95 %, so that no body that can exist agrees with the data.
        """
        robot = self.equations.robot
        bounds = [[p.lower for p in e.coefficient_parameters.values()] for e in robot.effects]
        lower = np.array([bounds[e.source][e.column] for e in robot.parameter_entries if e.source >= 0])
        found = consistent_parameters(self.parameters, self.information, self.start, lower=lower, pull=pull)
        return with_parameters(robot, found.parameters), found


def least_squares(
    equations: Equations,
    start: Array,
    *,
    weights: Array | None = None,
    dimension: int | None = None,
    instruments: Equations | None = None,
) -> CoordinatesFit:
    """Weighted linear least squares on the essential parameter space.

    Parameters
    ----------
    equations : Equations
    start : array, shape (p,)
        First guess of the parameters, such as CAD values. A parameter guessed zero is scaled by its column.
    weights : array, shape (n,) or (N, n), optional
        One over the standard deviation of each equation (W_L of section 4.2.1); ones where not given.
    dimension : int, optional
        Of the essential space. By default the smallest with which the residual is no larger than the estimated noise: the
        source's rule (its figure 4.4), which takes the noise from the true parameters. Where the columns are noisy they
        explain noise too, and this is too large: give instruments from a simulation, or the dimension.
    instruments : Equations, optional
        The same equations from signals whose noise is independent of that in `equations`: another period of the same
        experiment (`other_periods`), or a simulation of it with parameters that are roughly right, such as the guess. Their
        columns Z span the space that the residual is made orthogonal to, ``U_Z' (y - A p) = 0``; least squares on noisy
        columns is biased, this is not (to first order in the noise).

    Raises
    ------
    ValueError
        Shapes that do not fit, a guess that is no number, or a dimension out of range.
    """
    start = np.asarray(start, dtype=float)
    p = equations.columns.shape[2]
    if start.shape != (p,) or not np.isfinite(start).all():
        raise ValueError(f"start has shape {start.shape}; expected {p} finite numbers")
    if instruments is not None and instruments.columns.shape != equations.columns.shape:
        raise ValueError(f"instruments have columns {instruments.columns.shape}; expected {equations.columns.shape}")
    if dimension is not None and not 1 <= dimension <= p:
        raise ValueError(f"dimension is {dimension}; expected 1 to {p}")
    w = np.broadcast_to(1.0 if weights is None else np.asarray(weights, dtype=float), equations.force.shape)
    scale = _scale(start, equations)
    y = (w * equations.force).ravel()
    a = (w[:, :, None] * equations.columns).reshape(-1, p) * scale
    z = a if instruments is None else (w[:, :, None] * instruments.columns).reshape(-1, p) * scale
    u, s, vt = np.linalg.svd(z, full_matrices=False)
    v, rank = vt.T, _rank(s)
    u[:, rank:] = 0.0  # what rounding has left of exact dependences is no direction of the data
    contributions = u.T @ y
    mixed = np.diag(s) if instruments is None else u.T @ a @ v  # U_Z' A V
    full = v[:, :rank] @ np.linalg.lstsq(mixed[:rank, :rank], contributions[:rank], rcond=None)[0]
    residual = (y - a @ full).reshape(equations.force.shape)
    noise = _noise(u, residual, equations)
    unexplained = float(np.linalg.norm(residual))
    left = np.r_[np.cumsum(contributions[::-1] ** 2)[::-1], 0.0]
    if dimension is None:
        dimension = max(1, int(np.argmax(left <= np.trace(noise))))
    kept, dropped = v[:, :dimension], v[:, dimension:]
    outside = dropped @ (dropped.T @ (start / scale))
    # for plain least squares U1' A V2 = 0, and what lies outside plays no part
    right = contributions[:dimension] - (0.0 if instruments is None else u[:, :dimension].T @ (a @ outside))
    inverse = np.linalg.inv(mixed[:dimension, :dimension])
    inside = kept @ (inverse @ right)
    reduced = inverse @ noise[:dimension, :dimension] @ inverse.T
    covariance = scale[:, None] * (kept @ reduced @ kept.T) * scale
    return CoordinatesFit(
        equations, start, w, scale, s, v, mixed, contributions, noise, unexplained, dimension, scale * (inside + outside), covariance
    )  # fmt: skip


def _rank(singular_values: Array) -> int:
    return int((singular_values > ROUNDING * singular_values[0]).sum())


def _scale(start: Array, equations: Equations) -> Array:
    length = np.linalg.norm(equations.columns, axis=(0, 1))
    typical = np.linalg.norm(equations.force) / np.where(length > 0, length, np.inf)
    found = np.where(start != 0, np.abs(start), typical)
    return np.where(found > 0, found, 1.0)


def _noise(u: Array, residual: Array, equations: Equations) -> Array:
    """Covariance of u' times the noise behind a weighted residual, shape (p, p).

    From the products of u and residual summed over the coordinates of a sample, with Parzen's window over `CORRELATION_S`
    (W. K. Newey, K. D. West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
    matrix", Econometrica 55, 1987): friction at a reversal errs in the drive's row and in the torsion's at once, and only there.
    What lies off the diagonal is shrunk by the part of it that such a sum makes up from few degrees of freedom.
    """
    scores = np.einsum("tj,tjp->tp", residual, u.reshape(*residual.shape, -1))
    out = np.zeros((scores.shape[1],) * 2)
    longest, freedom = round(CORRELATION_S * equations.rate_hz), 0.0
    for span in equations.spans:
        part = scores[span]
        lags = max(2, min(longest, len(part) // 6))
        freedom += 3.7 * len(part) / lags
        size = fft.next_fast_len(len(part) + lags, real=True)
        window = np.zeros(size)
        window[:lags] = parzen(lags)
        window[size - lags + 1 :] = window[lags - 1 : 0 : -1]
        spectra = fft.fft(part, size, axis=0)
        # the window's transform is not negative, so neither is the sum
        out += ((spectra.conj() * np.maximum(fft.fft(window).real, 0.0)[:, None]).T @ spectra).real / size
    shrunk = max(0.0, 1.0 - scores.shape[1] / freedom)
    return np.asarray(shrunk * out + (1.0 - shrunk) * np.diag(np.diag(out)))


def reweighted(
    equations: Equations,
    start: Array,
    *,
    rounds: int = 8,
    dimension: int | None = None,
    instruments: Equations | None = None,
) -> CoordinatesFit:
    """Iteratively re-weighted least squares: each equation by its own residual, outliers by Huber's weights.

    The rows of a joint's drive carry the current's noise and their friction's reversals, those of a bending hinge next
    to nothing: each gets the inverse of its residual's robust standard deviation, found anew from each fit. Samples beyond
    `HUBER` of them (friction that turns within a sample) count linearly.

    Parameters
    ----------
    equations, start, dimension, instruments : as `least_squares`
    rounds : int
        At the most; it ends when no parameter moves by a hundredth of its standard deviation.
    """
    fit = least_squares(equations, start, dimension=dimension, instruments=instruments)
    for _ in range(rounds):
        residual = equations.residual(fit.parameters)
        sigma = np.median(np.abs(residual), axis=0) / 0.6745
        sigma = np.maximum(sigma, 1e-9 * np.abs(equations.columns @ fit.parameters).max())
        relative = np.abs(residual) / sigma
        weights = np.sqrt(np.minimum(1.0, HUBER / np.maximum(relative, 1e-300))) / sigma
        before, fit = (
            fit,
            least_squares(equations, start, weights=weights, dimension=dimension, instruments=instruments),
        )
        moved = np.abs(fit.parameters - before.parameters)
        if fit.dimension == before.dimension and (moved <= 0.01 * fit.std).all():
            break
    return fit


def indirect_inference(
    robot: Robot,
    logs: Sequence[FullLog],
    estimate: Callable[[Sequence[FullLog]], CoordinatesFit],
    repeat: Callable[[Robot], Sequence[FullLog]],
    *,
    rounds: int = 2,
) -> CoordinatesFit:
    """An estimate without the bias that its own way of getting there has: what logs and filters do to sharp friction.

    The experiment is repeated in simulation on the identified robot and identified in the same way. What comes back differs from what
    went in by the bias, ``p <- p + (p_measured - p_simulated)``; at the end the simulated logs give the same estimate as
    the measured ones (Gouriéroux, Monfort and Renault 1993, indirect inference). What the logs hardly tell no repetition betters:
    of section 4.2.2's one run the asperity torques of joints 3 and 4, whose standard deviations are 0.5 to 17 %.

    Parameters
    ----------
    robot : Robot
    logs : sequence of FullLog
    estimate : callable
        From logs to a `Fit`.
    repeat : callable
        From a robot to the logs of the same experiment, without noise.
    rounds : int
        Each takes out all but what the bias changes over its own size.

    Returns
    -------
    Fit
        That of `logs` with other `parameters`; its covariance still is that of the estimate before.
    """
    if rounds < 0:
        raise ValueError(f"rounds is {rounds}; expected 0 or more")
    fit = estimate(logs)
    parameters = fit.parameters
    for _ in range(rounds):
        again = estimate(repeat(with_parameters(robot, parameters, allow_inconsistent=True)))
        parameters = parameters + fit.parameters - again.parameters
    return dataclasses.replace(fit, parameters=parameters)


def other_periods(equations: Equations) -> Equations:
    """Instruments from an experiment that was run several times: each log's equations replaced by the next one's.

    Each log must hold the same samples of the same motion; what differs between them is noise.
    """
    lengths = {s.stop - s.start for s in equations.spans}
    if len(equations.spans) < 2 or len(lengths) > 1:
        raise ValueError(
            f"{len(equations.spans)} logs of {sorted(lengths)} samples; expected two or more of one length"
        )
    turned = [*equations.spans[1:], equations.spans[0]]
    columns, force = (np.concatenate([x[s] for s in turned]) for x in (equations.columns, equations.force))
    return dataclasses.replace(equations, columns=columns, force=force)
