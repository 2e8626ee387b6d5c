"""[daylight] of a link file: the light of sun and sky, moon or night."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from itertools import chain
from typing import Any

from meshtrace.daylight.light import Daylight
from meshtrace.errors import MISSING, Described, Refused, require_keys, require_word
from meshtrace.link import Link
from meshtrace.scenario.files import Table, as_table

_SUN = ("sun_zenith_deg", "sun_azimuth_deg")
_IRRADIANCES = ("direct", "diffuse")
_COMMON = ("model", *_IRRADIANCES, "pattern", "water", "foam_reflectance", "light")
_ATMOSPHERE = ("aerosol", "ozone", "water_vapour", "pressure", "day_of_year", "width_nm")
_KEYS: dict[str, tuple[str, ...]] = {
    "clear": (*_SUN, "time", "latitude", "longitude", *_ATMOSPHERE),
    "overcast": (*_SUN, "transmittance"),
    "uniform": _SUN,
    "moon": (*_SUN, "phase_deg"),
    "night": _SUN,
    "none": (),
}
_OF_IRRADIANCE = {"model", *chain.from_iterable(_KEYS.values())}
_PATTERNS = {"uniform": "uniform", "night": "uniform", "overcast": "cie-1"}
_MODELS = {"clear sky": "clear", "overcast sky": "overcast", "uniform sky": "uniform",
           "moonlight": "moon", "moonless night": "night"}  # fmt: skip
_MAKERS: dict[str, Callable[..., Daylight]] = {
    "clear": Daylight.clear_sky,
    "overcast": Daylight.overcast,
    "moon": Daylight.moon,
    "night": Daylight.night,
}


def read_daylight(value: Any, link: Link) -> Daylight | None:
    """Return the light of [daylight] at the wavelength of the transmitter; None for "none".

    With `direct` and `diffuse` [W m-2 nm-1] no spectral model is evaluated.
    """
    table = as_table(value, "daylight", "model")
    model = table.get("model", "clear")
    require_word(model, _KEYS, "daylight.model")
    require_keys(table, [*_COMMON, *_KEYS[model]], "daylight")
    table.pop("model", None)
    if model == "none":
        return None
    wavelength = {"wavelength_nm": link.transmitters[0].wavelength_nm}
    try:
        return _made(model, {**table, **wavelength})
    except Refused as error:
        raise error.inside("daylight") if error.field != "daylight" else error from None


def _made(model: str, table: Table) -> Daylight:
    light = next(name for name, word in _MODELS.items() if word == model)
    table = {"light": light, **table}
    if model in _PATTERNS:
        table = {"pattern": _PATTERNS[model], **table}
    if "direct" in table or "diffuse" in table:
        for key in _KEYS[model]:
            if key in table and key not in _SUN:
                raise Refused(key, table[key], "without direct and diffuse")
        return Daylight.model_validate({"direct": 0.0, "diffuse": 0.0, **table})
    if model == "uniform":
        raise Refused("diffuse", MISSING, "the irradiance of the uniform sky [W m-2 nm-1]")
    if model == "moon":
        old_to_new = {"sun_zenith_deg": "zenith_deg", "sun_azimuth_deg": "azimuth_deg"}
        table = {old_to_new.get(key, key): item for key, item in table.items()}
    maker = Daylight.at if "time" in table else _MAKERS[model]
    if "time" in table:
        for key in _SUN:
            if key in table:
                raise Refused(key, table[key], "without time, which gives the sun")
        table = {"latitude": None, "longitude": None, **table}
    return maker(**table)


def daylight_config(day: Daylight) -> Table:
    """Return the table of a light without its wavelength, which follows the transmitter.

    Irradiances, pattern and name that follow from the model and its options are left out.
    """
    table = day.model_dump(mode="json", exclude={"wavelength_nm", "recipe"})
    model = _MODELS.get(day.light, "clear")
    options = {k: v for k, v in {**table, **day.recipe}.items() if k not in _IRRADIANCES}
    if not _gives(model, options, day):
        return {"model": model, **table}
    for key in ("pattern", "light"):
        rest = {k: v for k, v in options.items() if k != key}
        options = rest if _gives(model, rest, day) else options
    return {"model": model, **options}


def _gives(model: str, options: Table, day: Daylight) -> bool:
    """Return whether a model with options gives a light."""
    try:
        return _made(model, {**options, "wavelength_nm": day.wavelength_nm}) == day
    except Refused:
        return False


def daylight_values(day: Daylight) -> dict[str, float]:
    """Return the continuous keys of [daylight] and their values, defaults of its model included."""
    table = daylight_config(day)
    model, values = table.pop("model"), {"foam_reflectance": day.foam_reflectance}
    if table.keys().isdisjoint(_IRRADIANCES):
        known = inspect.signature(_MAKERS[model]).parameters
        values |= {key: known[key].default for key in _KEYS[model] if key in known}
    place = {key: getattr(day, key) for key in _SUN}
    return {k: v for k, v in {**values, **place, **table}.items() if isinstance(v, float)}


def daylight_with(day: Daylight, key: str, value: Any) -> Daylight:
    """Return a light with another value of a key of [daylight]; irradiances follow their model.

    Raises
    ------
    Refused
        If there is no such key, the value is out of range, or the wavelength of irradiances that
        no model gives would change.
    """
    table = daylight_config(day)
    model = table.pop("model")
    require_keys({key: value}, ["wavelength_nm", *_COMMON, *_KEYS[model]])
    if key == "wavelength_nm" and value != day.wavelength_nm:
        daylight_recipe(day)
    return _made(model, {"wavelength_nm": day.wavelength_nm, **table, key: value})


def changes_irradiance(key: str) -> bool:
    """Return whether direct and diffuse follow the value at a dotted key of a link file."""
    table, _, name = key.partition(".")
    return name.endswith("wavelength_nm") or (table == "daylight" and name in _OF_IRRADIANCE)


def daylight_recipe(day: Daylight) -> Table:
    """Return the table of a light without its irradiances, which follow from the model.

    Raises
    ------
    Refused
        If the irradiances are not those of the model.
    """
    table = daylight_config(day)
    model = table.pop("model")
    if not table.keys().isdisjoint(_IRRADIANCES):
        found = Described("irradiances other than those of a model")
        raise Refused("daylight", found, "a link file or its plain data, with the model")
    for key in list(table):
        rest = {k: v for k, v in table.items() if k != key}
        if _gives(model, rest, day):
            table = rest
    return {"model": model, **table}
