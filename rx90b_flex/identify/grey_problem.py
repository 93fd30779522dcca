"""The grey box's least squares: whitened errors of all responses, what is known beforehand, and the bias that the model may have."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import optimize

from rx90b_flex.effects import close_match
from rx90b_flex.effects.motion import Array, Mask
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.grey_bias import GreyBias, bias_functions, bias_of
from rx90b_flex.identify.grey_data import (
    FRICTION_ERROR,
    MODEL_ERROR,
    REACH_HZ,
    GreyBoxOptions,
    PoseResponse,
    smoothed_covariance,
)
from rx90b_flex.identify.grey_model import (
    DELAY,
    DELAY_UNIT,
    SLOPE,
    GreyExperiments,
    GreyMotion,
    GreyParameter,
    grey_parameters,
    hinge_parameters,
    late,
    matrices_at,
    moved_hinges,
    shares_of,
    slope_name,
)
from rx90b_flex.robot import Robot

COARSE = 0.3  # part of |P| taken as an additional error where the search from many starts begins
ERROR_RANGE = (1e-3, 10.0)  # over the stated model and friction error: less is seen by no data, more by every eye


@dataclass(frozen=True, eq=False)
class GreyTerm:
    """One response beside its model: of the drives, or of accelerometers on links."""

    response: FrequencyResponse
    model: GreyExperiments
    whitener: ComplexArray  # (F, n*n, n*n)
    bias: GreyBias | None = None  # None: the model is taken as exact

    @classmethod
    def of(
        cls, response: FrequencyResponse, model: GreyExperiments, covariance: ComplexArray | None = None
    ) -> GreyTerm:
        """With the response's own covariance, smoothed, where no other is given."""
        return cls(
            response, model, _whitener(smoothed_covariance(response)[0] if covariance is None else covariance, response)
        )

    def errors(self, predicted: ComplexArray) -> ComplexArray:
        """Whitened errors line by line, (F * n*n,): unit variance where the model is exact."""
        left = (self.response.value - predicted).reshape(len(self.response.hz), -1)
        return np.asarray(np.einsum("fab,fb->fa", self.whitener, left).ravel())

    def slopes(self, derivatives: ComplexArray) -> ComplexArray:
        """Derivatives of the whitened errors, (F * n*n, p), of the model's, (p, F, n, n)."""
        lines = derivatives.reshape(len(derivatives), len(self.response.hz), -1)
        return np.asarray(-(self.whitener @ np.moveaxis(lines, 0, -1)).reshape(-1, len(derivatives)))

    def white(self, errors: ComplexArray) -> ComplexArray:
        """Whitened errors or slopes with the bias, too, brought to unit variance."""
        return errors if self.bias is None else self.bias.white(errors)

    def coarser(self, part: float, step: int) -> GreyTerm:
        """Every `step`-th line at the middle pose alone, with `part` of |P| as an additional error."""
        r = self.response
        keep = slice(step // 2 if len(r.hz) > step else 0, None, step)
        extra = (part * np.abs(r.value[keep]).reshape(len(r.hz[keep]), -1)) ** 2
        diagonal = np.einsum("faa->fa", smoothed_covariance(r)[0][keep]).real + extra
        full = diagonal[:, :, None] * np.eye(diagonal.shape[1])
        kept = dataclasses.replace(
            r, hz=r.hz[keep], value=r.value[keep], covariance=full, noise_covariance=None, degrees_of_freedom=np.inf
        )
        return GreyTerm.of(kept, self.model.coarser(keep), full)


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


@dataclass(frozen=True, eq=False)
class GreyProblem:
    """Whitened residuals of all responses and their Jacobian, as functions of x: parameters' logarithms, or themselves over a scale.

    A delay, where there is one, stands last and has no part in the matrices.
    """

    parameters: tuple[GreyParameter, ...]
    terms: tuple[GreyTerm, ...]  # of the drives at each pose, then of accelerometers
    free: Mask  # parameters that are fitted
    bending_alike_std: float
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

    @cached_property
    def scale(self) -> Array:
        """Of parameters that are fitted as they are; 0 for logarithms."""
        return np.array([p.scale for p in self.parameters])

    def values(self, x: Array) -> Array:
        return np.where(self.scale > 0.0, self.scale * x, np.exp(x))

    @property
    def has_delay(self) -> bool:
        return self.parameters[-1].name == DELAY

    def predicted(self, x: Array) -> list[ComplexArray]:
        return [t.model.response(t.response.hz, self.values(x)) * self._late(t.response.hz, x) for t in self.terms]

    def _late(self, hz: Array, x: Array) -> ComplexArray:
        """What torques that were logged late multiply a response over them by, (F, 1, 1)."""
        return late(hz, DELAY_UNIT * float(x[-1]) if self.has_delay else 0.0)

    def errors(self, x: Array) -> list[ComplexArray]:
        """Whitened errors of each response, the bias left aside."""
        return [t.errors(model) for t, model in zip(self.terms, self.predicted(x), strict=True)]

    def slopes(self, x: Array) -> list[ComplexArray]:
        """Derivatives of `errors` by x, (F * n*n, p)."""
        return [t.slopes(by_x) for t, by_x in zip(self.terms, self.derivatives(x), strict=True)]

    def derivatives(self, x: Array) -> list[ComplexArray]:
        """Derivatives of each response by x, (p, F, joints, joints)."""
        p, out = self.values(x), []
        unit = np.where(self.scale > 0.0, self.scale, p)[:, None, None, None]
        for t in self.terms:
            hz = t.response.hz
            by_x = t.model.derivatives(hz, p) * unit
            if self.has_delay:
                by_x[-1] = 2j * np.pi * DELAY_UNIT * hz[:, None, None] * t.model.response(hz, p)
            out.append(by_x * self._late(hz, x))
        return out

    def whitened(self, errors: list[ComplexArray]) -> list[ComplexArray]:
        """Errors or slopes with the bias, too, brought to unit variance."""
        return [t.white(e) for t, e in zip(self.terms, errors, strict=True)]

    def with_bias(self, x: Array, sizes: tuple[float | None, float | None]) -> GreyProblem:
        """The same problem with the bias that a response near x may have; sizes that are None are estimated there.

        The estimate is the restricted likelihood's: of the sizes given what the parameters cannot explain.
        """
        each = zip(self.terms, self.predicted(x), self.derivatives(x), strict=True)
        functions = [
            bias_functions(t.whitener, t.response.hz, p, self._by_friction(t, d), REACH_HZ) for t, p, d in each
        ]
        found = _bias_sizes(self, x, functions, sizes)
        terms = [dataclasses.replace(t, bias=bias_of(*f, found)) for t, f in zip(self.terms, functions, strict=True)]
        return dataclasses.replace(self, terms=tuple(terms), bias_sizes=found)

    def _by_friction(self, term: GreyTerm, derivatives: ComplexArray) -> ComplexArray:
        """Derivatives by each joint's friction slope, in all experiments alike, (joints, F, n, n)."""
        own = [[p.name.startswith(f"{joint}.{SLOPE}") for p in self.parameters] for joint in term.response.joints]
        return np.array([derivatives[np.array(mask)].sum(axis=0) for mask in own])

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

    def coarser(self, part: float, step: int) -> GreyProblem:
        """Every `step`-th line, with `part` of |P| as an additional error: wide valleys, and cheap."""
        return dataclasses.replace(self, terms=tuple(t.coarser(part, step) for t in self.terms))

    def minimum(self, start: Array, evaluations: int) -> Array:
        found = optimize.least_squares(
            self.residual, start[self.free], self.jacobian, method="lm", max_nfev=evaluations, xtol=1e-9, ftol=1e-10
        )
        return self.full(found.x)

    def cost(self, x: Array) -> float:
        return float((self.residual(x[self.free]) ** 2).sum())


def _bias_sizes(
    problem: GreyProblem,
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


def grey_problem(
    robot: Robot, poses: Sequence[PoseResponse], options: GreyBoxOptions, places: Mapping[str, Array] | None = None
) -> GreyProblem:
    """The problem of a robot and what was measured of it; its hinges were already moved by `places`, m, by joint.

    Raises
    ------
    ValueError
        Responses that do not belong to the robot or together, a parameter without value or unknown, a singular covariance.
    """
    kept, joints = _in_band(robot, poses, options.band_hz), poses[0].response.joints
    numbers = {p.experiments for p in kept}
    experiments = numbers.pop() if len(numbers) == 1 else 1
    parameters = tuple(grey_parameters(robot, joints, experiments, options.link_mass_std))
    names = [p.name for p in parameters]
    for name in options.fixed:
        if name not in names:
            raise ValueError(f"fixed: no parameter {name!r}; {close_match(name, names)}")
    hinges = tuple(hinge_parameters(robot, options.hinge_std, places))
    if hinges and any(pose.accelerations is not None for pose in kept):
        raise ValueError("hinge_std: places of hinges are not fitted with accelerometers")
    parameters += hinges
    if options.delay_std > 0.0:
        parameters += (GreyParameter(DELAY, "s", 0.0, options.delay_std / DELAY_UNIT, DELAY_UNIT),)
    moved = moved_hinges(robot, hinges)
    drives, sensors = [], []
    for pose in kept:
        model = _model(robot, pose, parameters, experiments, moved)
        drives.append(GreyTerm.of(pose.response, model))
        if pose.accelerations is not None:
            sensors.append(GreyTerm.of(pose.accelerations, model.of_sensors()))
    free = np.array([p.name not in options.fixed for p in parameters])
    return GreyProblem(parameters, (*drives, *sensors), free, options.bending_alike_std)


def _model(
    robot: Robot,
    pose: PoseResponse,
    parameters: Sequence[GreyParameter],
    experiments: int,
    moved: Mapping[str, tuple[Robot, Robot]],
) -> GreyExperiments:
    hz, joints = pose.response.hz, pose.response.joints
    path = np.atleast_2d(pose.response.pose if pose.along is None else pose.along)
    sensors = () if pose.accelerations is None else pose.accelerations.sensors
    back = None if pose.feedback is None else pose.feedback(hz)
    each = []
    for number in range(experiments):
        slopes = {joint: slope_name(joint, number, experiments) for joint in joints}
        poses = tuple(matrices_at(robot, slopes, np.asarray(q, dtype=float), parameters, sensors, moved) for q in path)
        each.append(GreyMotion(poses, back))
    return GreyExperiments(tuple(each), shares_of(pose.torques if experiments > 1 else None, len(joints)))


def _in_band(robot: Robot, poses: Sequence[PoseResponse], band_hz: tuple[float, float]) -> list[PoseResponse]:
    """The responses within the band; a clear word where they do not go together."""
    if not poses:
        raise ValueError("no frequency response to fit to")
    if len({p.accelerations is None for p in poses}) > 1:
        raise ValueError("accelerations at some poses; expected them at all, or at none")
    for response in (p.response for p in poses):
        joints = poses[0].response.joints
        unknown = [j for j in response.joints if j not in robot.joints]
        if unknown:
            raise ValueError(f"the response is of joint {unknown[0]!r}; {close_match(unknown[0], robot.joints)}")
        if response.joints != joints:
            raise ValueError(f"responses of joints {joints} and {response.joints}; expected the same joints")
        if np.shape(response.pose) != (len(robot.joints),):
            raise ValueError(
                f"the response's pose has shape {np.shape(response.pose)}; expected {len(robot.joints)} angles of {robot.name}"
            )
    kept = [p.band(*band_hz) for p in poses]
    for whole, part in zip(poses, kept, strict=True):
        if len(part.response.hz) < 2:
            raise ValueError(
                f"{len(part.response.hz)} lines between {band_hz[0]:g} and {band_hz[1]:g} Hz (the response has "
                f"{len(whole.response.hz)}); expected 2 or more"
            )
    return kept
