"""Close the loop on data over frequency: what a flexible robot lacks to have measured modes, or a measured frequency response."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rx90b_flex.diagnose.flexible import (
    MOST_CHANGES,
    NEW_STD,
    Change,
    FlexibleFit,
    FlexibleTrial,
    FoundChange,
    Progress,
    Residual,
    SearchResult,
    Structure,
    search,
)
from rx90b_flex.diagnose.modal import (
    MODEL_ERROR,
    Compared,
    ModalPose,
    ModalResidual,
    ModalTable,
    load_modal_table,
    modes_of,
    rms,
)
from rx90b_flex.diagnose.response import MODEL_ERROR as RESPONSE_ERROR
from rx90b_flex.diagnose.response import ResponseResidual, load_frequency_responses, thinned
from rx90b_flex.effects import close_match
from rx90b_flex.export import save_robot
from rx90b_flex.identify.frequency_response import ComplexArray, FrequencyResponse
from rx90b_flex.identify.grey_box import Delay
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals.folders import CLOSED_LOOP, fill_folder

SCHEMA = 1
UNUSUAL = 10.0  # factor from declared stiffnesses of its kind beyond which a new hinge's is called unusual
SEPARATING_DEG = (-60.0, 0.0, 60.0, 120.0)  # angles of the second and third moving joint that are looked at
FEW_MODES = 6.0  # data for each fitted parameter below which a fit says little


@dataclass(frozen=True)
class Separation:
    """An experiment that tells two explanations apart.

    Attributes
    ----------
    angles : mapping of joint to angle, rad
    measured : str
        Which list of modes.
    with_found, with_alternative : float
        Frequency of the mode that differs most, Hz.
    """

    angles: Mapping[str, float]
    measured: str
    with_found: float
    with_alternative: float

    @property
    def words(self) -> str:
        """In a sentence."""
        pose = ", ".join(f"{j.replace('_', ' ')} at {np.rad2deg(a):.0f}°" for j, a in self.angles.items())
        both = f"{self.with_found:.1f} Hz against {self.with_alternative:.1f} Hz"
        return f"{pose}: one of the {self.measured.replace('_', ' ')} is at {both}"


@dataclass(frozen=True, eq=False)
class FlexibleLoop:
    """What both kinds of data over frequency have in common.

    Attributes
    ----------
    source : Robot
        As declared.
    joints : tuple of str
        Whose drives moved.
    residual : Residual
    result : SearchResult
    """

    source: Robot
    joints: tuple[str, ...]
    residual: Residual
    result: SearchResult

    @property
    def verdict(self) -> str:
        """``nothing_missing``, ``explained``, ``partly_explained`` or ``unexplained``."""
        return self.result.verdict

    @property
    def found(self) -> tuple[FoundChange, ...]:
        """What the data support, in the order in which it was added."""
        return self.result.found

    @property
    def structure(self) -> Structure:
        """The robot with all that it might have."""
        return self.residual.structure

    @cached_property
    def robot(self) -> Robot:
        """The robot with what was found."""
        return self.structure.changed((*self.residual.nuisance, *self.result.after.changes), self.result.after.x)

    def doubts(self) -> list[str]:
        """What limits how sure this is, in sentences."""
        out = []
        after = self.result.after
        if self.verdict in ("partly_explained", "unexplained"):
            out.append(
                f"A scatter of {100 * after.model_error:.2g} % is left, where the stated model error is "
                f"{100 * self.residual.smallest_error:.2g} %: something is still wrong or missing in the model."
            )
        if len(self.structure.poses) == 1 and self.found:
            out.append("One pose only: another cause may act alike there. A second pose would test what was found.")
        per = self.residual.size / max(len(after.x), 1)
        if len(after.x) and per < FEW_MODES:
            out.append(f"{self.residual.size:.0f} independent numbers for {len(after.x)} parameters.")
        distinct = self._distinct()
        if self.found and distinct is not None and distinct < 0.7 * self.residual.size:
            out.append(
                f"The {self.residual.size:.0f} modes lie at {distinct} frequencies, apart by more than the scatter that is left: "
                "a resonance and the antiresonances beside it share their error, and the chances given here take them as independent."
            )
        for found in self.found:
            factor = float(np.exp(np.log(found.values) - found.change.usual).mean())
            hinge = found.change.adds and any(
                e.type_name() == found.change.type and e.virtual for e in self.source.effects
            )
            if hinge and not 1 / UNUSUAL < factor < UNUSUAL:
                size = f"{1 / factor:.0f} times softer" if factor < 1 else f"{factor:.0f} times stiffer"
                out.append(
                    f"The {found.change.words} comes out {size} than the declared ones of its kind. A frequency tells a "
                    "stiffness over an inertia only: it is off by as much as the inertia behind the hinge."
                )
            if found.alternatives:
                others = ", ".join(t.change.words for t in found.alternatives)
                out.append(f"Instead of {found.change.words} the data allow: {others}.")
        return out

    def _distinct(self) -> int | None:
        """How many groups of modes the data hold, apart by more than the scatter; None where it is no list of modes."""
        return None


@dataclass(frozen=True, eq=False)
class ModalLoop(FlexibleLoop):
    """The loop closed on a modal table.

    Attributes
    ----------
    table : ModalTable
    before, after : tuple of Compared
        Every list of the identification poses.
    validation_before, validation_after : tuple of Compared
        Of the validation poses, which were not fitted.
    left_out_before, left_out_after : float
        Root mean square error of the logarithms with each mode predicted from the others.
    separations : mapping of (found, alternative) labels to Separation
    """

    table: ModalTable
    before: tuple[Compared, ...]
    after: tuple[Compared, ...]
    validation_before: tuple[Compared, ...]
    validation_after: tuple[Compared, ...]
    left_out_before: float
    left_out_after: float
    separations: Mapping[tuple[str, str], Separation]

    def _distinct(self) -> int | None:
        groups = 0
        for pose in {c.pose for c in self.after}:
            logs = np.sort(np.concatenate([c.measured.log for c in self.after if c.pose == pose]))
            groups += 1 + int((np.diff(logs) > self.result.after.model_error).sum())
        return groups


def close_modal(
    table: ModalTable | str | os.PathLike[str],
    robot: Robot | str | None = None,
    *,
    model_error: float = MODEL_ERROR,
    new_std: float = NEW_STD,
    only: Sequence[str] = (),
    most: int = MOST_CHANGES,
    progress: Progress | None = None,
) -> ModalLoop:
    """Find what a robot lacks to have the modes of a table.

    Parameters
    ----------
    table : ModalTable or path
    robot : Robot or what `load_robot` takes; the table's own where not given.
    model_error : float
        Relative error of every frequency that is allowed for beside the stated standard deviations.
    new_std : float
        Prior standard deviation of the logarithm of a new stiffness about those declared of its kind.
    only : sequence of str
        Labels of changes to try (``base.base_flexibility``, ``joint_2.drive_stiffness``); all where empty.
    most : int
        Changes at the most.
    progress : callable, optional

    Raises
    ------
    ValueError
        A table that cannot be read, without a robot, or with joints that the robot does not have.
    """
    read = table if isinstance(table, ModalTable) else load_modal_table(table)
    if robot is None and read.robot is None:
        raise ValueError(f"{read.name}: robot is missing; name it in the table or give one")
    if not model_error > 0:
        raise ValueError(f"model_error is {model_error:g}; expected a relative error above 0, as {MODEL_ERROR:g}")
    source = robot if isinstance(robot, Robot) else load_robot(robot or str(read.robot))
    fitted = read.role("identification")

    def residual(poses: Sequence[ModalPose]) -> ModalResidual:
        angles = [p.drive_angles(source) for p in poses]
        structure = Structure.of(source, read.joints, angles, read.band_hz, new_std)
        return ModalResidual(structure, poses, read.band_hz, model_error)

    data = residual(fitted)
    if only:
        labels = [c.label for c in data.structure.changes]
        for label in only:
            if label not in labels:
                raise ValueError(f"only: no change {label!r} of {source.name}; {close_match(label, labels)}")
        kept = tuple(c for c in data.structure.changes if c.label in only)
        data.structure = dataclasses.replace(data.structure, changes=kept)
    result = search(data, progress, most)
    held_out = read.role("validation")
    other = residual(held_out) if held_out else None
    separations = {
        (found.change.label, trial.change.label): separation
        for found in result.found
        for trial in found.alternatives
        if (separation := _separation(source, read, fitted[0], result.after, trial)) is not None
    }
    return ModalLoop(
        source, read.joints, data, result, read, data.compare(result.before), data.compare(result.after),
        other.compare(result.before) if other else (), other.compare(result.after) if other else (),
        data.left_out(result.before), data.left_out(result.after), separations,
    )  # fmt: skip


def _separation(
    robot: Robot, table: ModalTable, pose: ModalPose, found: FlexibleFit, trial: FlexibleTrial
) -> Separation | None:
    """The pose, of a few, where two explanations differ most in a mode of the band."""
    tree, turned = robot.tree, table.joints[1:3]
    reach = {}
    for joint in turned:
        i = tree.joints[tree.getJointId(joint)].idx_q
        low, high = tree.lowerPositionLimit[i], tree.upperPositionLimit[i]
        reach[joint] = [a for a in np.deg2rad(SEPARATING_DEG) if low <= a <= high]
    poses = [{**pose.angles, **dict(zip(turned, a, strict=True))} for a in itertools.product(*reach.values())]
    structure = Structure.of(robot, table.joints, [ModalPose(p, ()).drive_angles(robot) for p in poses], table.band_hz)
    best: tuple[float, Separation] | None = None
    for k, angles in enumerate(poses):
        both = [structure.matrices(k, f.changes, f.x) for f in (found, trial.fit)]
        for locked in (None, *table.joints):
            a, b = (modes_of(structure, f.changes, m, locked)[0] for f, m in zip((found, trial.fit), both, strict=True))
            count = min(len(a), len(b))
            inside = a[:count] <= np.log(table.band_hz[1])
            if not inside.any():
                continue
            gap = np.where(inside, np.abs(a[:count] - b[:count]), 0.0)
            at = int(np.argmax(gap))
            if best is None or gap[at] > best[0]:
                name = "resonances" if locked is None else f"antiresonances of {locked}"
                best = float(gap[at]), Separation(angles, name, float(np.exp(a[at])), float(np.exp(b[at])))
    return best[1] if best else None


# ---- frequency responses ---------------------------------------------------------------------------------------------


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


def close_response(
    responses: FrequencyResponse | Sequence[FrequencyResponse],
    robot: Robot | str,
    *,
    held_out: Sequence[FrequencyResponse] = (),
    band_hz: tuple[float, float] = (8.0, 80.0),
    model_error: float = RESPONSE_ERROR,
    new_std: float = NEW_STD,
    most: int = MOST_CHANGES,
    progress: Progress | None = None,
) -> ResponseLoop:
    """Find what a robot lacks to have measured frequency responses.

    Friction is one viscous slope a joint, each declared hinge has a damping of its own beside its stiffness, and torques may be
    logged late against angles: all three are fitted with every model. Each response is held
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
    new_std, most, progress
        As for `close_modal`.

    Raises
    ------
    ValueError
        Responses of other joints or without a pose; fewer than two lines in the band.
    """
    given = (responses,) if isinstance(responses, FrequencyResponse) else tuple(responses)
    source = robot if isinstance(robot, Robot) else load_robot(robot)
    if not given:
        raise ValueError("no frequency response to hold the robot against")
    if not model_error > 0:
        raise ValueError(f"model_error is {model_error:g}; expected a relative error above 0, as {RESPONSE_ERROR:g}")
    everything = [r.band(*band_hz) for r in (*given, *held_out)]
    for r in everything:
        if r.joints != given[0].joints:
            raise ValueError(f"responses of joints {given[0].joints} and {r.joints}; expected the same joints")
        if len(r.hz) < 2:
            raise ValueError(f"{len(r.hz)} lines between {band_hz[0]:g} and {band_hz[1]:g} Hz; expected 2 or more")
    split = [thinned(r) for r in everything[: len(given)]]
    between = [(k, rest) for k, (_, rest) in enumerate(split) if rest is not None]
    others = [*between, *enumerate(everything[len(given) :], start=len(given))]

    def residual(parts: Sequence[FrequencyResponse]) -> ResponseResidual:
        structure = Structure.of(source, given[0].joints, [r.pose for r in parts], band_hz, new_std)
        return ResponseResidual(structure, parts, model_error)

    data = residual([used for used, _ in split])
    result = search(data, progress, most)
    whole = residual(everything)
    rest = residual([r for _, r in others]) if others else None
    fits = (result.before, result.after)
    before, after = (whole.predict(f) for f in fits)
    errors = [_response_errors(data, f) for f in fits]
    left = [_response_errors(rest, f) if rest else () for f in fits]
    return ResponseLoop(
        source, given[0].joints, data, result, tuple(everything), len(given), before, after, *errors, *left
    )


def _response_errors(residual: ResponseResidual, fit: FlexibleFit) -> tuple[ResponseErrors, ...]:
    return tuple(ResponseErrors(*pair) for pair in residual.errors(fit))


# ---- files -----------------------------------------------------------------------------------------------------------


def error_rms(compared: Iterable[Compared]) -> float:
    """Root mean square of the errors of all pairs, of the logarithm of frequency."""
    return rms(np.concatenate([*(c.errors for c in compared), np.zeros(0)]))


def in_order_rms(compared: Iterable[Compared]) -> float:
    """The same where the n-th measured mode is the model's n-th: no mode is left out, none is taken for another."""
    return rms(np.concatenate([*(c.in_order for c in compared), np.zeros(0)]))


