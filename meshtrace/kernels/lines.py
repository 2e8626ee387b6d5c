"""Values on lines between those of equally spaced lines."""

from __future__ import annotations

from meshtrace.kernels.jit import entry


@entry
def between_lines(first, weights, values, out):
    """Write values (n, m) as sums over neighbouring lines of `values` (lines, m).

    Array twin: the product with a sparse matrix.
    Row i is the sum of `weights` (n, width) times the rows of `values` from `first[i]` on.
    """
    n, width = weights.shape
    for i in range(n):
        for c in range(out.shape[1]):
            out[i, c] = 0.0
        for j in range(width):
            weight, row = weights[i, j], first[i] + j
            for c in range(out.shape[1]):
                out[i, c] += weight * values[row, c]
