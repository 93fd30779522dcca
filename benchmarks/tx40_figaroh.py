"""Base parameters of the TX40 recording beside figaroh 1.0's, on the same filtered samples, with the time of both.

Both get the samples that `rx90b_flex.identify.segment.prepare` makes: angles differentiated behind one low-pass,
torques behind another. Both build their regressor from them (links, drive inertia, viscous and dry friction, offset),
low-pass and thin out its columns alike, and fit. figaroh: `build_regressor_basic`, `QRDecomposer` (double QR), ordinary
least squares with `relative_stdev`, then its weighted least squares. Ours: `identify`, weighted least squares over the
essential space, with standard deviations that allow for coloured residuals. Errors are on the recording's last third,
which nobody fitted. The robot stands still there for a while: figaroh's dry friction, sign(v), then takes either sign,
ours is smoothed; a further line gives figaroh our dry friction, so that the solvers alone are compared. Needs the extra
`bench` and the recording:

    pip install -e ".[bench]" && RX90B_FLEX_DATA=... python benchmarks/tx40_figaroh.py
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from figaroh.identification.identification_tools import relative_stdev, weigthed_least_squares
from figaroh.tools.qrdecomposition import QRDecomposer
from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate

import rx90b_flex as rf
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.robot import Robot
from rx90b_flex.signals import load_campaign

Array = np.ndarray
PINOCCHIO = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
TABLE = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")  # our order of the same
FIGAROHS = {"fv": "viscous_friction", "fs": "coulomb_friction", "ia": "drive_inertia", "off": "torque_offset"}


@dataclass(frozen=True, eq=False)
class Figaroh:
    """What figaroh finds: its base parameters by both methods, and how they follow from all parameters."""

    names: list[str]
    mapping: Array  # (base, parameters), over `kept`
    kept: list[int]
    base: list[int]
    ordinary: Array
    std: Array
    weighted: Array


def names_of(robot: Robot) -> list[str]:
    """Names of figaroh's columns, in its order."""
    links = [f"{name}{j + 1}" for j in range(len(robot.joints)) for name in PINOCCHIO]
    return links + [f"{kind}{j + 1}" for kind in FIGAROHS for j in range(len(robot.joints))]


def figaroh_columns(robot: Robot, regression: Regression) -> Array:
    """figaroh's regressor of the samples, low-passed and thinned out as ours is; rows joint by joint."""
    n = len(robot.joints)
    peer = SimpleNamespace(model=robot.tree, data=robot.tree.createData())
    config = {"act_idxv": list(range(n)), "has_friction": True, "has_actuator_inertia": True, "has_joint_offset": True}
    parts = []
    for segment in regression.segments:
        q, v, a = segment.motion.q, segment.motion.v, segment.motion.a
        full = build_regressor_basic(peer, q, v, a, config).reshape(n, len(q), -1)
        parts.append(segment.brought(full.transpose(1, 0, 2)))
    columns = np.concatenate(parts)[:, regression.rows]
    return columns.transpose(1, 0, 2).reshape(-1, columns.shape[2])


def with_smooth_friction(columns: Array, regression: Regression) -> Array:
    """figaroh's columns with our dry friction in the place of its sign(v)."""
    out, n = columns.copy(), len(regression.joints)
    for effect in regression.robot.effects:
        if effect.type_name() == FIGAROHS["fs"]:
            at = 10 * n + n + regression.robot.joints.index(effect.joints[0])
            out[:, at] = regression.columns(effect)[:, :, 0].T.ravel()
    return out


def fit_figaroh(robot: Robot, columns: Array, torque: Array, weighted: bool) -> Figaroh:
    """Base parameters by double QR; ordinary and (if asked for) weighted least squares."""
    names = names_of(robot)
    dropped, left = get_index_eliminate(columns, dict.fromkeys(names, 0.0), tol_e=1e-6)
    reduced = build_regressor_reduced(columns, dropped)
    y = torque.T.ravel()
    result = QRDecomposer().decompose(reduced, left, tau=y, method="double")
    base = reduced[:, result.base_indices]
    ordinary = np.linalg.lstsq(base, y, rcond=None)[0]
    percent = relative_stdev(base, ordinary, y)
    solved = ordinary
    if weighted:
        stops = {"idx_tau_stop": [len(torque) * (j + 1) for j in range(torque.shape[1])]}
        solved = weigthed_least_squares(robot_of(robot), ordinary, base, y, base @ ordinary, stops)
    kept = [i for i in range(len(names)) if i not in set(dropped)]
    std = np.abs(ordinary) * np.asarray(percent) / 100.0
    return Figaroh(result.base_param_expressions, result.M, kept, result.base_indices, ordinary, std, solved)


def robot_of(robot: Robot) -> SimpleNamespace:
    return SimpleNamespace(model=robot.tree)


def in_figarohs_order(robot: Robot, fit: Identification) -> tuple[Array, Array]:
    """Our parameters and their covariance in figaroh's order."""
    n = len(robot.joints)
    place = [10 * j + TABLE.index(name) for j in range(n) for name in PINOCCHIO]
    for kind in FIGAROHS.values():
        for joint in robot.joints:
            (i,) = (k for k, e in enumerate(fit.effects) if (e.type_name(), e.joints) == (kind, (joint,)))
            place.append(fit.first_column(i))
    return fit.theta[place], fit.covariance[np.ix_(place, place)]


