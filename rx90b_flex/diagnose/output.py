"""Write the result of closing the loop: JSON, predictions, the model, and whatever else is handed in."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from rx90b_flex.diagnose.alternatives import Alternative
from rx90b_flex.diagnose.check import faults_json
from rx90b_flex.diagnose.close import SCHEMA, ClosedLoop, FoundEffect
from rx90b_flex.diagnose.deflection import deflection_json, estimates_json, with_gears
from rx90b_flex.diagnose.identified import identified_robot
from rx90b_flex.diagnose.refused import RefusedLoop, refused_json
from rx90b_flex.diagnose.residual import RoleErrors
from rx90b_flex.diagnose.trial import TorqueTrial
from rx90b_flex.effects import Effect
from rx90b_flex.export import save_robot
from rx90b_flex.files.results import write_json
from rx90b_flex.identify.command import write_prediction
from rx90b_flex.robot import Robot
from rx90b_flex.signals.folders import CLOSED_LOOP, fill_folder

if TYPE_CHECKING:
    from rx90b_flex.diagnose.motion import MotionErrors

Loop = TypeVar("Loop", bound=ClosedLoop | RefusedLoop)
REFUSED_SHARE = 0.05  # of its joints' squared error that a refused candidate would explain, to be told of


def closed_loop_json(result: ClosedLoop | RefusedLoop) -> dict[str, Any]:
    """The content of ``closed_loop.json``, schema 1."""
    if isinstance(result, RefusedLoop):
        return refused_json(result)
    return {
        "schema": SCHEMA,
        "robot": result.robot,
        "joints": list(result.joints),
        "before": _roles(result.before),
        "after": _roles(result.after),
        "noise_floor": None if result.noise_floor is None else {"torque_rms": list(result.noise_floor)},
        "effects": [_effect(e, result.model.regression.robot) for e in result.effects],
        "verdict": result.verdict,
        "data_faults": faults_json(result.data_faults),
        "explainable": _explainable(result),
        "moving": {
            "before": {"relative_error": result.moving.before},
            "after": {"relative_error": result.moving.after},
            "at_rest": result.moving.at_rest,
        },
        "fitted": result.fitted and {"before": _roles(result.fitted.before), "after": _roles(result.fitted.after)},
        "unexplained": {
            "relative_error": result.unexplained.relative_error,
            "where": [{"joint": d.joint, "signal": d.signal, "score": d.score} for d in result.unexplained.where],
            "bands": [
                {"joint": b.joint, "low_hz": b.low_hz, "high_hz": b.high_hz, "score": b.score}
                for b in result.unexplained.bands
            ],
            "cautions": list(result.cautions),
            "refused": [
                *(_refused(t) for t in result.last_round.taken_out),
                *(_refused(t) for t in result.last_round.trials if _large(t)),
            ],
        },
    } | ({"deflection": deflection_json(result.deflection)} if result.deflection else {})


def _explainable(result: ClosedLoop) -> dict[str, Any] | None:
    known = result.explainable
    if known is None:
        return None
    return {"validation": {"relative_error": known.validation.relative_error}, "share": known.share}


def motion_json(motion: MotionErrors | str) -> dict[str, Any]:
    """The content of ``motion.json``; `motion` as `rx90b_flex.diagnose.motion.motion_errors` gives it."""
    return {"schema": SCHEMA} | ({"not_simulated": motion} if isinstance(motion, str) else motion.as_json())


def _roles(errors: RoleErrors) -> dict[str, Any]:
    roles = {"validation": errors.validation, "identification": errors.identification}
    return {role: {"relative_error": e.relative_error, "torque_rms": list(e.torque_rms)} for role, e in roles.items()}


def _effect(found: FoundEffect, robot: Robot) -> dict[str, Any]:
    return _named(found.effect) | {
        "parameters": estimates_json(found.parameters),
        "validation_relative_error_before": found.before.relative_error,
        "validation_relative_error_after": found.after.relative_error,
        "p_value": found.p_value,
        "alternatives": [_alternative(a, robot) for a in found.alternatives],
    }


def _large(trial: TorqueTrial) -> bool:
    """Whether a refused candidate would explain much."""
    return bool(trial.refusal) and trial.share > REFUSED_SHARE


def _refused(trial: TorqueTrial) -> dict[str, Any]:
    """A candidate of the last round that would explain much, and why it is not believed; of a family all its joints."""
    named = _named(trial.effect)
    if trial.members:
        named |= {"joint": None, "joints": [j for e in trial.effects for j in e.joints]}
    return named | {"share": float(trial.share), "reason": trial.refusal}


def _named(effect: Effect) -> dict[str, Any]:
    joints = effect.joints
    out: dict[str, Any] = {"type": effect.type_name(), "joint": joints[0] if len(joints) == 1 else None}
    if len(joints) > 1:
        out["joints"] = list(joints)
    if effect.traits.on == "frame":
        out["frame"] = effect.place[0]
    return out


def _alternative(other: Alternative, robot: Robot) -> dict[str, Any]:
    return _named(other.effect) | {
        "parameters": {
            name: {"value": None if np.isnan(value) else float(value), "unit": unit}
            for name, unit, value in robot.values_of(other.effect)
        },
        "gain_share": other.share,
        "standard_errors_behind": other.behind,
        "experiment": other.advice,
    }


def closed_loop_robot(result: ClosedLoop) -> Robot:
    """The robot with the effects added and the identified values, flexible effects as declared.

    Fitted links that no body could have, and coefficients below their bounds, are replaced by the nearest that are possible,
    in the metric of the data's own information (see `rx90b_flex.identify.physical`).
    """
    return with_gears(identified_robot(result.source, result.model, result.joints), result.deflection)


def write_result(
    result: Loop,
    folder: str | os.PathLike[str],
    extra: Iterable[Callable[[Loop, Path], None]] = (),
    motion: MotionErrors | str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write everything that belongs to a result; all of it or nothing.

    Parameters
    ----------
    result : ClosedLoop or RefusedLoop
    folder : path
        Made if it does not exist; the result of an earlier run in it is replaced as a whole.
    extra : iterable of callable
        Each gets the result and the folder to write more into, such as a report.
    motion : MotionErrors or str, optional
        What `rx90b_flex.diagnose.motion.motion_errors` says of the result.
    overwrite : bool
        Whether other files of the same names are replaced, too.
    """
    folder = Path(folder)

    def fill(at: Path) -> None:
        contents = {"closed_loop.json": closed_loop_json(result)}
        if motion is not None:
            contents["motion.json"] = motion_json(motion)
        for name, content in contents.items():
            write_json(at / name, content)
        if isinstance(result, ClosedLoop):
            _write_model(result, at)
        for write in extra:
            write(result, at)

    fill_folder(folder, fill, CLOSED_LOOP, overwrite)
    return folder


def _write_model(result: ClosedLoop, folder: Path) -> None:
    """The robot and its predictions."""
    for p in result.predictions:
        write_prediction(p.recording, {"tau": p.torque, "tau_before": p.before, "tau_after": p.after}, folder)
    # known links are written as they were given, even if no body could have them
    save_robot(closed_loop_robot(result), folder, allow_inconsistent=not result.model.links_fitted)
