"""Sixteen thousand hostile inputs of fifteen kinds: each is a number or one line of refusal.

No traceback, no signal, no hang, no nan, and no damaged file that gives another number.
`python tests/drills/drill.py KIND N N+1` repeats input N of a kind.
"""

import pytest
from drill import drill

pytestmark = [pytest.mark.drill, pytest.mark.process]

SMALL = {"links": 15, "arguments": 60, "commands": 8, "meshes": 12, "spectra": 10,
         "results": 15, "origins": 4, "stores": 6, "studies": 12, "environment": 1,
         "records": 20, "sequences": 10, "profiles": 15, "forged": 15, "forged_stores": 10}  # fmt: skip
LARGE = {"links": 1500, "arguments": 3400, "commands": 1000, "meshes": 1200, "spectra": 1000,
         "results": 1100, "origins": 900, "stores": 240, "studies": 520, "environment": 40,
         "records": 2000, "sequences": 1000, "profiles": 1000, "forged": 1500, "forged_stores": 500}  # fmt: skip


def check(*plan):
    counts, failures = drill(plan)
    shown = "\n".join(f"{text}\n    {found}" for text, found in failures[:20])
    assert not failures, f"{len(failures)} inputs failed\n{shown}"
    for kind, first, last in plan:
        assert sum(counts[kind].values()) == last - first
        # damaged lines of a store are computed again
        assert counts[kind]["refusal"] > 0 or kind in {"environment", "stores"}
        assert counts[kind]["number"] > 0


@pytest.mark.posix
@pytest.mark.thorough
def test_some_inputs():
    """One process for all kinds: its start costs more than the inputs."""
    check(*((kind, 0, last) for kind, last in SMALL.items()))


@pytest.mark.posix
@pytest.mark.slow
@pytest.mark.parametrize("kind", LARGE)
def test_many_inputs(kind):
    check((kind, SMALL[kind], LARGE[kind]))


def test_failures_are_found():
    """The judge tells refusals from tracebacks and numbers from nan."""
    from drill import outcome

    def fail(error):
        raise error

    assert outcome(lambda: (1.0, 0.1)) == "number"
    assert outcome(lambda: fail(ValueError("depth: -1, allowed: > 0"))) == "refusal"
    assert outcome(lambda: (float("nan"), 0.1)).startswith("not finite")
    assert "operands" in outcome(lambda: fail(ValueError("operands could not be broadcast")))
    assert "KeyError" in outcome(lambda: fail(KeyError("depth, allowed")))
    assert "line two" in outcome(lambda: fail(ValueError("allowed: 1\nline two")))
    assert "letters" in outcome(lambda: fail(ValueError(f"allowed: {5000 * 'x'} letters")))
    assert "AttributeError" in outcome(lambda: fail(AttributeError("link: 1, allowed: a Link")))
