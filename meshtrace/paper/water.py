"""Figures of the stations, their temperature and salinity, and the resulting refraction."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import xarray as xr

from meshtrace.fields import attrs
from meshtrace.paper.canvas import panels
from meshtrace.paper.profiles import WaterProfile, profiles_of, ray_deflection
from meshtrace.paper.registry import Entry, FigureOutput, Setting, row
from meshtrace.viz.style import PALETTE

STATIONS = ((165.91, -21.17), (167.33, -22.11), (165.45, -20.51))
"""Longitude and latitude [degrees east, north] of the stations, Appendix A."""

EARTH_RADIUS = 6371.0
"""Mean radius [km]."""

DEEPEST = 50.0
"""Largest depth of interest [m]."""

STAND_INS = (
    "NOT the paper's data, which cannot be distributed: invented profiles, from a mixed layer "
    "to a thermocline far sharper than the paper reports. Use --profiles for files of the AODN "
    "portal or of Argo."
)

ZENITHS = np.radians(np.linspace(0.0, 40.0, 41))


def stations(setting: Setting) -> FigureOutput:
    """Draw the stations on a map without coast lines."""
    given = [p for p in profiles_of(setting) if np.isfinite([p.longitude, p.latitude]).all()]
    lon, lat = np.array(STATIONS).T
    picture, axes = panels(width=6.0)
    ax = axes[0, 0]
    ax.plot(lon, lat, "*", color=PALETTE["orange"], markersize=14, label="printed")
    for i, (x, y) in enumerate(STATIONS, start=1):
        ax.annotate(f"station {i}", (x, y), (8, 6), textcoords="offset points")
    if given:
        measured = np.array([(p.longitude, p.latitude) for p in given])
        ax.plot(*measured.T, "o", color=PALETTE["blue"], label="files of profiles")
        ax.legend()
    ax.set(xlabel="longitude [° E]", ylabel="latitude [° N]")
    ax.set_aspect(1.0 / np.cos(np.radians(lat.mean())))
    ax.margins(0.25)
    numbers = [
        row("distance", (None, _distance(p, q)), i=i, j=j)
        for (i, p), (j, q) in itertools.combinations(enumerate(STATIONS, start=1), 2)
    ]
    degrees = {"units": "degrees_east"}, {"units": "degrees_north"}
    places = {"longitude": ("station", lon, degrees[0]), "latitude": ("station", lat, degrees[1])}
    data = xr.Dataset(places)
    circles = "Circles: places of the given profiles. " if given else ""
    return FigureOutput(picture, data, numbers, {"circles": circles})


def _distance(p: tuple[float, float], q: tuple[float, float]) -> float:
    """Return the great-circle distance [km] of two places (longitude, latitude) [degrees]."""
    (lon1, lat1), (lon2, lat2) = np.radians(p), np.radians(q)
    a = np.sin((lat2 - lat1) / 2) ** 2
    a += np.cos(lat1) * np.cos(lat2) * np.sin((lon2 - lon1) / 2) ** 2
    return float(2.0 * EARTH_RADIUS * np.arcsin(np.sqrt(a)))


def temperature_salinity(setting: Setting) -> FigureOutput:
    """Draw temperature, salinity and refractive index over depth, and the deflection of rays."""
    profiles = profiles_of(setting)
    picture, axes = panels(1, 4, width=4.0)
    depths, offsets, numbers = [], [], []
    for profile in profiles:
        depth = min(DEEPEST, float(profile.depth[-1]))
        offset = np.array([ray_deflection(profile, depth, float(t)).offset for t in ZENITHS])
        shown = profile.depth <= depth
        z = profile.depth[shown]
        axes[0, 0].plot(profile.temperature[shown], z, label=profile.name)
        axes[0, 1].plot(profile.salinity[shown], z)
        axes[0, 2].plot(profile.n(z), z)
        axes[0, 3].plot(np.degrees(ZENITHS), 1e3 * offset)
        numbers += _numbers(profile, depth, offset)
        depths.append(depth)
        offsets.append(offset)
    _name_axes(axes[0])
    source = "Profiles of the given files." if setting.profiles else STAND_INS
    data = _dataset(profiles, depths, offsets)
    return FigureOutput(picture, data, numbers, {"source": source})


def _name_axes(axes: Any) -> None:
    axes[0].set(xlabel="temperature $T$ [°C]", ylabel="depth below still water $d$ [m]")
    axes[1].set(xlabel="practical salinity $S$ [psu]")
    axes[2].set(xlabel="refractive index at 470 nm")
    axes[2].ticklabel_format(axis="x", useOffset=False)
    axes[2].locator_params(axis="x", nbins=4)
    for ax in axes[:3]:
        ax.invert_yaxis()
    axes[3].set(xlabel="angle of the ray at the source [°]", ylabel="offset at the surface [mm]")
    axes[0].legend()


def _numbers(profile: WaterProfile, depth: float, offset: Any) -> list[Entry]:
    shown = profile.depth <= depth
    at = int(np.argmin(np.abs(ZENITHS - np.radians(10.0))))
    words = {"depth": depth, "name": profile.name, "angle": np.degrees(ZENITHS[at])}
    return [
        row("temperature", (float(np.ptp(profile.temperature[shown])), None), **words),
        row("salinity", (float(np.ptp(profile.salinity[shown])), None), **words),
        row("offset", (1e3 * float(offset[at]), 0.0), **words),
    ]


def _dataset(profiles: list[WaterProfile], depths: list[float], offsets: list[Any]) -> xr.Dataset:
    grid, dims = np.linspace(0.0, min(depths), 101), ("profile", "depth")

    def on_grid(values: str) -> list[Any]:
        return [np.interp(grid, p.depth, getattr(p, values)) for p in profiles]

    variables = {
        "temperature": (dims, on_grid("temperature"), {"units": "degree_Celsius"}),
        "salinity": (dims, on_grid("salinity"), {"units": "1"}),
        "n_water": (dims, [p.n(grid) for p in profiles], {"units": "1"}),
        "offset": (("profile", "zenith"), offsets, {"units": "m"}),
        "start_depth": ("profile", depths, {"units": "m"}),
    }
    zenith, names = ("zenith", ZENITHS, {"units": "rad"}), [p.name for p in profiles]
    depth = ("depth", grid, attrs("depth"))
    return xr.Dataset(variables, {"profile": names, "depth": depth, "zenith": zenith})
