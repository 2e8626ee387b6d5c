"""Measure the scintillation index by wind and band limit and write the table of fading.md."""

from __future__ import annotations

import numpy as np
from places import write_table

import meshtrace as mt
from meshtrace.surfaces import Band, JonswapSea

# wind [m s-1], highest frequency [rad s-1] (None: the paper's band), what lies beyond the band,
# spacing [m], realizations
CASES = [
    (5.0, None, "band", 0.1, 600),
    (13.0, None, "band", 0.1, 600),
    (5.0, 4.0, "band", 0.1, 300),
    (13.0, 4.0, "band", 0.1, 300),
    (5.0, 8.0, "band", 0.05, 120),
    (13.0, 8.0, "band", 0.05, 120),
    (5.0, None, "cox-munk", 0.1, 300),
    (13.0, None, "cox-munk", 0.1, 300),
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


def sea_of(wind_speed: float, omega_max: float | None, mss: str) -> JonswapSea:
    """Return a sea with the paper's band, or one from its lowest up to another frequency."""
    if omega_max is None:
        return JonswapSea(wind_speed=wind_speed, seed=1, mss=mss, waves="paper")
    low, step = (1.2, 0.2) if wind_speed == 5.0 else (0.9, 0.1)
    equal = {"d_omega": step, "d_theta": np.pi / 20, "drawn": False}
    band = Band(omega_min=low, omega_max=omega_max, **equal)
    return JonswapSea(wind_speed=wind_speed, seed=1, waves=band, mss=mss)


def table() -> str:
    """Return the table of scintillation indices."""
    rows = [
        "| wind | highest omega | beyond it | realizations | scintillation index | 95 % interval "
        "| mean gain [1e-5] | of focusing alone | of focusing and height |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    link = mt.Link()
    for wind, omega_max, mss, spacing, n in CASES:
        sea = sea_of(wind, omega_max, mss)
        series = mt.ensemble(link, n, sea, photons=512, mesh=mt.Meshing(spacing=spacing))
        statistics = series.fading(test_resamples=0)
        si = statistics.scintillation_index
        focus, full = paraxial(link, sea, series.coordinate)
        rows.append(
            f"| {wind:g} m/s | {'paper' if omega_max is None else f'{omega_max:g} rad/s'} "
            f"| {'nothing' if mss == 'band' else 'tilted normals'} | {n} | {si.value:.4f} "
            f"| {si.low:.4f} to {si.high:.4f} "
            f"| {1e5 * statistics.mean:.3f} ± {1e5 * statistics.mean_stderr:.3f} "
            f"| {focus:.4f} | {full:.4f} |"
        )
        print(rows[-1], f"noise {statistics.noise_share:.3f}", flush=True)
    return "\n".join(rows)


if __name__ == "__main__":
    write_table("fading", table())
