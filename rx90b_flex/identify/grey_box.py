"""Physical parameters fitted straight to frequency responses: the grey box.

The model is (3.90) at the poses that were measured, with one viscous slope a joint for its friction. It is linear in its parameters,
``Z(p) = s^2 M(p) + s D(p) + K(p)``, ``s = jw``, so that the response ``P = s^2 B^T Z^-1 B`` has the derivative
``dP/dp = -s^2 (B^T Z^-1) dZ/dp (Z^-1 B)``. All lines of a pose are worked out together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array
from rx90b_flex.export import with_link_parameters
from rx90b_flex.hinge_places import with_hinges_moved
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.grey_data import GreyBoxOptions, PoseResponse, smoothed_covariance
from rx90b_flex.identify.grey_model import AXES, DELAY, HINGE, MASS, Delay, GreyParameter, HingePlace, parameter_names
from rx90b_flex.identify.grey_problem import COARSE, GreyProblem, grey_problem
from rx90b_flex.robot import Robot
from rx90b_flex.showing import Showing

# Relative standard deviation from the data alone beyond which a direction or parameter is called undetermined.
UNDETERMINED = 0.5
VAGUE = 0.1  # the same, beyond which a direction is worth naming
SPREAD = 0.4  # standard deviation of drawn starts, of the logarithms
NAMED = 0.4  # entries of a direction that are named, over its largest
Progress = Callable[[str, float], None]


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
    hinges : tuple of HingePlace
        Of those whose place was not taken as known.
    options : GreyBoxOptions
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
    torque_delay: Delay | None
    hinges: tuple[HingePlace, ...]
    options: GreyBoxOptions

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
            hinges=tuple(dataclasses.replace(h, std=w.std) for h, w in zip(self.hinges, other.hinges, strict=True)),
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

    def undetermined(self, names: Collection[str]) -> GreyBox:
        """The same with some parameters that the data are not trusted to tell."""
        estimates = (dataclasses.replace(e, determined=e.determined and e.name not in names) for e in self.estimates)
        return dataclasses.replace(self, estimates=tuple(estimates))

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
    measured: FrequencyResponse | Sequence[FrequencyResponse | PoseResponse],
    options: GreyBoxOptions | None = None,
    *,
    start: Mapping[str, float] | None = None,
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
    measured : FrequencyResponse, or sequence of them or of PoseResponse
        At one or several poses; each knows its pose.
    options : GreyBoxOptions, optional
    start : mapping of parameter names to values, optional
        Another start, for example drive stiffness and inertia from poles and zeros: ``{"joint_1.drive_stiffness": 1.5e5}``.
    progress : callable, optional

    Raises
    ------
    ValueError
        A response without pose or of unknown joints, a parameter without value or unknown, a singular covariance.
    """
    options, tell = options or GreyBoxOptions(), progress or (lambda text, part: None)
    given = (measured,) if isinstance(measured, FrequencyResponse) else measured
    poses = [m if isinstance(m, PoseResponse) else PoseResponse(m) for m in given]
    problem = grey_problem(robot, poses, options)
    problem, best, ends = _search(problem, _starts(problem, options, start or {}), options, tell)
    if any(HINGE in p.name for p in problem.parameters):
        problem, best = _about_hinges_found(robot, poses, options, problem, best)
    tell("information", 0.95)
    return _result(robot, problem, best, ends, options)


def _about_hinges_found(
    robot: Robot, poses: Sequence[PoseResponse], options: GreyBoxOptions, problem: GreyProblem, x: Array
) -> tuple[GreyProblem, Array]:
    """The problem and its minimum once more, linear in the hinges' places about those that were found."""
    found = {h.joint: np.array(h.offset) for h in _places(problem, x, np.eye(len(x)))[1]}
    again = grey_problem(with_hinges_moved(robot, found), poses, options, found)
    start = np.where([HINGE in p.name for p in problem.parameters], 0.0, x)
    again = again.with_bias(start, problem.bias_sizes)
    return again, again.minimum(start, 60)


def _starts(problem: GreyProblem, options: GreyBoxOptions, start: Mapping[str, float]) -> list[tuple[str, Array]]:
    """Where fits begin, by name: a start that is given, the declared values, and drawn ones about the first of these."""
    names = [p.name for p in problem.parameters if not p.scale]
    begin = [("declared values", problem.declared)]
    if start:
        other = problem.declared.copy()
        for name, value in start.items():
            if name not in names:
                raise ValueError(f"start: no parameter {name!r}; {close_match(name, names)}")
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"start: {name} is {value:g}; expected a positive value")
            other[names.index(name)] = np.log(value)
        begin.insert(0, ("given start", other))
    rng = np.random.default_rng(options.seed)
    centre = begin[0][1]
    reach = np.minimum(SPREAD, [p.prior_std for p in problem.parameters])  # no larger than priors allow
    drawn = rng.standard_normal((options.starts, len(centre))) * reach
    return begin + [(f"drawn {k + 1}", centre + step) for k, step in enumerate(drawn)]


