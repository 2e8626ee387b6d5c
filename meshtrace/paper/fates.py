"""Figure of what becomes of photons, for the paper's flow chart of its algorithm."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.paper.canvas import panels
from meshtrace.paper.links import FORM_NAMES, FORMS, scenario
from meshtrace.paper.registry import Drawing, Number, Setting, compared, figure
from meshtrace.results.gain import FATE_MEANING, Fate
from meshtrace.viz import plot_fates

WIND = 13.0
RADIUS = 0.25
"""Radius of an aperture that photons followed one by one meet often enough [m]."""


@figure(
    "fates",
    "5",
    "what becomes of the light",
    quick={"photons": 400_000},
    full={"photons": 20_000_000},
)
def fates(setting: Setting, photons: int) -> Drawing:
    """Draw shares of the light by fate."""
    picture, axes = panels(1, 2, width=6.4)
    results = {}
    for ax, form in zip(axes[0], FORMS, strict=True):
        made = scenario(WIND, form, receiver={"radius": RADIUS}, run={"estimator": "analog"})
        options: Any = {"photons": photons, "seed": setting.seed, "threads": setting.threads}
        results[form] = mt.simulate(made.link, made.surface, estimator="analog", **options)
        plot_fates(results[form], ax=ax)
        ax.set_title(FORM_NAMES[form])
    names = list(dict.fromkeys(n for r in results.values() for n in r.fates))
    shares = [
        [results[form].fates[n].weight if n in results[form].fates else 0.0 for n in names]
        for form in FORMS
    ]
    counts = np.array(shares) * photons
    rows = [
        compared(
            f"share of the light: {FATE_MEANING[Fate[name.upper()]]}",
            (
                Number(s, float(np.sqrt(max(c, 0.0)) / photons))
                for s, c in zip(both, n, strict=True)
            ),
            "The paper draws the branches of its algorithm and prints no share; its forms end "
            "reflected light and weigh by the albedo.",
        )
        for name, both, n in zip(names, np.array(shares).T, counts.T, strict=True)
        if max(both) > 0.0
    ]
    data = xr.Dataset(
        {"fate_weight": (("form", "fate"), shares, {"units": "1"})},
        {"form": list(FORMS), "fate": names},
    )
    caption = (
        f"The paper's flow chart has no numbers; here is how the light divides among its ends, at "
        f"{WIND:g} m/s with an aperture of {RADIUS:g} m. Standard errors are "
        "upper bounds, those of whole photons."
    )
    return Drawing(picture, data, rows, caption)
