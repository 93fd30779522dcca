"""The present model as normal equations: the same with links for which others stand and without, by either way to solve them."""

from __future__ import annotations

import numpy as np
import pytest

from rx90b_flex.diagnose.base import Base, SharedColumns
from rx90b_flex.identify.columns import ColumnsByJoint
from rx90b_flex.identify.normal_equations import dependent, solve_weighted, solved

SAMPLES, JOINTS, LINKS, OTHERS = 400, 3, 12, 5
BLOCKS = tuple(slice(k * 50, (k + 1) * 50) for k in range(8))


def links(rng: np.random.Generator) -> np.ndarray:
    """Columns (N, joints, links) of which seven are independent: two are zero, three sums of others, of any size."""
    columns = rng.standard_normal((SAMPLES, JOINTS, LINKS))
    columns[..., [3, 8]] = 0.0
    columns[..., 5] = columns[..., 0] - 2.0 * columns[..., 1]
    columns[..., 9] = 0.3 * columns[..., 5] + columns[..., 2]
    columns[..., 11] = columns[..., 9] + columns[..., 10]
    return columns * 10.0 ** rng.uniform(-3.0, 3.0, LINKS)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_left_of_dependent_columns_spans_them_all(seed):
    columns = links(np.random.default_rng(seed)).reshape(-1, LINKS)
    out = dependent(columns.T @ columns)
    rest = np.setdiff1d(np.arange(LINKS), out)
    assert len(rest) == 7
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left = scaled - scaled[:, rest] @ np.linalg.lstsq(scaled[:, rest], scaled, rcond=None)[0]
    assert np.abs(left).max() < 1e-10


