"""Linear algebra on small matrices that dominate on their diagonals: no pivots."""

from __future__ import annotations

from rx90b_flex.compiled.compile import Array, Integers, inlined


@inlined
def factor(system: Array, partner: Integers) -> None:
    """U of ``U.T diag(1 / d) U = system`` in place, from the upper triangle of a symmetric matrix; 1 / d on its
    diagonal. What is below it is lost.

    Of the first rows, one an entry of `partner`, nothing off the diagonal is looked at but what joins them to that coordinate.
    """
    n, first = len(system), len(partner)
    for k in range(first):
        p = partner[k]
        inverse = 1.0 / system[k, k]
        system[k, k] = inverse
        system[p, p] -= system[k, p] * inverse * system[k, p]
    for i in range(first, n):
        for k in range(first, i):  # scaled rows beside the diagonal, which nothing else needs
            system[i, k] = system[k, i] * system[k, k]
        j = i
        while j + 4 <= n:  # four at a time, since looks at memory cost more than the arithmetic
            t0, t1, t2, t3 = system[i, j], system[i, j + 1], system[i, j + 2], system[i, j + 3]
            for k in range(first, i):
                scale = system[i, k]
                t0 -= scale * system[k, j]
                t1 -= scale * system[k, j + 1]
                t2 -= scale * system[k, j + 2]
                t3 -= scale * system[k, j + 3]
            system[i, j], system[i, j + 1], system[i, j + 2], system[i, j + 3] = t0, t1, t2, t3
            j += 4
        while j < n:
            total = system[i, j]
            for k in range(first, i):
                total -= system[i, k] * system[k, j]
            system[i, j] = total
            j += 1
        system[i, i] = 1.0 / system[i, i]


@inlined
def solve(system: Array, partner: Integers, x: Array) -> None:
    """Solve with what `factor` left, in place."""
    n, first = len(x), len(partner)
    for k in range(first):
        x[k] *= system[k, k]
        x[partner[k]] -= x[k] * system[k, partner[k]]
    for k in range(first, n):
        x[k] *= system[k, k]
        for j in range(k + 1, n):
            x[j] -= x[k] * system[k, j]
    for k in range(n - 1, first - 1, -1):
        total = 0.0
        for j in range(k + 1, n):
            total += system[k, j] * x[j]
        x[k] -= total * system[k, k]
    for k in range(first):
        x[k] -= system[k, partner[k]] * x[partner[k]] * system[k, k]


@inlined
def factor_general(system: Array) -> None:
    """L and U in place, 1 / U_kk on the diagonal; no pivots: inertia outweighs what makes the matrix unsymmetric."""
    n = len(system)
    for k in range(n):
        inverse = 1.0 / system[k, k]
        system[k, k] = inverse
        for i in range(k + 1, n):
            scale = system[i, k] * inverse
            system[i, k] = scale
            for j in range(k + 1, n):
                system[i, j] -= scale * system[k, j]


@inlined
def solve_general(system: Array, x: Array) -> None:
    """Solve in place with a system that is factored without pivots, its pivots inverted; x (n,) is the right side."""
    n = len(x)
    for i in range(n):
        for j in range(i):
            x[i] -= system[i, j] * x[j]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= system[i, j] * x[j]
        x[i] *= system[i, i]


@inlined
def add_dense(matrix: Array, lane: int, scale: float, x: Array, out: Array) -> None:
    """Add `scale` times a lane's matrix (n, n) times x (n,) to out (n,)."""
    n = len(x)
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += matrix[lane, i, j] * x[j]
        out[i] += scale * total


@inlined
def invert(matrix: Array, out: Array) -> None:
    """Inverse by Gauss and Jordan without pivots: the mass matrix dominates."""
    n = len(matrix)
    for i in range(n):
        for j in range(n):
            out[i, j] = 1.0 if i == j else 0.0
    for k in range(n):
        scale = 1.0 / matrix[k, k]
        for j in range(k, n):
            matrix[k, j] *= scale
        for j in range(k + 1):
            out[k, j] *= scale
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                if factor != 0.0:
                    for j in range(k, n):
                        matrix[i, j] -= factor * matrix[k, j]
                    for j in range(k + 1):
                        out[i, j] -= factor * out[k, j]


@inlined
def product(matrix: Array, y: Array, shift: Array, out: Array) -> None:
    """out = matrix @ y + shift, lanes in the columns."""
    rows, inner = matrix.shape
    lanes = y.shape[1]
    for i in range(rows):
        for c in range(lanes):
            out[i, c] = shift[i]
        j = 0
        while j + 6 <= inner:  # several at a time, since looks at `out` cost as much as the arithmetic
            a0, a1, a2, a3, a4, a5 = (
                matrix[i, j],
                matrix[i, j + 1],
                matrix[i, j + 2],
                matrix[i, j + 3],
                matrix[i, j + 4],
                matrix[i, j + 5],
            )
            for c in range(lanes):
                half = a0 * y[j, c] + a1 * y[j + 1, c] + a2 * y[j + 2, c]
                out[i, c] += half + (a3 * y[j + 3, c] + a4 * y[j + 4, c] + a5 * y[j + 5, c])
            j += 6
        while j < inner:
            a0 = matrix[i, j]
            for c in range(lanes):
                out[i, c] += a0 * y[j, c]
            j += 1
