"""Philox 4x32-10 against the Random123 known answers; uniforms and streams."""

import itertools

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak

from meshtrace.kernels.jit import allocating_entry
from meshtrace.kernels.random import Purpose, philox, uniforms

ONES = 0xFFFFFFFF

# kat_vectors of Random123: counter, key, output as 32-bit words
KNOWN_ANSWERS = [
    (
        (0, 0, 0, 0),
        (0, 0),
        (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8),
    ),
    (
        (ONES, ONES, ONES, ONES),
        (ONES, ONES),
        (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
    ),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@allocating_entry
def words(seed, photon, event, purpose):
    return philox(seed, photon, event, purpose)


@allocating_entry
def draw(seed, photons, events, purposes):
    out = np.empty((len(photons), 4))
    for i in range(len(photons)):
        u0, u1, u2, u3 = uniforms(seed, photons[i], events[i], purposes[i])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = u0, u1, u2, u3
    return out


def stream(seed=1, photon=0, event=0, purpose=0, n=1 << 18, along="photon"):
    """Return n draws that count along one of the three coordinates of the stream."""
    counter = {
        "photon": np.full(n, photon),
        "event": np.full(n, event),
        "purpose": np.full(n, purpose),
    }
    counter[along] = counter[along] + np.arange(n)
    return draw(seed, counter["photon"], counter["event"], counter["purpose"])


def cells(a, b, bins=16):
    """Return the counts of pairs of uniforms in square cells."""
    return np.bincount(
        (a * bins).astype(int) * bins + (b * bins).astype(int), minlength=bins * bins
    )


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN_ANSWERS)
@pytest.mark.parametrize("jit", [True, False])
def test_known_answers(counter, key, answer, jit):
    event, purpose, low, high = counter
    function = words if jit else philox.py_func
    got = function(np.uint64(key[0] | key[1] << 32), np.uint64(low | high << 32), event, purpose)
    assert tuple(int(w) for w in got) == answer


@pytest.mark.parametrize("along", ["photon", "event"])
def test_each_word_is_uniform(along):
    u = stream(along=along)
    for column in u.T:
        counts = np.bincount((column * 512).astype(int), minlength=512)
        assert chi2_test(counts, np.full(512, 1 / 512)) > sidak(ALPHA, 8)


def test_words_of_one_call_are_independent():
    u = stream(seed=2)
    for i, j in itertools.combinations(range(4), 2):
        assert chi2_test(cells(u[:, i], u[:, j]), np.full(256, 1 / 256)) > sidak(ALPHA, 6)


@pytest.mark.parametrize(
    "other",
    [
        {"photon": 1},
        {"event": 1},
        {"purpose": 1},
        {"purpose": 3},
        {"seed": 4},
        {"seed": 3 + 2**32},
        {"photon": 2**32},
    ],
    ids=lambda change: "-".join(f"{k}{v}" for k, v in change.items()),
)
def test_neighbouring_streams_are_independent(other):
    a, b = stream(seed=3), stream(**{"seed": 3, **other})
    assert not (a == b).all(axis=1).any()
    for i in range(4):
        p = chi2_test(cells(a[:, i], b[:, i]), np.full(256, 1 / 256))
        assert p > sidak(ALPHA, 28)


def test_no_two_draws_share_their_words():
    """64 photons of 64 events of every purpose: all counters must differ."""
    grid = np.array(list(itertools.product(range(64), range(64), (int(p) for p in Purpose))))
    u = draw(5, *(np.ascontiguousarray(c) for c in grid.T))
    assert len(np.unique(u, axis=0)) == len(grid)


def test_purposes_are_distinct_codes():
    assert sorted(int(p) for p in Purpose) == list(range(len(Purpose)))


@pytest.mark.parametrize("word", [0, ONES])
def test_uniforms_are_open_at_both_ends(word):
    """-log(u), u^(1/(m+1)) and 1 - u must stay finite for every word that can occur."""
    u = (np.float64(word) + 0.5) * 2.0**-32
    assert 0.0 < u < 1.0
    assert np.isfinite([np.log(u), np.log1p(-u)]).all()


def test_uniforms_are_the_words_scaled():
    u = stream(seed=6, n=100)
    for photon in range(100):
        expected = [(float(w) + 0.5) / 2.0**32 for w in words(6, photon, 0, 0)]
        assert u[photon].tolist() == expected
