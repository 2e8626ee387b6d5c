"""Scrambled Sobol points of the unit cube, the same as by `scipy.stats.qmc.Sobol`.

The import of `scipy.stats` takes as long as a third of a whole run. `joe_kuo.txt` has the first
rows of new-joe-kuo-6.21201 (Joe and Kuo 2008, https://web.maths.unsw.edu.au/~fkuo/sobol): the
number of a dimension, degree s and inner coefficients a of a primitive polynomial, and its first
direction numbers m_i.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.models import Floats

_BITS = 30


def sobol_points(width: int, count: int, rng: np.random.Generator) -> Floats:
    """Return the first Sobol points, (count, width), scrambled and shifted digit by digit.

    Notes
    -----
    Direction numbers v are multiplied by random lower triangular matrices of bits (Matousek 1998,
    J. Complexity 14:527), all points shifted by random bits. In the order of Gray's code the points
    2^j ... 2^(j+1) - 1 are the points before them, backwards, shifted by v_j.
    """
    (rng,) = rng.spawn(1)  # as scipy does
    place = 2 ** np.arange(_BITS, dtype=np.uint32)
    shift = rng.integers(2, size=(width, _BITS), dtype=np.uint32) @ place
    lower = np.tril(rng.integers(2, size=(width, _BITS, _BITS), dtype=np.uint32))
    lower[:, range(_BITS), range(_BITS)] = 1
    doublings = math.ceil(math.log2(max(count, 2)))
    scrambled = (lower @ _directions(doublings)[:width]) & 1
    points: Any = shift[None]
    for v in np.tensordot(scrambled, place[::-1], (1, 0)).T:
        points = np.concatenate([points, points[::-1] ^ v])
    return points[:count] * 2.0**-_BITS


@cache
def _directions(count: int) -> NDArray[np.uint32]:
    """Return the bits of the first direction numbers, highest first: shape (widths, bits, count).

    m_k = 2 a_1 m_(k-1) ^ ... ^ 2^(s-1) a_(s-1) m_(k-s+1) ^ 2^s m_(k-s) ^ m_(k-s), v_k = m_k / 2^k.
    """
    table = Path(__file__).with_name("joe_kuo.txt").read_text(encoding="ascii").splitlines()[1:]
    numbers = [[1] * count]
    for row in table:
        _, s, a, *m = map(int, row.split())
        for k in range(s, count):
            last = m[k - s] ^ (m[k - s] << s)
            for i in range(1, s):
                last ^= ((a >> (s - 1 - i)) & 1) * (m[k - i] << i)
            m.append(last)
        numbers.append(m[:count])
    place = np.arange(_BITS - 1, -1, -1, dtype=np.uint32)
    v: Any = np.array(numbers, np.uint32) << place[:count]
    return (v[:, None] >> place[:, None]) & 1
