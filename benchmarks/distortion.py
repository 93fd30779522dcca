"""The source's study of nonlinear distortion: sections 6.6.6, 6.6.7 and 6.7.2, on the robot of section 6.6.1.

All six joints are in closed loop; joints 1 to 3 are flexible, as in table 5.1, joints 4 to 6 rigid. Campaigns of section 6.6.2 by
the perturbation method, estimated with `estimate_frequency_response` and compared with the linear robot in the mean pose, friction
viscous with the slope that it has at 0.11 rad/s.

- figure 6.7: friction linear or not, links and hinges linear or not, one realisation;
- figure 6.8: one input at a time against the matrix (6.50), one realisation;
- figure 6.9: multisines of 45 N m against 30 N m, signal over noise and over nonlinear distortion;
- figure 6.10: with the sign of the multisine switched against not, as many runs.

    python benchmarks/distortion.py [--realisations 16] [--figures FOLDER]
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

import rx90b_flex as rf
from rx90b_flex.effects import Effect
from rx90b_flex.effects.friction import ViscousFriction, friction_side
from rx90b_flex.effects.motion import Array
from rx90b_flex.excitation import identity, minus_below_first
from rx90b_flex.identify.frf import MeasuredResponse, estimate_frequency_response
from rx90b_flex.robot import Robot
from rx90b_flex.signals import load_campaign
from rx90b_flex.simulate import load_cs8, run_campaign, section_662
from rx90b_flex.simulate.excite import NOISE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BAND_HZ = (2.5, 78.5)  # the source's lines: 2k + 1 cycles in 4.096 s, k = 5 to 160
SPLIT_HZ = 40.0  # below it, the source finds, friction distorts most
SPEED = 0.11  # rad/s, section 6.6.2


@dataclass(frozen=True)
class Case:
    """One campaign.

    Attributes
    ----------
    matrix : str
        ``ones``: (6.50). ``identity``: one joint at a time.
    peak : float
        Of the multisine, N m.
    signs : tuple of int
    realisations : int
    dry : bool
        Friction as declared, else viscous.
    moving : bool
        Links and hinges follow the motion, else those of the mean pose.
    """

    matrix: Literal["ones", "identity"] = "ones"
    peak: float = 45.0
    signs: tuple[int, ...] = (1, -1)
    realisations: int = 1
    dry: bool = True
    moving: bool = True


def six_joints() -> Robot:
    """The robot of section 6.6.1: `rx90b_3dof`'s first three joints, `rx90b`'s wrist without its flexibilities."""
    first, whole = rf.load_robot("rx90b_3dof"), rf.load_robot("rx90b")
    wrist = [e for e in whole.effects if not set(e.joints) & set(first.joints) and e.traits.part != "flexibility"]
    return whole.with_effects([*first.effects, *wrist])


def with_viscous_friction(robot: Robot) -> Robot:
    """Friction replaced by its slope at the speed of the reference, at the joints that rest as well."""
    rest = np.zeros((1, robot.model.nv))
    motion = robot.motion(rest, rest + robot.input_matrix @ np.full(6, SPEED), rest)
    effects: list[Effect] = [e for e in robot.effects if not e.traits.is_friction]
    for place, joint in enumerate(robot.joints):
        own = [e for e in robot.effects if e.traits.is_friction and e.joints == (joint,)]
        drive = int(np.argmax(robot.input_matrix[:, place]))
        slope = sum(float(e.derivatives(motion)[1][0][drive, drive]) for e in own)
        effects.append(ViscousFriction(joint=joint, coefficient=slope, side=friction_side(own, joint)))
    return robot.with_effects(effects)


def measure(case: Case, robot: Robot, folder: Path) -> MeasuredResponse:
    """Simulate a campaign where it is not there, and estimate its response."""
    name = f"{case.matrix}_{case.peak:g}_{len(case.signs)}_{case.realisations}_{'dry' if case.dry else 'viscous'}"
    path = folder / (name + ("_moving" if case.moving else "_frozen"))
    if not (path / "campaign.toml").exists():
        matrix = minus_below_first(3) if case.matrix == "ones" else identity(3)
        plan = section_662(
            robot if case.dry else with_viscous_friction(robot),
            load_cs8(),
            input_matrix=tuple(tuple(float(x) for x in row) for row in matrix),
            peak=case.peak,
            signs=case.signs,
            realisations=case.realisations,
            noise=NOISE,
            crest="clip",
            method="perturbation",
            manipulator="moving" if case.moving else "frozen",
        )
        result = run_campaign(plan, path)
        assert not result.failed, result.failed[0]
    return estimate_frequency_response(load_campaign(path / "campaign.toml"), joints=robot.joints[:3], band_hz=BAND_HZ)


def truth(robot: Robot, hz: Array) -> Array:
    """Response of the linear robot in the mean pose, joints 1 to 3, the wrist's drives held by their controllers as in the loop."""
    line = with_viscous_friction(robot)
    pose = np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    at = line.linearize(line.input_matrix @ pose)
    s = 2j * np.pi * hz[:, None, None]
    dynamics = at.K + s * at.D + s**2 * at.M
    for place, own in enumerate(load_cs8().for_joints(robot.joints).joints[3:], start=3):
        drive = np.outer(line.input_matrix[:, place], line.input_matrix[:, place])
        dynamics = dynamics + (own.position_gain + s * own.velocity_gain + own.integral_gain / s) * drive
    drives = line.input_matrix[:, :3]
    return np.asarray(s**2 * (drives.T @ np.linalg.solve(dynamics, drives.astype(complex)[None])))


