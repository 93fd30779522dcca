"""Identified robots for simulators: as URDF, MJCF (MuJoCo) and SDF (Gazebo), and what each of them cannot hold."""

from rx90b_flex.simulators.exporting import Exported, export_robot
from rx90b_flex.simulators.held import Lost

__all__ = ["Exported", "Lost", "export_robot"]
