"""Every public function refuses wrong objects alike: one walk over all names.

The names are those on the pages of the API and in the stubs, so that a new one joins by itself; its
parameters need sound values in `sound_calls`. One argument at a time is replaced by each of
`hostile_values`: a call ends in `Refused`, or in a finite answer where the annotation allows the
value. Light is not traced: what would be traced has been accepted.
"""

import _thread
import contextlib
import inspect
import re
import signal
import threading
import warnings
from functools import cache
from random import Random

import numpy as np
import pytest
from hostile_values import VALUES, made
from public_names import callables
from sound_calls import INSTANCES, OTHER, SOUND

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.models import Family, Model

ELSEWHERE = {
    "viz.": "tests/viz/test_viz_refusals.py, with sound results for each",
    "apps.plot_": "tests/viz/test_viz_refusals.py, with sound results for each",
    "engine.": "internals that the pages of the estimators name",
    "files.atomic": "refuses when its block is entered",
    "explore": "starts a server",
    "apps.measured.": "runs all published measurements",
    "apps.w2a1.": "runs the published cases",
    "apps.plot": "tests/viz/test_viz_refusals.py, with sound results for each",
    "results.tallies.": "arrays of the engine",
    "studies.operating_point.": "steps of the studies that are walked",
    "studies.response.": "a step of the studies that are walked",
    "studies.sweeps.Sweep.": "the parts of `sweep`",
    "surfaces.nonlinear.ChoppyWaves.": "arrays of the sea that is walked",
    "surfaces.MeshSequence.model_post_init": "called by pydantic",
    "MeshSource.": "a protocol",
    "SurfaceModel.": "a protocol",
    "Refused.": "the refusal itself",
}
LATE = ("Design.", "studies.ConvergenceStudy.")  # whose instances take half a minute
WITHOUT = (  # nan: no flash, no fade, no depth that crosses the rate, no range with it
    "IrradianceSeries.flashes", "fading.mean_fade_duration", "DepthSweep.range_at_ber",
    "LinkPerformance.range_at_ber", "LinkPerformance.at",
)  # fmt: skip
USERS = ("validation.validate(progress = class)",)  # int("still water"): an error of the user's
LACKING = ("surfaces.from_gauge", "optics.mie.cached_table")  # need more than plain arguments
SAMPLE = 1  # values of a parameter in the quick walk
LONGEST = 2.0  # [s], after which a call counts as accepted
KINDS = {"float": "float", "int": "int", "bool": "bool", "str": "str", "None": "none",
         "ArrayLike": "array", "Floats": "array", "Path": "path", "PathLike": "path",
         "Ranged": "float", "RangedArray": "array", "Seed": "int", "Resamples": "int",
         **dict.fromkeys(("Sizes", "ScatteringWavelength", "Temperature"), "array"),
         **dict.fromkeys(("Finite", "Positive", "NonNegative", "Probability", "ErrorRate",
                          "Threshold", "WindSpeed", "Depth", "FieldOfView"), "float")}  # fmt: skip


class Accepted(BaseException):
    """A value was accepted: the call goes on to work."""


def names():
    apart = tuple(ELSEWHERE)
    return [name for name in callables() if not name.startswith(apart) and parameters(name)]


def parameters(name):
    """Return the parameters of a function that take one object."""
    function, _ = callables()[name]
    rows = inspect.signature(function).parameters.values()
    single = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    return [p for p in rows if p.name not in ("self", "cls") and p.kind not in single]


def kinds_of(annotation):
    """Return the kinds that an annotation of plain types names, None for any other annotation."""
    text = re.sub(r"\[str\]|Annotated\[|, .*\]$", "", str(annotation))
    words = [word.strip() for word in text.split("|")]
    return {KINDS[word] for word in words} if set(words) <= set(KINDS) else None


def value_of(name, parameter):
    value = OTHER.get(name, {}).get(parameter.name, SOUND.get(parameter.name, parameter.empty))
    if name.startswith("comms.") and parameter.name == "link":
        return SOUND["ook"]
    if name.endswith(".decide") and parameter.name == "power":
        return [1e-9, 2e-9]
    if value is parameter.empty:
        if parameter.default is parameter.empty:
            raise LookupError(f"no sound value of {parameter.name} in sound_calls: {name}")
        return parameter.default
    return value() if callable(value) and value.__module__ == "sound_calls" else value


@cache
def sound(name):
    """Return the sound arguments of a function; studies are among them, so that they are kept."""
    return {p.name: value_of(name, p) for p in parameters(name)}


@cache
def bound(name):
    """Return a function, a method of an instance or of its class."""
    function, cls = callables()[name]
    if cls is None:
        return function
    word = name.rpartition(".")[2]
    if isinstance(inspect.getattr_static(cls, word), classmethod | staticmethod):
        bare = inspect.isabstract(cls) or cls in (Model, Family)
        return getattr(INSTANCES[cls.__name__]() if bare else cls, word)
    return getattr(INSTANCES[cls.__name__](), word)


