"""Drive parameters from resonances and antiresonances, against the source's tables and a system made here."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from two_drives import HZ, MASS, STIFFNESS, noisy, truth

from rx90b_flex import drive_parameters
from rx90b_flex.identify.inverse_eigenvalue import (
    DriveParameters,
    identify_drives,
)
from rx90b_flex.identify.transfer_function import fit_transfer_functions

# Table 5.1, Hz: the linearised 3-DOF model without its rigid-body modes.
RESONANCES = [31.3, 41.0, 52.2, 71.3, 82.6, 99.1, 144.7, 249.8, 381.5]
ANTIRESONANCES = [
    [14.8, 38.7, 51.7, 70.5, 81.8, 99.1, 144.5, 247.9, 381.5],
    [20.3, 32.3, 49.9, 59.2, 78.4, 95.3, 143.6, 249.1, 381.5],
    [31.3, 40.4, 49.5, 52.2, 79.8, 99.1, 144.6, 249.8, 381.5],
]
INERTIAS = [3.10, 1.31, 0.79]
STIFFNESSES = [2.80e5, 2.70e5, 1.00e5]  # table 4.1


def truncated_drive_parameters(
    resonances_hz: ArrayLike,
    antiresonances_hz: ArrayLike,
    drive_inertia: float,
    kept: int,
    convention: Literal["exact", "source"] = "exact",
) -> DriveParameters:
    """What a drive seems to be when only its lowest modes are seen (table 5.2), the low-frequency gain held.

    That gain is ``prod(mu_r^2 / w_r^2) / J`` over all modes. With n of them, ``J_n = J prod_{r>n} (w_r / mu_r)^2``, which
    rises as modes are lost; ``stiffness = J_n (sum w_r^2 - sum mu_r^2)`` over the n. Table 5.2 was made otherwise (``source``): it
    divides where this multiplies, so that its inertia falls, and scales the eigenvectors in (5.53) by the true inertia. It counts one
    more mode than `kept`, the rigid-body mode.
    """
    w, mu = (2 * np.pi * np.asarray(x, dtype=float) for x in (resonances_hz, antiresonances_hz))
    lost = float(np.prod((w[kept:] / mu[kept:]) ** 2))
    difference = float((w[:kept] ** 2).sum() - (mu[:kept] ** 2).sum())
    if convention == "source":
        return DriveParameters(drive_inertia / lost, drive_inertia / lost**2 * difference, 0.0, 0.0)
    return DriveParameters(drive_inertia * lost, drive_inertia * lost * difference, 0.0, 0.0)


def rounding(inertia: float, zeros: list[float]) -> float:
    """Largest error that frequencies printed to 0.1 Hz leave in the stiffness, added up as if all were worst."""
    return inertia * (2 * np.pi) ** 2 * sum(2 * f * 0.05 for f in (*RESONANCES, *zeros))


@pytest.mark.parametrize("drive", [0, 1, 2])
def test_table_5_1_gives_the_drive_stiffness_within_the_rounding_of_its_frequencies(drive: int) -> None:
    found = drive_parameters(RESONANCES, ANTIRESONANCES[drive], drive_inertia=INERTIAS[drive])
    assert abs(found.stiffness - STIFFNESSES[drive]) < rounding(INERTIAS[drive], ANTIRESONANCES[drive])


# Tables 6.1 (estimates, Hz), 6.3 (rigid mass matrix, kg m^2) and 6.2 (result), last digit as printed.
ESTIMATED = [31.6, 41.7, 53.8, 70.9, 80.0]
ESTIMATED_ZEROS = [[14.9, 39.1, 53.6, 70.2, 79.7], [20.6, 32.5, 50.8, 59.2, 76.5], [31.5, 40.8, 50.4, 53.8, 76.4]]
RIGID_MASS = np.array([[17.24, 0.00, -0.05], [0.00, 14.56, 3.35], [-0.05, 3.35, 2.58]])


@pytest.mark.parametrize(("drive", "inertia", "stiffness"), [(0, 3.25, 1.49e5), (1, 1.50, 2.16e5), (2, 0.79, 0.98e5)])
def test_tables_6_1_and_6_3_give_table_6_2_within_the_rounding_of_the_frequencies(
    drive: int, inertia: float, stiffness: float
) -> None:
    rigid = 1.0 / np.linalg.inv(RIGID_MASS)[drive, drive]
    spread = 0.1 / np.sqrt(12.0)  # standard deviation of a number printed to 0.1
    found = drive_parameters(
        ESTIMATED,
        ESTIMATED_ZEROS[drive],
        rigid_inertia=rigid,
        resonances_std_hz=[spread] * 5,
        antiresonances_std_hz=[spread] * 5,
    )
    assert abs(found.inertia - inertia) < 3 * found.inertia_std + 0.005
    assert abs(found.stiffness - stiffness) < 3 * found.stiffness_std + 500.0


def chain(inertia: float, stiffness: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Resonances and antiresonances, Hz, of a drive before three masses in a chain, and its rigid inertia."""
    mass = np.diag([inertia, 2.0, 1.0, 0.5])
    links = [stiffness, 3.0e4, 1.0e4]
    k = np.zeros((4, 4))
    for i, value in enumerate(links):
        k[i : i + 2, i : i + 2] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])
    free = np.sqrt(eigh(k, mass, eigvals_only=True)[1:]) / (2 * np.pi)
    locked = np.sqrt(eigh(k[1:, 1:], mass[1:, 1:], eigvals_only=True)) / (2 * np.pi)
    return free, locked, float(mass.sum())


