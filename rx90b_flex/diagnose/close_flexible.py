"""Close the loop on data over frequency: what a flexible robot lacks to have measured modes, or a measured frequency response."""

from __future__ import annotations

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
    Fit,
    Found,
    Progress,
    Residual,
    SearchResult,
    Structure,
    Trial,
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
from rx90b_flex.export import save_robot
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals.folders import fill_folder

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
    def found(self) -> tuple[Found, ...]:
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


def close_modal(
    table: ModalTable | str | os.PathLike[str],
    robot: Robot | str | None = None,
    *,
    model_error: float = MODEL_ERROR,
    new_std: float = NEW_STD,
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


def _separation(robot: Robot, table: ModalTable, pose: ModalPose, found: Fit, trial: Trial) -> Separation | None:
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


def _found_json(found: Found) -> dict[str, Any]:
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
        "p_value": found.p_value,
        "alternatives": [_trial_json(t) for t in found.alternatives],
    }


def _trial_json(trial: Trial) -> dict[str, Any]:
    return {
        "type": trial.change.type,
        "place": trial.change.place,
        "label": trial.change.label,
        "criterion": trial.criterion,
    }


def _errors_json(compared: tuple[Compared, ...], left_out: float, fit: Fit, chance: float) -> dict[str, Any]:
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


def write_modal(
    loop: ModalLoop, folder: str | os.PathLike[str], extra: Iterable[Callable[[ModalLoop, Path], None]] = ()
) -> Path:
    """Write ``closed_loop.json``, the robot with what was found, and what else is given; all of it or nothing."""
    folder = Path(folder)

    def fill(at: Path) -> None:
        text = json.dumps(modal_json(loop), indent=2, allow_nan=False)
        (at / "closed_loop.json").write_text(text + "\n", encoding="utf-8")
        save_robot(loop.robot, at, allow_inconsistent=True)
        for write in extra:
            write(loop, at)

    fill_folder(folder, fill)
    return folder


def change_words(found: Found) -> str:
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
