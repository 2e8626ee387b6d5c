"""Figures of the wind at the UAV, of its tilt, and of the factor of the gain that follows."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.paper.canvas import panels, wind_name
from meshtrace.paper.links import FORM_NAMES, FORMS, Form, gusts
from meshtrace.paper.printed import MODERATE_W20
from meshtrace.paper.registry import Drawing, Number, Row, Setting, compared, figure
from meshtrace.uav.airframe import UAVS
from meshtrace.uav.tilt import ExactTiltLaw, GammaTiltLaw, TiltLaw, compare_laws
from meshtrace.viz.style import INK, PALETTE

WINDS = (5.0, 13.0)
KNOT = 1852.0 / 3600.0
"""One knot [m s-1]."""

_UAV = UAVS["dji-m300-rtk"]


def _laws(wind: float, form: Form) -> tuple[ExactTiltLaw, GammaTiltLaw]:
    dryden = gusts(wind, form)
    exact, gamma = _UAV.tilt_law(dryden), _UAV.tilt_law(dryden, "gamma")
    assert isinstance(exact, ExactTiltLaw)
    assert isinstance(gamma, GammaTiltLaw)
    return exact, gamma


@figure(
    "tilt", "6", "distribution of the tilt", quick={"samples": 20_000}, full={"samples": 100_000}
)
def tilt(setting: Setting, samples: int) -> Drawing:
    """Draw sampled tilts, their exact law and the paper's Gamma law."""
    picture, axes = panels(2, 2)
    rows: list[Row] = []
    variables: dict[str, Any] = {}
    for i, form in enumerate(FORMS):
        for j, wind in enumerate(WINDS):
            exact, gamma = _laws(wind, form)
            drawn = _UAV.tilt(gusts(wind, form).sample_wind(samples, setting.seed)).angle
            grid = np.linspace(exact.ppf(1e-6), exact.ppf(1.0 - 1e-6), 400)
            density, edges = np.histogram(drawn, bins=80, density=True)
            _draw_tilt(axes[i, j], density, edges, grid, exact, gamma)
            axes[i, j].set_title(f"{wind_name(wind)}, {FORM_NAMES[form]}")
            dims, key = f"angle_{form}_{wind:g}", f"{form}_{wind:g}"
            variables[f"pdf_exact_{key}"] = (dims, exact.pdf(grid), {"units": "rad-1"})
            variables[f"pdf_gamma_{key}"] = (dims, gamma.pdf(grid), {"units": "rad-1"})
            variables[dims] = (dims, grid, {"units": "rad"})
            variables[f"pdf_sampled_{key}"] = (f"bin_{key}", density, {"units": "rad-1"})
            variables[f"edges_{key}"] = (f"edge_{key}", edges, {"units": "rad"})
    for wind in WINDS:
        rows += _tilt_rows(wind)
    caption = (
        "Tilt of the airframe in gusts of the Dryden model: sampled (bars), exact law, and Gamma "
        "law of the same mean and variance. Top: gusts of the military specification; bottom: as "
        "the paper prints them."
    )
    return Drawing(picture, xr.Dataset(variables), rows, caption)


def _draw_tilt(
    ax: Any, density: Any, edges: Any, grid: Any, exact: ExactTiltLaw, gamma: GammaTiltLaw
) -> None:
    degrees, per_degree = np.degrees(grid), np.radians(1.0)
    look: Any = {"fill": True, "color": PALETTE["sky"], "alpha": 0.5}
    ax.stairs(density * per_degree, np.degrees(edges), **look, label="sampled")
    ax.plot(degrees, exact.pdf(grid) * per_degree, color=INK, label="exact law")
    ax.plot(degrees, gamma.pdf(grid) * per_degree, "--", color=PALETTE["vermilion"], label="Gamma")
    ax.set(xlabel=r"tilt $\alpha$ [°]", ylabel=r"probability density [1/°]")
    ax.legend()


def _tilt_rows(wind: float) -> list[Any]:
    pairs = [_laws(wind, form) for form in FORMS]
    distances = [compare_laws(exact, gamma) for exact, gamma in pairs]
    stds = [Number(float(np.degrees(exact.std()))) for exact, _ in pairs]
    name = wind_name(wind)
    rows = [
        compared(
            f"standard deviation of the tilt, {name}",
            stds,
            "The paper divides the variance of gusts by pi and takes metres for feet; a record of "
            "finite length explains the rest.",
            printed=f"tilt-std-{wind:g}",
        )
    ]
    whys = {
        "rmse": "Distance of the two laws themselves; the paper's holds the noise of its sample.",
        "mae": "Distance of the two laws themselves; the paper's holds the noise of its sample.",
        "ks": "It cannot depend on the wind, since V^2/U^2 has one law; a coarse histogram does.",
        "kl": "Distance of the two laws themselves; the paper's holds the noise of its sample.",
    }
    for field, why in whys.items():
        default, paper = (Number(getattr(d, field)) for d in distances)
        text = f"{field.upper()} of the Gamma law, {name}"
        rows.append(compared(text, (default, paper), why, printed=f"tilt-{field}-{wind:g}"))
    return rows


