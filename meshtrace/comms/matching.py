"""The parts of a link, made to agree: channel, transmission, weather, depth."""

from __future__ import annotations

from typing import Any, Literal, TypeVar

import pydantic

from meshtrace.comms.ook import OokLink
from meshtrace.link import Link, Receiver, WaterSource, Whitecaps
from meshtrace.optics.bubbles import HallNovarini

Preset = Literal["physical", "paper", "paper-ranges"]
Model = TypeVar("Model", bound=pydantic.BaseModel)


def ook_link(
    link: Link, ook: OokLink | Preset = "physical", bit_rate: float | None = None
) -> OokLink:
    """Return the transmission that belongs to a link.

    Parameters
    ----------
    link : Link
        Its power and wavelength, aperture radius and field of view are taken over.
    ook : OokLink or preset
        Everything else.
    bit_rate : float, optional
        R_b [bit s-1]; by default that of `ook`.

    Returns
    -------
    OokLink

    Raises
    ------
    ValueError
        If the preset is unknown, the bit rate does not fit, or the link has not one receiver in the
        air.

    Examples
    --------
    >>> from meshtrace.link import Led
    >>> ook_link(Link(transmitter=Led(power_mw=50.0)), bit_rate=5e6).led.power
    0.05
    """
    receiver, first = receiver_of(link), link.transmitters[0]
    base = ook if isinstance(ook, OokLink) else OokLink.preset(ook)
    led = {
        "power": 1e-3 * sum(t.power_mw for t in link.transmitters),
        "wavelength": 1e-9 * first.wavelength_nm,
    }
    optics = {"radius": receiver.radius, "fov_deg": receiver.fov_deg}
    return _changed(
        base,
        bit_rate=base.bit_rate if bit_rate is None else bit_rate,
        led=base.led.model_copy(update=led),
        optics=base.optics.model_copy(update=optics),
    )


def channel_link(link: Link, ook: OokLink) -> Link:
    """Return the link under which a calibration wants its gains: the water's a times a factor.

    Parameters
    ----------
    link : Link
        The link.
    ook : OokLink
        Its `absorption_factor` is 2 in the empirical calibration "paper-ranges", else 1.
    """
    factor, water = ook.absorption_factor, link.water
    if factor == 1.0:
        return link
    changes: dict[str, Any] = {"a": factor * water.a}
    if water.layers is not None:
        changes["layers"] = tuple((z, factor * a, b) for z, a, b in water.layers)
    return link.model_copy(update={"water": water.model_copy(update=changes)})


def in_wind(link: Link, wind_speed: float) -> Link:
    """Return a link with the whitecaps and bubbles of a wind.

    Parameters
    ----------
    link : Link
        The link; bubbles and whitecaps of its own are replaced.
    wind_speed : float
        Wind at 10 m [m s-1]; 0 for neither whitecaps nor bubbles.

    Examples
    --------
    >>> round(in_wind(Link(), 13.0).whitecaps.transmittance, 4)
    0.8899
    """
    if wind_speed == 0.0:
        return link.model_copy(update={"whitecaps": None, "bubbles": None})
    wavelength = link.transmitters[0].wavelength_nm
    bubbles = HallNovarini(wind_speed=wind_speed, n_water=link.water.n, wavelength_nm=wavelength)
    caps = Whitecaps(wind_speed=wind_speed)
    return link.model_copy(update={"whitecaps": caps, "bubbles": bubbles})


def receiver_of(link: Link) -> Receiver:
    """Return the only receiver of a link, or raise a ValueError."""
    if not isinstance(link.receiver, Receiver):
        raise ValueError("receiver: none or several, allowed one receiver in the air")
    return link.receiver


def at_depth(link: Link, depth: float) -> Link:
    """Return a link whose source lies at a depth [m]."""
    source = link.transmitter
    if not isinstance(source, WaterSource):
        raise ValueError("transmitter: allowed one source in the water, whose depth varies")
    return _changed(link, transmitter=_changed(source, depth=depth))


def _changed(model: Model, **changes: Any) -> Model:
    """Return a model with other values, checked; one line says what does not fit."""
    try:
        return type(model).model_validate({**dict(model), **changes})
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        text = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
        if ", allowed" not in text:
            text = f"{first['loc'][-1]}: {first['input']}, allowed {text}"
        raise ValueError(text) from error
