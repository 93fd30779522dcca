"""What ``rx90b-flex identify`` does: the declared robot of a campaign, identified on its motor signals, as a result and as files."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg
from threadpoolctl import threadpool_limits

from rx90b_flex.bodies import Inconsistency, inconsistencies
from rx90b_flex.effects.flexibility import stiff_for_want_of_values
from rx90b_flex.effects.motion import Array
from rx90b_flex.export import save_robot, with_link_parameters
from rx90b_flex.files.results import write_json
from rx90b_flex.files.toml import named_in
from rx90b_flex.identify.estimators.estimator import Estimator, estimator_named, identified
from rx90b_flex.identify.least_squares import Estimate, Identification
from rx90b_flex.identify.normal_equations import column_scale
from rx90b_flex.identify.physical import information_root, possible_coefficients, with_coefficients
from rx90b_flex.identify.regression import Regression
from rx90b_flex.identify.segment import Segment, prepare
from rx90b_flex.identify.torque_scale import resolved
from rx90b_flex.identify.torque_sensors import calibrated, sensors_to_use, wrong_sensors
from rx90b_flex.robot import LINK_PARAMETERS, LINK_UNITS, Robot, load_robot
from rx90b_flex.showing import Showing
from rx90b_flex.signals import Campaign, Recording, load_campaign

SCHEMA = 1
NEGLIGIBLE = 1e-4  # part of a base parameter below which a term is left out of its name
SURE = 3.0  # standard deviations beyond a bound that noise does not explain
READ_BACK = 1e-9  # largest relative change of a parameter on its way through the files

Progress = Callable[[str, float], None]


# ---- result -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RoleError:
    """Error of the exported robot on the recordings of one role.

    Attributes
    ----------
    relative_error : float
        2-norm of the torque error over the 2-norm of the torque.
    torque_rms : tuple of float
        One a joint, N m.
    """

    relative_error: float
    torque_rms: tuple[float, ...]


@dataclass(frozen=True)
class BaseParameter:
    """A combination of parameters that the data determines.

    Attributes
    ----------
    terms : tuple of (str, float)
        Names and their coefficients; the first one is 1.
    value, std : float
    unit : str
        Of the first term.
    """

    terms: tuple[tuple[str, float], ...]
    value: float
    std: float
    unit: str

    @property
    def text(self) -> str:
        """The combination as a sum."""
        first, *rest = self.terms
        return first[0] + "".join(f" {'-' if c < 0 else '+'} {abs(c):.4g} {name}" for name, c in rest)


@dataclass(frozen=True)
class Consistency:
    """Whether the identified links can exist, and what it took to make them.

    Attributes
    ----------
    found : tuple of Inconsistency
        Of the least-squares estimate; none if its links can exist, or were not identified.
    wrong_sign : tuple of str
        Masses, inertias and friction that come out negative by more than three standard deviations: what noise does not do.
    relative_error_before, relative_error_after : float
        Of the least-squares estimate and of the exported robot, on the data of the fit.
    largest_shift_std : float
        Largest move of a base parameter, in its standard deviations.
    held : tuple of str
        Coefficients that came out below their physical bound and are held at it.
    """

    found: tuple[Inconsistency, ...]
    relative_error_before: float
    relative_error_after: float
    largest_shift_std: float
    held: tuple[str, ...]
    wrong_sign: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class IdentifiedPrediction:
    """Torques of one recording, each (N, joints), N m, after the low-pass; what the exported robot says, and the log."""

    recording: Recording
    measured: Array
    predicted: Array


@dataclass(frozen=True, eq=False, repr=False)
class Identified(Showing):
    """A robot identified on a campaign.

    Attributes
    ----------
    source : Robot
        As declared.
    campaign : Campaign
    model : Identification
        The least-squares estimate.
    possible : Identification
        The same with the nearest values that a robot can have.
    robot : Robot
        With the identified values, made possible: what is exported.
    base : tuple of BaseParameter
    consistency : Consistency
    identification : RoleError
    validation : RoleError or None
        None where no recording has that role.
    predictions : tuple of Prediction
        Of the validation recordings, of those of identification where there are none.
    estimator : str
    cautions : tuple of str
        How torque constants were told, and torque sensors that were not used.
    """

    source: Robot
    campaign: Campaign
    model: Identification
    possible: Identification
    robot: Robot
    base: tuple[BaseParameter, ...]
    consistency: Consistency
    identification: RoleError
    validation: RoleError | None
    predictions: tuple[IdentifiedPrediction, ...]
    estimator: str = "least_squares"
    cautions: tuple[str, ...] = ()

    @property
    def parameters(self) -> tuple[Estimate, ...]:
        """Every parameter of the robot that is written: links, then effects; value None where only combinations are determined.

        Standard deviations are those of the fit.
        """
        return _estimates(self.possible)

    @property
    def fitted(self) -> tuple[Estimate, ...]:
        """The same as least squares alone have them, whether a robot can have such values or not."""
        return _estimates(self.model)


def _estimates(model: Identification) -> tuple[Estimate, ...]:
    effects = []
    for i, effect in enumerate(model.effects):
        effects += [dataclasses.replace(e, name=f"{effect.label}.{e.name}") for e in model.estimates(i)]
    return (*(model.link_estimates() if model.links_fitted else ()), *effects)


def identify_campaign(
    source: Path | Campaign,
    *,
    robot: Robot | None = None,
    estimator: str = "least_squares",
    progress: Progress | None = None,
) -> Identified:
    """Identify the declared robot of a campaign on its identification recordings.

    By an estimator of `rx90b_flex.identify.estimators`; by default weighted least squares over base parameters, shape parameters by
    variable projection. Flexible effects stay as declared, since motor signals below the first resonance do not tell them. Links that
    cannot exist are replaced by the nearest ones that can, in the metric of the data and pulled to the declared ones.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it.
    """
    tell = progress or (lambda _text, _part: None)
    # many products of small matrices: threads would wait for each other longer than they work
    with threadpool_limits(limits=1, user_api="blas"):
        return _identified(source, robot, estimator_named(estimator), tell)


def _identified(source: Path | Campaign, robot: Robot | None, estimator: Estimator, tell: Progress) -> Identified:
    tell("reading", 0.0)
    campaign = source if isinstance(source, Campaign) else load_campaign(source)
    declared = load_robot(campaign.robot_source) if robot is None else robot
    with named_in(campaign.path, "joints"):
        declared.restricted(campaign.joints)
    campaign, constants = resolved(campaign, declared)
    for recording in campaign.recordings:
        if not recording.torque.any():
            raise ValueError(
                f"{recording.source or recording.name}: every torque is zero; errors have no size to go by"
            )
    if declared.inertial_parameters == "known" and not any(not e.traits.virtual for e in declared.effects):
        raise ValueError(
            f"{campaign.robot_source}: nothing to identify: inertial_parameters is 'known' and no effects are declared"
        )
    tell("differentiating", 0.1)
    campaign, scaled = calibrated(campaign)
    sensors = sensors_to_use(campaign)
    regression, fitted_logs = Regression.and_whole(declared, campaign.identification, campaign.cutoff_hz, sensors)
    rigid = regression.robot
    held_out = [
        prepare(rigid, r, campaign.cutoff_hz, thin=False, sticking=regression.sticking) for r in campaign.validation
    ]
    tell("identifying", 0.3)
    fitted = declared.inertial_parameters == "fitted"
    model = identified(estimator, regression, regression.robot.effects, fit_links=fitted)
    tell("making it possible", 0.6)
    try:
        theta, held = possible_coefficients(model)
    except ValueError as error:  # of a torque that hardly depends on the motion, say
        raise ValueError(f"{campaign.path}: {error}; do the torques belong to these motions?") from None
    possible = with_coefficients(model, theta)
    found = _robot(declared, possible)
    base = base_parameters(model)
    tell("predicting", 0.8)
    fit, kept = (_predictions(found, rigid, logs) for logs in (fitted_logs, held_out))
    consistency = _consistency(model, theta, held, base)
    tell("done", 1.0)
    return Identified(
        declared,
        campaign,
        model,
        possible,
        found,
        base,
        consistency,
        _error(fit),
        _error(kept) if kept else None,
        kept or fit,
        estimator.name(),
        (
            *(c.message for c in constants),
            *scaled,
            *(w.message for w in wrong_sensors(campaign)),
            *stiff_for_want_of_values(declared.effects),
        ),
    )


# ---- parameters that are possible -------------------------------------------------------------------------------


def _robot(declared: Robot, model: Identification) -> Robot:
    """The declared robot with identified values; effects that add coordinates, or sit on held joints, as declared."""
    standing = {e.label for e in declared.over_time().effects}
    flexible = [e for e in declared.effects if e.traits.virtual or e.label not in standing]
    stand_ins = {e.label for e in flexible}  # of the flexible ones, on the rigid tree
    effects = [e for e in model.effects if e.label not in stand_ins]
    if not model.links_fitted:
        joints = set(model.regression.joints)
        resting = [e for e in declared.effects if e not in flexible and not set(e.joints) <= joints]
        return declared.with_effects([*flexible, *resting, *effects])
    rigid = model.regression.robot
    kept = [e for e in flexible if set(e.joints) <= set(rigid.joints)]
    return with_link_parameters(rigid, model.link_parameters).with_effects([*kept, *effects])


def _consistency(
    model: Identification, theta: Array, held: tuple[str, ...], base: Sequence[BaseParameter]
) -> Consistency:
    found: tuple[Inconsistency, ...] = ()
    if model.links_fitted:
        found = inconsistencies(model.link_parameters, [name for name, _ in model.regression.robot.bodies])
    residual = model.residual - model.columns @ (theta - model.theta)
    names = {name: i for i, name in enumerate(model.coefficient_names)}
    moves = [abs(sum(c * (theta - model.theta)[names[name]] for name, c in b.terms)) / b.std for b in base if b.std > 0]
    return Consistency(
        found,
        model.relative_error,
        float(np.linalg.norm(residual) / np.linalg.norm(model.regression.torque)),
        float(max(moves, default=0.0)),
        held,
        _wrong_signs(model),
    )


def _wrong_signs(model: Identification) -> tuple[str, ...]:
    """Names of determined coefficients that lie surely below what bodies and friction can have."""
    bounds = np.array([p.lower for e in model.effects for p in e.coefficient_parameters.values()])
    if model.links_fitted:
        positive = np.array([name in ("mass", "J_xx", "J_yy", "J_zz") for name in LINK_PARAMETERS])
        of_links = np.tile(np.where(positive, 0.0, -np.inf), len(model.regression.robot.bodies))
        bounds = np.concatenate([of_links, bounds])
    std = np.sqrt(np.maximum(np.diag(model.covariance)[: len(bounds)], 0.0))
    wrong = model.solution.determined[: len(bounds)] & (model.theta < bounds - SURE * std)
    return tuple(name for name, w in zip(model.coefficient_names, wrong, strict=True) if w)


# ---- base parameters --------------------------------------------------------------------------------------------


def base_parameters(model: Identification) -> tuple[BaseParameter, ...]:
    """Combinations of coefficients that the data determines, each led by one coefficient that stands in no other.

    By QR with column pivoting of the weighted columns, scaled to length one (M. Gautier, "Numerical calculation of the base
    inertial parameters of robots", Journal of Robotic Systems 8(4), 1991).
    """
    root = information_root(model.information)
    scale = column_scale((root**2).sum(axis=0))
    _, upper, order = linalg.qr(root / scale, mode="economic", pivoting=True)
    rank = len(root)
    leading, rest = order[:rank], order[rank:]
    mixed = linalg.solve_triangular(upper[:, :rank], upper[:, rank:])
    mixed = mixed * scale[rest] / scale[leading][:, None]
    bodies = model.regression.robot.bodies if model.links_fitted else ()
    names = model.coefficient_names
    robot = model.regression.robot
    of_effects = (robot.unit_of(e, p.unit) for e in model.effects for p in e.coefficient_parameters.values())
    units = [*LINK_UNITS * len(bodies), *of_effects]
    p = len(model.theta)
    combination = np.zeros((rank, p))
    combination[np.arange(rank), leading] = 1.0
    combination[:, rest] = mixed
    # a term counts by what it would add if its coefficient were as large as its column can make it
    combination[np.abs(combination) * scale[leading][:, None] < NEGLIGIBLE * scale] = 0.0
    covariance = model.covariance[:p, :p]
    stds = np.sqrt(np.maximum(np.einsum("ip,pq,iq->i", combination, covariance, combination), 0.0))
    out = []
    for row in np.argsort(leading):
        others = [i for i in np.flatnonzero(combination[row]) if i != leading[row]]
        terms = tuple((names[i], float(combination[row, i])) for i in (leading[row], *others))
        value = float(combination[row] @ model.theta)
        out.append(BaseParameter(terms, value, float(stds[row]), units[leading[row]]))
    return tuple(out)


# ---- errors -----------------------------------------------------------------------------------------------------


def _predictions(robot: Robot, rigid: Robot, logs: Sequence[Segment]) -> tuple[IdentifiedPrediction, ...]:
    """What the exported robot says of recordings, at their own rate."""
    own = robot.over_time().restricted(rigid.joints)
    out = []
    for segment in logs:
        rows = np.array([own.layout.index(j) for j in segment.recording.joints])
        motion = own.on_links(segment.motion, segment.loaded(own.link_parameters), effects=own.forces)
        force = np.array(motion.on_tree.load())
        for effect in own.effects:
            force = force + effect.force(motion)
        out.append(IdentifiedPrediction(segment.recording, segment.torque, segment.brought(force[:, rows])))
    return tuple(out)


def _error(predictions: Sequence[IdentifiedPrediction]) -> RoleError:
    measured = np.concatenate([p.measured for p in predictions])
    error = measured - np.concatenate([p.predicted for p in predictions])
    rms = np.sqrt((error**2).mean(axis=0))
    return RoleError(float(np.linalg.norm(error) / np.linalg.norm(measured)), tuple(float(x) for x in rms))


# ---- files ------------------------------------------------------------------------------------------------------


def identification_json(result: Identified) -> dict[str, Any]:
    """The content of ``identification.json``, schema 1."""
    consistency = result.consistency
    return {
        "schema": SCHEMA,
        "robot": result.source.name,
        "joints": list(result.campaign.joints),
        "estimator": result.estimator,
        "identification": dataclasses.asdict(result.identification),
        "validation": None if result.validation is None else dataclasses.asdict(result.validation),
        "cautions": list(result.cautions),
        "rank": result.model.solution.rank,
        "parameters": [
            dataclasses.asdict(e) | {"fitted": f.value} for e, f in zip(result.parameters, result.fitted, strict=True)
        ],
        "base_parameters": [
            {"terms": [list(t) for t in b.terms], "value": b.value, "std": b.std, "unit": b.unit} for b in result.base
        ],
        "physical_consistency": {
            "links_fitted": result.model.links_fitted,
            "consistent": not consistency.found,
            "links": [{"link": f.link, "eigenvalue": f.eigenvalue, "message": f.message} for f in consistency.found],
            "held_at_bounds": list(consistency.held),
            "wrong_sign": list(consistency.wrong_sign),
            "relative_error_before": consistency.relative_error_before,
            "relative_error_after": consistency.relative_error_after,
            "largest_shift_std": consistency.largest_shift_std,
        },
    }


def write_prediction(recording: Recording, torques: Mapping[str, Array], folder: Path) -> None:
    """CSV of one recording: its time, and torques (N, joints) as columns ``<name>_<joint>``."""
    names = ["time", *(f"{name}_{joint}" for name in torques for joint in recording.joints)]
    values = np.column_stack([recording.time, *torques.values()])
    with (folder / f"prediction_{recording.name}.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([names, *values.tolist()])


def write_identified(result: Identified, folder: Path) -> None:
    """JSON, robot file and URDF (read back and compared) and predictions into a folder that exists.

    Raises
    ------
    ValueError
        The robot does not come back from its files as it was.
    """
    write_json(folder / "identification.json", identification_json(result))
    # known links are written as they were given, even if no body could have them
    path = save_robot(result.robot, folder, allow_inconsistent=not result.model.links_fitted)
    again = load_robot(path)
    scale = np.nanmax(np.abs(result.robot.parameters))
    same = again.parameter_names == result.robot.parameter_names and np.allclose(
        again.parameters, result.robot.parameters, rtol=READ_BACK, atol=READ_BACK * scale, equal_nan=True
    )
    if not same:
        raise ValueError(f"{path}: the robot read back is not the one that was written")
    for p in result.predictions:
        write_prediction(p.recording, {"tau": p.measured, "tau_model": p.predicted}, folder)
