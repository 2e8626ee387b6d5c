"""Gains per second of the models of a series; run with `pytest tests/benchmarks --benchmark-only`.

The bound is the project's own: a million gains in a second of processor time.
"""

import numpy as np
import pytest
from clocks import timed

from meshtrace import apps

N = 1_000_000


@pytest.mark.parametrize("kind", ["markov", "transformed"])
def test_gains_per_second(benchmark, kind):
    noise = np.random.default_rng(1).normal(size=20_000)
    gain = np.exp(0.5 * np.convolve(noise, np.hanning(25) / 3.0, mode="same"))
    if kind == "markov":
        model = apps.MarkovChannel.fit(gain, 0.02, 8)
    else:
        model = apps.TransformedGaussian.fit(gain, 0.02)
    spent = []
    benchmark.pedantic(lambda: spent.append(timed(lambda: model.sample(N, seed=2))[1]), rounds=5)
    benchmark.extra_info["gains_per_cpu_s"] = N / min(spent)
    assert min(spent) < 1.0
