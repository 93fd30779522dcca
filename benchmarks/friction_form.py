"""The replay where friction's form is wrong: the real robot's Stribeck velocity or a power differs by 30 % from the declared.

    python benchmarks/friction_form.py --folder /tmp/form --seed 0

Campaigns of section 6.6.2 with two periods kept, by the perturbation method; those in the folder are used again. The robot that is
fitted is declared wrong as in `grey_box.py`. Prints, as measured and by replay, errors in per cent, 95 % intervals that hold, and how
far the drive points of one realisation deviate.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np
from grey_box import BAND_HZ, declared_wrong, show, timed

from rx90b_flex.identify.frf import estimate_frequency_response
from rx90b_flex.identify.frf_command import feedback_of, mean_motion
from rx90b_flex.identify.grey_box import grey_box
from rx90b_flex.identify.grey_data import GreyBoxOptions, PoseResponse
from rx90b_flex.identify.grey_model import declared_parameters
from rx90b_flex.identify.replay import Replay, grey_box_by_replay
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import load_campaign
from rx90b_flex.simulate import load_cs8, run_campaign, section_662
from rx90b_flex.simulate.excite import NOISE

CASES = {  # effect and the factors of its shape
    "form right": ("stribeck_friction", (1.0, 1.0)),
    "velocity x1.3": ("stribeck_friction", (1.3, 1.0)),
    "velocity x0.7": ("stribeck_friction", (0.7, 1.0)),
    "power x1.3": ("stribeck_friction", (1.0, 1.3)),
    "power x0.7": ("stribeck_friction", (1.0, 0.7)),
    "viscous power x1.3": ("viscous_power_friction", (1.3,)),
}


def reshaped(robot: Robot, kind: str, factors: tuple[float, ...]) -> Robot:
    """The robot with the first shapes of all effects of a kind times factors."""
    return robot.with_effects(
        [
            dataclasses.replace(
                e,
                **{name: factor * getattr(e, name) for name, factor in zip(e.shape_parameters, factors, strict=False)},
            )
            if e.type_name() == kind
            else e
            for e in robot.effects
        ]
    )


def main() -> None:
    """Simulate and fit, case by case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True, help="for the campaigns")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    options = parser.parse_args()
    true, controller = load_robot("rx90b_3dof"), load_cs8()
    truth, declared = declared_parameters(true), declared_wrong(true, 0.2, 0.1, options.seed)
    chosen = GreyBoxOptions(starts=0, bending_alike_std=0.1)
    print("errors in per cent: inertia of drives | stiffness of drives | of joints | intervals that hold | processor")
    for case in options.cases:
        path = options.folder / f"{options.seed}_{case.replace(' ', '_')}"
        if not (path / "campaign.toml").exists():
            real = reshaped(true, *CASES[case])
            sizes = {"periods": 3, "seed": options.seed}
            run_campaign(section_662(real, controller, noise=NOISE, method="perturbation", **sizes), path)
        runs = load_campaign(path / "campaign.toml").identification
        measured = estimate_frequency_response(runs, band_hz=BAND_HZ)
        data = PoseResponse.of(measured, mean_motion(runs, declared.joints), feedback_of(controller, measured.joints))
        first, seconds = timed(lambda data=data: grey_box(declared, [data], chosen))
        print(case)
        show("  as measured", first, truth, seconds)
        replay = Replay.of(runs, measured, controller)
        better, seconds = timed(lambda first=first, replay=replay: grey_box_by_replay(declared, first, replay))
        show("  by replay", better.grey, truth, seconds)
        before, after = (100 * np.median(np.diag(x[0])) for x in (better.before, better.after))
        print(f"  drive points deviate by {before:.2f} % as measured, by {after:.2f} % less the replay", flush=True)


if __name__ == "__main__":
    main()
