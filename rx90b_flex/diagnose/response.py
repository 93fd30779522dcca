"""Frequency responses held against a flexible robot: a residual of the loop in `rx90b_flex.diagnose.loop`.

The response of ``(s^2 M + s D + K) q = B tau`` is ``P = s^2 B^T Z^-1 B`` (5.36); its slope by a parameter is
``-s^2 (B^T Z^-1) dZ (Z^-1 B)``. Friction enters as one viscous slope a joint, each declared hinge has a damping of its own beside its
stiffness, those that are added share one, and torques may be logged late against angles by some delay d, which multiplies P by
``exp(s d)``: all of these are fitted with every model, so that none is taken for a missing hinge.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy import ndimage

from rx90b_flex.diagnose.flexible import FlexibleLoop, FlexibleResidual, Structure
from rx90b_flex.diagnose.likelihood import Change, LikelihoodFit, State, close_residual
from rx90b_flex.diagnose.loop import Progress
from rx90b_flex.effects.motion import Array
from rx90b_flex.files.table import shown
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.grey_data import REACH_HZ, smoothed_covariance
from rx90b_flex.identify.grey_model import DELAY_STD, DELAY_UNIT, Delay, late
from rx90b_flex.robot import Robot, load_robot

# of |P| about a line: what parts a simulated campaign of section 6.6.2 from the right model at its mean pose
MODEL_ERROR = 0.03
LINES = 60  # a response is fitted at, at the most; those between are held out
NUISANCE_STD = 2.0  # of the logarithms of friction slopes and dampings


def response_of(structure: Structure, pose: int, changes: Sequence[Change], x: Array, hz: Array) -> ComplexArray:
    """P of a changed model, (F, joints, joints), rad/s^2 per N m; ``changes`` with nuisances."""
    return _response(structure, pose, changes, x, hz, slopes=False)[0]


def _response(
    structure: Structure, pose: int, changes: Sequence[Change], x: Array, hz: Array, slopes: bool = True
) -> tuple[ComplexArray, ComplexArray]:
    """P, and its derivatives by x, (p, F, joints, joints)."""
    matrices, by_x = structure.matrices(pose, changes, x)
    free = structure.free(changes)
    at = np.ix_(free, free)
    M, D, K = (m[at] for m in matrices)
    drives = structure.drives(free).astype(complex)
    s: ComplexArray = np.asarray(2j * np.pi * hz[:, None, None], dtype=np.complex128)
    place = _place_of_delay(changes)
    shift = 1.0 if place is None else late(hz, DELAY_UNIT * float(x[place]))
    Z = s**2 * M + s * D + K
    right = np.linalg.solve(Z, drives[None])
    left = right.transpose(0, 2, 1)  # at rest all but damping has a potential, and that is symmetric too: so is Z
    response: ComplexArray = np.asarray(s**2 * (drives.T @ right) * shift)
    if not slopes:
        return response, np.zeros((0, *response.shape), dtype=complex)
    out = np.zeros((len(x), *response.shape), dtype=complex)
    for k, patterns in enumerate(by_x):
        for power, pattern in ((4, patterns[0]), (3, patterns[1]), (2, patterns[2])):
            own = pattern[at]
            touched = np.flatnonzero(own.any(axis=0) | own.any(axis=1))
            if len(touched):
                out[k] -= s**power * (left[:, :, touched] @ own[np.ix_(touched, touched)] @ right[:, touched])
    out *= shift
    if place is not None:
        out[place] = DELAY_UNIT * s * response
    return response, out


def _place_of_delay(changes: Sequence[Change]) -> int | None:
    """Where the delay stands among the numbers of some changes."""
    at = 0
    for change in changes:
        if change.type == "torque_delay":
            return at
        at += change.size
    return None


class ResponseResidual(FlexibleResidual):
    """Complex errors of frequency responses, each line with its own covariance.

    The model error of a line is alike to that of its neighbours within `REACH_HZ`, so that so many lines count as one.

    Parameters
    ----------
    structure : Structure
        At the poses of the responses, in their order.
    responses : sequence of FrequencyResponse
        Of the structure's joints.
    model_error : float
        Relative error of P about a line that is always allowed for.
    """

    def __init__(self, structure: Structure, responses: Sequence[FrequencyResponse], model_error: float) -> None:
        self.structure = structure
        self.responses = tuple(responses)
        self.smallest_error = model_error
        self.nuisance = _nuisances(structure)
        self._parts: dict[float, list[tuple[ComplexArray, float]]] = {}

    @cached_property
    def _sizes(self) -> list[Array]:
        """|P| about each line, root mean square, (F, n*n)."""
        out = []
        for r in self.responses:
            near = max(1, round(REACH_HZ / float(np.median(np.diff(r.hz)))))
            power = np.abs(r.value.reshape(len(r.hz), -1)) ** 2
            out.append(np.sqrt(ndimage.uniform_filter1d(power, near, axis=0, mode="nearest")))
        return out

    @cached_property
    def _covariances(self) -> list[ComplexArray]:
        """Of each line; larger where they were estimated from few realisations, as their inverse is too large."""
        out = []
        for r in self.responses:
            covariance, freedom = smoothed_covariance(r)
            entries = covariance.shape[1]
            out.append(covariance * (freedom / max(freedom - entries, 1.0) if np.isfinite(freedom) else 1.0))
        return out

    @cached_property
    def _variances(self) -> list[Array]:
        return [np.einsum("faa->fa", c).real for c in self._covariances]

    @cached_property
    def _together(self) -> list[float]:
        """Lines of each response that count as one."""
        return [max(1.0, REACH_HZ / float(np.median(np.diff(r.hz)))) for r in self.responses]

    @property
    def size(self) -> float:
        return sum(2.0 * r.value.size / m for r, m in zip(self.responses, self._together, strict=True))

    @cached_property
    def _weights(self) -> list[tuple[Array, Array]]:
        """Of each response at each model error: what a squared error counts, (E, F*n*n), and the sum of log variances, (E,)."""
        out = []
        for own, size in zip(self._variances, self._sizes, strict=True):
            variance = own.ravel() + (self.model_errors[:, None] * size.ravel()) ** 2
            out.append((1.0 / variance, np.asarray(np.log(variance).sum(axis=1))))
        return out

    def _whiteners(self, error: float) -> list[tuple[ComplexArray, float]]:
        """Of each response at a model error: inverse Cholesky factors, and the sum of log determinants."""
        if error not in self._parts:
            out = []
            for covariance, size in zip(self._covariances, self._sizes, strict=True):
                whole = covariance + (error * size)[:, :, None] ** 2 * np.eye(size.shape[1])
                factor = np.linalg.cholesky(whole)
                logs = 2.0 * float(np.log(np.einsum("faa->fa", factor).real).sum())
                out.append((np.asarray(np.linalg.inv(factor)), logs))
            self._parts[error] = out
        return self._parts[error]

    def evaluate(self, changes: tuple[Change, ...], x: Array, model_error: float) -> State:
        # errors on a grid, so that few of them have to be factorised
        error = float(self.model_errors[np.argmin(np.abs(np.log(self.model_errors / max(model_error, 1e-9))))])
        deviance, gradient, information = 0.0, np.zeros(len(x)), np.zeros((len(x), len(x)))
        likely = np.zeros(len(self.model_errors))
        parts = zip(self.responses, self._whiteners(error), self._weights, self._together, strict=True)
        for k, (r, (whitener, logs), (weights, log_variances), many) in enumerate(parts):
            model, by_x = _response(self.structure, k, changes, x, r.hz)
            e = (r.value - model).reshape(len(r.hz), -1)
            white = np.einsum("fab,fb->fa", whitener, e).ravel()
            slopes = -np.einsum("fab,kfb->kfa", whitener, by_x.reshape(len(x), len(r.hz), -1)).reshape(len(x), -1)
            deviance += 2.0 * (logs + float((np.abs(white) ** 2).sum())) / many
            gradient += 2.0 * (slopes.conj() @ white).real / many
            information += 2.0 * (slopes.conj() @ slopes.T).real / many
            likely += (log_variances + weights @ np.abs(e.ravel()) ** 2) / many
        return State(deviance, gradient, information, float(self.model_errors[np.argmin(likely)]))

    def _left(self, fit: LikelihoodFit) -> Iterator[tuple[ComplexArray, ComplexArray]]:
        """Of each response, errors as they are and over the stated errors, (F, n*n)."""
        stated = self._whiteners(self.smallest_error)
        for r, model, (whitener, _) in zip(self.responses, self.predict(fit), stated, strict=True):
            e = (r.value - model).reshape(len(r.hz), -1)
            yield e, np.einsum("fab,fb->fa", whitener, e)

    def chance(self, fit: LikelihoodFit) -> float:
        squares = (2.0 * float((np.abs(white) ** 2).sum()) for _, white in self._left(fit))
        total = sum(s / many for s, many in zip(squares, self._together, strict=True))
        return self.by_chi_squared(total, self.size, fit)

    def errors(self, fit: LikelihoodFit) -> tuple[ResponseErrors, ...]:
        """Of each response."""
        both = ((e / size, white) for (e, white), size in zip(self._left(fit), self._sizes, strict=True))
        return tuple(ResponseErrors(*(float(np.sqrt(np.mean(np.abs(x) ** 2))) for x in each)) for each in both)

    def torque_delay(self, fit: LikelihoodFit) -> Delay:
        """By how much a fit has torques logged later than angles."""
        place = _place_of_delay(self.nuisance)
        assert place is not None
        return Delay(DELAY_UNIT * float(fit.x[place]), DELAY_UNIT * float(np.sqrt(fit.covariance[place, place])))

    def predict(self, fit: LikelihoodFit, hz: Sequence[Array] | None = None) -> tuple[ComplexArray, ...]:
        """Responses of a fitted model, at the data's lines or others."""
        lines = [r.hz for r in self.responses] if hz is None else hz
        changes = (*self.nuisance, *fit.changes)
        return tuple(response_of(self.structure, k, changes, fit.x, h) for k, h in enumerate(lines))


