"""Draw the fading of a resolved sea at 5 m/s, and its effect on bit errors, for fading.md.

python docs/scripts/make_interleaving_figure.py [gains.nc]   # without gains 13 CPU minutes
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy.typing import NDArray
from places import STATIC
from scipy import stats
from scipy.interpolate import PchipInterpolator

import meshtrace as mt
from meshtrace import fading, viz
from meshtrace.comms import OokLink
from meshtrace.comms.budget import ber_of_gains, required_gain
from meshtrace.comms.interleaving import fade_margin_db, interleaved_outage
from meshtrace.results import load
from meshtrace.surfaces import resolved_sea

SEAS = 10_000
OOK = OokLink(bit_rate=1e6)
RATE, LIMIT = 0.8, 1e-3
FADES = (1, 2, 4, 8, 16, 64)


def gains_of(path: str | None) -> Any:
    """Return the gains of a file, or those of many seas resolved up to 24 rad/s."""
    if path is not None:
        return load(path)
    sea = resolved_sea(5.0, fetch=30e3).model_copy(update={"omega_max": 24.0})
    found = mt.ensemble(mt.Link(), SEAS, sea, photons=1024)
    found.save(Path("fading_gains.nc"))
    return found


def statistics(name: str, gain: NDArray[np.float64]) -> str:
    """Return index, quantiles and Kolmogorov distances of gains as a row of a table."""
    drawn = np.random.default_rng(1).choice(gain, (400, len(gain)))
    indices = drawn.var(axis=1) / drawn.mean(axis=1) ** 2
    relative = gain / gain.mean()
    laws = {
        "lognormal": stats.lognorm(*stats.lognorm.fit(gain, floc=0.0)),
        "gamma": stats.gamma(*stats.gamma.fit(gain, floc=0.0)),
        "gamma-gamma": fading.fit_gamma_gamma(gain).law,
    }
    distances = ", ".join(
        f"{law} {stats.kstest(gain, fit.cdf).statistic:.3f}" for law, fit in laws.items()
    )
    quantiles = ", ".join(f"{q:.3f}" for q in np.quantile(relative, [0.01, 0.05, 0.5, 0.95, 0.99]))
    index = gain.var(ddof=1) / gain.mean() ** 2
    return f"| {name} | {index:.4f} ± {indices.std():.4f} | {quantiles} | {distances} |"


def effective_fades(depths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the independent fades of the same variance of the mean over some times [s].

    The variance of the mean over T is 2 / T int_0^T (1 - t / T) rho(t) dt of that of the gain.
    """
    sea = resolved_sea(5.0, fetch=30e3).model_copy(update={"omega_max": 24.0})
    lag = np.concatenate([np.arange(0.0, 0.4, 0.01), np.arange(0.4, 4.0, 0.05)])
    rho = fading.gain_autocovariance(mt.Link(), sea, lag)
    curve = PchipInterpolator(lag, rho / rho[0])
    return np.array(
        [
            0.5 * t / np.trapezoid((1.0 - x / t) * curve(x), x)
            for t in depths
            for x in [np.linspace(0.0, t, 2001)]
        ]
    )


def average_bers(relative: NDArray[np.float64], margins: NDArray[np.float64]) -> list[float]:
    """Return the bit error rate averaged over the fading at mean margins [dB]."""
    needed = required_gain(OOK, LIMIT)
    return [float(ber_of_gains(OOK, needed * 10.0 ** (0.1 * m) * relative).mean()) for m in margins]


def panels(figure: Figure, gain: NDArray[np.float64]) -> None:
    """Draw distribution function, average error rate and outage."""
    left, middle, right = figure.subplots(1, 3)
    relative, margins = np.sort(gain / gain.mean()), np.linspace(-2.0, 10.0, 49)
    left.step(relative, (np.arange(len(gain)) + 1.0) / len(gain), label=f"{len(gain)} seas")
    x = np.geomspace(relative[0], relative[-1], 300)
    for name, fit in (
        ("lognormal", fading.fit_lognormal),
        ("gamma-gamma", fading.fit_gamma_gamma),
    ):
        left.plot(x, fit(relative).law.cdf(x), lw=1.2, label=name)
    left.set(xscale="log", yscale="log", xlabel="gain over its mean", ylim=(0.5 / len(gain), 1.2))
    left.set_xticks([0.2, 0.5, 1, 2, 5], ["0.2", "0.5", "1", "2", "5"])
    left.minorticks_off()
    left.set_ylabel("probability of a smaller gain")
    middle.plot(margins, average_bers(np.ones(2), margins), label="no fading")
    middle.plot(margins, average_bers(relative, margins), label="resolved sea, 5 m/s")
    middle.set(yscale="log", ylim=(1e-9, 0.5), xlabel="mean optical margin [dB]")
    middle.set_ylabel("average bit error rate")
    needed = margin_without_fading()
    shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(FADES)))
    for m, shade in zip(FADES, shades, strict=True):
        out = [
            interleaved_outage(OOK, needed * 10.0 ** (0.1 * margin) * relative, RATE, m)
            for margin in margins
        ]
        right.plot(margins, out, label=f"{m}", color=shade)
    right.set(yscale="log", ylim=(1e-4, 1.2), xlim=(-1.0, 10.0), xlabel="mean optical margin [dB]")
    right.set_ylabel("outage of a code of rate 0.8")
    right.legend(title="fades of\na code word", loc="upper right", fontsize="small")
    for ax in (left, middle):
        viz.marks.finished(ax)


def margin_without_fading() -> float:
    """Return the gain that the code needs without fading."""
    low, high = 0.1, 10.0
    needed = required_gain(OOK, LIMIT)
    for _ in range(50):
        m = np.sqrt(low * high)
        low, high = (low, m) if interleaved_outage(OOK, [m * needed], RATE) == 0.0 else (m, high)
    return high * needed


def main(path: str | None) -> None:
    found = gains_of(path)
    light = found.gain_ballistic
    print("| light | scintillation index | quantiles 1, 5, 50, 95, 99 % | Kolmogorov distances |")
    print("|---|---|---|---|")
    parts = (("unscattered", light), ("scattered", found.gain - light), ("all", found.gain))
    for name, gain in parts:
        print(statistics(name, gain))
    depths = np.array([0.05, 0.1, 0.2, 0.5, 1.0, 2.0])
    print("| depth [s] | fades | size at 1 Mbit/s |\n|---|---|---|")
    for depth, fades in zip(depths, effective_fades(depths), strict=True):
        print(f"| {depth:g} | {fades:.1f} | {depth:g} Mbit |")
    relative = found.gain / found.gain.mean()
    print("| fades of a code word | margin for an outage of 1e-2 [dB] | of 1e-3 [dB] |")
    print("|---|---|---|")
    for m in FADES:
        db = [fade_margin_db(OOK, relative, RATE, m, outage) for outage in (1e-2, 1e-3)]
        print(f"| {m} | {db[0]:.2f} | {db[1]:.2f} |")
    print("| mean optical margin [dB] | BER without fading | average BER |\n|---|---|---|")
    for m in (0.0, 3.0, 6.0):
        plain, faded = (average_bers(g, np.array([m]))[0] for g in (np.ones(2), relative))
        print(f"| {m:g} | {plain:.1e} | {faded:.1e} |")
    viz.use_style()
    figure = Figure(figsize=(11.0, 3.6), dpi=110)
    panels(figure, found.gain)
    viz.save_picture(figure, STATIC / "interleaving.png")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