def alone(compared: Iterable[Compared]) -> int:
    """Measured modes that the model has none for."""
    return sum(len(c.measured.hz) - len(c.pairing.measured) for c in compared)


def modal_json(loop: ModalLoop) -> dict[str, Any]:
    """The content of ``closed_loop.json`` for a modal table."""
    return {
        "schema": SCHEMA,
        "residual": "modes",
        **_shared_json(loop),
        "before": _errors_json(loop.before, loop.left_out_before, loop.result.before, loop.result.chance_before),
        "after": _errors_json(loop.after, loop.left_out_after, loop.result.after, loop.result.chance_after),
        "validation": None
        if not loop.validation_before
        else {
            "before": {"log_frequency_rms": _number(error_rms(loop.validation_before))},
            "after": {"log_frequency_rms": _number(error_rms(loop.validation_after))},
        },
        "modes": [
            {
                "pose": b.pose,
                "list": b.measured.name,
                "measured_hz": b.measured.hz.tolist(),
                "std_hz": b.measured.std_hz.tolist(),
                "before_hz": _partners(b),
                "after_hz": _partners(a),
            }
            for b, a in zip(loop.before, loop.after, strict=True)
        ],
        "separate_by": [
            {"found": found, "alternative": other, "angles_deg": {j: float(np.rad2deg(a)) for j, a in s.angles.items()},
             "list": s.measured, "hz_with_found": s.with_found, "hz_with_alternative": s.with_alternative}
            for (found, other), s in loop.separations.items()
        ],
    }  # fmt: skip