def error(columns: Array, theta: Array, torque: Array) -> float:
    """Norm of what is left over the norm of the torque."""
    y = torque.T.ravel()
    return float(np.linalg.norm(y - columns @ theta) / np.linalg.norm(y))


def main() -> None:
    """Print errors, base parameters and times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--no-weighted", action="store_true", help="leave out figaroh's slow weighted least squares")
    options = parser.parse_args()
    data = Path(os.environ.get("RX90B_FLEX_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    campaign = load_campaign(data / "tx40" / "campaign.toml")
    robot = rf.load_robot(campaign.robot_source)
    fitted, held_out = (
        Regression.of(robot, r, campaign.cutoff_hz) for r in (campaign.identification, campaign.validation)
    )
    print(
        f"TX40: {len(fitted)} fitted samples and {len(held_out)} held out at {fitted.segments[0].rate_hz:g} Hz, 6 joints"
    )

    ours, theirs = [], []
    for _ in range(options.rounds):  # in turn, so that a change of the machine's speed meets both
        regression = Regression(
            fitted.robot, fitted.joints, tuple(forgetting(s, fitted.robot) for s in fitted.segments)
        )
        start = time.perf_counter()
        fit = identify(regression, fitted.robot.effects, fit_links=True)
        middle = time.perf_counter()
        columns = figaroh_columns(fitted.robot, fitted)
        peer = fit_figaroh(fitted.robot, columns, fitted.torque, weighted=False)
        theirs.append(time.perf_counter() - middle)
        ours.append(middle - start)
    started = time.perf_counter()
    if not options.no_weighted:
        peer = fit_figaroh(fitted.robot, columns, fitted.torque, weighted=True)
    slow = time.perf_counter() - started

    held = figaroh_columns(held_out.robot, held_out)
    residual = fit.residual_on(held_out)
    own_error = float(np.linalg.norm(residual) / np.linalg.norm(held_out.torque))
    print(f"\n{'relative torque error':34s}{'fitted':>9s}{'held out':>10s}{'time':>9s}")
    print(f"{'rx90b_flex, weighted':34s}{fit.relative_error:9.4f}{own_error:10.4f}{statistics.median(ours):8.2f}s")
    methods = [("figaroh, ordinary", peer.ordinary, statistics.median(theirs))]
    smooth = [with_smooth_friction(c, r) for c, r in ((columns, fitted), (held, held_out))]
    peer_smooth = fit_figaroh(fitted.robot, smooth[0], fitted.torque, weighted=False)
    methods += [] if options.no_weighted else [("figaroh, weighted", peer.weighted, slow + statistics.median(theirs))]
    for name, phi, seconds in methods:
        errors = [error(c[:, peer.kept][:, peer.base], phi, r.torque) for c, r in ((columns, fitted), (held, held_out))]
        print(f"{name:34s}{errors[0]:9.4f}{errors[1]:10.4f}{seconds:8.2f}s")
    errors = [
        error(c[:, peer_smooth.kept][:, peer_smooth.base], peer_smooth.ordinary, r.torque)
        for c, r in zip(smooth, (fitted, held_out), strict=True)
    ]
    print(f"{'figaroh, ordinary, our dry friction':34s}{errors[0]:8.4f}{errors[1]:10.4f}")

    theta, covariance = in_figarohs_order(fitted.robot, fit)
    own = peer.mapping @ theta[peer.kept]
    own_std = np.sqrt(np.diag(peer.mapping @ covariance[np.ix_(peer.kept, peer.kept)] @ peer.mapping.T))
    reference = peer.ordinary if options.no_weighted else peer.weighted
    apart = np.abs(own - reference) / own_std
    print(
        f"\n{len(own)} base parameters (figaroh's), rank of ours {fit.solution.rank}; "
        "std: ours for coloured, theirs for white residuals"
    )
    print(f"{'parameter':62s}{'ours':>10s}{'std':>9s}{'ordinary':>10s}{'std':>9s}{'weighted':>10s}")
    for i in np.argsort(-np.abs(own) / own_std):
        name = peer.names[i] if len(peer.names[i]) < 60 else peer.names[i][:57] + "..."
        row = f"{own[i]:10.4f}{own_std[i]:9.4f}{peer.ordinary[i]:10.4f}{peer.std[i]:9.4f}{reference[i]:10.4f}"
        print(f"{name:62s}{row}")
    print(f"\nours against figaroh's {'ordinary' if options.no_weighted else 'weighted'}, in our std: "
          f"median {np.median(apart):.2f}, {np.mean(apart < 2):.0%} within 2")  # fmt: skip


def forgetting(segment, robot: Robot):  # type: ignore[no-untyped-def]
    """The same samples without what was worked out from them before."""
    import dataclasses

    m = segment.motion
    return dataclasses.replace(segment, motion=robot.motion(m.q, m.v, m.a, m.time))


if __name__ == "__main__":
    main()
