"""Measure the scintillation index by wind and band limit and write it into fading.md."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import meshtrace as mt
from meshtrace.surfaces import JonswapSea

PAGE = Path(__file__).with_name("fading.md")
CASES = [
    (5.0, None, 0.1, 1000),
    (13.0, None, 0.1, 1000),
    (5.0, 4.0, 0.1, 400),
    (13.0, 4.0, 0.1, 400),
    (5.0, 8.0, 0.05, 150),
    (13.0, 8.0, 0.05, 150),
]


def paraxial(link: mt.Link, sea: JonswapSea, seeds: np.ndarray) -> tuple[float, float]:
    """Return the scintillation index of focusing alone, and of focusing with the wave's height.

    Unscattered light on the axis: gain ~ exp(-c (d + eta)) / (d + eta + n (h - eta))^2
    / |det(I + beta Hess eta)|.
    """
    d, h, n, c = 10.0, 5.0, link.water.n, link.water.c
    focus, full = [], []
    for seed in seeds:
        wave = sea.with_seed(int(seed))
        eta = float(wave.elevation(0.0, 0.0))
        xx, xy, yy = (float(v) for v in wave.second_derivatives(0.0, 0.0))
        beta = (n - 1.0) * h * d / (d + n * h)
        lens = 1.0 / abs((1.0 + beta * xx) * (1.0 + beta * yy) - (beta * xy) ** 2)
        focus.append(lens)
        full.append(lens * np.exp(-c * eta) / (d + eta + n * (h - eta)) ** 2)
    return tuple(float(np.var(g) / np.mean(g) ** 2) for g in (focus, full))


def table() -> str:
    """Return the table of scintillation indices."""
    rows = [
        "| wind | highest omega | realizations | scintillation index | 95 % interval | mean gain "
        "| of focusing alone | of focusing and height |",
        "|---|---|---|---|---|---|---|---|",
    ]
    link = mt.Link()
    for wind, omega_max, spacing, n in CASES:
        if omega_max is None:
            sea = JonswapSea(wind_speed=wind, seed=1)
            top = "paper's band"
        else:
            step = 0.2 if wind == 5.0 else 0.1
            low = 1.2 if wind == 5.0 else 0.9
            sea = JonswapSea(
                wind_speed=wind,
                seed=1,
                omega_min=low,
                omega_max=omega_max,
                d_omega=step,
                d_theta=np.pi / 20,
            )
            top = f"{omega_max:g} rad/s"
        series = mt.ensemble(link, n, sea, photons=512, spacing=spacing)
        statistics = series.fading(test_resamples=0)
        si = statistics.scintillation_index
        focus, full = paraxial(link, sea, series.coordinate)
        rows.append(
            f"| {wind:g} m/s | {top} | {n} | {si.value:.4f} | {si.low:.4f} to {si.high:.4f} | "
            f"{series.gain.mean():.3e} | {focus:.4f} | {full:.4f} |"
        )
        print(rows[-1], flush=True)
    return "\n".join(rows)


if __name__ == "__main__":
    page = PAGE.read_text()
    block = f"<!-- table -->\n{table()}\n<!-- end -->"
    PAGE.write_text(re.sub(r"<!-- table -->.*<!-- end -->", lambda _: block, page, flags=re.S))
