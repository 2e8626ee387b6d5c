"""Counter-based random numbers: a draw belongs to (seed, photon id, event, purpose).

Philox 4x32-10 maps a 128-bit counter and a 64-bit key to 128 random bits. With the photon id,
the event and the purpose in the counter, every photon owns its random numbers: results do not
depend on the number of threads, on the batch size or on the order of the photons.

References
----------
J. K. Salmon, M. A. Moraes, R. O. Dror and D. E. Shaw, "Parallel random numbers: as easy as
1, 2, 3", SC11 (2011), doi:10.1145/2063384.2063405.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from meshtrace.errors import require_seed, require_whole
from meshtrace.kernels.jit import inlined

# Multipliers M and increments W of the key, the golden ratio and sqrt 3 - 1 times 2^32, from the
# reference; 32-bit words as uint64, masked by _LOW.
_LOW = np.uint64(0xFFFFFFFF)
_M0 = np.uint64(0xD2511F53)
_M1 = np.uint64(0xCD9E8D57)
_W0 = np.uint64(0x9E3779B9)
_W1 = np.uint64(0xBB67AE85)
_SHIFT = np.uint64(32)
_TO_UNIT = 2.0**-32


class Purpose(IntEnum):
    """Purpose of a draw: each one is a separate random stream.

    The numbers are part of every result: a new purpose takes the next number.
    """

    LAUNCH = 0  # direction and source of a photon
    SOURCE = 1  # place on an extended source
    COLLISION = 2
    INTERFACE = 3  # crossing of the surface
    ROULETTE = 4
    BOTTOM = 5  # reflection by the bottom
    CHAIN = 6  # not drawn; the number stays taken
    APERTURE = 7  # of a photon that joins a target where it meets the surface
    SLOPE = 8  # of unresolved waves at a crossing
    JOIN = 9  # whether a collision is connected to a target
    JOIN_SLOPE = 10  # crossing of that connection
    GUIDE = 11  # direction towards a target
    TRIAL = 12  # starts of searches for further crossings
    BODY = 14  # reflection by a body
    SERIES = 13  # rejection of slopes that are not Gaussian


@inlined
def philox(seed, photon, event, purpose):
    """Return four 32-bit words of Philox 4x32-10 as uint64.

    Array twin: none; checked against the Random123 known answers.
    Masked uint64 arithmetic gives the same words with and without the JIT.
    """
    # The counter: event, purpose and the two halves of the photon's id. The key: the seed.
    c0 = np.uint64(event) & _LOW
    c1 = np.uint64(purpose) & _LOW
    c2 = np.uint64(photon) & _LOW
    c3 = np.uint64(photon) >> _SHIFT
    k0 = np.uint64(seed) & _LOW
    k1 = np.uint64(seed) >> _SHIFT
    # Ten rounds, of which seven pass all tests of TestU01 (Salmon et al. 2011).
    for _ in range(10):
        p0 = _M0 * c0
        p1 = _M1 * c2
        c0 = (p1 >> _SHIFT) ^ c1 ^ k0
        c1 = p1 & _LOW
        c2 = (p0 >> _SHIFT) ^ c3 ^ k1
        c3 = p0 & _LOW
        k0 = (k0 + _W0) & _LOW
        k1 = (k1 + _W1) & _LOW
    return c0, c1, c2, c3


@inlined
def uniforms(seed, photon, event, purpose):
    """Return four independent uniforms on the open interval (0, 1).

    Array twin: `philox` words as (word + 1/2) / 2^32.
    32 bits each, so that one Philox call serves a whole scattering event; the resolution of
    2.3e-10 is far below any Monte Carlo error.
    """
    # Half a step off the ends 0 and 1: log(u) and log(1 - u) stay finite.
    w0, w1, w2, w3 = philox(seed, photon, event, purpose)
    return (
        (np.float64(w0) + 0.5) * _TO_UNIT,
        (np.float64(w1) + 0.5) * _TO_UNIT,
        (np.float64(w2) + 0.5) * _TO_UNIT,
        (np.float64(w3) + 0.5) * _TO_UNIT,
    )


def realization_seed(seed: int, realization: int, word: int = 0) -> int:
    """Return the seed of a realization i: a word of `numpy.random.SeedSequence([seed, i])`.

    Word 0 seeds the phases of a sea, word 1 the photons of a separate run.
    """
    require_seed(seed)
    require_whole(realization, 0, 2**32 - 1, "realization")
    require_whole(word, 0, 2**16, "word")
    # SeedSequence hashes: neighbouring seeds and realizations give unrelated seeds
    sequence = np.random.SeedSequence([seed, realization])
    return int(sequence.generate_state(word + 1)[word])
