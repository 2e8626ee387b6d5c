"""Figures of scattering, bubbles and refraction."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.fields import attrs
from meshtrace.optics.fresnel import fresnel_reflectance, refract
from paper.links import ROUGH, WIND_COLORS, panels, wind_name
from paper.registry import FigureOutput, Floats, Setting, row

NODES = 500
"""Even grid of angles from 0 to 180 degrees on which the distances of two CDFs are taken."""


def integrated_cdf(phase: mt.FournierForand, theta: Floats) -> Floats:
    """Return the CDF at rising angles by quadrature of the phase function alone.

    F(theta) = integral of 2 pi beta sin(t) dt from 0; t = pi u^4 tames the peak at 0. Gauss
    quadrature of eight nodes in each of the steps of `theta` and 64 in the first.
    """
    u = np.linspace(0.0, 1.0, 65)[:-1] * (theta[1] / np.pi) ** 0.25
    edges = np.concatenate([u, (theta[1:] / np.pi) ** 0.25])
    x, w = np.polynomial.legendre.leggauss(8)
    half = 0.5 * np.diff(edges)[:, None]
    nodes = edges[:-1, None] + half * (x + 1.0)
    angle = np.pi * nodes**4
    density = 2.0 * np.pi * phase.pdf(angle) * np.sin(angle) * 4.0 * np.pi * nodes**3
    cumulative = np.concatenate([[0.0], np.cumsum(np.sum(half * w * density, axis=1))])
    return np.concatenate([[0.0], cumulative[len(u) :]])


def ff_cdf(setting: Setting) -> FigureOutput:
    """Draw the Fournier-Forand CDF: quadrature, exact closed form, published closed form."""
    theta = np.linspace(0.0, np.pi, NODES)
    exact, printed = mt.FournierForand(), mt.FournierForand(cdf_coef="paper")
    curves = {
        "quadrature": integrated_cdf(exact, theta),
        "closed form, exact": exact.cdf(theta),
        "closed form, printed": printed.cdf(theta),
    }
    picture, axes = panels(1, 2)
    left, right = axes[0]
    shown = np.array(list(curves.values()))[:, 1:]
    coords = {"form": list(curves), "theta": theta[1:]}
    viz.plot_phase_cdf(xr.Dataset({"phase_cdf": (("form", "theta"), shown)}, coords), ax=left)
    left.lines[0].set(linewidth=5.0, alpha=0.35)
    left.legend()
    reference, *closed = curves
    differences = [curves[name] - curves[reference] for name in closed]
    for name, difference, line in zip(closed, differences, left.lines[1:], strict=True):
        right.plot(np.degrees(theta), difference, color=line.get_color(), label=name)
    ends = {"xlabel": left.get_xlabel(), "ylabel": "difference from the quadrature"}
    viz.marks.finished(right, **ends)
    names = ("RMSE of the CDF", "MAE of the CDF", "Kolmogorov-Smirnov distance")
    sizes = [np.abs(difference) for difference in differences]
    distances = [(np.sqrt(np.mean(e**2)), np.mean(e), e.max()) for e in sizes]
    numbers = [
        row("distance", map(float, pair), name=name, key=key)
        for name, key, *pair in zip(names, ("rmse", "mae", "ks"), *distances, strict=True)
    ]
    columns = zip(("cdf_quadrature", "cdf_exact", "cdf_printed"), curves.values(), strict=True)
    data = xr.Dataset(
        {name: ("theta", values, {"units": "1"}) for name, values in columns},
        {"theta": ("theta", theta, attrs("theta"))},
    )
    return FigureOutput(picture, data, numbers)


def snell(setting: Setting) -> FigureOutput:
    """Draw rays from the water through a flat surface, and angle and transmittance over theta."""
    n = mt.Link().water.n
    angle = np.radians(np.linspace(0.0, 60.0, 241))
    right = _refracted(angle, n)
    printed = np.arcsin(np.sin(angle) / n)
    share = 1.0 - fresnel_reflectance(np.cos(angle), n, 1.0)
    picture, axes = panels(1, 3, width=4.6)
    _draw_rays(axes[0, 0], n)
    degrees, incidence = np.degrees(angle), r"angle of incidence $\theta_i$ [°]"
    ax = axes[0, 1]
    for values, color, dashes, label in (
        (right, "vermilion", "-", r"default, $n_1 \sin\theta_i = n_2 \sin\theta_t$"),
        (printed, "green", "--", "printed, $n_1$ and $n_2$ exchanged"),
    ):
        ax.plot(degrees, np.degrees(values), dashes, color=viz.style.PALETTE[color], label=label)
    ax.set(xlabel=incidence, ylabel=r"angle of refraction $\theta_t$ [°]")
    ax.legend(loc="upper left")
    axes[0, 2].plot(degrees, share)
    axes[0, 2].set(xlabel=incidence, ylabel="transmittance $T$")
    at = np.radians(20.0)
    angles = np.degrees([_refracted(np.array([at]), n)[0], np.arcsin(np.sin(at) / n)])
    numbers = [
        row("angle", angles.tolist()),
        row("critical", (float(np.degrees(np.arcsin(1.0 / n))), None)),
        row("transmittance", (float(share[0]), float(share[0] ** 2))),
    ]
    data = xr.Dataset(
        {
            "theta_t": ("theta_i", right, {"units": "rad", "long_name": "angle of refraction"}),
            "theta_t_printed": ("theta_i", printed, {"units": "rad"}),
            "transmittance": ("theta_i", share, {"units": "1"}),
        },
        {"theta_i": ("theta_i", angle, {"units": "rad", "long_name": "angle of incidence"})},
    )
    return FigureOutput(picture, data, numbers)


def _refracted(angle: Floats, n: float) -> Floats:
    """Return angles of refraction into air, nan under total reflection."""
    d = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
    out = refract(d, np.array([0.0, 0.0, 1.0]), n, 1.0)
    return np.arctan2(out[..., 0], out[..., 2])


def _draw_rays(ax: Any, n: float) -> None:
    ax.axhspan(-1.0, 0.0, color=viz.style.PALETTE["sky"], alpha=0.25, lw=0)
    ax.axhline(0.0, color=viz.style.INK, lw=1.0)

    def ray(x: float, y: float, color: str, width: float, dashes: str = "-") -> None:
        ax.plot([0.0, x], [0.0, y], dashes, color=viz.style.PALETTE[color], lw=width)

    for degrees in (10.0, 20.0, 30.0, 40.0, 55.0):
        angle = np.radians(degrees)
        ray(-np.tan(angle), -1.0, "blue", 1.2)
        theta = float(_refracted(np.array([angle]), n)[0])
        if np.isfinite(theta):
            ray(np.sin(theta), np.cos(theta), "vermilion", 1.6)
        else:
            ray(np.tan(angle), -1.0, "blue", 0.9, ":")
        wrong = np.arcsin(np.sin(angle) / n)
        ray(np.sin(wrong), np.cos(wrong), "green", 1.2, "--")
    arrow = {"arrowstyle": "->", "color": viz.style.INK}
    ax.annotate("", (0.0, 1.0), (0.0, -1.0), arrowprops=arrow)
    ax.text(-0.03, 1.0, "normal", ha="right", va="top", color=viz.style.INK)
    ax.text(-1.45, 0.06, "air, $n_2 = 1$", color=viz.style.INK)
    ax.text(-1.45, -0.12, f"water, $n_1 = {n:g}$", color=viz.style.INK)
    ax.set(xlim=(-1.5, 1.5), ylim=(-1.0, 1.05), aspect="equal", xticks=[], yticks=[])
    ax.grid(visible=False)


def bubble_density(setting: Setting) -> FigureOutput:
    """Draw the number density of the Hall-Novarini population."""
    return _bubbles("n_bubbles", mt.HallNovarini.number_density)


def bubble_scattering(setting: Setting) -> FigureOutput:
    """Draw the scattering coefficient of the Hall-Novarini population."""
    output = _bubbles("b_bub", mt.HallNovarini.b)
    (ax,) = output.picture.axes
    ax.axvline(mt.Water().b, color=viz.style.INK, ls=":", lw=1.0, label="water alone")
    ax.legend()
    return output


def _bubbles(name: str, quantity: Callable[..., Floats]) -> FigureOutput:
    forms: dict[str, dict[str, Any]] = {"default": {}, "paper": {"psi": "paper", "q": 2.0}}
    coords = {"form": forms, "wind_speed": ROUGH, "depth": np.linspace(0.0, 10.0, 201)}
    depth = coords["depth"]
    bubbles = [[mt.HallNovarini(wind_speed=u, **form) for u in ROUGH] for form in forms.values()]
    values = np.array([[quantity(one, depth) for one in pair] for pair in bubbles])
    data = viz.marks.dataset({name: values}, coords)
    curves = data.stack(curve=("form", "wind_speed")).transpose("curve", "depth")
    names = [*map(wind_name, ROUGH), "paper", ""]
    picture, axes = panels()
    shown = curves.drop_vars(("curve", "form", "wind_speed")).assign_coords(curve=names)
    ax = viz.plot_bubble_profile(shown, quantity=name, ax=axes[0, 0])
    for i, line in enumerate(ax.lines):
        # the published ones are wide and pale below: they differ by a few per cent
        wide = i >= len(ROUGH)
        line.set(linewidth=5.0 if wide else 1.5, alpha=0.35 if wide else 1.0)
        line.set(color=WIND_COLORS[ROUGH[i % 2]], zorder=1.5 if wide else 2.0)
        if wide:
            line.set_linestyle("-")
    ax.legend()
    numbers = []
    for z, wind in itertools.product((0.0, 1.0), ROUGH):
        words = {"name": attrs(name)["long_name"], "z": z, "wind": wind_name(wind)}
        found = data[name].sel(depth=z, wind_speed=wind, method="nearest").to_numpy().tolist()
        numbers.append(row("value", found, **words))
    return FigureOutput(picture, data, numbers)
