"""Measure the dependence of the mean gain on band and spacing, for slopes.md.

The mean over seas of light that crosses once knows heights and slopes at one point only. Both are
Gaussian and independent there, so a flat mesh whose slopes are all random, averaged over its
height, gives that mean without any sea.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from places import write_table

import meshtrace as mt
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.surfaces.statistics import components_hs, cox_munk

BATCHES = 16
"""Sets of seas, each with chains of its own: their scatter is the standard error."""
CHAINS = 1024
HEIGHTS = 7
"""Nodes of the quadrature over heights."""

Floats = NDArray[np.float64]


class Study(NamedTuple):
    """A link, the part of the sea that its light crosses, and how many seas a batch holds."""

    title: str
    link: mt.Link
    extent: float
    seas: int


STUDIES = (
    Study(
        "A beam of 2 degrees, lens of 0.5 m radius 20 m above the sea",
        mt.Link(
            transmitter=mt.Led(half_angle_deg=2.0), receiver=mt.Receiver(radius=0.5, height=20.0)
        ),
        6.0,
        30,
    ),
    Study(
        "The default link, lens of 2 m radius", mt.Link(receiver=mt.Receiver(radius=2.0)), 9.0, 30
    ),
)
CASES = {
    5.0: ((4.0, 0.2), (4.0, 2.0), (8.0, 0.2)),
    13.0: ((3.0, 0.2), (3.0, 2.0), (9.0, 0.2)),
}


def means(study: Study, sea: JonswapSea, spacing: float, unresolved: str) -> Floats:
    """Return the mean gain of each batch of seas."""
    link = study.link.model_copy(update={"physics": mt.Physics(unresolved=unresolved)})
    options = {"photons": CHAINS, "mesh": mt.Meshing(spacing=spacing, extent=study.extent)}
    return np.array(
        [
            mt.ensemble(link, study.seas, sea, seed=batch, **options).gain.mean()
            for batch in range(BATCHES)
        ]
    )


def without_seas(study: Study, sea: JonswapSea) -> Floats:
    """Return the closed mean with the chains of each batch."""
    flat, slopes = FlatSea().mesh(extent=2.0 * study.extent, spacing=1.0), cox_munk(sea.wind_speed)
    rough = UnresolvedSlopes(slopes, slopes, sea.wind_direction_deg)
    nodes, weights = np.polynomial.hermite_e.hermegauss(HEIGHTS)
    total = np.zeros(BATCHES)
    for node, weight in zip(nodes, weights / weights.sum(), strict=True):
        level = [0.0, 0.0, node * components_hs(sea.components) / 4.0]
        mesh = mt.TriangleMesh(flat.vertices + level, flat.faces, flat.vertex_normals, rough)
        for batch in range(BATCHES):
            total[batch] += weight * mt.simulate(study.link, mesh, photons=CHAINS, seed=batch).gain
    return total


def rows(study: Study) -> list[str]:
    """Return a table of one link."""
    lines = [
        f"{study.title}:",
        "",
        "| wind [m/s] | omega_max [rad/s] | spacing [m] | share of the slope variance in the mesh "
        "[%] | gain of the mesh alone over the closed mean [%] | with tilts [%] |",
        "|---|---|---|---|---|---|",
    ]
    for wind_speed, cases in CASES.items():
        for omega_max, spacing in cases:
            sea = JonswapSea(wind_speed=wind_speed, omega_max=omega_max, waves="paper")
            target = sum(cox_munk(wind_speed))
            shown = 1.0 - sum(sea.unresolved_slopes(spacing).vertex) / target
            closed = without_seas(study, sea)
            cells = [f"{wind_speed:g}", f"{omega_max:g}", f"{spacing:g}", f"{100.0 * shown:.0f}"]
            for unresolved in ("none", "tilt"):
                change = 100.0 * (means(study, sea, spacing, unresolved) / closed - 1.0)
                stderr = change.std(ddof=1) / np.sqrt(BATCHES)
                cells.append(f"{change.mean():+.2f} ± {stderr:.2f}")
            lines.append("| " + " | ".join(cells) + " |")
            print(lines[-1], flush=True)
    return lines


def main() -> None:
    """Write the tables."""
    text = "\n".join([*rows(STUDIES[0]), "", *rows(STUDIES[1])])
    write_table("slopes", text)


if __name__ == "__main__":
    main()
