"""Draw the scintillation index against the shortest waves of the sea: closed form and meshes.

python docs/scripts/make_bands_figure.py       # some five CPU minutes
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from places import STATIC

import meshtrace as mt
from meshtrace import viz
from meshtrace.studies import fading_study
from meshtrace.surfaces import Elfouhaily, SpectralSea

CURVE = tuple(np.geomspace(3.0, 128.0, 25))
BANDS = (4.0, 8.0, 16.0, 24.0)
SEAS = 150
LINK = mt.Link()
SEA = SpectralSea(
    spectrum=Elfouhaily(wind_speed=5.0, fetch=30e3),
    spreading="elfouhaily",
    mss="elfouhaily",
    omega_max=24.0,
)


def index(gains: np.ndarray) -> tuple[float, float]:
    """Return the scintillation index of independent gains and its bootstrap error."""
    drawn = np.random.default_rng(1).choice(gains, (400, len(gains)))
    indices = drawn.var(axis=1) / drawn.mean(axis=1) ** 2
    return float(gains.var(ddof=1) / gains.mean() ** 2), float(indices.std())


def band_alone(omega_max: float) -> tuple[float, float]:
    """Return the index of unscattered light over seas without waves beyond a band."""
    sea = SEA.model_copy(update={"omega_max": omega_max, "mss": "band"})
    seas = mt.ensemble(LINK, SEAS, sea, photons=32, seed=2)
    return index(seas.gain_ballistic)


def main(folder: Path) -> None:
    viz.use_style()
    curve = fading_study(LINK, SEA, CURVE)
    points = fading_study(LINK, SEA, BANDS, realizations=SEAS, photons=32)
    alone = np.array([band_alone(omega) for omega in BANDS])

    figure, ax = plt.subplots(figsize=(6.4, 4.0))
    parts = (
        (
            "random slopes beyond the band",
            curve.with_tilts,
            points.measured,
            points.measured_stderr,
        ),
        ("no waves beyond the band", curve.band_alone, *alone.T),
    )
    for (label, closed, found, error), color in zip(parts, ("C0", "C1"), strict=True):
        ax.plot(curve.omega_max, closed, color=color, label=f"closed form, {label}")
        ax.errorbar(
            BANDS, found, 2.0 * error, fmt="o", ms=4, capsize=2, color=color,
            label=f"{SEAS} seas, {label}",
        )  # fmt: skip
    ax.axhline(curve.all_waves, color="0.4", ls="--", lw=1.0)
    ax.annotate(
        f"all waves, {curve.all_waves:.2f}", (3.2, curve.all_waves), xytext=(0, 4),
        textcoords="offset points", color="0.3",
    )  # fmt: skip
    ax.set(xscale="log", yscale="log", ylim=(1e-3, 4.0), xlim=(3.0, 128.0))
    ax.set_xticks([4, 8, 16, 24, 32, 64, 128], ["4", "8", "16", "24", "32", "64", "128"])
    ax.minorticks_off()
    ax.set_xlabel(r"highest frequency of the sea $\omega_\mathrm{max}$ [rad s$^{-1}$]")
    ax.set_ylabel("scintillation index of unscattered light")
    viz.marks.finished(ax)
    figure.savefig(folder / "fading_bands.png")
    plt.close(figure)


if __name__ == "__main__":
    main(STATIC)
