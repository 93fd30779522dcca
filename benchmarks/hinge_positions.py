"""Where the hinges of table D.1's robot lie, from the table's column p(E).

No motion can tell to which of its two links a point mass at a hinge belongs. Table D.1's essential parameters p(E) (equation 4.8)
therefore are its parameters p less what 4 + 15 of the 78 directions hold: link 1's mass, the point masses at the hinges of joints
2, 3 and 4, and fifteen parameters that p(E) prints as next to nothing (eleven of links, four asperity torques). So p(E) - p, read
the other way round, tells the hinges: for masses d moved from the link before a hinge at c to the link behind it,

    p(E)_behind = p_behind + d (1, 0, 0),      p(E)_before = p_before - d (1, c, c'c I - c c').

Least squares over the 28 remaining link values, each weighed with the rounding of its two printed numbers; the moved masses follow
from the projection, with each parameter as the scale of its column. Standard deviations are widened by what is left over.

    python benchmarks/hinge_positions.py
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import optimize

from rx90b_flex.effects.motion import Array

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import test_rx90b as source

SHOULDER_M = 0.42  # above the floor: the maker's table
STARTS = ((0.0, 0.32, 0.0, 0.45, 0.0, 0.0), (0.2, 0.2, 0.1, 0.4, 0.1, 0.1))


@dataclass(frozen=True, eq=False)
class Hinges:
    """Places of the hinges of joints 2, 3 and 4, each from the one before.

    Attributes
    ----------
    places, std : array, shape (3, 2)
        y and z, m; the arm points straight up.
    relative : array, shape (28,)
        Projection with these hinges over the printed one, less 1.
    widening : float
        Of the standard deviations: root of chi-square over its degrees of freedom.
    """

    places: Array
    std: Array
    relative: Array
    widening: float


def rounding(values: Array) -> Array:
    """Standard deviation of numbers printed to three digits, shape as given."""
    size = np.maximum(np.abs(values), 1e-300)
    return np.asarray(10.0 ** (np.floor(np.log10(size)) - 2.0) / np.sqrt(12.0))


def projected(places: Array) -> Array:
    """Link parameters without the exchanges at hinges and without the inessential ones, shape (40,)."""
    p = np.ravel(source.LINKS)
    away = np.zeros((3, 40))
    for row, (y, z) in enumerate(np.reshape(places, (3, 2))):
        away[row, 10 * (row + 1)] = 1.0
        away[row, 10 * row : 10 * (row + 1)] -= source.point_mass(np.array([0.0, y, z]))
    alone = np.eye(40)[[source.NAMES.index(name) for name in ("link_1.mass", *source.INESSENTIAL)]]
    basis, _ = np.linalg.qr((np.vstack([alone, away]) / p).T)
    return np.asarray(p * (1.0 - basis @ basis.sum(axis=0)))


def estimate() -> Hinges:
    """Fit all six coordinates to the printed digits."""
    kept = source.ESSENTIAL_LINK_VALUES
    printed = np.ravel(source.ESSENTIAL)
    error = np.hypot(rounding(np.ravel(source.LINKS)), rounding(printed))[kept]

    def misfit(places: Array) -> Array:
        return np.asarray((projected(places) - printed)[kept] / error)

    fits = [optimize.least_squares(misfit, start, x_scale=0.05) for start in STARTS]
    fit = min(fits, key=lambda f: f.cost)
    widening = float(np.sqrt(2.0 * fit.cost / (len(kept) - 6)))
    std = widening * np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    relative = projected(fit.x)[kept] / printed[kept] - 1.0
    return Hinges(fit.x.reshape(3, 2), std.reshape(3, 2), relative, widening)


def rms(relative: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(relative**2)))


def main() -> None:
    """Print places, uncertainty and the values."""
    kept, printed = source.ESSENTIAL_LINK_VALUES, np.ravel(source.ESSENTIAL)
    hinges = estimate()
    print("Hinges from table D.1's column p(E), each from the one before, m:      y                z")
    for joint, (place, std) in enumerate(zip(hinges.places, hinges.std, strict=True), start=2):
        print(f"  joint {joint}" + "".join(f"{x:9.4f} +- {s:.4f}" for x, s in zip(place, std, strict=True)))
    print(f"  standard deviations {hinges.widening:.2f} times those of the printed digits' rounding")
    aside = hinges.places[:, 0].sum()
    print(f"  forearm's axis {1e3 * aside:+.1f} mm beside joint 1's (the maker's table: 0)")
    print(
        f"  joint 1's hinge {SHOULDER_M - hinges.places[0, 1]:.3f} m above the floor, from the maker's shoulder height"
    )

    packaged = source.hinge_places()
    before = np.array([[0.0, 0.32], [0.0, 0.45], [0.0, 0.0]])
    columns = {"fitted": hinges.places, "robot file": packaged, "all on the axis": before}
    values = {name: projected(np.ravel(places))[kept] for name, places in columns.items()}
    print("\nLink values: " + "".join(f"{name:>16s}" for name in ("p", "printed p(E)", *columns)))
    for place, k in enumerate(kept):
        numbers = (np.ravel(source.LINKS)[k], printed[k], *(v[place] for v in values.values()))
        print(f"  {source.NAMES[k]:11s}" + "".join(f"{x:16.4g}" for x in numbers))
    for name, found in values.items():
        off = found / printed[kept] - 1.0
        print(f"  {name:16s} RMS of the relative error {rms(off):.4f}, median {np.median(np.abs(off)):.4f}")


if __name__ == "__main__":
    main()
