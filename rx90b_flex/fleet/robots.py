"""What is done for one robot of a fleet, in whatever process: close its loop once, read what was written, fit it again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from rx90b_flex.closing import LoopOptions, close_campaign
from rx90b_flex.diagnose.basics import declared_robot
from rx90b_flex.diagnose.refused import DATA_FAULT
from rx90b_flex.diagnose.residual import Errors, RoleErrors
from rx90b_flex.effects import Effect
from rx90b_flex.fleet.second_fit import SecondFit, found_effects, second_fit
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign
from rx90b_flex.signals.folders import CLOSED_LOOP, files_read

REFUSED = "refused"  # in place of a verdict
CONTENT = {"verdict", "robot", "before", "after", "effects", "data_faults"}  # of a result that is read


@dataclass(frozen=True)
class Task:
    """One robot's campaign, and the folder for its result.

    Attributes
    ----------
    name : str
    campaign, folder : Path
        Absolute: other machines see the same folders.
    options : Options
    """

    name: str
    campaign: Path
    folder: Path
    options: LoopOptions

    @property
    def done(self) -> bool:
        """Whether its result is there, as a whole: what is damaged is made again."""
        return self.content is not None

    @property
    def content(self) -> dict[str, Any] | None:
        """Of its ``closed_loop.json``; None where there is none, or one that no run wrote."""
        try:
            content = json.loads((self.folder / CLOSED_LOOP.mark).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        whole = isinstance(content, dict) and content.keys() >= CONTENT
        return content if whole else None

    @property
    def digest(self) -> str:
        """Of everything that decides its result, hexadecimal: options, campaign file, recordings, robot and controller."""
        state = hashlib.sha256(repr(self.options).encode())
        for path in files_read(self.campaign):
            state.update(b"\0" + path.name.encode() + b"\0")
            if path.is_file():
                with path.open("rb") as file:
                    state.update(hashlib.file_digest(file, "sha256").digest())
        return state.hexdigest()


@dataclass(frozen=True)
class Outcome:
    """What closing one robot's loop came to; the content of its ``closed_loop.json``.

    Attributes
    ----------
    name : str
        Of its folder.
    campaign : Path
    robot : str
        Empty where the campaign was refused.
    verdict : str
        As in ``closed_loop.json``, or ``refused``.
    reason : str
        Why it was refused, in one line; what is wrong with the data where the verdict is ``data_fault``; else empty.
    before, after : RoleErrors or None
    found : tuple of Effect
        What the loop added, with its values.
    p_values : tuple of float
        That it is not there, one each.
    dates : tuple of str
        Of its recordings, earliest first (ISO 8601).
    """

    name: str
    campaign: Path
    robot: str
    verdict: str
    reason: str = ""
    before: RoleErrors | None = None
    after: RoleErrors | None = None
    found: tuple[Effect, ...] = ()
    p_values: tuple[float, ...] = ()
    dates: tuple[str, ...] = ()

    @property
    def compared(self) -> bool:
        """Whether it is one of the robots that are compared."""
        return self.verdict not in (REFUSED, DATA_FAULT)

    @staticmethod
    def refused(task: Task, reason: str) -> Outcome:
        """Of a campaign that cannot be used."""
        return Outcome(task.name, task.campaign, "", REFUSED, " ".join(reason.split()))


def close_robot(task: Task) -> Outcome:
    """Close the loop on one robot's campaign and write its folder, unless it is there already.

    A campaign that cannot be used is an outcome; a folder that cannot be written is an error.

    Raises
    ------
    ValueError
        One line that names the folder.
    """
    if not task.done:
        try:
            closed = close_campaign(task.campaign, task.options)
        except (ValueError, OSError, MemoryError) as error:
            return Outcome.refused(task, str(error) or "not enough memory")
        except Exception as error:  # a fault of the program: the others go on
            return Outcome.refused(task, f"{task.campaign}: a fault of the program: {type(error).__name__}: {error}")
        closed.write(task.folder)
    return read_outcome(task)


def read_outcome(task: Task) -> Outcome:
    """What a robot's folder says, of this run or an earlier one.

    Raises
    ------
    ValueError
        One line that names a file that cannot be read.
    """
    content = task.content
    if content is None:
        raise ValueError(f"{task.folder / CLOSED_LOOP.mark}: cannot be read; expected what an earlier run wrote")
    if content["verdict"] == DATA_FAULT:
        reason = " ".join(f["message"] for f in content["data_faults"])
        return Outcome(task.name, task.campaign, content["robot"], DATA_FAULT, reason)
    campaign = load_campaign(task.campaign)
    declared = declared_robot(campaign, task.options.basics)
    found = found_effects(declared, load_robot(task.folder / "robot.toml"), campaign.joints)
    return Outcome(
        task.name, task.campaign, content["robot"], content["verdict"], "", _errors(content["before"]), _errors(content["after"]),
        found, tuple(_p_value(e, content["effects"]) for e in found),
        tuple(sorted({r.date for r in campaign.recordings if r.date is not None})),
    )  # fmt: skip


def _errors(content: dict[str, Any]) -> RoleErrors:
    of = {role: Errors(e["relative_error"], tuple(e["torque_rms"])) for role, e in content.items()}
    return RoleErrors(of["validation"], of["identification"])


def _p_value(effect: Effect, entries: Sequence[dict[str, Any]]) -> float:
    """The smallest among effects of its type in its place."""
    joints = list(effect.joints)
    here = [e for e in entries if e["type"] == effect.type_name()]
    here = [e for e in here if (e.get("joints") or ([e["joint"]] if e["joint"] else [])) == joints]
    return min((float(e["p_value"]) for e in here), default=1.0)


def fit_again(
    task: Task, found: Sequence[Effect], common: Sequence[Effect], others: Sequence[Effect], robots: int
) -> SecondFit | str:
    """The second fit of a robot whose loop was closed (`rx90b_flex.fleet.second_fit`), or why there is none."""
    try:
        campaign = load_campaign(task.campaign)
        # as in the loop: threads would wait for each other longer than they work
        with threadpool_limits(limits=1, user_api="blas"):
            return second_fit(campaign, declared_robot(campaign, task.options.basics), found, common, others, robots)
    except Exception as error:  # of one robot: the others are compared
        return f"{task.campaign}: not compared: {type(error).__name__}: {' '.join(str(error).split())}"
