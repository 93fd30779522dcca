"""What an estimator is, and the list of all estimators."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from rx90b_flex.effects import Effect, close_match
from rx90b_flex.files.extensions import (
    ESTIMATORS,
    Brought,
    brought,
    concrete,
    import_all,
    own,
    subclasses,
    whose,
    wrong_class,
)
from rx90b_flex.identify.least_squares import Identification
from rx90b_flex.identify.regression import Regression


class Estimator(ABC):
    """Makes parameters with a covariance of the rows of a regression: measured torques and the columns that are to explain them.

    A concrete subclass in a module of this folder, or of another package that names it in the entry point group
    ``rx90b_flex.estimators``, can be chosen by its name.
    """

    @classmethod
    def name(cls) -> str:
        """Name in commands: the class name in snake case."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    @abstractmethod
    def identify(self, regression: Regression, effects: Sequence[Effect], *, fit_links: bool) -> Identification:
        """Identify a model.

        Parameters
        ----------
        regression : Regression
            Torques (N, joints), N m, and the columns of links and effects.
        effects : sequence of Effect
            The model beyond the tree; values that they have are starts.
        fit_links : bool
            Whether the links' inertial parameters are identified, too.
        """


def identified(
    estimator: Estimator, regression: Regression, effects: Sequence[Effect], *, fit_links: bool
) -> Identification:
    """What an estimator identifies.

    Raises
    ------
    ValueError
        One line that names whose it is, where it returned no identification, or one without numbers.
    """
    model = estimator.identify(regression, effects, fit_links=fit_links)
    why = ""
    if not isinstance(model, Identification):
        why = f"{'None' if model is None else type(model).__name__}; expected an Identification"
    elif len(model.effects) != len(effects) or np.shape(model.residual) != np.shape(regression.torque):
        shapes = [
            f"{n} effects and a residual of shape {np.shape(r)}"
            for n, r in ((len(model.effects), model.residual), (len(effects), regression.torque))
        ]
        why = "; expected ".join(shapes)
    elif not np.isfinite(model.theta).all():
        why = "parameters that are no numbers"
    if why:
        raise ValueError(f"estimator is {estimator.name()!r}; {whose(type(estimator))}: identify returned {why}")
    return model


def estimators() -> dict[str, type[Estimator]]:
    """All estimators by name."""
    import_all("rx90b_flex.identify.estimators")
    found = [*_from_others().things, *filter(own, filter(concrete, subclasses(Estimator)))]
    return {cls.name(): cls for cls in sorted(found, key=lambda cls: (own(cls), cls.name()))}


def estimator_named(name: str) -> Estimator:
    """An estimator by its name.

    Raises
    ------
    ValueError
        One line that names it and the nearest one, or the package that should bring it.
    """
    known = estimators()
    if name not in known:
        why = _from_others().why_missing(name) or f"; {close_match(name, list(known))}"
        raise ValueError(f"estimator is {name!r}{why}")
    return known[name]()


def _from_others() -> Brought:
    return brought(ESTIMATORS, _why_no_estimator)


def _why_no_estimator(found: Any) -> str:
    """What is wrong with an estimator that another package brings; empty: nothing."""
    wrong = wrong_class(found, Estimator)
    if not wrong and any(own(sub) and sub.__name__ == found.__name__ for sub in subclasses(Estimator)):
        return f"there is an estimator {found.name()!r} already"
    return wrong