def relative(found: Array, true: Array) -> Array:
    """Error of the diagonal over its magnitude, shape (F, 3)."""
    return np.abs(np.einsum("fjj->fj", found - true)) / np.abs(np.einsum("fjj->fj", true))


def in_bands(hz: Array, error: Array) -> str:
    """Medians of three columns below and above `SPLIT_HZ`, per cent."""
    parts = [np.median(error[rows], axis=0) for rows in (hz < SPLIT_HZ, hz >= SPLIT_HZ)]
    return "  |".join("".join(f"{100 * x:8.2f}" for x in part) for part in parts)


def main() -> None:
    """Run all cases and print; draw with `--figures`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--realisations", type=int, default=4, help="of figures 6.9 and 6.10; the source has 16")
    parser.add_argument("--folder", type=Path, help="keeps the campaigns")
    parser.add_argument("--figures", type=Path)
    options = parser.parse_args()
    if options.folder is None:
        with tempfile.TemporaryDirectory() as folder:
            study(Path(folder), options.realisations, options.figures)
    else:
        study(options.folder, options.realisations, options.figures)


def study(folder: Path, realisations: int, figures: Path | None) -> None:
    """All four comparisons."""
    robot, many = six_joints(), max(realisations, 2)
    partly = {
        "links linear, friction linear": Case(dry=False, moving=False),
        "links linear, friction dry": Case(moving=False),
        "links moving, friction linear": Case(dry=False),
        "links moving, friction dry": Case(),
    }
    matrices = {"one input at a time": Case(matrix="identity"), "ones, (6.50)": Case()}
    levels = {"45 N m": Case(realisations=many), "30 N m": Case(realisations=many, peak=30.0)}
    switched = {"switched": levels["45 N m"], "not switched": Case(realisations=2 * many, signs=(1,))}
    known: dict[Case, MeasuredResponse] = {}
    for case in (*partly.values(), *matrices.values(), *levels.values(), *switched.values()):
        if case not in known:
            known[case] = measure(case, robot, folder)
    hz = known[Case()].hz
    true = truth(robot, hz)

    print(f"Error of P_jj over its magnitude, median, %: joints 1 to 3 below {SPLIT_HZ:g} Hz | above")
    for title, cases in (("Figure 6.7, one realisation", partly), ("Figure 6.8, one realisation", matrices)):
        print(title)
        for name, case in cases.items():
            print(f"  {name:32s}{in_bands(hz, relative(known[case].value, true))}")
    print("Figures 6.9 and 6.10, one realisation, medians over the lines: joints 1 to 3 below the split | above")
    for name, case in {**levels, **switched}.items():
        found = known[case]
        print(f"  {name} ({case.realisations} realisations)")
        for what, ratio in (
            ("torque over noise", found.spectra.torque_snr),
            ("acceleration over noise", found.spectra.acceleration_snr),
            ("acceleration over distortion", found.acceleration_distortion),
        ):
            print(f"    {what:30s}{in_bands(hz, ratio / 100)}")
    for name, case in {**levels, **switched}.items():
        print(f"  {name:32s}{in_bands(hz, relative(known[case].value, true))}  error of P_jj, %")
    if figures is not None:
        figures.mkdir(parents=True, exist_ok=True)
        draw_errors(hz, true, {n: known[c] for n, c in partly.items()}).savefig(figures / "figure_6_7.png", dpi=100)
        draw_errors(hz, true, {n: known[c] for n, c in matrices.items()}).savefig(figures / "figure_6_8.png", dpi=100)
        draw_ratios({n: known[c] for n, c in levels.items()}).savefig(figures / "figure_6_9.png", dpi=100)
        draw_ratios({n: known[c] for n, c in switched.items()}, SPLIT_HZ).savefig(figures / "figure_6_10.png", dpi=100)


def draw_errors(hz: Array, true: Array, found: dict[str, MeasuredResponse]) -> Figure:
    """Magnitude of P_jj on the left, of its errors on the right."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    for j, (left, right) in enumerate(axes):
        left.semilogy(hz, np.abs(true[:, j, j]), "k", lw=1.0, label="linear robot")
        for name, response in found.items():
            left.semilogy(hz, np.abs(response.value[:, j, j]), lw=0.7)
            right.semilogy(hz, np.abs((response.value - true)[:, j, j]), lw=0.7, label=name)
        left.set_ylabel(f"|P{j + 1}{j + 1}|, rad/s² per N m")
        right.set_ylabel(f"error of P{j + 1}{j + 1}")
    for axis in axes[-1]:
        axis.set_xlabel("frequency, Hz")
    axes[0, 0].legend(fontsize=7)
    axes[0, 1].legend(fontsize=7)
    return figure


def draw_ratios(found: dict[str, MeasuredResponse], end_hz: float = BAND_HZ[1]) -> Figure:
    """Signal over noise of the torques on the left, of the accelerations on the right, with their distortion."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    for place, (name, response) in enumerate(found.items()):
        rows, colour = response.hz < end_hz, f"C{place}"
        hz = response.hz[rows]
        for j, (left, right) in enumerate(axes):
            left.semilogy(hz, response.spectra.torque_snr[rows, j], colour, lw=0.8, label=f"{name}: over noise")
            right.semilogy(hz, response.spectra.acceleration_snr[rows, j], colour, lw=0.8, label=f"{name}: over noise")
            distortion = response.acceleration_distortion[rows, j]
            right.semilogy(hz, distortion, colour, lw=0.8, ls="--", label=f"{name}: over distortion")
            left.set_ylabel(f"torque {j + 1}")
            right.set_ylabel(f"acceleration {j + 1}")
    for axis in axes[-1]:
        axis.set_xlabel("frequency, Hz")
    axes[0, 0].legend(fontsize=7)
    axes[0, 1].legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main()
