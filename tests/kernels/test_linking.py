"""Compilation of entry points with all that they call as one module."""

import gc
import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import float64, njit

from meshtrace.kernels import jit, linker


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


@pytest.mark.skipif(not linker.LINKED, reason="linking is for one release of numba")
def test_only_entry_points_are_optimised_and_emitted(kernel):
    compiled = kernel()
    result(compiled)
    (library,) = (o.library for o in compiled.overloads.values())
    assert isinstance(library, linker.Whole)
    (part,) = (o.library for o in root.overloads.values())
    assert isinstance(part, linker.Part)
    assert part.get_pointer_to_function(part.name) == 0


def test_a_saved_entry_point_raises_the_same(kernel):
    result(kernel())
    with pytest.raises(ValueError, match="a negative number"):
        kernel()(-X, np.empty(3))


@pytest.mark.skipif(not linker.LINKED, reason="linking is for one release of numba")
def test_kernels_do_not_call_entry_points(kernel):
    """Neither one just compiled nor one restored from the cache, whose code is a stub."""

    def refused():
        whole = jit.entry(lambda x: 2.0 * x)
        with pytest.raises(TypeError, match="is an entry point, which kernels do not call"):
            jit.entry(lambda x: whole(x))(1.0)
        assert whole(1.5) == 3.0
        return sum(whole.stats.cache_hits.values())

    assert [refused(), refused()] == [0, 1]


@pytest.mark.skipif(not linker.LINKED, reason="linking is for one release of numba")
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


class Pair(NamedTuple):
    numbers: Any
    offset: float


class Many(NamedTuple):
    numbers: Any
    offset: float
    rest: tuple[Any, ...]


@pytest.mark.parametrize("caller", [jit.entry, njit])
def test_inlined_functions_take_tuples(caller):
    @jit.inlined
    def largest(pair, least):
        for i in range(len(pair.numbers)):
            if pair.numbers[i] + pair.offset > least:
                least = pair.numbers[i] + pair.offset
        pair = Pair(pair.numbers, 2.0 * least)  # an argument that is assigned again
        return pair.offset

    @jit.inlined
    def both(pair, upper):
        if upper:
            return largest(pair, 0.0)
        return -largest(Pair(pair.numbers[1:], -pair.offset), -math.inf)

    run = caller(lambda pair, upper: both(pair, upper))
    pair = Pair(np.array([3.0, 5.0, 4.0]), 0.5)
    assert (run(pair, True), run(pair, False)) == (11.0, -9.0)


def code_of(compiled):
    """Return the number of instructions of the one overload of a function below, as lowered."""
    (part,) = (o.library for o in compiled.overloads.values())
    blocks = [b for f in part.own_module().functions for b in f.blocks]
    return sum(1 for block in blocks for _ in block.instructions)


@pytest.mark.skipif(not linker.LINKED, reason="linking is for one release of numba")
def test_a_tuple_that_is_handed_on_costs_no_code():
    """Numba passes its scalars one by one, and copies it at each use in another block."""
    sizes = []
    for bundle in (Pair(X, 0.5), Many(X, 0.5, (X,) * 40)):

        @jit.inlined
        def first(values):
            return values.numbers[0] + values.offset

        @jit.inlined
        def twice(values, n):
            return first(values) + first(values) if n > 0 else first(values)

        assert jit.entry(lambda v, n: twice(v, n))(bundle, 1) == 9.0
        sizes.append(code_of(twice))
    assert sizes[0] == sizes[1]


def test_nothing_is_collected_during_a_compilation(kernel):
    """The collection of cycles took a quarter of the time."""
    compiled, phases = kernel(), []
    gc.callbacks.append(lambda phase, _: phases.append(phase))
    try:
        compiled.compile((float64[::1], float64[::1]))
        during = phases.count("start")
    finally:
        gc.callbacks.pop()
    # one may follow at once when collection goes on
    assert during <= 1
    assert gc.isenabled()
