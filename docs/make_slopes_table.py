"""Measure how the mean gain hangs on band and spacing, and write it into slopes.md."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace.surfaces import JonswapSea
from meshtrace.surfaces.statistics import cox_munk

PAGE = Path(__file__).with_name("slopes.md")
SEAS = 80
LENS = mt.Receiver(radius=2.0)
CASES = {
    5.0: ((4.0, 0.1), (4.0, 1.0), (4.0, 2.0), (6.0, 0.1), (8.0, 0.1)),
    13.0: ((3.0, 0.1), (3.0, 1.0), (3.0, 2.0), (6.0, 0.1), (9.0, 0.1)),
}


def gains(sea: JonswapSea, spacing: float, unresolved: str) -> mt.GainSeries:
    """Return the gains over random phases, the same long waves for every band."""
    link = mt.Link(receiver=LENS, physics=mt.Physics(unresolved=unresolved))
    return mt.ensemble(link, SEAS, sea, photons=1024, spacing=spacing, extent=9.0)


def change(e: mt.GainSeries, first: mt.GainSeries) -> str:
    """Return the change of the mean gain [%] with its standard error, by pairs of seas."""
    ratio = 100.0 * (e.gain - first.gain) / first.gain.mean()
    return f"{ratio.mean():+.2f} +- {ratio.std(ddof=1) / np.sqrt(SEAS):.2f}"


def table() -> str:
    """Return the table."""
    rows = [
        "| wind [m/s] | omega_max [rad/s] | spacing [m] | slope variance of the mesh "
        "| change of the mean gain, mesh alone [%] | with tilts [%] |",
        "|---|---|---|---|---|---|",
    ]
    for wind_speed, cases in CASES.items():
        first: dict[str, mt.GainSeries] = {}
        for omega_max, spacing in cases:
            sea = JonswapSea(wind_speed=wind_speed, omega_max=omega_max)
            missing = sea.unresolved_slopes(spacing)
            shown = sum(cox_munk(wind_speed)) - sum(missing.vertex)
            cells = [f"{wind_speed:g}", f"{omega_max:g}", f"{spacing:g}", f"{shown:.4f}"]
            for unresolved in ("none", "tilt"):
                e = gains(sea, spacing, unresolved)
                cells.append(change(e, first.setdefault(unresolved, e)))
                if e is first[unresolved]:
                    error = e.gain.std(ddof=1) / np.sqrt(SEAS)
                    cells[-1] = f"{e.gain.mean():.5f} +- {error:.5f}"
            rows.append("| " + " | ".join(cells) + " |")
            print(rows[-1], flush=True)
    return "\n".join(rows)


if __name__ == "__main__":
    page = PAGE.read_text()
    block = f"<!-- table -->\n{table()}\n<!-- end -->"
    PAGE.write_text(re.sub(r"<!-- table -->.*<!-- end -->", lambda _: block, page, flags=re.S))
