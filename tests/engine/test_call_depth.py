"""Way from `simulate` to the kernels: frames and files of every call of compiled code.

Whoever asks what happens to a photon reads them from top to bottom. The rays of Embree count as
calls of a kernel; the geometry of a mesh does not, it is there before the light.
"""

import sys

import pytest
from numba.core.registry import CPUDispatcher

import meshtrace as mt
from meshtrace.kernels import jit
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = [
    pytest.mark.skipif(bool(jit.config.DISABLE_JIT), reason="there are no compiled kernels"),
    pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning"),
]

MOST = 7  # frames from `simulate` to the caller of a kernel, and files with that of the kernel

LINK = mt.Link()
SEA = JonswapSea(wind_speed=13.0, seed=3, waves="paper")
SMALL = {"photons": 64, "threads": 1, "mesh": mt.Meshing(extent=4.0, spacing=0.2)}
BEAM = LINK.replace("transmitter", mt.GaussianBeam(divergence_deg=1.0))
BACK = mt.IrradianceMap(height=5.0, extent=1.0, step=0.5, axis=(0.0, 0.0, -1.0))
CASES = {
    "sea": lambda: mt.simulate(LINK, SEA, **SMALL),
    "arrivals": lambda: mt.simulate(LINK, SEA, record=[mt.Arrivals()], **SMALL),
    "facets": lambda: mt.simulate(LINK, SEA.replace(mss="band"), normals="facet", **SMALL),
    "down": lambda: mt.simulate(LINK.mirrored(), SEA, **SMALL),
    "turbid": lambda: mt.simulate(LINK.replace("water.b", 0.4), SEA, **SMALL),
    "bubbles": lambda: mt.simulate(LINK.in_wind(10.0), SEA, **SMALL),
    "beam": lambda: mt.simulate(BEAM, SEA, **SMALL),
    "waist": lambda: mt.simulate(BEAM.replace("transmitter.waist", 0.05), SEA, **SMALL),
    "dark": lambda: mt.simulate(
        LINK.replace("receiver.position", (60.0, 0.0)), FlatSea(), photons=64, threads=1
    ),
    "analog": lambda: mt.simulate(
        LINK, SEA, "analog", photons=4096, threads=1, record=[BACK, mt.Arrivals()]
    ),
}


@pytest.fixture
def ways(monkeypatch):
    """Return the ways to kernels, as they are called: (file, function) of each frame."""
    found = {}

    def way_of(frame):
        rows = []
        while frame is not None:
            rows.append((frame.f_code.co_filename, frame.f_code.co_name))
            if rows[-1][1] == "simulate":
                return rows[::-1]
            frame = frame.f_back
        return None

    def watched(name, file, kernel):
        def call(*args, **options):
            way = way_of(sys._getframe(1))
            if way is not None and not any(f in apart for f, _ in way):
                found[name, tuple(way)] = {file, *(f for f, _ in way)}
            return kernel(*args, **options)

        return call

    apart = {sys.modules[c.__module__].__file__ for c in (mt.EmbreeIntersector, mt.TriangleMesh)}
    embree = sys.modules[mt.EmbreeIntersector.__module__].__file__
    rays = watched("rays", embree, mt.EmbreeIntersector.intersect)
    monkeypatch.setattr(mt.EmbreeIntersector, "intersect", rays)
    modules = [m for name, m in sys.modules.items() if name.startswith("meshtrace.")]
    for module in modules:
        for name, value in list(vars(module).items()):
            if isinstance(value, CPUDispatcher) and isinstance(value._cache, jit.KernelCache):
                file = value.py_func.__code__.co_filename
                monkeypatch.setattr(module, name, watched(name, file, value))
    return found


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.thorough) if n == "waist" else n for n in CASES]
)
def test_kernels_are_called_a_few_frames_below_simulate(name, ways):
    CASES[name]()
    kernels = {kernel for kernel, _ in ways}
    assert len(kernels) > 1 or kernels == {"follow"}  # analog photons
    deep = {k: [f for _, f in way] for (k, way), _ in ways.items() if len(way) > MOST}
    assert not deep
    assert max(len(files) for files in ways.values()) <= MOST
