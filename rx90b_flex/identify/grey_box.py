"""Physical parameters fitted straight to frequency responses: the grey box.

The model is (3.90) at the poses that were measured, with one viscous slope a joint for its friction. It is linear in its parameters,
``Z(p) = s^2 M(p) + s D(p) + K(p)``, ``s = jw``, so that the response ``P = s^2 B^T Z^-1 B`` has the derivative
``dP/dp = -s^2 (B^T Z^-1) dZ/dp (Z^-1 B)``. All lines of a pose are worked out together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import optimize, stats

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.export import with_link_parameters
from rx90b_flex.identify.accelerometers import AccelerationResponse
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.grey_bias import GreyBias, bias_functions, bias_of
from rx90b_flex.identify.grey_model import (
    DELAY,
    DELAY_STD,
    DELAY_UNIT,
    MASS,
    SLOPE,
    Delay,
    GreyExperiments,
    GreyMotion,
    GreyParameter,
    grey_parameters,
    late,
    matrices_at,
    parameter_names,
    shares_of,
    slope_name,
)
from rx90b_flex.robot import Robot
from rx90b_flex.showing import Showing

UNDETERMINED = (
    0.5  # relative standard deviation from the data alone beyond which a direction or parameter is called undetermined
)
VAGUE = 0.1  # the same, beyond which a direction is worth naming
NAMED = 0.4  # entries of a direction that are named, over its largest
SMOOTHED = 8  # degrees of freedom that a line's covariance is given by its neighbours, per entry of the response
OWN = 3.0  # a line whose variance exceeds its neighbours' mean by this keeps its own: an interfering line
COARSE = 0.3  # part of |P| taken as an additional error where the search from many starts begins
# Of |P|, what separates the response of a moving robot from the model after all that is averaged: with viscous friction, 0.3 % at the
# drive points and up to 1.2 % elsewhere (RMS over the lines of section 6.6.2's campaign).
MODEL_ERROR = 0.005
# Of a friction slope, what separates friction with reversals from a viscous one: it locks a joint for a part of the time.
FRICTION_ERROR = 0.5
ERROR_RANGE = (1e-3, 10.0)  # over these two: smaller errors are seen by no data, larger ones by every eye
REACH_HZ = 5.0  # over which these errors stay alike
Progress = Callable[[str, float], None]
Feedback = Callable[[Array], ComplexArray]


# ---- the data ---------------------------------------------------------------------------------------------------


def smoothed_covariance(response: FrequencyResponse) -> tuple[ComplexArray, float]:
    """Covariance of a response, averaged over neighbouring lines as far as its few degrees of freedom ask for.

    A covariance of n^2 entries from a dozen realisations is nearly singular, and its inverse far too large. The distortion changes
    slowly along the lines, so that neighbours may be put together; a line whose variance sticks out keeps its own.

    Returns
    -------
    covariance : complex array, shape (F, n*n, n*n)
    degrees_of_freedom : float
        Of each, about.
    """
    covariance, own = response.covariance, response.degrees_of_freedom
    size = covariance.shape[1]
    if not np.isfinite(own) or own >= SMOOTHED * size:
        return covariance, own
    half = math.ceil((SMOOTHED * size / max(own, 1.0) - 1) / 2)
    lines = len(response.hz)
    sums = np.concatenate([np.zeros((1, size, size)), np.cumsum(covariance, axis=0)])
    low, high = np.maximum(np.arange(lines) - half, 0), np.minimum(np.arange(lines) + half + 1, lines)
    mean = (sums[high] - sums[low]) / (high - low)[:, None, None]
    excess = np.einsum("faa->fa", covariance).real / np.einsum("faa->fa", mean).real
    grow = np.sqrt(np.where(excess > OWN, excess, 1.0))
    return grow[:, :, None] * mean * grow[:, None, :], float(own * np.mean(high - low))


@dataclass(frozen=True, eq=False)
class _GreyBoxProblem:
    """Whitened residuals of all responses and their Jacobian, as functions of the logarithms x of the parameters.

    A delay, where there is one, stands last and has no part in the matrices.
    """

    parameters: tuple[GreyParameter, ...]
    responses: tuple[FrequencyResponse, ...]
    motions: tuple[GreyExperiments, ...]  # of each response
    whiteners: tuple[ComplexArray, ...]  # (F, n*n, n*n)
    free: Mask  # parameters that are fitted
    bending_alike_std: float
    bias: tuple[GreyBias, ...] = ()  # of each response; empty: the model is taken as exact
    bias_sizes: tuple[float, float] = (0.0, 0.0)  # model and friction error

    @cached_property
    def declared(self) -> Array:
        return np.array([p.begin for p in self.parameters])

    @cached_property
    def prior(self) -> Array:
        """Rows that bring what is known of ``x - declared`` to unit variance, (rows, free parameters)."""
        own = np.diag([1.0 / p.prior_std for p in self.parameters])
        names = [p.name for p in self.parameters]
        pairs = []
        for i, name in enumerate(names):
            if self.bending_alike_std > 0.0 and ".joint_" in name and name.endswith("_1"):
                row = np.zeros(len(names))
                row[i], row[names.index(name[:-1] + "2")] = 1.0 / self.bending_alike_std, -1.0 / self.bending_alike_std
                pairs.append(row)
        return np.vstack([own[self.free], *pairs])[:, self.free]

    @property
    def has_delay(self) -> bool:
        return self.parameters[-1].name == DELAY

    def predicted(self, x: Array) -> list[ComplexArray]:
        both = zip(self.responses, self.motions, strict=True)
        return [motion.response(r.hz, np.exp(x)) * self._late(r.hz, x) for r, motion in both]

    def _late(self, hz: Array, x: Array) -> ComplexArray:
        """What torques that were logged late multiply a response over them by, (F, 1, 1)."""
        return late(hz, DELAY_UNIT * float(x[-1]) if self.has_delay else 0.0)

    def errors(self, x: Array) -> list[ComplexArray]:
        """Whitened errors of each response, line by line, (F * n*n,): unit variance where the model is exact."""
        return [
            np.einsum("fab,fb->fa", w, (r.value - model).reshape(len(r.hz), -1)).ravel()
            for w, r, model in zip(self.whiteners, self.responses, self.predicted(x), strict=True)
        ]

    def slopes(self, x: Array) -> list[ComplexArray]:
        """Derivatives of `errors` by x, (F * n*n, p)."""
        out = []
        for w, r, by_x in zip(self.whiteners, self.responses, self.derivatives(x), strict=True):
            lines = by_x.reshape(len(by_x), len(r.hz), -1)
            out.append(-(w @ np.moveaxis(lines, 0, -1)).reshape(-1, len(x)))
        return out

    def derivatives(self, x: Array) -> list[ComplexArray]:
        """Derivatives of each response by x, (p, F, joints, joints)."""
        p, out = np.exp(x), []
        for r, motion in zip(self.responses, self.motions, strict=True):
            by_x = motion.derivatives(r.hz, p) * p[:, None, None, None]
            if self.has_delay:
                by_x[-1] = 2j * np.pi * DELAY_UNIT * r.hz[:, None, None] * motion.response(r.hz, p)
            out.append(by_x * self._late(r.hz, x))
        return out

    def whitened(self, errors: list[ComplexArray]) -> list[ComplexArray]:
        """Errors or slopes with the bias, too, brought to unit variance."""
        return [bias.white(e) for bias, e in zip(self.bias, errors, strict=True)] if self.bias else errors

    def with_bias(self, x: Array, sizes: tuple[float | None, float | None]) -> _GreyBoxProblem:
        """The same problem with the bias that a response near x may have; sizes that are None are estimated there.

        The estimate is the restricted likelihood's: of the sizes given what the parameters cannot explain.
        """
        functions = [
            bias_functions(
                w, r.hz, model, np.array([by_x[own].sum(axis=0) for own in self.slopes_of(r.joints)]), REACH_HZ
            )
            for w, r, model, by_x in zip(
                self.whiteners, self.responses, self.predicted(x), self.derivatives(x), strict=True
            )
        ]
        found = _bias_sizes(self, x, functions, sizes)
        bias = tuple(bias_of(*pair, found) for pair in functions)
        return dataclasses.replace(self, bias=bias, bias_sizes=found)

    def slopes_of(self, joints: Sequence[str]) -> list[Mask]:
        """Which parameters are friction slopes of each joint, one an experiment."""
        return [np.array([p.name.startswith(f"{joint}.{SLOPE}") for p in self.parameters]) for joint in joints]

    # real residuals of unit variance, with the prior's

    def residual(self, free: Array) -> Array:
        x = self.full(free)
        errors = self.whitened(self.errors(x))
        data = [np.sqrt(2.0) * part for e in errors for part in (e.real, e.imag)]
        return np.concatenate([*data, self.prior @ (x - self.declared)[self.free]])

    def jacobian(self, free: Array) -> Array:
        slopes = self.whitened([d[:, self.free] for d in self.slopes(self.full(free))])
        data = [np.sqrt(2.0) * part for d in slopes for part in (d.real, d.imag)]
        return np.concatenate([*data, self.prior])

    def full(self, free: Array) -> Array:
        x = self.declared.copy()
        x[self.free] = free
        return x

    def coarser(self, part: float, step: int) -> _GreyBoxProblem:
        """Every `step`-th line, with `part` of |P| as an additional error: wide valleys, and cheap."""
        responses, motions = [], []
        for r, motion in zip(self.responses, self.motions, strict=True):
            keep = slice(step // 2 if len(r.hz) > step else 0, None, step)
            extra = (part * np.abs(r.value[keep]).reshape(len(r.hz[keep]), -1)) ** 2
            covariance, _ = smoothed_covariance(r)
            diagonal = np.einsum("faa->fa", covariance[keep]).real + extra
            full = diagonal[:, :, None] * np.eye(diagonal.shape[1])
            responses.append(dataclasses.replace(
                r, hz=r.hz[keep], value=r.value[keep], covariance=full, noise_covariance=None, degrees_of_freedom=np.inf
            ))  # fmt: skip
            motions.append(motion.coarser(keep))
        whiteners = tuple(_whitener(r.covariance, r) for r in responses)
        return dataclasses.replace(
            self, responses=tuple(responses), motions=tuple(motions), whiteners=whiteners, bias=()
        )

    def minimum(self, start: Array, evaluations: int) -> Array:
        found = optimize.least_squares(
            self.residual, start[self.free], self.jacobian, method="lm", max_nfev=evaluations, xtol=1e-9, ftol=1e-10
        )
        return self.full(found.x)

    def cost(self, x: Array) -> float:
        return float((self.residual(x[self.free]) ** 2).sum())


def _whitener(covariance: ComplexArray, response: FrequencyResponse) -> ComplexArray:
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
    except np.linalg.LinAlgError:
        positive = np.linalg.eigvalsh(covariance).min(axis=1) > 0
        where = f"{response.hz[np.argmin(positive)]:.2f} Hz"
        raise ValueError(
            f"the covariance of the frequency response is not positive definite at {where}; expected more realisations "
            "than its entries, or lines whose neighbours have them"
        ) from None


def _bias_sizes(
    problem: _GreyBoxProblem,
    x: Array,
    functions: list[tuple[ComplexArray, ComplexArray]],
    given: tuple[float | None, float | None],
) -> tuple[float, float]:
    """Model and friction error, those not given of the highest restricted likelihood with the model linear about x."""
    model, friction = given
    if model is not None and friction is not None:
        return model, friction
    free = problem.free
    rows = [np.column_stack([d[:, free], e]) for d, e in zip(problem.slopes(x), problem.errors(x), strict=True)]
    products = []  # of functions with themselves, and with slopes and errors, once for all sizes
    for pair, row in zip(functions, rows, strict=True):
        f = np.concatenate(pair, axis=1)
        products.append((f.conj().T @ f, f.conj().T @ row, len(pair[0].T)))
    plain = sum(((row.conj().T @ row).real for row in rows), np.zeros((free.sum() + 1,) * 2))
    begin, reach = np.log([MODEL_ERROR, FRICTION_ERROR]), np.log(ERROR_RANGE)
    fixed = np.array([value is not None for value in given])

    def sizes(logarithms: Array) -> tuple[float, float]:
        own = iter(np.exp(begin[~fixed] + np.clip(logarithms, *reach)).tolist())
        both = [next(own) if value is None else value for value in given]
        return both[0], both[1]

    def deviance(logarithms: Array) -> float:
        moments, volume = 2.0 * plain, 0.0
        pair = sizes(logarithms)
        for gram, with_rows, number in products:
            scale = np.where(np.arange(len(gram)) < number, *pair)
            inner = np.linalg.cholesky(np.eye(len(gram)) + scale[:, None] * gram * scale)
            seen = np.linalg.solve(inner, scale[:, None] * with_rows)
            moments = moments - 2.0 * (seen.conj().T @ seen).real
            volume += 4.0 * float(np.log(np.diag(inner).real).sum())
        information = moments[:-1, :-1] + problem.prior.T @ problem.prior
        slope = moments[:-1, -1] + problem.prior.T @ problem.prior @ (x - problem.declared)[free]
        rest = moments[-1, -1] - slope @ np.linalg.solve(information, slope)
        return float(volume + np.linalg.slogdet(information)[1] + rest)

    count = int((~fixed).sum())
    found = optimize.minimize(
        deviance, np.zeros(count), method="Nelder-Mead",
        options={"xatol": 0.05, "fatol": 0.1, "initial_simplex": np.vstack([np.zeros(count), -1.5 * np.eye(count)])},
    )  # fmt: skip
    return sizes(found.x)


# ---- what comes out -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class GreyEstimate:
    """One parameter as it was found.

    Attributes
    ----------
    name, unit : str
    value, std : float
    low, high : float
        95 % interval, from the logarithm.
    start : float
        The robot's declared value.
    determined : bool
        Whether the data alone say it, to better than `UNDETERMINED`.
    """

    name: str
    unit: str
    value: float
    std: float
    low: float
    high: float
    start: float
    determined: bool


@dataclass(frozen=True)
class Direction:
    """Parameters that can change together almost unseen.

    Attributes
    ----------
    relative_std : float
        Of the combination, from the data alone.
    parts : tuple of (GreyParameter name, float)
        Share of each named parameter, largest first; their signs tell which go up where others go down.
    """

    relative_std: float
    parts: tuple[tuple[str, float], ...]

    @property
    def words(self) -> str:
        """In a sentence."""
        named = [f"{name.replace('.', ' ').replace('_', ' ')}" for name, _ in self.parts]
        signs = ["up" if share * self.parts[0][1] > 0 else "down" for _, share in self.parts]
        if len(named) == 1:
            return f"{named[0]} alone: {100 * self.relative_std:.0f} %"
        together = ", ".join(f"{n} {s}" for n, s in zip(named, signs, strict=True))
        return f"together: {together}: {100 * self.relative_std:.0f} %"


@dataclass(frozen=True)
class Start:
    """One start of the search: where from, and the cost at which it ended."""

    name: str
    coarse_cost: float
    cost: float | None  # None: not among the best, not followed to its end


@dataclass(frozen=True, eq=False, repr=False)
class GreyBox(Showing):
    """A robot's physical parameters from its frequency responses.

    Attributes
    ----------
    estimates : tuple of GreyEstimate
    covariance : array, shape (p, p)
        Of the logarithms; noise, distortion and the stated model errors are in it, and a cost beyond what these explain.
    information : array, shape (p, p)
        Of the data alone, of the logarithms, as if the model were right.
    directions : tuple of Direction
        Vaguest first.
    robot : Robot
        With the drives, flexibilities and (where fitted) links found; its friction is as declared.
    responses, predicted : the data, and the model's responses at its lines; those of accelerometers follow those of the drives.
    errors : tuple of complex array, shape (F * n*n,)
        Whitened residuals, unit variance where noise, distortion and the stated model error are all that there is.
    cost, expected_cost : float
        Sum of squared whitened residuals, and what it would be without bias.
    cost_limit : float
        95 % of right models stay below.
    starts : tuple of Start
    model_error, friction_error : float
        Given or estimated: what bias the intervals allow for, of |P| and of the friction slopes.
    torque_delay : Delay or None
        By which the torques were logged late against the angles; None where it was taken as none.
    """

    estimates: tuple[GreyEstimate, ...]
    covariance: Array
    information: Array
    directions: tuple[Direction, ...]
    robot: Robot
    responses: tuple[FrequencyResponse, ...]
    predicted: tuple[ComplexArray, ...]
    errors: tuple[ComplexArray, ...]
    cost: float
    expected_cost: float
    cost_limit: float
    starts: tuple[Start, ...]
    model_error: float
    friction_error: float
    torque_delay: Delay | None = None

    def __getitem__(self, name: str) -> GreyEstimate:
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise ValueError(f"no parameter {name!r}; {close_match(name, [e.name for e in self.estimates])}")

    def as_wide_as(self, other: GreyBox) -> GreyBox:
        """The same values with the relative standard deviations and the covariance of another fit of these parameters.

        For one that allows for errors which this one's residual does not show: its intervals count them, its values give away to
        them what the data tell.
        """
        pairs = [(e, other[e.name], e.value / other[e.name].value) for e in self.estimates]
        estimates = [dataclasses.replace(e, std=w.std * x, low=w.low * x, high=w.high * x) for e, w, x in pairs]
        return dataclasses.replace(
            self,
            estimates=tuple(estimates),
            covariance=other.covariance,
            directions=other.directions,
            model_error=other.model_error,
            friction_error=other.friction_error,
        )

    def doubted(self, shifts: Mapping[str, float]) -> GreyBox:
        """The same with a bias of the logarithms, by parameter, as one more error that all of them share."""
        shift = np.array([shifts.get(e.name, 0.0) for e in self.estimates])
        reach = float(stats.norm.ppf(0.975))
        estimates = []
        for e, own in zip(self.estimates, shift.tolist(), strict=True):
            std = math.hypot(e.std / e.value, own)
            low, high = (e.value * math.exp(sign * reach * std) for sign in (-1.0, 1.0))
            estimates.append(dataclasses.replace(e, std=e.value * std, low=low, high=high))
        free = shift[[e.std > 0.0 for e in self.estimates]]  # of fixed ones there is no covariance
        return dataclasses.replace(self, estimates=tuple(estimates), covariance=self.covariance + np.outer(free, free))

    @property
    def bias_detected(self) -> bool:
        """Whether the residual is larger than noise and distortion explain."""
        return self.cost > self.cost_limit

    @property
    def ended_alike(self) -> tuple[int, int]:
        """How many of the starts that were followed to their end found the best minimum, and how many there were."""
        costs = np.array([s.cost for s in self.starts if s.cost is not None])
        return int((costs < costs.min() + 1.0).sum()), len(costs)


def grey_box(
    robot: Robot,
    responses: FrequencyResponse | Sequence[FrequencyResponse],
    *,
    band_hz: tuple[float, float] = (8.0, 80.0),
    start: Mapping[str, float] | None = None,
    starts: int = 16,
    spread: float = 0.4,
    seed: int = 0,
    link_mass_std: float = 0.0,
    bending_alike_std: float = 0.0,
    fixed: Sequence[str] = (),
    along: Sequence[Array] | None = None,
    feedback: Feedback | None = None,
    torques: Sequence[ComplexArray] | None = None,
    model_error: float | None = MODEL_ERROR,
    friction_error: float | None = FRICTION_ERROR,
    accelerations: Sequence[AccelerationResponse] | None = None,
    delay_std: float = DELAY_STD,
    progress: Progress | None = None,
) -> GreyBox:
    """Fit drive and joint stiffness, damping, drive inertia and friction slope to frequency responses, by maximum likelihood.

    The errors are circular complex normal with the responses' own covariance. Parameters are fitted as logarithms, from several
    starts: first on a third of the lines with 30 % of additional error, which smooths the likelihood's narrow valleys, then the best
    on all lines.

    Parameters
    ----------
    robot : Robot
        With links, springs and the effects whose values are asked for; declared values are one of the starts.
    responses : FrequencyResponse or sequence of them
        At one or several poses; each knows its pose.
    band_hz : (low, high)
        Lines used.
    start : mapping of parameter names to values, optional
        Another start, for example drive stiffness and inertia from poles and zeros: ``{"joint_1.drive_stiffness": 1.5e5}``.
    starts, spread, seed : int, float, int
        Further starts, and the standard deviation of their logarithms about the declared values.
    link_mass_std : float
        Relative standard deviation to which the links' masses are known; then one factor a link is fitted too. 0: known exactly.
    bending_alike_std : float
        Relative standard deviation to which a joint is known to be equally stiff (and damped) about both its bending axes, up to
        their declared ratio: bearings are round. One pose may not tell joints apart that bend about the same axis. 0: not known.
    fixed : names of parameters that keep their declared values.
    along : sequence of array, shape (S, joints of the robot), rad, optional
        Of each response, poses that the motion passes (`poses_along`), alike in time: the model is averaged over them. Otherwise
        the pose alone.
    feedback : callable, optional
        Feedback torque against drive acceleration, (F, joints, joints), as a function of frequencies in Hz.
        With it the average over the poses is that of a closed loop.
    torques : sequence of complex array, shape (F, joints, experiments), optional
        Of each response, the torques of its experiments at one phase realisation. Friction with reversals is steeper where a joint
        vibrates less, and so differs between experiments; with their torques each has its own slopes (``joint_3.friction_slope_2``).
    model_error, friction_error : float or None
        Bias that is left, as random functions of frequency that stay alike over `REACH_HZ`: of each entry, over its magnitude, and of
        each friction slope in each column, over the slope. It weighs the lines and widens the intervals. 0: the model is exact. None:
        estimated from what the fit cannot explain, by restricted maximum likelihood. That sees no bias which parameters can take
        up: with dry friction its intervals are too short, and those of the stated default are not.
    accelerations : sequence of AccelerationResponse, optional
        Of each response, what accelerometers on links showed at the same lines; fitted together with it, their errors independent
        of those of the drives and of each other.
    delay_std : float
        Standard deviation, s, to which torques are known to be logged at the instants of angles: by that much they may be late, or
        early, and how much is estimated (`GreyBox.torque_delay`). 0: logged together.
    progress : callable, optional

    Raises
    ------
    ValueError
        A response without pose or of unknown joints, a parameter without value or unknown, a singular covariance.
    """
    given = (responses,) if isinstance(responses, FrequencyResponse) else tuple(responses)
    tell = progress or (lambda text, part: None)
    problem = _problem(
        robot,
        given,
        band_hz,
        link_mass_std,
        fixed,
        along,
        feedback,
        torques,
        bending_alike_std,
        accelerations,
        delay_std,
    )
    first = problem.declared.copy()
    names = [p.name for p in problem.parameters if p.name != DELAY]
    begin = [("declared values", first)]
    if start:
        other = first.copy()
        for name, value in start.items():
            if name not in names:
                raise ValueError(f"start: no parameter {name!r}; {close_match(name, names)}")
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"start: {name} is {value:g}; expected a positive value")
            other[names.index(name)] = np.log(value)
        begin.insert(0, ("given start", other))
    rng = np.random.default_rng(seed)
    centre = begin[0][1]
    begin += [(f"drawn {k + 1}", centre + _drawn(problem, spread, rng)) for k in range(starts)]
    problem, best, ends = _search(problem, begin, (model_error, friction_error), tell)
    tell("information", 0.95)
    return _result(robot, problem, best, ends)


def _kept(
    robot: Robot,
    given: tuple[FrequencyResponse, ...],
    band_hz: tuple[float, float],
    along: Sequence[Array] | None,
) -> tuple[FrequencyResponse, ...]:
    """The responses within the band; a clear word where they do not go together."""
    if not given:
        raise ValueError("no frequency response to fit to")
    if along is not None and len(along) != len(given):
        raise ValueError(f"along has {len(along)} motions; expected {len(given)}, one a response")
    joints = given[0].joints
    for response in given:
        unknown = [j for j in response.joints if j not in robot.joints]
        if unknown:
            raise ValueError(f"the response is of joint {unknown[0]!r}; {close_match(unknown[0], robot.joints)}")
        if response.joints != joints:
            raise ValueError(f"responses of joints {joints} and {response.joints}; expected the same joints")
        if np.shape(response.pose) != (len(robot.joints),):
            raise ValueError(
                f"the response's pose has shape {np.shape(response.pose)}; expected {len(robot.joints)} angles of {robot.name}"
            )
    kept = tuple(r.band(*band_hz) for r in given)
    for r, k in zip(given, kept, strict=True):
        if len(k.hz) < 2:
            raise ValueError(
                f"{len(k.hz)} lines between {band_hz[0]:g} and {band_hz[1]:g} Hz (the response has {len(r.hz)}); expected 2 or more"
            )
    return kept


def _problem(
    robot: Robot,
    given: tuple[FrequencyResponse, ...],
    band_hz: tuple[float, float],
    link_mass_std: float,
    fixed: Sequence[str],
    along: Sequence[Array] | None,
    feedback: Feedback | None,
    torques: Sequence[ComplexArray] | None,
    bending_alike_std: float,
    accelerations: Sequence[AccelerationResponse] | None = None,
    delay_std: float = DELAY_STD,
) -> _GreyBoxProblem:
    kept, joints = _kept(robot, given, band_hz, along), given[0].joints
    used = _torques(given, torques, band_hz)
    experiments = 1 if used[0] is None else used[0].shape[2]
    parameters = tuple(grey_parameters(robot, joints, experiments, link_mass_std))
    names = [p.name for p in parameters]
    for name in fixed:
        if name not in names:
            raise ValueError(f"fixed: no parameter {name!r}; {close_match(name, names)}")
    if delay_std > 0.0:
        parameters += (GreyParameter(DELAY, "s", 0.0, delay_std / DELAY_UNIT),)
    passed = along if along is not None else [np.atleast_2d(r.pose) for r in kept]
    if accelerations is not None and len(accelerations) != len(given):
        raise ValueError(
            f"accelerations has {len(accelerations)} responses; expected {len(given)}, one a response of the drives"
        )
    beside = () if accelerations is None else tuple(x.band(*band_hz) for x in accelerations)
    for r, other in zip(kept, beside, strict=False):
        if other.joints != joints or not np.array_equal(other.hz, r.hz):
            raise ValueError("accelerations are of other joints or lines than the drives' response")
    motions, shown = [], []
    for place, (r, path, torque) in enumerate(zip(kept, passed, used, strict=True)):
        back = None if feedback is None else feedback(r.hz)
        sensors = beside[place].sensors if beside else ()
        each = []
        for number in range(experiments):
            slopes = {joint: slope_name(joint, number, experiments) for joint in joints}
            poses = tuple(matrices_at(robot, slopes, np.asarray(q, dtype=float), parameters, sensors) for q in path)
            each.append(GreyMotion(poses, back))
        shares = shares_of(torque, len(joints))
        motions.append(GreyExperiments(tuple(each), shares))
        if sensors:
            shown.append(GreyExperiments(tuple(dataclasses.replace(m, sensors=True) for m in each), shares))
    motions += shown
    kept += tuple(other for other in beside if other.sensors)
    whiteners = tuple(_whitener(smoothed_covariance(r)[0], r) for r in kept)
    return _GreyBoxProblem(
        parameters,
        kept,
        tuple(motions),
        whiteners,
        np.array([p.name not in fixed for p in parameters]),
        bending_alike_std,
    )


def _torques(
    given: tuple[FrequencyResponse, ...], torques: Sequence[ComplexArray] | None, band_hz: tuple[float, float]
) -> list[ComplexArray | None]:
    if torques is None:
        return [None] * len(given)
    if len(torques) != len(given):
        raise ValueError(f"torques has {len(torques)} arrays; expected {len(given)}, one a response")
    out: list[ComplexArray | None] = []
    for r, torque in zip(given, torques, strict=True):
        shape = np.shape(torque)
        if (
            len(shape) != 3
            or shape[:2] != r.value.shape[:2]
            or shape[2] != np.shape(torques[0])[2]
            or shape[2] < shape[1]
        ):
            raise ValueError(
                f"torques has shape {shape}; expected {r.value.shape[:2]} and at least as many experiments as joints"
            )
        out.append(np.asarray(torque)[(r.hz >= band_hz[0]) & (r.hz <= band_hz[1])])
    return out


def _drawn(problem: _GreyBoxProblem, spread: float, rng: np.random.Generator) -> Array:
    """A random step of the logarithms, no larger than priors allow."""
    return np.asarray(
        rng.standard_normal(len(problem.declared)) * np.minimum(spread, [p.prior_std for p in problem.parameters])
    )


FOLLOWED = 4  # best starts that are followed to their end
SAME = 1e-3  # of the logarithms: starts that are so near each other after the coarse fits are followed once


def _search(
    problem: _GreyBoxProblem, begin: list[tuple[str, Array]], sizes: tuple[float | None, float | None], tell: Progress
) -> tuple[_GreyBoxProblem, Array, tuple[Start, ...]]:
    coarse, middle = problem.coarser(COARSE, 3), problem.coarser(0.1 * COARSE, 3)
    found = []
    for k, (name, x) in enumerate(begin):
        tell(f"start {k + 1} of {len(begin)}", 0.7 * k / len(begin))
        x = middle.minimum(coarse.minimum(x, 30), 20)
        found.append((middle.cost(x), name, x))
    order = sorted(range(len(found)), key=lambda k: found[k][0])
    problem = problem.with_bias(found[order[0]][2], sizes)
    if None in sizes:  # once more where the fit ends
        problem = problem.with_bias(problem.minimum(found[order[0]][2], 60), sizes)
    ends: dict[int, tuple[float, Array]] = {}
    for k in order[:FOLLOWED]:
        same = [other for other in ends if np.abs(found[k][2] - found[other][2]).max() < SAME]
        if same:
            ends[k] = ends[same[0]]
            continue
        tell(f"fit from {found[k][1]}", 0.7 + 0.2 * len(ends) / FOLLOWED)
        x = problem.minimum(found[k][2], 60)
        ends[k] = (problem.cost(x), x)
    best = min(ends, key=lambda k: ends[k][0])
    starts = tuple(Start(name, cost, ends[k][0] if k in ends else None) for k, (cost, name, _) in enumerate(found))
    return problem, ends[best][1], starts


def _result(robot: Robot, problem: _GreyBoxProblem, x: Array, starts: tuple[Start, ...]) -> GreyBox:
    free = np.flatnonzero(problem.free)
    errors = problem.whitened(problem.errors(x))
    slopes = problem.whitened([d[:, free] for d in problem.slopes(x)])
    information = sum((2.0 * (d.conj().T @ d).real for d in slopes), np.zeros((len(free),) * 2))
    cost = float(sum((np.abs(e) ** 2).sum() for e in errors))
    expected, spread = _expected_cost(problem, len(free))
    # covariances from few realisations are too small or too large by a common factor; a cost beyond it is unknown bias
    information /= max(cost / expected, 1.0)
    covariance: Array = np.asarray(np.linalg.inv(information + problem.prior.T @ problem.prior))
    predicted = tuple(problem.predicted(x))
    delay, parameters = None, problem.parameters
    if problem.has_delay:
        delay = Delay(DELAY_UNIT * float(x[-1]), DELAY_UNIT * math.sqrt(covariance[-1, -1]))
        # of the others, whatever the delay is
        across = information[:-1, -1]
        information = information[:-1, :-1] - np.outer(across, across) / (
            information[-1, -1] + (problem.prior[:, -1] ** 2).sum()
        )
        covariance, x, free, parameters = covariance[:-1, :-1], x[:-1], free[:-1], parameters[:-1]
    values, std, alone = np.exp(x), np.zeros(len(x)), np.zeros(len(x))
    std[free], alone[free] = np.sqrt(np.diag(covariance)), _std_without_prior(information)
    reach = float(stats.norm.ppf(0.975))
    estimates = tuple(
        GreyEstimate(
            p.name,
            p.unit,
            v,
            v * s,
            v * math.exp(-reach * s),
            v * math.exp(reach * s),
            p.declared,
            bool(a < UNDETERMINED),
        )
        for p, v, s, a in zip(parameters, values.tolist(), std.tolist(), alone.tolist(), strict=True)
    )
    names = [parameters[i].name for i in free]
    return GreyBox(
        estimates, covariance, information, _directions(information, names), _fitted_robot(robot, parameters, values),
        problem.responses, predicted, tuple(errors), cost, expected, expected + 1.645 * spread, starts,
        *problem.bias_sizes, delay,
    )  # fmt: skip


def _std_without_prior(information: Array) -> Array:
    values, vectors = np.linalg.eigh(information)
    return np.asarray(np.sqrt((vectors**2 / np.maximum(values, 1e-12 * values[-1])).sum(axis=1)))


def _directions(information: Array, names: Sequence[str]) -> tuple[Direction, ...]:
    values, vectors = np.linalg.eigh(information)
    out = []
    for value, vector in zip(values, vectors.T, strict=True):
        std = float(1.0 / np.sqrt(max(value, 1e-12 * values[-1])))
        if std < VAGUE:
            break
        order = np.argsort(-np.abs(vector))
        kept = [i for i in order if abs(vector[i]) >= NAMED * abs(vector[order[0]])]
        sign = np.sign(vector[order[0]])
        out.append(Direction(std, tuple((names[i], float(sign * vector[i])) for i in kept)))
    return tuple(out)


def _expected_cost(problem: _GreyBoxProblem, fitted: int) -> tuple[float, float]:
    """Mean and standard deviation of the cost of a right model; covariances from few realisations make it larger."""
    mean, variance = 0.0, 0.0
    for r in problem.responses:
        size, lines = r.value[0].size, len(r.hz)
        _, freedom = smoothed_covariance(r)
        larger = 1.0 if not np.isfinite(freedom) else freedom / max(freedom - size, 1.0)
        mean += larger * size * lines
        # neighbours share a smoothed covariance, so its error does not average out over them
        shared = (
            0.0
            if not np.isfinite(freedom)
            else (larger * size * lines) ** 2 / (freedom * lines / max(freedom / r.degrees_of_freedom, 1.0) * size)
        )
        variance += larger**2 * size * lines + shared
    return mean - 0.5 * fitted, math.sqrt(variance)


def _fitted_robot(robot: Robot, parameters: Sequence[GreyParameter], values: Array) -> Robot:
    found = {p.name: float(v) for p, v in zip(parameters, values, strict=True)}
    effects = [
        e.with_coefficients([found[name] for name in parameter_names(e)]) if e.part in ("drives", "flexibility") else e
        for e in robot.effects
    ]
    factors = np.array([found.get(f"{link}.{MASS}", 1.0) for link, _ in robot.bodies])
    if (factors != 1.0).any():
        robot = with_link_parameters(robot, np.repeat(factors, 10) * robot.link_parameters, allow_inconsistent=True)
    return robot.with_effects(effects)