FOLLOWED = 4  # best starts that are followed to their end
SAME = 1e-3  # of the logarithms: starts that are so near each other after the coarse fits are followed once


def _search(
    problem: GreyProblem, begin: list[tuple[str, Array]], options: GreyBoxOptions, tell: Progress
) -> tuple[GreyProblem, Array, tuple[Start, ...]]:
    sizes = options.model_error, options.friction_error
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
    starts = tuple(Start(name, ends[k][0] if k in ends else None) for k, (_, name, _) in enumerate(found))
    return problem, ends[best][1], starts


def _result(
    robot: Robot, problem: GreyProblem, x: Array, starts: tuple[Start, ...], options: GreyBoxOptions
) -> GreyBox:
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
    delay, hinges = _places(problem, x, covariance)
    # of the others, whatever these are
    plain = np.flatnonzero(problem.scale == 0.0)
    own, other = (np.flatnonzero(among) for among in (problem.scale[free] == 0.0, problem.scale[free] > 0.0))
    across, known = information[np.ix_(own, other)], (problem.prior.T @ problem.prior)[np.ix_(other, other)]
    information = information[np.ix_(own, own)] - across @ np.linalg.solve(
        information[np.ix_(other, other)] + known, across.T
    )
    covariance, x, free = covariance[np.ix_(own, own)], x[plain], free[own]
    parameters = [problem.parameters[i] for i in plain]
    values, std, alone = np.exp(x), np.zeros(len(x)), np.zeros(len(x))
    std[free], alone[free] = np.sqrt(np.diag(covariance)), _std_without_prior(information)
    reach = float(stats.norm.ppf(0.975))
    low, high = values * np.exp(-reach * std), values * np.exp(reach * std)
    numbers = (x.tolist() for x in (values, values * std, low, high, alone))
    estimates = tuple(
        GreyEstimate(p.name, p.unit, v, s, below, above, p.declared, bool(vague < UNDETERMINED))
        for p, v, s, below, above, vague in zip(parameters, *numbers, strict=True)
    )
    names = [parameters[i].name for i in free]
    return GreyBox(
        estimates, covariance, information, _directions(information, names),
        _fitted_robot(robot, parameters, values, hinges),
        tuple(t.response for t in problem.terms), predicted, tuple(errors), cost, expected, expected + 1.645 * spread, starts,
        *problem.bias_sizes, delay, hinges, options,
    )  # fmt: skip


def _places(problem: GreyProblem, x: Array, covariance: Array) -> tuple[Delay | None, tuple[HingePlace, ...]]:
    """What is fitted beside logarithms, all of it free."""
    fitted = np.flatnonzero(problem.free)
    found = {
        p.name: (p.scale * float(x[i]) - p.declared, p.scale * math.sqrt(covariance[k, k]), p.scale * p.prior_std)
        for k, (i, p) in enumerate((i, problem.parameters[i]) for i in fitted)
        if p.scale
    }
    delay = Delay(*found[DELAY][:2]) if DELAY in found else None
    hinges = []
    for joint in dict.fromkeys(name.split(f".{HINGE}_")[0] for name in found if name != DELAY):
        value, std, declared = zip(*(found[f"{joint}.{HINGE}_{axis}"] for axis in AXES), strict=True)
        hinges.append(HingePlace(joint, value, std, declared[0]))
    return delay, tuple(hinges)


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


def _expected_cost(problem: GreyProblem, fitted: int) -> tuple[float, float]:
    """Mean and standard deviation of the cost of a right model; covariances from few realisations make it larger."""
    mean, variance = 0.0, 0.0
    for r in (t.response for t in problem.terms):
        size, lines, (_, freedom) = r.value[0].size, len(r.hz), smoothed_covariance(r)
        larger = freedom / max(freedom - size, 1.0) if np.isfinite(freedom) else 1.0
        mean += larger * size * lines
        variance += larger**2 * size * lines
        if np.isfinite(freedom):
            # neighbours share a smoothed covariance, so its error does not average out over them
            alone = freedom * lines / max(freedom / r.degrees_of_freedom, 1.0) * size
            variance += (larger * size * lines) ** 2 / alone
    return mean - 0.5 * fitted, math.sqrt(variance)


def _fitted_robot(
    robot: Robot, parameters: Sequence[GreyParameter], values: Array, hinges: Sequence[HingePlace]
) -> Robot:
    found = {p.name: float(v) for p, v in zip(parameters, values, strict=True)}
    effects = [
        e.with_coefficients([found[name] for name in parameter_names(e)]) if e.traits.in_drivetrain else e
        for e in robot.effects
    ]
    if hinges:
        robot = with_hinges_moved(robot, {h.joint: np.array(h.offset) for h in hinges})
    factors = np.array([found.get(f"{link}.{MASS}", 1.0) for link, _ in robot.bodies])
    if (factors != 1.0).any():
        robot = with_link_parameters(robot, np.repeat(factors, 10) * robot.link_parameters, allow_inconsistent=True)
    return robot.with_effects(effects)