def _shared_json(loop: FlexibleLoop) -> dict[str, Any]:
    return {
        "robot": loop.source.name,
        "joints": list(loop.joints),
        "effects": [_found_json(f) for f in loop.found],
        "verdict": loop.verdict,
        "tried": loop.result.tried,
        "doubts": loop.doubts(),
    }


def _found_json(found: FoundChange) -> dict[str, Any]:
    change = found.change
    return {
        "type": change.type,
        "place": change.place,
        "change": "added" if change.adds else "multiplied",
        "parameters": {
            name: {"value": float(v), "std": float(s), "unit": unit if change.adds else "-"}
            for name, unit, v, s in zip(change.names, change.units, found.values, found.stds, strict=True)
        },
        "deviance_gain": found.gain,
        "criterion": found.criterion,
        "p_value": found.p_value,
        "alternatives": [_trial_json(t) for t in found.alternatives],
    }


def _trial_json(trial: FlexibleTrial) -> dict[str, Any]:
    return {
        "type": trial.change.type,
        "place": trial.change.place,
        "label": trial.change.label,
        "criterion": trial.criterion,
    }


def _errors_json(compared: tuple[Compared, ...], left_out: float, fit: FlexibleFit, chance: float) -> dict[str, Any]:
    return {
        "log_frequency_rms": _number(error_rms(compared)),
        "log_frequency_rms_in_order": _number(in_order_rms(compared)),
        "log_frequency_rms_left_out": _number(left_out),
        "measured_without_partner": alone(compared),
        "model_modes_unseen": sum(c.pairing.unseen for c in compared),
        "model_error": fit.model_error,
        "p_value": chance,
    }


