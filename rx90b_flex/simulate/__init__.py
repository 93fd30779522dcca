"""The robot under its controller: trajectories, the CS8, closed-loop simulation."""

from typing import TYPE_CHECKING

from rx90b_flex.on_demand import names_of

if TYPE_CHECKING:
    from rx90b_flex.excitation import multisine
    from rx90b_flex.simulate.campaign import CampaignPlan, CampaignResult, run_campaign, section_662
    from rx90b_flex.simulate.closed_loop import Noise, RawLog, Simulation, simulate, simulate_lanes, static_start
    from rx90b_flex.simulate.cs8 import (
        CS8,
        JointController,
        design_cs8,
        design_gains,
        drive_compliance,
        load_cs8,
        rigid_inertia,
        save_cs8,
    )
    from rx90b_flex.simulate.perturbation import perturb_lanes
    from rx90b_flex.simulate.trajectories import (
        Trajectory,
        from_recording,
        harmonics,
        sine_excitation,
        square_wave,
        straight_line,
    )

__all__ = [
    "CS8",
    "CampaignPlan",
    "CampaignResult",
    "JointController",
    "Noise",
    "RawLog",
    "Simulation",
    "Trajectory",
    "design_cs8",
    "design_gains",
    "drive_compliance",
    "from_recording",
    "harmonics",
    "load_cs8",
    "multisine",
    "perturb_lanes",
    "rigid_inertia",
    "run_campaign",
    "save_cs8",
    "section_662",
    "simulate",
    "simulate_lanes",
    "sine_excitation",
    "square_wave",
    "static_start",
    "straight_line",
]

__getattr__ = names_of(__name__)
