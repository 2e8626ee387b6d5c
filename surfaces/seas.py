"""Seas from plain data, and the default sea of a wind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from meshtrace.errors import MISSING, Refused, require_real

from .random_seas import JonswapSea, SpectralSea
from .sequence import MeshSequence
from .spectra import Elfouhaily
from .spreading import ElfouhailySpreading
from .surface import FlatSea, Surface


def sea_from_config(config: Mapping[str, Any]) -> Surface | MeshSequence:
    """Return a sea from the plain data of `to_config`.

    Parameters
    ----------
    config : mapping
        Plain data with the key "kind" (or an import path "module:Class" under it) and the
        parameters of that kind.

    Returns
    -------
    Surface or MeshSequence
        An equal sea, with bitwise the same meshes.

    Raises
    ------
    Refused
        If the kind is unknown or a parameter is out of range.

    Examples
    --------
    >>> sea_from_config({"kind": "flat", "height": 0.1})
    FlatSea(height=0.1)
    """
    if not isinstance(config, Mapping) or "kind" not in config:
        raise Refused("kind", MISSING, ", ".join(Surface.registered))
    if config["kind"] == "meshes":
        return MeshSequence.model_validate(config)
    found: Surface = Surface.read(config)
    return found


def resolved_sea(wind_speed: float, fetch: float | None = None, seed: int = 0) -> SpectralSea:
    """Return the sea of a wind with the fading of all waves.

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1], 0 < U <= 60.
    fetch : float, optional
        Fetch [m]; None is the fully developed sea.
    seed : int
        Seed of the random phases.

    Returns
    -------
    SpectralSea
        Spectrum, spreading and mss of Elfouhaily et al., with `omega_max="fading"`: `simulate`
        and the studies replace it by the number for their link, some 13 to 32 rad/s.

    Raises
    ------
    Refused
        If an argument is out of range.

    Examples
    --------
    >>> resolved_sea(5.0, fetch=30e3).omega_max
    'fading'
    """
    return SpectralSea(
        spectrum=Elfouhaily(wind_speed=wind_speed, fetch=fetch),
        spreading=ElfouhailySpreading(),
        mss="elfouhaily",
        omega_max="fading",
        seed=seed,
    )


def sea_in_wind(wind_speed: float, seed: int = 0) -> Surface:
    """Return the default sea of a wind: a JONSWAP sea, or a flat one without wind.

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1], 0 to 60.
    seed : int
        Seed of the random phases.

    Raises
    ------
    Refused
        If an argument is out of range.

    Examples
    --------
    >>> sea_in_wind(0.0), sea_in_wind(8.0) == JonswapSea(wind_speed=8.0)
    (FlatSea(), True)
    """
    if require_real(wind_speed, "wind_speed", "0 <= wind_speed <= 60") == 0.0:
        return FlatSea()
    return JonswapSea(wind_speed=wind_speed, seed=seed)
