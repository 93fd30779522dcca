"""Levenberg and Marquardt's descent, on goals whose lowest place is known."""

from dataclasses import dataclass

import numpy as np
import pytest

from rx90b_flex.levenberg import Iterate, damped_step, descent, lowest


@dataclass(frozen=True, eq=False)
class Valley(Iterate):
    """Rosenbrock's: residuals ``10 (y - x^2)`` and ``1 - x``; beyond `edge` its goal is no number."""

    at: np.ndarray
    edge: float = np.inf

    @property
    def residual(self):
        x, y = self.at
        return np.array([10.0 * (y - x**2), 1.0 - x])

    @property
    def goal(self):
        return float(self.residual @ self.residual) if self.at[0] < self.edge else np.nan

    @property
    def enough(self):
        return 1e-12

    def equations(self):
        slope = np.array([[-20.0 * self.at[0], 10.0], [-1.0, 0.0]])
        return slope.T @ slope, -slope.T @ self.residual

    def moved(self, step):
        return Valley(self.at + step, self.edge)


def test_it_ends_at_the_bottom_of_a_bent_valley():
    assert lowest(Valley(np.array([-1.2, 1.0])), 200).at == pytest.approx([1.0, 1.0], abs=1e-5)


def test_every_place_on_the_way_lies_lower():
    goals = [place.goal for place in descent(Valley(np.array([-1.2, 1.0])), 200)]
    assert len(goals) > 3
    assert (np.diff(goals) < 0.0).all()


def test_from_no_number_it_does_not_go_anywhere():
    assert lowest(Valley(np.array([2.0, 1.0]), edge=0.5), 200).at == pytest.approx([2.0, 1.0])


def test_it_does_not_step_to_where_the_goal_is_no_number():
    end = lowest(Valley(np.array([-1.2, 1.0]), edge=0.5), 400)
    assert end.at[0] < 0.5
    assert end.goal < 1.0


def test_what_only_rounding_tells_stays_where_it_is():
    jacobian = np.array([[1.0, 3e-17], [2.0, -1e-17], [0.5, 2e-17]])
    step = damped_step(jacobian.T @ jacobian, jacobian.T @ np.array([1.0, 0.3, -2.0]), 1e-10)
    assert step[1] == 0.0 and step[0] == pytest.approx(0.6 / 5.25)
