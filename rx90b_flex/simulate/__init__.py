"""The robot under its controller: trajectories, the CS8, closed-loop simulation."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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

# loaded when they are asked for, so that one name does not cost the libraries of all
_HOME = {
    "CS8": "rx90b_flex.simulate.cs8",
    "CampaignResult": "rx90b_flex.simulate.campaign",
    "JointController": "rx90b_flex.simulate.cs8",
    "Noise": "rx90b_flex.simulate.closed_loop",
    "CampaignPlan": "rx90b_flex.simulate.campaign",
    "RawLog": "rx90b_flex.simulate.closed_loop",
    "Simulation": "rx90b_flex.simulate.closed_loop",
    "Trajectory": "rx90b_flex.simulate.trajectories",
    "design_cs8": "rx90b_flex.simulate.cs8",
    "design_gains": "rx90b_flex.simulate.cs8",
    "drive_compliance": "rx90b_flex.simulate.cs8",
    "from_recording": "rx90b_flex.simulate.trajectories",
    "harmonics": "rx90b_flex.simulate.trajectories",
    "load_cs8": "rx90b_flex.simulate.cs8",
    "multisine": "rx90b_flex.excitation",
    "perturb_lanes": "rx90b_flex.simulate.perturbation",
    "rigid_inertia": "rx90b_flex.simulate.cs8",
    "run_campaign": "rx90b_flex.simulate.campaign",
    "save_cs8": "rx90b_flex.simulate.cs8",
    "section_662": "rx90b_flex.simulate.campaign",
    "simulate": "rx90b_flex.simulate.closed_loop",
    "simulate_lanes": "rx90b_flex.simulate.closed_loop",
    "sine_excitation": "rx90b_flex.simulate.trajectories",
    "square_wave": "rx90b_flex.simulate.trajectories",
    "static_start": "rx90b_flex.simulate.closed_loop",
    "straight_line": "rx90b_flex.simulate.trajectories",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
