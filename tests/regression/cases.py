"""Small runs of every study, whose numbers a change of structure leaves as they are.

The keys name the kept numbers in `digits.json`; a case is a function without arguments.
"""

from functools import partial

import numpy as np

import meshtrace as mt
from meshtrace.scenario import Scenario
from meshtrace.studies import fading_study
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea, resolved_sea

LINK = mt.Link()
DOWN = LINK.mirrored()
TWO = mt.Link(receiver=(mt.Receiver(), mt.Receiver(position=(0.5, 0.0))))
LAMPS = mt.Link(transmitter=(mt.Led(), mt.Led(position=(0.3, 0.0))))
BEAM = mt.Link(transmitter=mt.GaussianBeam(divergence_deg=1.0))
SEA = JonswapSea(wind_speed=13.0, seed=3, waves="paper")
BARE = JonswapSea(wind_speed=13.0, seed=3, mss="band", waves="paper")
WAVE = SinusoidalSea(amplitude=0.06, wavelength=4.0, direction_deg=30.0, phase=3.0)
FLAT = FlatSea()
DAY = mt.Daylight(direct=1.42, diffuse=0.295)

FEW = {"photons": 64, "seed": 5, "threads": 1}
MESH = mt.Meshing(extent=4.0, spacing=0.2)
SMALL = {**FEW, "mesh": MESH}
ANALOG = {"estimator": "analog", "photons": 20_000, "seed": 5, "threads": 1}
TIMES = np.arange(6) * 0.4
FLIGHT = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=8.0))
COUPLED = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=8.0), coupled=True)
ROUTE = mt.Route(times=(0.0, 2.0), positions=((0.0, 0.0), (1.0, 0.5)))
ANGLE = "transmitter.half_angle_deg"
DEEP = LINK.replace("transmitter.depth", 40.0)
PAIR = {"clear": LINK, "turbid": LINK.replace("water.b", 0.1), "far": LINK.at_depth(12.0)}
FILE = """
wind_speed = 8.0
[transmitter]
kind = "led"
depth = 30.0
[receiver]
fov_deg = 20.0
[detector]
optics = {filter_width_nm = 2.0}
[run]
photons = 64
seed = 9
"""
LIT = Scenario.from_toml(FILE).replace(daylight=DAY, surface=SEA)
MEASURED = [
    {"transmitter.depth": d, "receiver.fov_deg": v, "gain": g, "stderr": 0.02 * g}
    for d, v, g in (
        (5.0, 60.0, 2.4e-4),
        (10.0, 60.0, 5.3e-5),
        (10.0, 6.0, 4.6e-5),
        (15.0, 6.0, 1.4e-5),
    )
]


def still(link):
    """Return the impulse response of photons over still water."""
    found = mt.simulate(link, FLAT, record=[mt.Arrivals()], **FEW)
    return mt.impulse_response(found)


