"""Figure of the fates of photons, for the paper's flow chart of its algorithm."""

from __future__ import annotations

from typing import Any

import numpy as np

import meshtrace as mt
from meshtrace.paper.canvas import dataset, panels
from meshtrace.paper.links import FORM_NAMES, FORMS, scenario
from meshtrace.paper.registry import FigureOutput, Number, Setting, row
from meshtrace.results.gain import FATE_MEANING, Fate
from meshtrace.viz import plot_fates

WIND = 13.0
RADIUS = 0.25
"""Radius of an aperture that photons followed one by one meet often enough [m]."""


def fates(setting: Setting, photons: int) -> FigureOutput:
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
    numbers = [
        row(
            "share",
            [
                Number(s, float(np.sqrt(max(c, 0.0)) / photons))
                for s, c in zip(both, n, strict=True)
            ],
            fate=FATE_MEANING[Fate[name.upper()]],
        )
        for name, both, n in zip(names, np.array(shares).T, counts.T, strict=True)
        if max(both) > 0.0
    ]
    data = dataset(("form", "fate"), {"fate_weight": shares}, form=FORMS, fate=names)
    return FigureOutput(picture, data, numbers, {"wind": WIND, "radius": RADIUS})
