"""The grey box on the campaign of section 6.6.2, with what each of its parts is worth, and with links that are 2 % wrong.

    rx90b-flex campaigns are made by `rx90b_flex.simulate.run_campaign(section_662(...), folder)`; then
    python benchmarks/grey_box.py folder/campaign.toml

Prints, for each way of fitting, the errors against the declared robot (the truth of a simulated campaign) in per cent, and how many
95 % intervals of stiffness and inertia hold it.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import time
from pathlib import Path

import numpy as np

from rx90b_flex.export import with_link_parameters
from rx90b_flex.identify.frequency_response import FrequencyResponse
from rx90b_flex.identify.frf import estimate_frequency_response
from rx90b_flex.identify.frf_command import feedback_of, mean_motion
from rx90b_flex.identify.grey_box import GreyBox, grey_box, poses_along
from rx90b_flex.robot import Robot, load_robot
from rx90b_flex.signals import load_campaign
from rx90b_flex.simulate import load_cs8

KINDS = ("drive_inertia", "drive_stiffness", "joint_stiffness")


def show(name: str, grey: GreyBox, seconds: float) -> None:
    """One line a fit: largest errors by kind, intervals, cost."""
    parts, inside = [], []
    for kind in KINDS:
        own = [e for e in grey.estimates if f".{kind}" in e.name]
        parts.append(" ".join(f"{100 * (e.value / e.start - 1):+5.1f}" for e in own))
        inside += [e.low <= e.start <= e.high for e in own]
    print(
        f"{name:<42} {' | '.join(parts)} | {sum(inside)}/{len(inside)} | {grey.cost / grey.expected_cost:.2f} | {seconds:.1f} s"
    )


def main() -> None:
    """Fit in several ways."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", type=Path)
    path = parser.parse_args().campaign
    campaign = load_campaign(path)
    robot: Robot = load_robot(campaign.robot_source)
    began = time.perf_counter()
    measured = estimate_frequency_response(campaign, band_hz=(8.0, 80.0))
    print(
        f"nonparametric estimate: {time.perf_counter() - began:.1f} s, {measured.degrees_of_freedom:g} degrees of freedom"
    )
    motion = mean_motion(campaign.identification, robot.joints)
    plain = {f.name: getattr(measured, f.name) for f in dataclasses.fields(FrequencyResponse)}
    data = FrequencyResponse(**plain)
    loop = {
        "along": [poses_along(motion)],
        "feedback": feedback_of(load_cs8(path.parent / "controller.toml"), data.joints),
    }
    full = {**loop, "torques": [measured.torque]}
    print("errors in per cent: inertia of drives | stiffness of drives | of joints | intervals that hold | cost | time")
    fits = {
        "mean pose, model exact": {"model_error": 0.0, "friction_error": 0.0},
        "poses in closed loop, model exact": {**loop, "model_error": 0.0, "friction_error": 0.0},
        "and friction of each experiment": {**full, "model_error": 0.0, "friction_error": 0.0},
        "and a stated model error": full,
        "and bearings alike to 10 %": {**full, "bending_alike_std": 0.1},
    }
    for name, arguments in fits.items():
        began = time.perf_counter()
        grey = grey_box(robot, data, starts=4, **arguments)
        show(name, grey, time.perf_counter() - began)
    for wrong in itertools.product((0.98, 1.02), repeat=len(robot.bodies)):
        scaled = np.repeat(wrong, 10) * robot.link_parameters
        other = with_link_parameters(robot, scaled, allow_inconsistent=True)
        for std in (0.0, 0.02):
            began = time.perf_counter()
            grey = grey_box(other, data, starts=0, link_mass_std=std, **fits["and bearings alike to 10 %"])
            show(f"links times {wrong}, {'known' if std == 0 else 'to 2 %'}", grey, time.perf_counter() - began)


if __name__ == "__main__":
    main()
