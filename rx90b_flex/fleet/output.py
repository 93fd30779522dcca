"""Write what was found on a fleet: ``fleet.csv``, ``fleet.json`` and ``fleet.html``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rx90b_flex.files.results import write_json
from rx90b_flex.fleet.fleet import Fleet
from rx90b_flex.fleet.make import MakeParameter, RobotValue
from rx90b_flex.fleet.robots import Outcome
from rx90b_flex.fleet.statistics import LEVEL, STANDS_OUT
from rx90b_flex.signals.folders import FLEET, fill_folder

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = 1
COLUMNS = (
    "robot", "verdict", "type", "place", "parameter", "unit", "value", "std", "present", "p_value", "stands_out", "since", "until",
    "before", "before_std", "make_mean", "make_low", "make_high", "between_std", "between_low", "between_high", "robots", "reason",
)  # fmt: skip


def fleet_table(fleet: Fleet) -> pd.DataFrame:
    """A row a robot and parameter, columns `COLUMNS`; a robot that is not compared has one row with its reason."""
    import pandas as pd

    rows = []
    for robot in fleet.robots:
        own = [(p, v) for p in fleet.parameters for v in p.values if v.robot == robot.name]
        rows += [_row(robot, p, v) for p, v in own] or [
            {"robot": robot.name, "verdict": robot.verdict, "reason": robot.reason}
        ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _row(robot: Outcome, p: MakeParameter, v: RobotValue) -> dict[str, Any]:
    make = {"make_mean": p.summary.mean, "make_low": p.summary.low, "make_high": p.summary.high, **_make(p)}
    own = _fields(p, "type", "place", "parameter", "unit")
    return make | own | dataclasses.asdict(v) | {"verdict": robot.verdict, "reason": robot.reason}


def _make(p: MakeParameter) -> dict[str, Any]:
    """The summary over a make; how many robots it is made of is called ``robots``."""
    content = dataclasses.asdict(p.summary)
    return {"robots": content.pop("count"), **content}


def fleet_json(fleet: Fleet) -> dict[str, Any]:
    """The content of ``fleet.json``, schema 1."""
    return {
        "schema": SCHEMA,
        "interval": LEVEL,
        "stands_out_below": STANDS_OUT,
        "robots": [_robot(fleet, o) for o in fleet.robots],
        "parameters": [_parameter(p) for p in fleet.parameters],
    }


def _robot(fleet: Fleet, o: Outcome) -> dict[str, Any]:
    before, after = (None if e is None else e.validation.relative_error for e in (o.before, o.after))
    out = fleet.standing_out(o.name)
    return {
        "name": o.name,
        "robot": o.robot or None,
        "verdict": o.verdict,
        "reason": o.reason or None,
        "dates": list(o.dates),
        "relative_error": None if before is None or after is None else {"before": before, "after": after},
        "found": [e.label for e in o.found],
        "stands_out": [
            _fields(p, "type", "place", "parameter") | _fields(v, "since", "until", "before", "before_std", "p_value")
            for p, v in out
        ],
    }


def _parameter(p: MakeParameter) -> dict[str, Any]:
    joints = list(p.effect.joints) if p.effect is not None else []
    shape = {} if p.effect is None else dict(zip(p.effect.shape_parameters, map(float, p.effect.shape), strict=True))
    return {
        "type": p.type,
        "joint": joints[0] if len(joints) == 1 else None,
        **({"joints": joints} if len(joints) > 1 else {}),
        **_fields(p, "place", "parameter", "unit"),
        # whoever lacks the effect was asked for it in this shape
        **({} if p.present == len(p.values) or not shape else {"shape": shape}),
        **_fields(p, "present", "tested"),
        "make": _make(p),
        "values": [dataclasses.asdict(v) for v in p.values],
    }


def _fields(of: object, *names: str) -> dict[str, Any]:
    return {name: getattr(of, name) for name in names}


def write_fleet(fleet: Fleet, folder: Path, overwrite: bool = False) -> None:
    """Write table and page beside the robots' folders; all of it or nothing."""
    from rx90b_flex.view.fleet_report import write_fleet_report

    def fill(at: Path) -> None:
        write_json(at / "fleet.json", fleet_json(fleet))
        fleet_table(fleet).to_csv(at / "fleet.csv", index=False)
        write_fleet_report(fleet, at / "fleet.html")

    fill_folder(folder, fill, FLEET, overwrite)
