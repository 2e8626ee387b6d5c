"""Compilation of entry points with all that they call as one module."""

import math

import numpy as np
import pytest
from numba import njit

from meshtrace.kernels import jit


@jit.outlined
def half(x):
    return 0.5 * x


@jit.inlined
def quarter(x):
    return half(half(x))


@jit.outlined
def root(x):
    if x < 0.0:
        raise ValueError("a negative number")
    return math.sqrt(quarter(x))


def roots(x, out):
    for i in range(len(x)):
        out[i] = root(x[i]) + half(x[i])


@pytest.fixture
def kernel(monkeypatch, tmp_path):
    """Return a function that makes the entry point, with a cache folder of the test."""
    monkeypatch.setattr(jit.config, "CACHE_DIR", str(tmp_path))
    return lambda: jit.entry(roots)


X = np.array([4.0, 9.0, 2.0])


def result(compiled):
    out = np.empty(3)
    compiled(X, out)
    return out


def test_functions_below_call_each_other(kernel):
    assert np.array_equal(result(kernel()), np.sqrt(0.25 * X) + 0.5 * X)


def test_a_saved_entry_point_gives_the_same(kernel):
    first = result(kernel())
    again = kernel()
    assert np.array_equal(result(again), first)
    assert sum(again.stats.cache_hits.values()) == 1


def test_exceptions_pass(kernel):
    with pytest.raises(ValueError, match="a negative number"):
        kernel()(-X, np.empty(3))


def test_plain_numba_calls_functions_below():
    assert njit(lambda x: root(x) + quarter(x))(16.0) == 6.0


@pytest.mark.skipif(not jit._LINKED, reason="linking is for one release of numba")
def test_only_entry_points_are_optimised_and_emitted(kernel):
    compiled = kernel()
    result(compiled)
    (library,) = (o.library for o in compiled.overloads.values())
    assert isinstance(library, jit.Whole)
    (part,) = (o.library for o in root.overloads.values())
    assert isinstance(part, jit.Part)
    assert part.get_pointer_to_function(part.name) == 0


def test_a_saved_entry_point_raises_the_same(kernel):
    result(kernel())
    with pytest.raises(ValueError, match="a negative number"):
        kernel()(-X, np.empty(3))


@pytest.mark.skipif(not jit._LINKED, reason="linking is for one release of numba")
def test_kernels_do_not_call_entry_points(kernel):
    """Neither one just compiled nor one restored from the cache, whose code is a stub."""

    def refused():
        whole = jit.entry(lambda x: 2.0 * x)
        with pytest.raises(TypeError, match="is an entry point, which kernels do not call"):
            jit.entry(lambda x: whole(x))(1.0)
        assert whole(1.5) == 3.0
        return sum(whole.stats.cache_hits.values())

    assert [refused(), refused()] == [0, 1]


@pytest.mark.skipif(not jit._LINKED, reason="linking is for one release of numba")
def test_a_saved_entry_point_holds_no_objects_of_the_functions_below(kernel):
    """Loading them takes five times as long as the code, and imports numba's own functions."""
    compiled = kernel()
    result(compiled)
    (overload,) = compiled.overloads.values()
    assert [e.env_name for e in overload._find_referenced_environments()] == [
        overload.environment.env_name
    ]


@pytest.mark.parametrize("decorate", [jit.inlined, jit.outlined])
def test_functions_below_entry_points_refuse_calls_from_python(decorate):
    @decorate
    def twice(x):
        return 2.0 * x

    @jit.entry
    def four_times(x):
        return twice(twice(x))

    assert four_times(1.5) == 6.0
    with pytest.raises(TypeError, match="called by kernels only"):
        twice(1.5)
    assert twice.py_func(1.5) == 3.0
