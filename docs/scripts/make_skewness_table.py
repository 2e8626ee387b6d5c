"""Measure the effect of skewed and peaked slopes on gain and glint, for slopes.md."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from places import write_table

import meshtrace as mt
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.surfaces.gram_charlier import GramCharlier
from meshtrace.surfaces.statistics import cox_munk

WINDS = 5.0, 10.0
LAWS = {
    "cox-munk": GramCharlier.cox_munk,
    "breon-henriot": GramCharlier.breon_henriot,
}
SEAS, SEEDS = 24, 12
ERRORS = 0.004, 0.002  # of the measured slope variances
BEAM = mt.Link(
    transmitter=mt.Led(half_angle_deg=2.0), receiver=mt.Receiver(radius=0.5, height=20.0)
)
LINKS = {
    "default link": mt.Link(),
    "beam of 2 degrees, on its axis": BEAM,
    "the same, lens 3 m downwind": BEAM.replace("receiver.position", (3.0, 0.0)),
    "the same, lens 3 m upwind": BEAM.replace("receiver.position", (-3.0, 0.0)),
    "the same, lens 6 m downwind": BEAM.replace("receiver.position", (6.0, 0.0)),
    "the same, lens 6 m upwind": BEAM.replace("receiver.position", (-6.0, 0.0)),
}
SUNS = {"downwind": 0.0, "across": 90.0, "upwind": 180.0}

Floats = NDArray[np.float64]


def flat(wind: float, law: GramCharlier, variances: tuple[float, float]) -> mt.TriangleMesh:
    """Return a flat sea whose slopes are all random."""
    mesh = FlatSea().mesh(extent=40.0, spacing=2.0)
    cumulants = law.cumulants(cox_munk(wind))
    slopes = UnresolvedSlopes(variances, variances, 0.0, cumulants)
    return mt.TriangleMesh(mesh.vertices, mesh.faces, mesh.vertex_normals, slopes)


def change(value: Floats, reference: Floats) -> str:
    """Return the relative change of the mean of pairs with its standard error [%]."""
    ratio, mean = value.mean() / reference.mean(), reference.mean()
    error = (value - ratio * reference).std(ddof=1) / mean / math.sqrt(len(value))
    return f"{100.0 * (ratio - 1.0):+.2f}±{100.0 * error:.2f}"


def gains(link: mt.Link, surfaces: list[JonswapSea] | list[mt.TriangleMesh]) -> Floats:
    """Return gains over surfaces, each with chains of its own."""
    return np.array(
        [mt.simulate(link, s, photons=8192, seed=i).gain for i, s in enumerate(surfaces)]
    )


def of_gains() -> list[str]:
    """Return the table of gains."""
    lines = [
        "| link | wind [m/s] | sea | Gaussian gain | Cox and Munk [%] | Breon and Henriot [%] | "
        "variances by their errors larger [%] |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, link in LINKS.items():
        for wind in WINDS:
            nodes = cox_munk(wind)
            wide = nodes[0] + ERRORS[0], nodes[1] + ERRORS[1]
            row = {
                law: gains(link, [flat(wind, made(wind), nodes)] * SEEDS)
                for law, made in LAWS.items()
            }
            plain = gains(link, [flat(wind, GramCharlier(), nodes)] * SEEDS)
            wider = gains(link, [flat(wind, GramCharlier(), wide)] * SEEDS)
            cells = [change(v, plain) for v in (*row.values(), wider)]
            lines.append(f"| {name} | {wind:g} | flat | {plain.mean():.3g} | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    return lines


def glint(surface: JonswapSea | mt.TriangleMesh, zenith: float, azimuth: float, seed: int) -> float:
    """Return the glint seen by the receiver of the default link, looking down."""
    day = mt.Daylight(direct=1.0, diffuse=0.0, sun_zenith_deg=zenith, sun_azimuth_deg=azimuth)
    found = mt.background(mt.Link(), surface, day, photons=16384, seed=seed, water="none")
    return float(found.parts["glint"])


def of_glint() -> list[str]:
    """Return the table of glint."""
    lines = [
        "| wind [m/s] | sun from the zenith [deg] | sun stands | glint over the sun's irradiance "
        "[sr-1] | Cox and Munk, flat [%] | waves [%] | Breon and Henriot, flat [%] |",
        "|---|---|---|---|---|---|---|",
    ]
    for wind in WINDS:
        nodes = cox_munk(wind)
        seas = [JonswapSea(wind_speed=wind, seed=seed) for seed in range(2 * SEAS)]
        skewed = [s.model_copy(update={"slope_law": "cox-munk"}) for s in seas]
        for zenith in (30.0, 50.0):
            for side, azimuth in SUNS.items():
                plain = np.array(
                    [glint(flat(wind, GramCharlier(), nodes), zenith, azimuth, i) for i in range(4)]
                )
                cells = []
                for made in LAWS.values():
                    mesh = flat(wind, made(wind), nodes)
                    values = [glint(mesh, zenith, azimuth, i) for i in range(4)]
                    cells.append(change(np.array(values), plain))
                pairs = [
                    [glint(s, zenith, azimuth, i) for i, s in enumerate(rows)]
                    for rows in (skewed, seas)
                ]
                cells.insert(1, change(*map(np.array, pairs)))
                place = f"| {wind:g} | {zenith:g} | {side} | {plain.mean():.3g} |"
                lines.append(f"{place} {' | '.join(cells)} |")
                print(lines[-1], flush=True)
    return lines


def main() -> None:
    """Write the table of gains, and print that of glint."""
    write_table("skewness_gains", "\n".join(of_gains()))
    print(*of_glint(), sep="\n")


if __name__ == "__main__":
    main()
