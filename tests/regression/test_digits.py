"""Numbers of small runs against those kept: a change of structure leaves every digit.

The kept numbers are those of one processor and its libraries, named in the file: there every digit
counts. Elsewhere the last bits differ, between instruction sets of 256 and of 512 bits by up to
5e-8 in differences of nearly equal numbers; numbers that agree to 1e-6 pass. To judge a change by
every digit there, make the numbers with --update-golden before it. Whoever changes an estimator
replaces them on purpose, and says so.
"""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from llvmlite import binding
from regression.cases import CASES

from meshtrace.results.provenance import environment

DIGITS = Path(__file__).with_name("digits.json")
MOST_NUMBERS = 40  # of an array kept as it is; of a longer one, sums
ELSEWHERE = 1e-6  # relative tolerance on other processors
COSTS = ("mesh_time", "bvh_time", "evaluation_time")
SLOW = ("optimum hover", "performance coupled", "compare lit", "compare lit seas")


def machine():
    """Return the processor and the versions on which last bits depend."""
    versions = {k: v for k, v in environment().items() if k not in ("meshtrace", "git_commit")}
    return {"processor": binding.get_host_cpu_name(), **versions}


def numbers_of(result):
    """Return the numeric arrays and attributes of a result by name, long ones as sums."""
    data = result.to_dataset()
    named = {str(k): v.to_numpy() for k, v in data.variables.items() if k not in COSTS}
    named |= {f"attribute {k}": np.asarray(v) for k, v in data.attrs.items()}
    return {k: reduced(v) for k, v in named.items() if v.dtype.kind in "biuf"}


def reduced(value):
    """Return the numbers of an array, or size and sums of a long one."""
    flat = value.astype(float).ravel()
    if flat.size <= MOST_NUMBERS:
        return flat.tolist()
    size, known = np.abs(flat), ~np.isnan(flat)
    weights = (1.0 + 0.5 * np.cos(f * np.arange(flat.size)) for f in (0.0, 1.0, 2.3))
    sums = [float((w * size)[known].sum()) for w in weights]
    return [float(flat.size), float(known.sum()), float((flat < 0.0).sum()), *sums]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in CASES]
)
def test_digits_are_those_kept(name, request):
    kept = json.loads(DIGITS.read_text())
    update = request.config.getoption("--update-golden")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = numbers_of(CASES[name]())
    if update:
        kept = {**kept, "machine": machine(), name: found}
        DIGITS.write_text(json.dumps(kept, indent=0, sort_keys=True) + "\n")
        return
    assert found.keys() == kept[name].keys()
    rtol = 0.0 if kept["machine"] == machine() else ELSEWHERE
    for key, values in found.items():
        np.testing.assert_allclose(values, kept[name][key], rtol, err_msg=key)
