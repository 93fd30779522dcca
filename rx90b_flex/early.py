"""What a command reads, checked before the libraries of its work are loaded: a wrong input is refused at once."""

from __future__ import annotations

from pathlib import Path

from rx90b_flex.files.toml import named_in
from rx90b_flex.signals.recording import Campaign, load_campaign

LONGEST_S = 86400.0  # of a simulated motion; a longer one is a slip of the decimal point
MOST_JOBS = 256  # processes


def read_campaign(path: Path) -> Campaign:
    """A campaign whose robot is there and has its joints.

    Raises
    ------
    ValueError
        One line that names the file and what is wrong in it.
    """
    campaign = load_campaign(path)
    from rx90b_flex.robot import load_robot

    with named_in(campaign.path, "robot"):
        robot = load_robot(campaign.robot_source)
    for joint in campaign.joints:
        if joint not in robot.joints:
            try:
                robot.restricted([joint])
            except ValueError as error:
                raise ValueError(f"{campaign.path}: joints: {error}") from None
    return campaign


def campaign_path(source: str) -> Path | None:
    """Of a folder with a campaign file, or of a file that is one; None where the name is neither.

    Raises
    ------
    ValueError
        A folder without a campaign file.
    """
    path = Path(source)
    if path.is_dir():
        inside = path / "campaign.toml"
        if not inside.is_file():
            raise ValueError(f"{path}: no campaign.toml in it; expected a folder of `rx90b-flex simulate`")
        return inside
    is_one = path.suffix == ".toml" and path.is_file() and b"[[recording]]" in path.read_bytes()
    return path if is_one else None


def check_jobs(jobs: int) -> None:
    """Refuse a number of processes that cannot be meant.

    Raises
    ------
    ValueError
        One line that names it.
    """
    if not 1 <= jobs <= MOST_JOBS:
        raise ValueError(f"jobs is {jobs}; expected 1 to {MOST_JOBS}")