CASES = {
    "simulate flat": partial(mt.simulate, LINK, FLAT, **FEW),
    "simulate sea": partial(mt.simulate, LINK, SEA, **SMALL),
    "simulate facets": partial(mt.simulate, LINK, BARE, normals="facet", **SMALL),
    "simulate default mesh": partial(mt.simulate, LINK, SEA, **FEW),
    "simulate turbid": partial(mt.simulate, LINK.replace("water.b", 0.4), SEA, **SMALL),
    "simulate receivers": partial(mt.simulate, TWO, SEA, **SMALL),
    "simulate lamps": partial(mt.simulate, LAMPS, SEA, **SMALL),
    "simulate beam": partial(mt.simulate, BEAM, WAVE, **SMALL),
    "simulate down": partial(mt.simulate, DOWN, SEA, **SMALL),
    "simulate wide": partial(mt.simulate, LINK.replace("receiver.fov_deg", 120.0), SEA, **SMALL),
    "simulate bubbles": partial(mt.simulate, LINK.in_wind(10.0), SEA, **SMALL),
    "simulate rtol": partial(mt.simulate, LINK, WAVE, rtol=0.02, **FEW),
    "impulse response": partial(still, LINK),
    "analog flat": partial(mt.simulate, LINK.replace("receiver.radius", 0.5), FLAT, **ANALOG),
    "analog sea": partial(mt.simulate, LINK.replace("receiver.radius", 0.5), SEA, **ANALOG),
    "analog down": partial(mt.simulate, DOWN.replace("receiver.radius", 0.5), WAVE, **ANALOG),
    "series": partial(mt.time_series, LINK, SEA, TIMES, **SMALL),
    "series threads": partial(mt.time_series, LINK, WAVE, TIMES, **{**SMALL, "threads": 2}),
    "series receivers": partial(mt.time_series, TWO, BARE, TIMES[:3], **SMALL),
    "series flight": partial(mt.time_series, LINK, SEA, TIMES, flight=FLIGHT, **SMALL),
    "series route": partial(mt.time_series, LINK, SEA, TIMES, route=ROUTE, **SMALL),
    "series flown route": partial(
        mt.time_series, LINK, SEA, TIMES, flight=FLIGHT, route=ROUTE, **{**SMALL, "threads": 2}
    ),
    "series down": partial(mt.time_series, DOWN, WAVE, TIMES[:3], **SMALL),
    "series flight down": partial(mt.time_series, DOWN, WAVE, TIMES[:3], flight=FLIGHT, **SMALL),
    "ensemble": partial(mt.ensemble, LINK, 6, SEA, **SMALL),
    "ensemble one": partial(mt.ensemble, LINK, 1, SEA, **SMALL),
    "ensemble receivers": partial(
        mt.ensemble, TWO, 5, BARE, **{**SMALL, "mesh": MESH.replace(normals="facet")}
    ),
    "ensemble at a time": partial(
        mt.ensemble, LINK, 3, SEA, **{**FEW, "threads": 2}, mesh=MESH.replace(time=2.5)
    ),
    "ensemble scenario": partial(mt.ensemble, LIT, 3, mesh=MESH, threads=1),
    "compare": partial(mt.compare, PAIR, SEA, **FEW),
    "compare seas": partial(mt.compare, PAIR, SEA, realizations=5, **{**FEW, "threads": 2}),
    "compare places": partial(
        mt.compare,
        {"a": LINK, "b": LINK.replace("receiver.position", (1.0, 0.5)), "c": BEAM},
        SEA,
        realizations=2,
        **FEW,
    ),
    "compare down": partial(mt.compare, {"a": DOWN, "b": DOWN.at_depth(8.0)}, WAVE, **FEW),
    "compare winds": partial(
        mt.compare, {"calm": LINK, "windy": LINK.in_wind(10.0)}, realizations=2, **FEW
    ),
    "compare lit": partial(mt.compare, {"lit": LIT, "deep": LIT.replace(link=DEEP)}, threads=1),
    "compare lit seas": partial(
        mt.compare, {"lit": LIT, "deep": LIT.replace(link=DEEP)}, realizations=3, threads=1
    ),
    "duplex times": partial(mt.duplex, LINK, DOWN, WAVE, TIMES, **SMALL),
    "duplex seas": partial(mt.duplex, LINK, DOWN, SEA, realizations=5, **{**SMALL, "threads": 2}),
    "duplex waters": partial(
        mt.duplex, LINK.replace("water.a", 0.2), DOWN, SEA, realizations=2, **FEW
    ),
    "coverage": partial(mt.coverage_map, LINK, SEA, 1.0, 0.25, photons=20_000, seed=3, threads=1),
    "coverage in time": partial(
        mt.coverage_map, LINK, FLAT, 1.0, 0.5, times=(0.0, 1.0), photons=20_000, threads=1
    ),
    "light pattern": partial(mt.light_pattern, LINK, WAVE, 0.5, 0.05),
    "background": partial(mt.background, LINK, SEA, DAY, photons=256, threads=1),
    "background down": partial(mt.background, DOWN, WAVE, DAY, photons=256, threads=1),
    "background series": partial(
        mt.background_series, LINK, WAVE, DAY, TIMES[:3], photons=64, seed=5, flight=FLIGHT, threads=1
    ),
    "performance": partial(
        mt.link_performance, LINK, SEA, depths=(20.0, 40.0), realizations=4, **FEW
    ),
    "performance flat": partial(mt.link_performance, LINK, FLAT, depths=(40.0, 50.0, 60.0), **FEW),
    "performance flight": partial(
        mt.link_performance, DEEP, SEA, flight=FLIGHT, realizations=4, **FEW
    ),
    "performance coupled": partial(
        mt.link_performance, DEEP, WAVE, flight=COUPLED, realizations=6,
        daylight=DAY, **FEW,
    ),
    "convergence": partial(
        mt.convergence_study, LINK, WAVE, (1.0, 0.5, 0.25, 0.2), placements=2, reference=None, **FEW
    ),
    "convergence bands": partial(
        mt.band_limit_study, LINK, SEA, (2.0, 3.0, 4.0, 5.0), realizations=2,
        mesh=mt.Meshing(spacing=0.5), **FEW
    ),
    "convergence steps": partial(
        mt.time_step_study, LINK, WAVE, (0.8, 0.4, 0.2, 0.1), duration=1.6,
        mesh=mt.Meshing(spacing=0.2), **FEW
    ),
    "convergence fading": partial(
        fading_study, LINK, resolved_sea(5.0), (4.0, 8.0, 12.0, 16.0), realizations=2,
        mesh=mt.Meshing(spacing=0.2), **FEW
    ),
    "sensitivities": partial(
        mt.sensitivities, LINK, WAVE, ["water.a", "water.b", "receiver.height", "receiver.fov_deg"], **FEW
    ),
    "sensitivities seas": partial(
        mt.sensitivities, LINK, SEA, ["water.a", "transmitter.depth"], "ber", realizations=2, **FEW
    ),
    "optimum": partial(
        mt.optimize, LINK, FLAT, {ANGLE: (3.0, 30.0)}, "gain", realizations=1, photons=64, threads=1
    ),
    "optimum hover": partial(
        mt.optimize, LINK, SEA, {ANGLE: (8.0, 14.0)}, "outage", hover_std=(0.5, 0.5),
        flight=mt.Flight(),
        realizations=3, photons=64, threads=1,
    ),
    "inference": partial(
        mt.infer, MEASURED, LINK, ["water.a", "water.b"], surface=FLAT, photons=64, threads=1
    ),
}  # fmt: skip