def test_all_modes_of_a_chain_give_its_drive_exactly() -> None:
    free, locked, rigid = chain(0.7, 5.0e4)
    known = drive_parameters(free, locked, drive_inertia=0.7)
    low = drive_parameters(free, locked, rigid_inertia=rigid)
    np.testing.assert_allclose([known.stiffness, low.inertia, low.stiffness], [5.0e4, 0.7, 5.0e4], rtol=1e-9)


def test_standard_deviations_are_those_of_many_noisy_tables() -> None:
    free, locked, rigid = chain(0.7, 5.0e4)
    rng = np.random.default_rng(1)
    std = 1e-3 * free
    drawn = [
        drive_parameters(free + std * rng.normal(size=3), locked + std * rng.normal(size=3), rigid_inertia=rigid)
        for _ in range(4000)
    ]
    told = drive_parameters(free, locked, rigid_inertia=rigid, resonances_std_hz=std, antiresonances_std_hz=std)
    # 4000 draws tell a standard deviation to 1.1 % (one sigma)
    np.testing.assert_allclose(np.std([d.inertia for d in drawn]), told.inertia_std, rtol=0.05)
    np.testing.assert_allclose(np.std([d.stiffness for d in drawn]), told.stiffness_std, rtol=0.05)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([30.0], [20.0, 25.0], 1.0), "1 resonances and 2 antiresonances"),
        (([30.0], [20.0]), "drive_inertia or rigid_inertia"),
        (([30.0], [20.0], 1.0, 1.0), "drive_inertia or rigid_inertia"),
        (([30.0], [-20.0], 1.0), "antiresonances_hz"),
        (([30.0], [40.0], 1.0), "no positive stiffness"),
        (([30.0], [20.0], -1.0), "positive number"),
        (([20.0, 25.0], [10.0, 30.0], 2.0), r"^antiresonance 2 \(30 Hz\) lies above resonance 2 \(25 Hz\)"),
        (([20.0, 40.0], [10.0, 15.0], 2.0), r"^resonance 1 \(20 Hz\) lies above antiresonance 2 \(15 Hz\)"),
        (([40.0, 20.0], [10.0, 15.0], 2.0), r"^resonance 1 \(20 Hz\) lies above antiresonance 2 \(15 Hz\)"),
    ],
)
def test_bad_input_is_refused_by_name(arguments: tuple[object, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        drive_parameters(*arguments)  # type: ignore[arg-type]


def test_frequencies_may_be_out_of_turn_by_their_noise() -> None:
    free, locked = [20.0, 22.0], [10.0, 24.0]
    assert drive_parameters(free, locked, drive_inertia=2.0, antiresonances_std_hz=[0.1, 1.0]).stiffness > 0.0
    with pytest.raises(ValueError, match="antiresonance 2"):
        drive_parameters(free, locked, drive_inertia=2.0, antiresonances_std_hz=[0.1, 0.1])


# ---- truncation, table 5.2 ------------------------------------------------------------------------------------

# N counts the rigid-body mode: N = 10 keeps all nine. Columns: inertias, stiffnesses in 1e5 N m/rad.
TABLE_5_2 = {
    10: (3.10, 1.31, 0.79, 2.80, 2.70, 1.00),
    9: (3.10, 1.31, 0.79, 2.80, 2.68, 1.00),
    8: (3.05, 1.31, 0.79, 1.53, 2.47, 1.00),
    7: (3.04, 1.29, 0.79, 1.46, 2.23, 0.98),
    6: (3.04, 1.18, 0.79, 1.46, 1.53, 0.97),
    5: (2.99, 1.07, 0.73, 1.27, 1.03, 0.71),
    4: (2.92, 0.74, 0.39, 1.08, 0.23, 0.02),
    3: (2.86, 0.67, 0.35, 0.98, 0.16, 0.00),
    2: (2.55, 0.42, 0.34, 0.63, 0.03, 0.00),
    1: (0.57, 0.18, 0.34, 0.00, 0.00, 0.00),
}


@pytest.mark.parametrize("drive", [0, 1, 2])
def test_the_source_s_truncation_gives_table_5_2_within_the_rounding_of_its_frequencies(drive: int) -> None:
    zeros = np.array(ANTIRESONANCES[drive])
    for modes, row in TABLE_5_2.items():
        kept = modes - 1
        found = truncated_drive_parameters(RESONANCES, zeros, INERTIAS[drive], kept, "source")
        # frequencies printed to 0.1 Hz and inertias to 0.01, all worst: relative error of the inertia, then of the squares kept
        relative = sum(0.1 / f for f in (*RESONANCES[kept:], *zeros[kept:])) + 0.005 / INERTIAS[drive]
        squares = (2 * np.pi) ** 2 * sum(0.1 * f for f in (*RESONANCES[:kept], *zeros[:kept]))
        assert abs(found.inertia - row[drive]) < found.inertia * relative + 0.005
        assert (
            abs(found.stiffness - 1e5 * row[3 + drive])
            < found.inertia * squares + 2 * found.stiffness * relative + 500.0
        )


@pytest.mark.parametrize("drive", [0, 1, 2])
def test_the_exact_truncation_keeps_the_low_frequency_gain_so_that_the_inertia_rises(drive: int) -> None:
    w, mu, inertia = np.array(RESONANCES), np.array(ANTIRESONANCES[drive]), INERTIAS[drive]
    found = [truncated_drive_parameters(w, mu, inertia, n) for n in range(10)]
    gains = [np.prod((mu[:n] / w[:n]) ** 2) / found[n].inertia for n in range(10)]
    np.testing.assert_allclose(gains, gains[-1], rtol=1e-12)
    assert all(a.inertia >= b.inertia for a, b in pairwise(found))
    # without any mode the drive is the rigid robot: table 6.6's 17.0, 1 / (M^-1)_22 and _33 of it
    rigid = 1.0 / gains[-1]
    again = drive_parameters(w[:4], mu[:4], rigid_inertia=rigid)
    np.testing.assert_allclose([again.inertia, again.stiffness], [found[4].inertia, found[4].stiffness], rtol=1e-12)


# Tables 6.4 (measured, Hz, with standard deviations) and 6.5 (result).
MEASURED = [28.4, 30.3, 32.5, 41.0, 44.7, 62.6, 64.1, 67.1, 69.3]
MEASURED_ZEROS = [
    [15.1, 28.5, 31.6, 39.8, 42.8, 61.8, 64.6, 68.3, 68.4],
    [20.8, 29.5, 30.4, 33.0, 44.0, 62.6, 65.7, 66.9, 68.3],
    [28.2, 30.2, 32.4, 37.7, 44.1, 62.5, 63.1, 64.9, 67.0],
]


@pytest.mark.parametrize(("drive", "inertia", "stiffness"), [(0, 3.54, 1.39e5), (1, 3.63, 1.68e5), (2, 1.47, 0.62e5)])
def test_table_6_4_gives_table_6_5_within_the_rounding_of_the_frequencies(
    drive: int, inertia: float, stiffness: float
) -> None:
    # a hundredth or less off as printed (1.40, 1.67, 0.63); 18 frequencies rounded to 0.1 Hz leave a standard deviation of
    # 0.013, 0.014 and 0.006e5
    spread = [0.1 / np.sqrt(12.0)] * 9
    found = drive_parameters(
        MEASURED,
        MEASURED_ZEROS[drive],
        drive_inertia=inertia,
        resonances_std_hz=spread,
        antiresonances_std_hz=spread,
        inertia_std=0.01 / np.sqrt(12.0),
    )
    assert abs(found.stiffness - stiffness) < 500.0 + 3 * found.stiffness_std


# ---- eigenvectors, damping, and all of it from a fit -----------------------------------------------------------


def test_eigenvector_entries_are_those_of_the_chain() -> None:
    mass = np.diag([0.7, 2.0, 1.0, 0.5])
    k = np.zeros((4, 4))
    for i, value in enumerate([5.0e4, 3.0e4, 1.0e4]):
        k[i : i + 2, i : i + 2] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])
    free, locked, _ = chain(0.7, 5.0e4)
    expected = np.abs(eigh(k, mass)[1][0])  # mass-normalised
    # (5.31), from P = nu_0^2 - w^2 sum_r nu_r^2 / (w_r^2 - w^2)
    w, mu = (2 * np.pi * free) ** 2, (2 * np.pi * locked) ** 2
    squares = [np.prod(mu / w)]
    for r, at in enumerate(w):
        squares.append(-(mu[r] - at) / at * np.prod((np.delete(mu, r) - at) / (np.delete(w, r) - at)))
    found = np.sqrt(np.array(squares) / 0.7)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    # (5.53), the source's sum, is the trace form
    source = 0.7**2 * ((found[1:] * 2 * np.pi * free) ** 2).sum()
    assert source == pytest.approx(drive_parameters(free, locked, drive_inertia=0.7).stiffness, rel=1e-9)


def test_drives_and_rigid_mass_from_a_fit_lie_within_their_standard_deviations() -> None:
    rng = np.random.default_rng(11)
    fit = fit_transfer_functions(noisy(truth(HZ), HZ, 0.005, rng), 3)
    told = identify_drives(fit)
    rigid = np.linalg.inv((v := eigh(STIFFNESS, MASS)[1][:2, :2]) @ v.T)
    for j, (inertia, stiffness) in enumerate([(2.0, 6.0e4), (1.0, 9.0e4)]):
        assert abs(told.drives[j].inertia - inertia) < 4 * told.drives[j].inertia_std
        assert abs(told.drives[j].stiffness - stiffness) < 4 * told.drives[j].stiffness_std
    assert (np.abs(told.rigid_mass - rigid) < 4 * told.rigid_mass_std).all()
    # damping is 2e-4 s times the stiffness: each mode decays with half of that times its frequency squared
    expected = 1e-4 * (2 * np.pi * fit.resonances_hz) ** 2
    assert (np.abs(told.decay_rate - expected) < 4 * told.decay_rate_std).all()
