"""How dry friction turns over, asked again once an addition took most of what hid it."""

from __future__ import annotations

import numpy as np

from rx90b_flex.effects.reversal import begun_wider
from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression

FELL = 0.5  # of a joint's error: what is left says other things than what there was
BETTER = 1e-3  # of the log error, all joints together


def turned_over_again(regression: Regression, model: Identification, before: Identification) -> Identification:
    """A fit, or a better one in which dry friction turns over more widely on joints whose error fell by half and more.

    Beside a large error a turn-over may end at a step, which no derivative leaves again.
    """
    fell = model.solution.sigma < FELL * before.solution.sigma
    joints = {joint for joint, less in zip(regression.joints, fell, strict=False) if less}  # behind them sensors
    effects = begun_wider(model.effects, regression.longest, joints)
    if not effects:
        return model
    other = identify(regression, effects, fit_links=model.links_fitted, start=model)
    less = np.log(model.solution.sigma).sum() - np.log(other.solution.sigma).sum()
    return other if less > BETTER else model