@pytest.fixture(autouse=True, scope="module")
def no_work(request, tmp_path_factory):
    """End calls where light would be traced, a store be written or workers be started."""
    tests = [item for item in request.session.items if item.module is request.module]
    walked = {item.callspec.params["name"] for item in tests if hasattr(item, "callspec")}
    for name in sorted(walked):  # sound results are traced before, else each would count as work
        sound(name)
        bound(name)

    def accept(*arguments, **options):
        raise Accepted

    from meshtrace.engine import forced, simulate
    from meshtrace.optics import mie
    from meshtrace.studies import sweeps

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("walk"))
        patch.setattr(forced.ForcedDetection, "__init__", accept)
        patch.setattr(simulate, "run_analog", accept)
        patch.setattr(sweeps.Cluster, "map", accept)
        patch.setattr(mie, "_miepython", accept)
        patch.setattr(mt.surfaces.surface, "MOST_VERTICES", 50_000)
        yield


def call(function, arguments):
    """Return the answer of a call, or raise; a long one counts as accepted."""

    def end(*arguments):
        raise Accepted

    old = signal.signal(signal.SIGINT, end)
    alarm = threading.Timer(LONGEST, _thread.interrupt_main)  # Windows lacks SIGALRM
    alarm.start()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return function(**arguments)
    finally:
        alarm.cancel()
        alarm.join()
        signal.signal(signal.SIGINT, old)


def prepared(name, arguments):
    """Return a function of keywords, and those that differ from the defaults."""
    function, first, named = bound(name), [], {}
    for p in parameters(name):
        if p.kind is p.POSITIONAL_ONLY:
            first.append(arguments[p.name])
        elif p.default is p.empty or arguments[p.name] is not p.default:
            named[p.name] = arguments[p.name]
    return lambda **rest: function(*first, **rest), named


def is_finite(answer):
    """Return whether numbers and arrays of numbers, alone or in tuples, have no nan."""
    if isinstance(answer, tuple):
        return all(map(is_finite, answer))
    if isinstance(answer, float | np.ndarray) and np.asarray(answer).dtype.kind in "fc":
        return not np.isnan(answer).any()
    return True


def verdict(name, parameter, value_name):
    """Return what is wrong with the outcome of one wrong object, or ""."""
    arguments = {**sound(name), parameter.name: made(value_name)}
    try:
        answer = call(*prepared(name, arguments))
    except Refused as error:
        text = str(error)
        good = text.isprintable() and len(text) < 1000 and "allowed: " in text
        return "" if good else f"text of the refusal: {text!r:.200}"
    except Accepted:
        answer = None
    except Exception as error:
        return f"{type(error).__name__}: {error!s:.200}"
    allowed = kinds_of(parameter.annotation)
    if "Infinite" in str(parameter.annotation):  # of the numbers only nan and texts are wrong
        with contextlib.suppress(TypeError, ValueError, OverflowError), np.errstate(over="ignore"):
            if np.isinf(np.asarray(made(value_name), dtype=float)).any():
                return ""
    if allowed is not None and not allowed & set(VALUES[value_name][1]):
        return f"accepted, for {parameter.annotation}"
    return "" if name in WITHOUT or is_finite(answer) else f"nan: {answer!r:.100}"


def failures(name, chosen):
    found = []
    for parameter in parameters(name):
        for value_name in chosen(parameter):
            wrong, case = (
                verdict(name, parameter, value_name),
                f"{name}({parameter.name} = {value_name})",
            )
            if wrong and case not in USERS:
                found.append(f"{case}: {wrong}")
    return found


def quick(name):
    random = Random(name)
    return lambda parameter: random.sample(sorted(VALUES), SAMPLE)


QUICK = [pytest.param(n, marks=[pytest.mark.slow] * n.startswith(LATE)) for n in names()]


@pytest.mark.parametrize("name", [n for n in QUICK if n.values[0] not in LACKING])
def test_sound_calls_succeed(name):
    """Otherwise each wrong object would be refused for another argument."""
    with contextlib.suppress(Accepted):
        call(*prepared(name, sound(name)))


@pytest.mark.parametrize("name", QUICK)
def test_some_wrong_objects_are_refused(name):
    assert not failures(name, quick(name))


@pytest.mark.slow
@pytest.mark.filterwarnings(  # the alarm may ring while a reference is dropped
    "ignore::pytest.PytestUnraisableExceptionWarning"
)
@pytest.mark.parametrize("name", names())
def test_all_wrong_objects_are_refused(name):
    assert not failures(name, lambda parameter: list(VALUES))


def test_there_are_names_and_values():
    assert len(names()) > 300
    assert len(VALUES) > 100