def _nuisances(structure: Structure) -> tuple[Change, ...]:
    """What is fitted with every model: the logs' skew, friction slopes, dampings."""
    declared, slopes = len(structure.robot.effects), []
    dampings: dict[int, list[int]] = {}
    for i, c in enumerate(structure.coefficients):
        if c.effect < 0:
            slopes.append(_nuisance("viscous_friction", structure.joints[c.column], "friction_slope", (i,)))
        elif not structure.stiffens(i):
            of = min(c.effect, declared)  # what may be added shares one damping, over that usual of its stiffness
            dampings.setdefault(of, []).append(i)
    places = {k: "_".join(e.place) or "base" for k, e in enumerate(structure.robot.effects)}
    delay = dataclasses.replace(_nuisance("torque_delay", "robot", "delay", ()), std=DELAY_STD / DELAY_UNIT)
    losses = (_nuisance("damping", places.get(k, "all"), "damping", tuple(at)) for k, at in dampings.items())
    return (delay, *slopes, *losses)


def _nuisance(kind: str, place: str, name: str, moved: tuple[int, ...]) -> Change:
    zero, one = np.zeros(1), np.zeros((1, 1))
    return Change(kind, place, False, (name,), ("-",), one, zero, NUISANCE_STD, (moved,))


def thinned(response: FrequencyResponse) -> tuple[FrequencyResponse, FrequencyResponse | None]:
    """Every k-th line, `LINES` at the most, and the others."""
    step = -(-len(response.hz) // LINES)
    kept = np.arange(len(response.hz)) % step == step // 2
    return _lines(response, kept), _lines(response, ~kept) if step > 1 else None


def _lines(response: FrequencyResponse, kept: Any) -> FrequencyResponse:
    covariance, freedom = smoothed_covariance(response)  # before the neighbours go
    return FrequencyResponse(
        response.hz[kept], response.value[kept], covariance[kept], response.joints, response.pose,
        degrees_of_freedom=freedom,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ResponseErrors:
    """Errors of one model on lines of one response.

    Attributes
    ----------
    relative : float
        Root mean square error over that of P about each line and entry.
    weighted : float
        Root mean square error over the stated errors; 1 where these are all that there is.
    """

    relative: float
    weighted: float


@dataclass(frozen=True, eq=False)
class ResponseLoop(FlexibleLoop):
    """The loop closed on frequency responses.

    Attributes
    ----------
    responses : tuple of FrequencyResponse
        As given; those that were not fitted last.
    fitted : int
        How many of them were fitted (at a part of their lines).
    before, after : tuple of complex array
        The model's responses at all lines of each.
    errors_before, errors_after : tuple of ResponseErrors
        On the fitted lines of each fitted response.
    held_out_before, held_out_after : tuple of ResponseErrors
        On what was not fitted: the lines between, and other responses.
    """

    kind: ClassVar[str] = "frequency responses"

    responses: tuple[FrequencyResponse, ...]
    fitted: int
    before: tuple[ComplexArray, ...]
    after: tuple[ComplexArray, ...]
    errors_before: tuple[ResponseErrors, ...]
    errors_after: tuple[ResponseErrors, ...]
    held_out_before: tuple[ResponseErrors, ...]
    held_out_after: tuple[ResponseErrors, ...]

    @property
    def torque_delay(self) -> Delay:
        """By how much torques were logged late against angles; fitted with every model, and no finding."""
        assert isinstance(self.residual, ResponseResidual)
        return self.residual.torque_delay(self.result.after)

    def as_json(self) -> dict[str, Any]:
        result = self.result
        return {
            **self.json_of_all("frequency_response"),
            "before": _errors_json(self.errors_before, self.held_out_before, result.before, result.chance_before),
            "after": _errors_json(self.errors_after, self.held_out_after, result.after, result.chance_after),
            "torque_delay": {**dataclasses.asdict(self.torque_delay), "unit": "s"},
            "responses": [
                {
                    "pose_rad": r.pose.tolist(),
                    "fitted": k < self.fitted,
                    "hz": r.hz.tolist(),
                    **{f"{name}_{part}": getattr(value, part).tolist() for name, value in
                       (("measured", r.value), ("before", self.before[k]), ("after", self.after[k])) for part in ("real", "imag")},
                }
                for k, r in enumerate(self.responses)
            ],
        }  # fmt: skip


def _errors_json(
    fitted: tuple[ResponseErrors, ...], held_out: tuple[ResponseErrors, ...], fit: LikelihoodFit, chance: float
) -> dict[str, Any]:
    lists = {"identification": fitted, "validation": held_out}
    return {
        **{
            role: [{"relative_error": e.relative, "weighted_error": e.weighted} for e in x] for role, x in lists.items()
        },
        "model_error": fit.model_error,
        "p_value": chance,
    }


def close_response(
    responses: FrequencyResponse | Sequence[FrequencyResponse],
    robot: Robot | str,
    *,
    held_out: Sequence[FrequencyResponse] = (),
    band_hz: tuple[float, float] = (8.0, 80.0),
    model_error: float = MODEL_ERROR,
    progress: Progress | None = None,
) -> ResponseLoop:
    """Find what a robot lacks to have measured frequency responses.

    Friction is one viscous slope a joint, and all dampings share a factor; both are fitted with every model. Each response is held
    against the robot at its mean pose: what a motion through several poses does to it is part of the model error.

    Parameters
    ----------
    responses : FrequencyResponse or sequence of them
        Of the same joints, each with its pose.
    robot : Robot or what `load_robot` takes
    held_out : sequence of FrequencyResponse
        At other poses or of other experiments: predicted, not fitted.
    band_hz : (low, high)
        Lines used.
    model_error : float
        Part of |P| about a line that is allowed for beside the covariance.
    progress : callable, optional

    Raises
    ------
    ValueError
        Responses of other joints or without a pose; fewer than two lines in the band.
    """
    given = (responses,) if isinstance(responses, FrequencyResponse) else tuple(responses)
    source = robot if isinstance(robot, Robot) else load_robot(robot)
    if not model_error > 0:
        raise ValueError(f"model_error is {model_error:g}; expected a relative error above 0, as {MODEL_ERROR:g}")
    everything = _in_band(given, held_out, band_hz)
    split = [thinned(r) for r in everything[: len(given)]]
    between = [(k, rest) for k, (_, rest) in enumerate(split) if rest is not None]
    others = [*between, *enumerate(everything[len(given) :], start=len(given))]

    def residual(parts: Sequence[FrequencyResponse]) -> ResponseResidual:
        structure = Structure.of(source, given[0].joints, [r.pose for r in parts], band_hz)
        return ResponseResidual(structure, parts, model_error)

    data = residual([used for used, _ in split])
    result = close_residual(data, progress)
    whole = residual(everything)
    rest = residual([r for _, r in others]) if others else None
    fits = (result.before, result.after)
    before, after = (whole.predict(f) for f in fits)
    errors = [data.errors(f) for f in fits]
    left = [rest.errors(f) if rest else () for f in fits]
    return ResponseLoop(
        source, given[0].joints, data, result, tuple(everything), len(given), before, after, *errors, *left
    )


def _in_band(
    given: Sequence[FrequencyResponse], held_out: Sequence[FrequencyResponse], band_hz: tuple[float, float]
) -> list[FrequencyResponse]:
    """All responses within the band, of the same joints."""
    if not given:
        raise ValueError("no frequency response to hold the robot against")
    everything = [r.band(*band_hz) for r in (*given, *held_out)]
    for r in everything:
        if r.joints != given[0].joints:
            raise ValueError(f"responses of joints {given[0].joints} and {r.joints}; expected the same joints")
        if len(r.hz) < 2:
            raise ValueError(f"{len(r.hz)} lines between {band_hz[0]:g} and {band_hz[1]:g} Hz; expected 2 or more")
    return everything


def load_frequency_responses(folder: str | os.PathLike[str]) -> tuple[tuple[FrequencyResponse, ...], str]:
    """The responses in a folder of ``rx90b-flex frf``, one a pose, with independent errors of their entries; and the robot's name.

    Where the experiments were replayed, those without the distortion that this explains; but those as measured where they are told
    better, for a replay on a robot that lacks something may add more distortion than it takes out.

    Raises
    ------
    ValueError
        One line that names the file and the key.
    """
    path = Path(folder) / "frf.json"
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(table, dict):
            raise ValueError(f"holds {'a list' if isinstance(table, list) else shown(table)}; expected a JSON object")
        # a campaign about one pose may stand by itself, not in a list of poses
        poses = table.get("poses", [table])
        responses = tuple(_read(pose, pose["frequency_response"], table["joints"]) for pose in poses)
        if all(pose.get("replayed_response") for pose in poses):
            replayed = tuple(_read(pose, pose["replayed_response"], table["joints"]) for pose in poses)
            responses = _better_told(responses, replayed)
        name = str(table["robot"])
    except FileNotFoundError:
        raise ValueError(f"{path}: no such file; expected a folder that `rx90b-flex frf` wrote") from None
    except KeyError as error:
        raise ValueError(f"{path}: key {error} is missing") from None
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: not a result of `rx90b-flex frf`: {error}") from None
    excited = dict.fromkeys(", ".join(r.joints) for r in responses)
    if len(excited) > 1:
        each = " at one pose and ".join(excited)
        raise ValueError(
            f"{path}: poses: {each} at another were excited; keep poses with the same joints in the campaign"
        )
    return responses, name


def _better_told(
    measured: tuple[FrequencyResponse, ...], replayed: tuple[FrequencyResponse, ...]
) -> tuple[FrequencyResponse, ...]:
    """All as measured or all replayed, never mixed: friction is another slope in them."""
    wider = [np.log(r.std() / m.std()).ravel() for r, m in zip(replayed, measured, strict=True)]
    return measured if np.mean(np.concatenate(wider)) > 0 else replayed


def _read(pose: dict[str, Any], measured: dict[str, Any], joints: Sequence[str]) -> FrequencyResponse:
    """One response; of all the robot's joints where it does not say which were excited."""
    hz, std = np.array(measured["hz"], dtype=float), np.array(measured["std"], dtype=float)
    value = np.array(measured["real"], dtype=float) + 1j * np.array(measured["imag"], dtype=float)
    variance = std.reshape(len(hz), -1) ** 2
    covariance = variance[:, :, None] * np.eye(variance.shape[1]).astype(complex)
    freedom = measured["degrees_of_freedom"]
    return FrequencyResponse(
        hz, value, covariance, tuple(measured.get("joints", joints)), np.array(pose["pose_rad"], dtype=float),
        degrees_of_freedom=np.inf if freedom is None else float(freedom),
    )  # fmt: skip
