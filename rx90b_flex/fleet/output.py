"""Write what was found on a fleet: ``fleet.csv``, ``fleet.json`` and ``fleet.html``."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    over = p.summary
    return {
        "robot": robot.name, "verdict": robot.verdict, "type": p.type, "place": p.place, "parameter": p.parameter, "unit": p.unit,
        "value": v.value, "std": v.std, "present": v.present, "p_value": v.p_value, "stands_out": v.stands_out, "since": v.since,
        "until": v.until, "before": v.before, "before_std": v.before_std, "make_mean": over.mean, "make_low": over.low,
        "make_high": over.high, "between_std": over.between_std, "between_low": over.between_low, "between_high": over.between_high,
        "robots": over.count, "reason": robot.reason,
    }  # fmt: skip


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
    return {
        "name": o.name,
        "robot": o.robot or None,
        "verdict": o.verdict,
        "reason": o.reason or None,
        "dates": list(o.dates),
        "relative_error": None
        if o.before is None or o.after is None
        else {"before": o.before.validation.relative_error, "after": o.after.validation.relative_error},
        "found": [e.label for e in o.found],
        "stands_out": [
            {
                "type": p.type,
                "place": p.place,
                "parameter": p.parameter,
                "since": v.since,
                "until": v.until,
                "before": v.before,
                "before_std": v.before_std,
                "p_value": v.p_value,
            }
            for p, v in fleet.standing_out(o.name)
        ],
    }


def _parameter(p: MakeParameter) -> dict[str, Any]:
    joints = list(p.effect.joints) if p.effect is not None else []
    shape = {} if p.effect is None else dict(zip(p.effect.shape_names(), map(float, p.effect.shape), strict=True))
    return {
        "type": p.type,
        "joint": joints[0] if len(joints) == 1 else None,
        **({"joints": joints} if len(joints) > 1 else {}),
        "place": p.place,
        "parameter": p.parameter,
        "unit": p.unit,
        # whoever lacks the effect was asked for it in this shape
        **({} if p.present == len(p.values) or not shape else {"shape": shape}),
        "present": p.present,
        "tested": p.tested,
        "make": {
            "robots": p.summary.count, "mean": p.summary.mean, "low": p.summary.low, "high": p.summary.high,
            "between_std": p.summary.between_std, "between_low": p.summary.between_low, "between_high": p.summary.between_high,
        },
        "values": [dataclasses.asdict(v) for v in p.values],
    }  # fmt: skip


def write_fleet(fleet: Fleet, folder: Path, overwrite: bool = False) -> None:
    """Write table and page beside the robots' folders; all of it or nothing."""
    from rx90b_flex.view.fleet_report import write_fleet_report

    def fill(at: Path) -> None:
        text = json.dumps(fleet_json(fleet), indent=2, allow_nan=False)
        (at / "fleet.json").write_text(text + "\n", encoding="utf-8")
        fleet_table(fleet).to_csv(at / "fleet.csv", index=False)
        write_fleet_report(fleet, at / "fleet.html")

    fill_folder(folder, fill, FLEET, overwrite)