@figure("h-alpha", "7", "distribution of the factor that the tilt takes of the gain")
def h_alpha(setting: Setting) -> Drawing:
    """Draw the density of h_alpha with the field of view's mass at 0."""
    fov = float(np.radians(mt.Receiver().fov_deg))
    picture, axes = panels(1, 2)
    variables: dict[str, Any] = {}
    rows = []
    for ax, wind in zip(axes[0], WINDS, strict=True):
        laws: dict[str, TiltLaw] = {"default, exact law": _laws(wind, "physical")[0]}
        laws["paper preset, Gamma law"] = _laws(wind, "paper")[1]
        low = max(min(float(np.cos(law.ppf(1.0 - 1e-5))) for law in laws.values()), 0.0)
        h = np.linspace(low, 1.0, 801)[:-1]
        for form, (name, law) in zip(FORMS, laws.items(), strict=True):
            ax.plot(h, law.h_pdf(h, fov), label=name)
            key = f"h_{wind:g}"
            variables[f"pdf_{form}_{wind:g}"] = (key, law.h_pdf(h, fov), {"units": "1"})
            variables[key] = (key, h, {"units": "1"})
        ax.set(xlabel=r"factor $h_\alpha$", ylabel=r"probability density $f(h_\alpha)$")
        ax.set_title(wind_name(wind))
        ax.legend()
        rows += _h_rows(wind, fov, list(laws.values()))
    caption = (
        "Density of the factor cos(alpha) by which the tilt reduces the gain. Beyond half of the "
        "field of view the factor is 0: that probability is in the table, not in the curves."
    )
    return Drawing(picture, xr.Dataset(variables), rows, caption)


def _h_rows(wind: float, fov: float, laws: list[Any]) -> list[Any]:
    name = wind_name(wind)
    default, paper = laws
    printed = paper.tilt_coefficient ** (paper.shape - 1.0)
    return [
        compared(
            f"mean factor, {name}",
            (Number(default.h_moment(1, fov)), Number(paper.h_moment(1, fov))),
            "Both are close to 1: the loss on average is small, as the paper says.",
        ),
        compared(
            f"probability that the tilt leaves the field of view, {name}",
            (Number(default.outage(fov)), Number(paper.outage(fov))),
            "Gusts of the specification's variance leave it far more often than printed ones; no "
            "power mends that.",
        ),
        compared(
            f"integral of the density, {name}",
            (Number(1.0), Number(float(printed))),
            "The printed constant 1/K must be 1/K^a with the shape a of the Gamma law; the curve "
            "of the paper preset has the right constant.",
        ),
    ]


@figure("wind", "23", "wind in time", quick={"duration": 120.0}, full={"duration": 600.0})
def wind(setting: Setting, duration: float) -> Drawing:
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
        stds.append(Number(float(dryden.std[0])))
        errors.append(float(dryden.std[0] * np.sqrt(2.0 * dryden.correlation_times[0] / duration)))
        for i in range(2):
            axes[i, 0].plot(times, records[form][:, i], lw=1.0, label=FORM_NAMES[form])
    for i, name in enumerate("xy"):
        axes[i, 0].axhline(mean[i], color=INK, lw=0.8, ls="--")
        axes[i, 0].set(ylabel=f"wind $V_{name}$ [m s$^{{-1}}$]")
    axes[0, 0].legend(ncols=2)
    axes[1, 0].set(xlabel="time $t$ [s]", xlim=(0.0, min(duration, 120.0)))
    rows = [
        compared(
            f"mean of the record along {name}",
            (
                Number(float(records[form][:, i].mean()), error)
                for form, error in zip(FORMS, errors, strict=True)
            ),
            "A record of finite length scatters about the given mean.",
            printed=f"mean-wind-{name}",
        )
        for i, name in enumerate("xy")
    ]
    rows.append(
        compared(
            "standard deviation of the gusts along x and y",
            stds,
            "The printed filters carry a factor of 1/sqrt(pi) that the specification does not.",
            unit="m/s",
        )
    )
    data = xr.Dataset(
        {
            f"wind_{form}": (("time", "component"), record, {"units": "m s-1"})
            for form, record in records.items()
        },
        {"time": ("time", times, {"units": "s"}), "component": ["x", "y"]},
    )
    caption = (
        "Dryden gusts about a mean of 5 m/s along both axes (dashed), with the wind at 20 feet of "
        "moderate turbulence; the same noise drives both. Gusts along and across the mean wind are "
        "turned onto the axes."
    )
    return Drawing(picture, data, rows, caption)