def _partners(compared: Compared) -> list[float | None]:
    out: list[float | None] = [None] * len(compared.measured.hz)
    for i, j in zip(compared.pairing.measured, compared.pairing.model, strict=True):
        out[i] = float(compared.model_hz[j])
    return out


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def response_json(loop: ResponseLoop) -> dict[str, Any]:
    """The content of ``closed_loop.json`` for frequency responses."""

    def errors(
        fitted: tuple[ResponseErrors, ...], held_out: tuple[ResponseErrors, ...], fit: FlexibleFit, chance: float
    ) -> Any:
        lists = {"identification": fitted, "validation": held_out}
        return {
            **{
                role: [{"relative_error": e.relative, "weighted_error": e.weighted} for e in x]
                for role, x in lists.items()
            },
            "model_error": fit.model_error,
            "p_value": chance,
        }

    result = loop.result
    return {
        "schema": SCHEMA,
        "residual": "frequency_response",
        **_shared_json(loop),
        "before": errors(loop.errors_before, loop.held_out_before, result.before, result.chance_before),
        "after": errors(loop.errors_after, loop.held_out_after, result.after, result.chance_after),
        "torque_delay": {**dataclasses.asdict(loop.torque_delay), "unit": "s"},
        "responses": [
            {
                "pose_rad": r.pose.tolist(),
                "fitted": k < loop.fitted,
                "hz": r.hz.tolist(),
                **{f"{name}_{part}": getattr(value, part).tolist() for name, value in
                   (("measured", r.value), ("before", loop.before[k]), ("after", loop.after[k])) for part in ("real", "imag")},
            }
            for k, r in enumerate(loop.responses)
        ],
    }  # fmt: skip


