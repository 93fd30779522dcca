"""Closing the loop on logs with something between robot and log (`log_effects.py`, which shares no code with the package)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import independent as ind
import log_effects
import numpy as np
import pytest
from marked import by_cost

import rx90b_flex as rf

RATE_HZ, CUTOFF_HZ, PERIOD_S = 200.0, 20.0, 10.0
JOINTS = tuple(ind.ur10().joints)
COULOMB, VISCOUS = (10.0, 10.0, 6.0, 1.5, 1.5, 1.0), (20.0, 20.0, 12.0, 3.0, 3.0, 2.0)
NOISE = 0.01  # of a joint's root mean square torque, white, as logged
POSITION_NOISE = 2e-6  # rad
DEVIATIONS = 4.0
# joint, values: sizes that an engineer would meet, which stand three times or more out of the noise
HIDDEN: dict[str, tuple[int | None, dict[str, float]]] = {
    "resolver_error": (1, {"order": 24.0, "amplitude": 3e-4, "phase": 0.5}),
    "transmission_error": (2, {"order": 15.0, "amplitude": 1.5e-3, "phase": -1.0}),
    "torque_delay": (None, {"delay": 0.004}),
    "motor_saturation": (1, {"coefficient": 2e-6}),
    "line_interference": (3, {"frequency_hz": 16.7, "amplitude": 0.3, "phase": 1.2}),
    "friction_drift": (0, {"coefficient": 4.0, "time_constant": 9.0}),
    "presliding_friction": (2, {"torque": 6.0, "stiffness": 400.0}),
}


def campaign(folder: Path, kind: str, seed: int) -> Path:
    """Two recordings to identify on, one to validate on; Coulomb and viscous friction declared."""
    rng, arm = np.random.default_rng(seed), ind.ur10()
    joint, values = HIDDEN[kind]
    # sampled, a step of dry friction shows to the nearest sample only when it came: a delay of less than one needs a smooth torque
    coulomb = np.zeros(len(JOINTS)) if kind == "torque_delay" else COULOMB
    time = np.arange(round(2 * PERIOD_S * RATE_HZ)) / RATE_HZ
    runs = []
    for role in ("identification", "identification", "validation"):
        run = log_effects.Experiment.draw(rng, PERIOD_S, 1.5, coulomb, VISCOUS)
        position, torque = log_effects.log(kind, arm, run, time, joint, values)
        noise = NOISE * np.sqrt((torque**2).mean(axis=0))
        motion = ind.Motion(time, position + POSITION_NOISE * rng.normal(size=position.shape), position, position)
        runs.append(ind.Run(role, motion, torque + noise * rng.normal(size=torque.shape), PERIOD_S))
    declared: list[Mapping[str, object]] = [
        {"type": name, "joint": j} for j in JOINTS for name in ("coulomb_friction", "viscous_friction")
    ]
    return ind.write_files(folder, arm, declared, runs, cutoff_hz=CUTOFF_HZ)


@pytest.mark.slow
@pytest.mark.parametrize("kind", by_cost(HIDDEN, long={"transmission_error", "line_interference"}))
def test_an_effect_between_robot_and_log_is_found_where_it_is_with_its_values(kind, tmp_path):
    joint, values = HIDDEN[kind]
    result = rf.close_loop(campaign(tmp_path, kind, seed=0))
    first = result.effects[0]
    assert first.effect.type_name() == kind
    assert first.effect.joints == (() if joint is None else (JOINTS[joint],))
    for p in first.parameters:
        assert p.value is not None and p.std is not None
        error = p.value - values[p.name]
        if p.name == "phase":
            error = (error + np.pi) % (2 * np.pi) - np.pi
        assert abs(error) < DEVIATIONS * p.std, p
    assert result.after.validation.relative_error < result.before.validation.relative_error
