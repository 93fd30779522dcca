"""Drive parameters from resonances and antiresonances, against the source's tables and a system made here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh

from rx90b_flex import drive_parameters

# Table 5.1, Hz: the linearised 3-DOF model without its rigid-body modes.
RESONANCES = [31.3, 41.0, 52.2, 71.3, 82.6, 99.1, 144.7, 249.8, 381.5]
ANTIRESONANCES = [
    [14.8, 38.7, 51.7, 70.5, 81.8, 99.1, 144.5, 247.9, 381.5],
    [20.3, 32.3, 49.9, 59.2, 78.4, 95.3, 143.6, 249.1, 381.5],
    [31.3, 40.4, 49.5, 52.2, 79.8, 99.1, 144.6, 249.8, 381.5],
]
INERTIAS = [3.10, 1.31, 0.79]
STIFFNESSES = [2.80e5, 2.70e5, 1.00e5]  # table 4.1


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


@pytest.mark.parametrize(("drive", "inertia", "stiffness"), [(0, 3.25, 1.48e5), (1, 1.50, 2.16e5), (2, 0.79, 0.98e5)])
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
    ],
)
def test_bad_input_is_refused_by_name(arguments: tuple[object, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        drive_parameters(*arguments)  # type: ignore[arg-type]
