"""Whether links that a robot file calls known stand behind what was added to it."""

from __future__ import annotations

from rx90b_flex.diagnose.loop import Standing
from rx90b_flex.diagnose.search import Search
from rx90b_flex.diagnose.torque import TorqueModel, TorqueResidual, find_added
from rx90b_flex.diagnose.trial import TorqueTrial
from rx90b_flex.identify.least_squares import identify

LINKS_OFF = 0.8  # of the error held out that is left where links are fitted: what they take is no effect's


def if_links_are_off(
    residual: TorqueResidual, standing: Standing[TorqueModel, TorqueTrial], left: float
) -> tuple[tuple[str, ...], bool]:
    """What would be otherwise if links that are declared as known were fitted, and whether that puts the names in doubt.

    One effect that stands for all that is wrong with the links is a name that explains as much with less; several are not.

    Parameters
    ----------
    residual : TorqueResidual
    standing : Standing
        Where the loop ended.
    left : float
        Relative error held out.
    """
    data, model = residual.data, standing.model.identified
    if model.links_fitted:
        return (), False
    free = identify(model.regression, model.effects, fit_links=True, start=model, with_covariance=False)
    less = data.errors(data.validation, free).told.relative_error
    search, words = Search(free, residual.sites), []
    if less < LINKS_OFF * left:
        words.append(f"they would leave {less:.2%} of the torque held out instead of {left:.2%}")
    added = find_added(TorqueModel(free, data), standing.steps)
    spare = [e.label for e in added if not search.without(e).accepted]
    if spare:
        words.append(f"{', '.join(spare)} would not be needed")
    if not words:
        return (), False
    text = (
        f"The links are declared as known. If they were fitted, {' and '.join(words)}: masses or inertias of the URDF may be "
        'off, and what was added stand for that. inertial_parameters = "fitted" in the robot file asks so.'
    )
    return (text,), less < LINKS_OFF * left or len(spare) > 1