@pytest.mark.parametrize("seed", range(5))
def test_normal_equations_have_one_solution_by_factors_and_by_eigenvalues(seed):
    rng = np.random.default_rng(seed)
    full = rng.standard_normal((100, 8)) * 10.0 ** rng.uniform(-4.0, 4.0, 8)
    short = np.concatenate([full, full[:, :2] @ rng.standard_normal((2, 1))], axis=1)
    for columns in (full, short):  # with all determined, and one direction open
        gram, cross = columns.T @ columns, columns.T @ rng.standard_normal(100)
        prior = rng.standard_normal(columns.shape[1])
        theta, inverse = solved(gram, cross, prior)
        known, also, _, _ = solve_weighted(gram, cross, prior)
        size = np.sqrt(np.diag(gram))
        np.testing.assert_allclose(theta * size, known * size, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(
            inverse * np.outer(size, size), also * np.outer(size, size), rtol=1e-7, atol=1e-7 * len(size)
        )


def test_of_no_columns_there_is_nothing_to_solve(capfd):
    theta, inverse = solved(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    assert theta.shape == (0,) and inverse.shape == (0, 0)
    assert len(dependent(np.zeros((0, 0)))) == 0 and list(dependent(np.zeros((2, 2)))) == [0, 1]
    said = capfd.readouterr()
    assert not said.out and not said.err, "LAPACK complains to the terminal"


@pytest.mark.parametrize("seed", range(3))
def test_a_base_is_the_same_without_the_links_for_which_others_stand(seed):
    rng = np.random.default_rng(seed)
    columns = np.concatenate([links(rng), rng.standard_normal((SAMPLES, JOINTS, OTHERS))], axis=2)
    size = LINKS + OTHERS
    theta = rng.standard_normal(size) / np.maximum(np.abs(columns).max(axis=(0, 1)), 1e-300)
    theta[[3, 8]] = 1.0  # what has no columns has no say
    target = (columns @ theta).T + rng.standard_normal((JOINTS, SAMPLES))
    shared = SharedColumns(
        ColumnsByJoint.of_dense(np.arange(size), iter(columns.transpose(1, 0, 2))),
        target, np.array([1.0, 4.0, 0.5]), BLOCKS, np.zeros((size, size)), theta, LINKS,
    )  # fmt: skip
    out, without = shared.spare
    kept = np.setdiff1d(np.arange(size), out)
    assert len(kept) == 7 + OTHERS
    # the model's torque is the same
    np.testing.assert_allclose(columns @ without, columns @ theta, atol=1e-9 * np.abs(columns @ theta).max())
    whole, fewer = Base(shared, np.arange(size), theta), Base(shared, kept, without[kept])
    np.testing.assert_allclose(fewer.residual, whole.residual, atol=1e-8)
    np.testing.assert_allclose(fewer.held_out, whole.held_out, rtol=1e-9)
    rows, candidates = np.array([0, 2]), rng.standard_normal((SAMPLES, 2, 6))
    np.testing.assert_allclose(fewer.gains(rows, candidates, 2), whole.gains(rows, candidates, 2), rtol=1e-7)
    np.testing.assert_allclose(fewer.apart(rows, candidates), whole.apart(rows, candidates), atol=1e-8)


def test_links_that_are_pulled_to_the_trees_values_all_stay():
    rng = np.random.default_rng(0)
    columns, ones = links(rng), np.eye(LINKS)
    shared = SharedColumns(
        ColumnsByJoint.of_dense(np.arange(LINKS), iter(columns.transpose(1, 0, 2))),
        np.zeros((JOINTS, SAMPLES)), np.ones(JOINTS), BLOCKS, ones, np.ones(LINKS), LINKS,
    )  # fmt: skip
    out, theta = shared.spare
    assert len(out) == 0 and np.array_equal(theta, np.ones(LINKS))


def by_itself(columns: np.ndarray, target: np.ndarray) -> Base:
    """A base of columns (N, p) of one joint."""
    size = columns.shape[1]
    shared = SharedColumns(
        ColumnsByJoint.of_dense(np.arange(size), iter(columns[None])),
        target[None], np.ones(1), BLOCKS, np.zeros((size, size)), np.zeros(size),
    )  # fmt: skip
    return Base(shared, np.arange(size), np.zeros(size))


@pytest.mark.parametrize("seed", range(5))
def test_what_is_left_of_a_block_by_a_fit_to_the_others(seed):
    """Where these tell everything it is that of a fit without the block; where they tell next to nothing, it stays bounded."""
    rng = np.random.default_rng(seed)
    columns, noise = rng.standard_normal((SAMPLES, 6)), rng.standard_normal(SAMPLES)
    target = columns @ rng.standard_normal(6) + noise
    left = []
    for block in BLOCKS:
        others = np.delete(np.arange(SAMPLES), block)
        theta = np.linalg.lstsq(columns[others], target[others], rcond=None)[0]
        left.append(((target[block] - columns[block] @ theta) ** 2).sum())
    np.testing.assert_allclose(by_itself(columns, target).held_out, left, rtol=0.02)
    # another column, of which blocks other than the first tell next to nothing
    alone = np.where(np.arange(SAMPLES) < 50, 1.0, 1e-4) * rng.standard_normal(SAMPLES)
    more = by_itself(np.concatenate([columns, alone[:, None]], axis=1), target + 3.0 * alone).held_out
    assert (more < 3.0 * np.array(left)).all()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("grouped", [False, True])
def test_a_candidate_beside_a_base_leaves_what_it_leaves_as_a_part_of_it(seed, grouped):
    """Also where the base explains most of it without the candidate, and where one block alone tells of it."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((SAMPLES, 6))
    new = np.stack([columns[:, 0] + 0.03 * rng.standard_normal(SAMPLES), rng.standard_normal(SAMPLES)], axis=1)
    new[50:, 1] = 0.0
    target = columns[:, 0] + 5.0 * new[:, 0] + 2.0 * new[:, 1] + rng.standard_normal(SAMPLES)
    base, whole = (by_itself(x, target) for x in (columns, np.concatenate([columns, new], axis=1)))
    b, y, d = (np.array(x) for x in zip(*(base.products(np.array([0]), new[:, None], k) for k in BLOCKS), strict=True))
    if grouped:
        groups = tuple(np.array_split(np.arange(len(BLOCKS)), 3))
        b, y, d = (np.array([x[at].sum(axis=0) for at in groups]) for x in (b, y, d))
        base, whole = base.grouped(groups), whole.grouped(groups)
    np.testing.assert_allclose(base.held_out_beside(b, y, d, np.zeros((2, 2))), whole.held_out, rtol=1e-6)
