"""Figures of the wind at the UAV, of its tilt, and of the factor of the gain that follows."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.paper.canvas import panels, wind_name
from meshtrace.paper.links import FORM_NAMES, FORMS, ROUGH, UAV, Form, gusts
from meshtrace.paper.registry import Entry, FigureOutput, Number, Setting, row
from meshtrace.uav.tilt import compare_laws
from meshtrace.viz.style import INK, PALETTE, finished

KNOT = 1852.0 / 3600.0
"""One knot [m s-1]."""

MODERATE_W20 = 30.0
"""Wind at 20 feet for moderate turbulence [kt], Appendix B."""

_RED = PALETTE["vermilion"]


def _laws(wind: float, form: Form) -> tuple[Any, Any]:
    """Return the exact law of the tilt and the paper's Gamma law."""
    dryden = gusts(wind, form)
    return UAV.tilt_law(dryden), UAV.tilt_law(dryden, "gamma")


def tilt(setting: Setting, samples: int) -> FigureOutput:
    """Draw sampled tilts, their exact law and the paper's Gamma law."""
    picture, axes = panels(2, 2)
    variables: dict[str, Any] = {}
    for ax, (form, wind) in zip(axes.flat, itertools.product(FORMS, ROUGH), strict=True):
        exact, gamma = _laws(wind, form)
        drawn = UAV.tilt(gusts(wind, form).sample_wind(samples, setting.seed)).angle
        grid = np.linspace(exact.ppf(1e-6), exact.ppf(1.0 - 1e-6), 400)
        density, edges = np.histogram(drawn, bins=80, density=True)
        key, per_degree = f"{form}_{wind:g}", np.radians(1.0)
        look: Any = {"fill": True, "color": PALETTE["sky"], "alpha": 0.5}
        ax.stairs(density * per_degree, np.degrees(edges), **look, label="sampled")
        laws = ((exact, "exact law", "exact", "-", INK), (gamma, "Gamma", "gamma", "--", _RED))
        for law, label, name, dashes, color in laws:
            pdf = law.pdf(grid)
            ax.plot(np.degrees(grid), pdf * per_degree, dashes, color=color, label=label)
            variables[f"pdf_{name}_{key}"] = (f"angle_{key}", pdf, {"units": "rad-1"})
        x, y = r"tilt $\alpha$ [°]", r"probability density [1/°]"
        finished(ax, title=f"{wind_name(wind)}, {FORM_NAMES[form]}", xlabel=x, ylabel=y)
        variables[f"angle_{key}"] = (f"angle_{key}", grid, {"units": "rad"})
        variables[f"pdf_sampled_{key}"] = (f"bin_{key}", density, {"units": "rad-1"})
        variables[f"edges_{key}"] = (f"edge_{key}", edges, {"units": "rad"})
    numbers = [entry for wind in ROUGH for entry in _tilt_numbers(wind)]
    return FigureOutput(picture, xr.Dataset(variables), numbers)


def _tilt_numbers(wind: float) -> list[Entry]:
    pairs = [_laws(wind, form) for form in FORMS]
    distances = [compare_laws(exact, gamma) for exact, gamma in pairs]
    words = {"wind": wind_name(wind), "u": wind}
    numbers = [row("std", [float(np.degrees(exact.std())) for exact, _ in pairs], **words)]
    for name in ("rmse", "mae", "ks", "kl"):
        key = "ks" if name == "ks" else "distance"
        found = [float(getattr(d, name)) for d in distances]
        numbers.append(row(key, found, name=name.upper(), key=name, **words))
    return numbers


def h_alpha(setting: Setting) -> FigureOutput:
    """Draw the density of h_alpha with the field of view's mass at 0."""
    fov = float(np.radians(mt.Receiver().fov_deg))
    picture, axes = panels(1, 2)
    variables: dict[str, Any] = {}
    numbers = []
    for ax, wind in zip(axes[0], ROUGH, strict=True):
        laws = _laws(wind, "physical")[0], _laws(wind, "paper")[1]
        low = max(min(float(np.cos(law.ppf(1.0 - 1e-5))) for law in laws), 0.0)
        h, key = np.linspace(low, 1.0, 801)[:-1], f"h_{wind:g}"
        names = ("default, exact law", "paper preset, Gamma law")
        for form, name, law in zip(FORMS, names, laws, strict=True):
            ax.plot(h, law.h_pdf(h, fov), label=name)
            variables[f"pdf_{form}_{wind:g}"] = (key, law.h_pdf(h, fov), {"units": "1"})
        variables[key] = (key, h, {"units": "1"})
        x, y = r"factor $h_\alpha$", r"probability density $f(h_\alpha)$"
        finished(ax, title=wind_name(wind), xlabel=x, ylabel=y)
        words = {"wind": wind_name(wind)}
        published = float(laws[1].tilt_coefficient ** (laws[1].shape - 1.0))
        numbers.append(row("mean", [float(law.h_moment(1, fov)) for law in laws], **words))
        numbers.append(row("outside", [float(law.outage(fov)) for law in laws], **words))
        numbers.append(row("integral", (1.0, published), **words))
    return FigureOutput(picture, xr.Dataset(variables), numbers)


def wind(setting: Setting, duration: float) -> FigureOutput:
    """Draw Dryden records with a mean of 5 m/s along both axes."""
    mean = np.array([5.0, 5.0])
    speed = float(np.hypot(*mean))
    times = np.arange(0.0, duration, 0.05)
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    picture, axes = panels(2, 1, width=8.0, height=2.7, sharex=True)
    records, stds, errors = {}, [], []
    for form in FORMS:
        dryden = mt.Dryden.preset(form, wind_speed=speed, height=5.0, w20=MODERATE_W20 * KNOT)
        records[form] = dryden.simulate_wind(times, setting.seed)[:, :2] @ turn.T
        stds.append(float(dryden.std[0]))
        errors.append(float(dryden.std[0] * np.sqrt(2.0 * dryden.correlation_times[0] / duration)))
        for i in range(2):
            axes[i, 0].plot(times, records[form][:, i], lw=1.0, label=FORM_NAMES[form])
    for i, name in enumerate("xy"):
        axes[i, 0].axhline(mean[i], color=INK, lw=0.8, ls="--")
        axes[i, 0].set(ylabel=f"wind $V_{name}$ [m s$^{{-1}}$]")
    axes[0, 0].legend(ncols=2)
    axes[1, 0].set(xlabel="time $t$ [s]", xlim=(0.0, min(duration, 120.0)))
    numbers = []
    for i, axis in enumerate("xy"):
        means = [float(records[form][:, i].mean()) for form in FORMS]
        numbers.append(row("mean", map(Number, means, errors), axis=axis))
    numbers.append(row("std", stds))
    dims, units = ("time", "component"), {"units": "m s-1"}
    data = xr.Dataset(
        {f"wind_{form}": (dims, record, units) for form, record in records.items()},
        {"time": ("time", times, {"units": "s"}), "component": ["x", "y"]},
    )
    return FigureOutput(picture, data, numbers)