def write_loop(
    loop: ModalLoop | ResponseLoop,
    folder: str | os.PathLike[str],
    extra: Iterable[Callable[[ModalLoop | ResponseLoop, Path], None]] = (),
    overwrite: bool = False,
) -> Path:
    """Write ``closed_loop.json``, the robot with what was found, and what else is given; all of it or nothing."""
    folder = Path(folder)

    def fill(at: Path) -> None:
        content = modal_json(loop) if isinstance(loop, ModalLoop) else response_json(loop)
        (at / "closed_loop.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        save_robot(loop.robot, at, allow_inconsistent=True)
        for write in extra:
            write(loop, at)

    fill_folder(folder, fill, CLOSED_LOOP, overwrite)
    return folder


def close_over_frequency(
    source: str | os.PathLike[str],
    robot: str | None = None,
    model_error: float | None = None,
    progress: Progress | None = None,
) -> ModalLoop | ResponseLoop:
    """Close the loop on a modal table or on a folder of ``rx90b-flex frf``: `close_modal` or `close_response`.

    A folder's robot is the one of that name, unless another is given.
    """
    if Path(source).is_dir():
        responses, name = load_frequency_responses(source)
        return close_response(responses, robot or name, model_error=model_error or RESPONSE_ERROR, progress=progress)
    return close_modal(source, robot, model_error=model_error or MODEL_ERROR, progress=progress)


def change_words(found: FoundChange) -> str:
    """A found change with its values, in a sentence."""
    c: Change = found.change
    if c.adds:
        values = ", ".join(
            f"{n.replace('_', ' ')} {v:.4g} ± {s:.2g} {u}"
            for n, v, s, u in zip(c.names, found.values, found.stds, c.units, strict=True)
        )
    else:
        values = f"{found.values[0]:.3g} ± {found.stds[0]:.2g} times the declared value"
    return f"{c.words}: {values}"
