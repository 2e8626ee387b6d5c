"""Figures of the stations, their temperature and salinity, and what these do to light."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from meshtrace.fields import attrs
from meshtrace.paper.canvas import panels
from meshtrace.paper.printed import STATIONS
from meshtrace.paper.profile_files import profiles_of
from meshtrace.paper.profiles import WaterProfile, ray_deflection
from meshtrace.paper.registry import Drawing, Number, Setting, compared, figure
from meshtrace.viz.style import PALETTE

EARTH_RADIUS = 6371.0
"""Mean radius [km]."""

DEEPEST = 50.0
"""The depths of interest end here [m]."""

ZENITHS = np.radians(np.linspace(0.0, 40.0, 41))


@figure("stations", "21", "where temperature and salinity were measured", reads_profiles=True)
def stations(setting: Setting) -> Drawing:
    """Draw the stations on a map without coast lines."""
    given = [p for p in profiles_of(setting) if np.isfinite([p.longitude, p.latitude]).all()]
    lon, lat = np.array(STATIONS).T
    picture, axes = panels(width=6.0)
    ax = axes[0, 0]
    ax.plot(lon, lat, "*", color=PALETTE["orange"], markersize=14, label="printed")
    for i, (x, y) in enumerate(STATIONS, start=1):
        ax.annotate(f"station {i}", (x, y), (8, 6), textcoords="offset points")
    if given:
        places = np.array([(p.longitude, p.latitude) for p in given])
        ax.plot(*places.T, "o", color=PALETTE["blue"], label="files of profiles")
        ax.legend()
    ax.set(xlabel="longitude [° E]", ylabel="latitude [° N]")
    ax.set_aspect(1.0 / np.cos(np.radians(lat.mean())))
    ax.margins(0.25)
    pairs = ((0, 1), (0, 2), (1, 2))
    rows = [
        compared(
            f"distance of stations {i + 1} and {j + 1}",
            (None, Number(_distance(STATIONS[i], STATIONS[j]))),
            "The paper prints the coordinates alone; the distance along the sphere follows.",
            unit="km",
        )
        for i, j in pairs
    ]
    data = xr.Dataset(
        {
            "longitude": ("station", lon, {"units": "degrees_east"}),
            "latitude": ("station", lat, {"units": "degrees_north"}),
        }
    )
    caption = (
        "The three stations east of New Caledonia, from the printed coordinates. "
        + ("Circles: where the given files were measured. " if given else "")
        + "Coast lines are left out."
    )
    return Drawing(picture, data, rows, caption)


def _distance(p: tuple[float, float], q: tuple[float, float]) -> float:
    """Return the great-circle distance [km] of two places (longitude, latitude) [degrees]."""
    (lon1, lat1), (lon2, lat2) = np.radians(p), np.radians(q)
    a = np.sin((lat2 - lat1) / 2) ** 2
    a += np.cos(lat1) * np.cos(lat2) * np.sin((lon2 - lon1) / 2) ** 2
    return float(2.0 * EARTH_RADIUS * np.arcsin(np.sqrt(a)))


@figure(
    "temperature-salinity",
    "22",
    "temperature and salinity over depth, and how they bend light",
    reads_profiles=True,
)
def temperature_salinity(setting: Setting) -> Drawing:
    """Draw profiles, the refractive index that follows, and the deflection of rays."""
    profiles = profiles_of(setting)
    picture, axes = panels(1, 4, width=4.0)
    depths = [min(DEEPEST, float(p.depth[-1])) for p in profiles]
    offsets = [
        np.array([ray_deflection(p, d, float(t)).offset for t in ZENITHS])
        for p, d in zip(profiles, depths, strict=True)
    ]
    for profile, depth, offset in zip(profiles, depths, offsets, strict=True):
        shown = profile.depth <= depth
        z = profile.depth[shown]
        axes[0, 0].plot(profile.temperature[shown], z, label=profile.name)
        axes[0, 1].plot(profile.salinity[shown], z)
        axes[0, 2].plot(profile.n(z), z)
        axes[0, 3].plot(np.degrees(ZENITHS), 1e3 * offset)
    _name_axes(axes[0])
    rows = []
    for profile, depth, offset in zip(profiles, depths, offsets, strict=True):
        rows += _rows(profile, depth, offset)
    return Drawing(picture, _dataset(profiles, depths, offsets), rows, _caption(setting))


def _name_axes(axes: Any) -> None:
    axes[0].set(xlabel="temperature $T$ [°C]", ylabel="depth below still water $d$ [m]")
    axes[1].set(xlabel="practical salinity $S$ [psu]")
    axes[2].set(xlabel="refractive index at 470 nm")
    axes[2].ticklabel_format(axis="x", useOffset=False)
    axes[2].locator_params(axis="x", nbins=4)
    for ax in axes[:3]:
        ax.invert_yaxis()
    axes[3].set(xlabel="angle of the ray at the lamp [°]", ylabel="offset at the surface [mm]")
    axes[0].legend()


def _rows(profile: WaterProfile, depth: float, offset: Any) -> list[Any]:
    shown = profile.depth <= depth
    at = int(np.argmin(np.abs(ZENITHS - np.radians(10.0))))
    spans = (
        ("temperature range", np.ptp(profile.temperature[shown]), "degree Celsius"),
        ("salinity range", np.ptp(profile.salinity[shown]), "psu"),
    )
    weak = "The paper calls the gradients extremely weak and prints no number."
    bent = (
        "Layers shift a ray sideways by far less than the aperture's radius; a vertical ray not "
        "at all. The printed forms have no layers."
    )
    rows = [
        compared(
            f"{what} down to {depth:g} m, {profile.name}", (Number(float(v)), None), weak, unit=u
        )
        for what, v, u in spans
    ]
    name = f"offset of a ray at {np.degrees(ZENITHS[at]):.0f} degrees, {depth:g} m, {profile.name}"
    rows.append(compared(name, (Number(1e3 * float(offset[at])), Number(0.0)), bent, unit="mm"))
    return rows


def _dataset(profiles: list[WaterProfile], depths: list[float], offsets: list[Any]) -> xr.Dataset:
    grid = np.linspace(0.0, min(depths), 101)
    dims = ("profile", "depth")

    def on_grid(values: str) -> list[Any]:
        return [np.interp(grid, p.depth, getattr(p, values)) for p in profiles]

    return xr.Dataset(
        {
            "temperature": (dims, on_grid("temperature"), {"units": "degree_Celsius"}),
            "salinity": (dims, on_grid("salinity"), {"units": "1"}),
            "n_water": (dims, [p.n(grid) for p in profiles], {"units": "1"}),
            "offset": (("profile", "zenith"), offsets, {"units": "m"}),
            "start_depth": ("profile", depths, {"units": "m"}),
        },
        {
            "profile": [p.name for p in profiles],
            "depth": ("depth", grid, attrs("depth")),
            "zenith": ("zenith", ZENITHS, {"units": "rad"}),
        },
    )


def _caption(setting: Setting) -> str:
    source = (
        "Profiles of the given files."
        if setting.profiles
        else "NOT the paper's data, which cannot be shipped: made-up profiles, from a mixed layer "
        "to a thermocline far sharper than the paper reports. Give files of the AODN portal or of "
        "Argo with --profiles."
    )
    return (
        f"{source} Third: refractive index after Quan and Fry. Fourth: how much farther out a ray "
        "from below meets the surface than a straight one."
    )
