"""Measure the fading of unscattered, scattered and all light over resolved seas, for fading.md.

`python docs/scripts/make_scattered_table.py [realizations] [series]` writes the
table of fading.md.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from numpy.typing import NDArray
from places import write_table
from scipy import stats

import meshtrace as mt
from meshtrace import fading
from meshtrace.surfaces import Band, Elfouhaily, SpectralSea

# wind [m s-1], first and last frequency, their distance [rad s-1]
SEAS = [
    (3.0, 1.2, 28.0, 0.35),
    (5.0, 0.8, 24.0, 0.3),
    (8.0, 0.7, 22.0, 0.3),
    (13.0, 0.55, 20.0, 0.3),
]
CHAINS, STEP, FRAMES = 1024, 0.02, 25


def sea_of(wind: float, low: float, high: float, step: float, seed: int = 1) -> SpectralSea:
    """Return a sea with the spectrum of Elfouhaily et al. and tilts beyond its band."""
    spectrum = Elfouhaily(wind_speed=wind, fetch=30e3)
    return SpectralSea(
        spectrum=spectrum,
        spreading="elfouhaily",
        mss="elfouhaily",
        waves=Band(omega_min=low, omega_max=high, d_omega=step, d_theta=math.pi / 18.0),
        seed=seed,
    )


def index(gain: NDArray[np.float64]) -> tuple[float, float]:
    """Return the scintillation index and its standard error by the jackknife."""
    n = len(gain)
    s, q = gain.sum(), np.square(gain).sum()
    mean, square = (s - gain) / (n - 1), (q - np.square(gain)) / (n - 1)
    each = (square / mean**2 - 1.0) * (n - 1) / (n - 2)
    whole = float(gain.var(ddof=1) / gain.mean() ** 2)
    return whole, float(np.sqrt((n - 1) / n * np.square(each - each.mean()).sum()))


def best_law(gain: NDArray[np.float64]) -> str:
    """Return the law of the smallest Kolmogorov distance, with the distances."""
    found = {
        "lognormal": stats.lognorm(*stats.lognorm.fit(gain, floc=0.0)),
        "gamma": stats.gamma(*stats.gamma.fit(gain, floc=0.0)),
        "gamma-gamma": fading.fit_gamma_gamma(gain).law,
    }
    distance = {name: stats.kstest(gain, law.cdf).statistic for name, law in found.items()}
    best = min(distance, key=lambda name: distance[name])
    return f"{best} ({', '.join(f'{name} {d:.3f}' for name, d in distance.items())})"


def in_time(sea: SpectralSea, link: mt.Link, n: int) -> tuple[float, float, float, float]:
    """Return coherence time (1/e) and rate of crossings of half the mean, with standard errors."""
    times = STEP * np.arange(FRAMES)
    rows = [mt.time_series(link, sea.with_seed(900 + i), times, photons=256).gain for i in range(n)]
    gain = np.array(rows)
    level = 0.5 * gain.mean()
    rate = ((gain[:, :-1] >= level) & (gain[:, 1:] < level)).sum(axis=1) / times[-1]

    def fall(g: NDArray[np.float64]) -> float:
        share = g - g.mean()
        rho = [np.mean(share[:, : FRAMES - k] * share[:, k:]) for k in range(FRAMES)]
        rho = np.array(rho) / rho[0]
        first = int(np.argmax(rho < math.exp(-1.0)))
        return float(
            np.interp(-math.exp(-1.0), -rho[first - 1 : first + 1], times[[first - 1, first]])
        )

    left = np.array([fall(np.delete(gain, i, axis=0)) for i in range(n)])
    spread = math.sqrt((n - 1) / n * float(np.square(left - left.mean()).sum()))
    return fall(gain), spread, float(rate.mean()), float(rate.std(ddof=1) / math.sqrt(n))


def table(realizations: int, series: int) -> str:
    """Return the table of the fading at each wind."""
    rows = [
        "| wind [m/s] | highest omega [rad/s] | SI of unscattered light, closed form | measured "
        "| SI of scattered light | SI of all light | share of scattered light | 1 %, 5 %, 50 % "
        "quantile over the mean | Kolmogorov distances | coherence time [s] "
        "| fades below half the mean [s-1] |",
        "|" + "---|" * 11,
    ]
    link = mt.Link()
    for wind, *band in SEAS:
        sea = sea_of(wind, *band)
        closed = fading.scintillation_of_spectrum(link, sea, band[1])
        found = mt.ensemble(link, realizations, sea, photons=CHAINS)
        whole, direct = found.gain, found.gain_ballistic
        parts = [index(g) for g in (direct, whole - direct, whole)]
        quantiles = np.quantile(whole / whole.mean(), [0.01, 0.05, 0.5])
        tau, tau_error, rate, rate_error = in_time(sea, link, series)
        rows.append(
            f"| {wind:g} | {band[1]:g} | {closed:.3f} "
            + "".join(f"| {si:.3f} ± {error:.3f} " for si, error in parts)
            + f"| {1.0 - direct.sum() / whole.sum():.3f} "
            f"| {', '.join(f'{q:.2f}' for q in quantiles)} | {best_law(whole)} "
            f"| {tau:.3f} ± {tau_error:.3f} | {rate:.2f} ± {rate_error:.2f} |"
        )
        print(rows[-1], flush=True)
    return "\n".join(rows)


if __name__ == "__main__":
    sizes = [int(n) for n in sys.argv[1:]] or [600, 24]
    write_table("scattered", table(*sizes))
