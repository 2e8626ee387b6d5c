"""The parts of a scenario except the sea: wind, link, detector, UAV.

Each is read from its table of a link file, with the values shared with other tables filled in, and
written back without the keys that follow the wind, the water or the transmitter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, get_args

from meshtrace.comms.ook import OokLink, Preset
from meshtrace.daylight.light import (
    MODELS,
    SUN,
    Daylight,
    UnavailableDaylight,
    defaults_of,
    light_of,
)
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.errors import Described, Refused, require_between, require_keys, require_word, within
from meshtrace.link import Link, Physics, Whitecaps
from meshtrace.models import Model
from meshtrace.optics.bubbles import BubblePopulation, HallNovarini
from meshtrace.optics.phase import FournierForand
from meshtrace.optics.spectra import WaterSpectrum
from meshtrace.optics.water import Water
from meshtrace.optics.water_files import read_spectrum
from meshtrace.scenario.files import Table, as_table, plain, unshared, validated
from meshtrace.uav import UAVS, Uav

DEFAULT_WIND_SPEED = 5.0

_FREE = ("physics", "transmitter", "receiver", "planes", "n_air")  # tables that share nothing


def read_wind_speed(config: Mapping[str, Any]) -> float:
    """Return the wind speed at the top of a link file [m s-1]."""
    speed, allowed = config.get("wind_speed", DEFAULT_WIND_SPEED), "0 <= wind_speed <= 60 m/s"
    return require_between(speed, 0.0, 60.0, "wind_speed", "[]", allowed)


def read_link(config: Mapping[str, Any], wind_speed: float) -> Link:
    """Return the link of all tables that describe it."""
    link = Link.model_validate({key: config[key] for key in _FREE if key in config})
    printed = config.get("physics") == "paper"
    water = _water(config.get("water", {}), link.transmitters[0].wavelength_nm, printed)
    link = link.replace(water=water)
    return link.replace(
        bubbles=_bubbles(config.get("bubbles", {}), wind_speed, link, printed),
        whitecaps=_whitecaps(config.get("whitecaps", {}), wind_speed, printed),
    )


def default_estimator(link: Link) -> Table:
    """Return the estimator of a link that forced detection cannot follow, else nothing."""
    try:
        crossing_reach(link)
    except Refused:
        return {"estimator": "analog"}
    return {}


_SHARED = ("spectrum", "wavelength_nm")
"""Fields of a water that follow from the keys of its spectrum and from the transmitter."""


def _water(value: Any, wavelength_nm: float, printed: bool) -> Water:
    table = as_table(value, "water")
    kinds = spectrum_keys()
    keys = [*kinds, "file", *(key for key in Water.model_fields if key not in _SHARED)]
    require_keys(table, keys, "water")
    spectral = {key: table.pop(key) for key in kinds if key in table}
    try:
        if spectral.keys() == {"type"} and "file" not in table:
            water = Water.from_type(spectral["type"], wavelength_nm, **table)
        elif spectral or "file" in table:
            if {"a", "b"} <= table.keys() or "layers" in table:
                key = next(iter({**spectral, "file": None}))
                raise Refused(key, {**spectral, **table}[key], "without a and b, or layers")
            spectrum = spectrum_of(spectral, table.pop("file", None))
            water = Water(**table, spectrum=spectrum, wavelength_nm=wavelength_nm)
        else:
            water = Water.model_validate(table)
    except Refused as error:
        raise error.inside("transmitter" if error.field == "wavelength_nm" else "water") from None
    phase = water.phase
    if printed and isinstance(phase, FournierForand) and "cdf_coef" not in phase.model_fields_set:
        return water.replace("phase.cdf_coef", "paper")
    return water


def spectrum_keys() -> dict[str, type[WaterSpectrum]]:
    """Return the keys of [water] that describe a spectrum, with the kind of spectrum."""
    members = WaterSpectrum.registered.values()
    return {key: kind for kind in members for key in kind.model_fields if key != "kind"}


def gives_spectrum(key: str) -> bool:
    """Return whether a dotted key of a link file describes the spectrum of the water."""
    table, _, name = key.partition(".")
    return table == "water" and name in (*spectrum_keys(), "file")


def spectrum_of(own: Table, file: Any = None) -> WaterSpectrum:
    """Return the spectrum of keys of [water], or of a file with the values of some keys."""
    if file is None:
        return spectrum_keys()[next(iter(own))].model_validate(own)
    if not isinstance(file, str):
        raise Refused("file", file, "the path of a file")
    return read_spectrum(file).replace(**own)


def _bubble_defaults(link: Link) -> Table:
    """Return the values that bubbles share with their surroundings."""
    return {"n_water": link.water.n, "wavelength_nm": link.transmitters[0].wavelength_nm}


def _bubbles(value: Any, wind_speed: float, link: Link, printed: bool) -> BubblePopulation | None:
    table = as_table(value, "bubbles", "model")
    if table.get("model", table.get("kind")) == "none":
        require_keys(table, ("model", *HallNovarini.model_fields), "bubbles")
        return None
    key = "kind" if "kind" in table else "model"
    with within("bubbles"):
        model = BubblePopulation.member(table.pop(key, "hall-novarini"), key)
        shared = {"wind_speed": wind_speed, **_bubble_defaults(link)}
        if printed:
            shared |= {"psi": "paper", "q": 2.0, "depth": "mean_level"}
        shared = {k: v for k, v in shared.items() if k in model.model_fields}
        calm = {**shared, **table}.get("wind_speed") == 0.0
        table = {**shared, **table, **({"wind_speed": DEFAULT_WIND_SPEED} if calm else {})}
        bubbles = model.model_validate(table)
    return None if calm else bubbles


def _whitecaps(value: Any, wind_speed: float, printed: bool) -> Whitecaps | None:
    table = as_table(value, "whitecaps", "model")
    table = {"wind_speed": wind_speed, "model": "paper_0255" if printed else "w_0225", **table}
    absent = table["model"] == "none"
    if absent:
        del table["model"]
    whitecaps = validated(Whitecaps, table, "whitecaps")
    return None if absent or whitecaps.wind_speed == 0.0 else whitecaps


def _over(base: Model, table: Table, path: str) -> Any:
    """Return a model with the fields of a table and of its inner tables replaced."""
    for name, value in table.items():
        part, inner = getattr(base, name, None), f"{path}.{name}"
        if isinstance(part, Model):
            table = {**table, name: _over(part, as_table(value, inner), inner)}
    return validated(type(base), {**dict(base), **table}, path, ("preset",))


def _over_preset(presets: Mapping[str, Model], value: Any, path: str) -> Any:
    """Return the preset that a table names, by default the first, with its fields replaced.

    None without a table.
    """
    if value is None:
        return None
    table = as_table(value, path, "preset")
    preset = table.pop("preset", next(iter(presets)))
    require_word(preset, presets, f"{path}.preset")
    return _over(presets[preset], table, path)


def read_detector(value: Any) -> OokLink | None:
    """Return the transmission of [detector]: a preset with replaced fields."""
    presets = {name: OokLink.preset(name) for name in get_args(Preset)}
    return _over_preset(presets, value, "detector")


def read_uav(value: Any) -> Uav | None:
    """Return the airframe of [uav]: a known airframe with replaced fields."""
    return _over_preset(UAVS, value, "uav")


OF_LINK = {"led": ("power", "wavelength"), "optics": ("radius", "fov_deg", "medium_index")}
"""Fields of a transmission that `OokLink.of_link` takes from the link."""


def detector_of(detector: OokLink, link: Link) -> OokLink:
    """Return the transmission with the power, wavelength and aperture of a link.

    A link with several receivers has no transmission of its own.
    """
    return OokLink.of_link(link, detector) if len(link.receivers) == 1 else detector


def require_of_link(value: Any, detector: OokLink) -> None:
    """Refuse keys of [detector] that contradict the link."""
    for part, names in OF_LINK.items():
        table = value.get(part, {}) if isinstance(value, Mapping) else {}
        for name in names:
            of_link = getattr(getattr(detector, part), name)
            if name in table and not math.isclose(table[name], of_link, rel_tol=1e-9):
                allowed = f"nothing, or {of_link:g}, which the link gives"
                raise Refused(f"detector.{part}.{name}", table[name], allowed)


def detector_config(detector: OokLink, link: Link) -> Table:
    """Return [detector] without the keys that follow the link."""
    table: Table = plain(detector)
    if len(link.receivers) == 1:
        for part, names in OF_LINK.items():
            table[part] = {k: v for k, v in table[part].items() if k not in names}
    return table


def water_config(link: Link) -> Table:
    """Return [water] without the values that follow the type, the layers or the transmitter."""
    water = link.water
    table: Table = {k: v for k, v in plain(water).items() if k not in _SHARED}
    following = {"a", "b"} if water.layers else set()
    if water.spectrum and water.wavelength_nm == link.transmitters[0].wavelength_nm:
        following = {"a", "b", "n", "phase", "layers"} - water.model_fields_set
        table = {**plain(water.spectrum), **table}
        del table["kind"]
    return {key: value for key, value in table.items() if key not in following}


def physics_config(physics: Physics) -> Any:
    """Return the preset of the physics by name, or else its fields."""
    names = (name for name in ("physical", "paper") if Physics.preset(name) == physics)
    return next(names, physics.model_dump())


def bubbles_config(link: Link, wind_speed: float) -> Table:
    """Return [bubbles] without the keys that follow the wind, the water or the transmitter."""
    if link.bubbles is None:
        return {"model": "none"}
    shared = {"wind_speed": wind_speed, **_bubble_defaults(link)}
    table = unshared(link.bubbles.model_dump(mode="json"), **shared)
    return {"model": table.pop("kind"), **table}


def whitecaps_config(link: Link, wind_speed: float) -> Any:
    """Return the word or the table of the whitecaps."""
    if link.whitecaps is None:
        return "none"
    config = unshared(link.whitecaps.model_dump(), wind_speed=wind_speed)
    return config if "wind_speed" in config else config["model"]


_IRRADIANCES = ("direct", "diffuse")
_LIT = ("model", *_IRRADIANCES, "pattern", "water", "foam_reflectance", "light", *SUN)


def read_daylight(value: Any, link: Link) -> Daylight | UnavailableDaylight | None:
    """Return the light of [daylight] at the wavelength of the transmitter; None for "none".

    With `direct` and `diffuse` [W m-2 nm-1] no spectral model is evaluated.
    """
    table = as_table(value, "daylight", "model")
    model = table.get("model", "clear")
    require_word(model, [*MODELS, "none"], "daylight.model")
    keys = (*_LIT, *MODELS[model].keys) if model in MODELS else _LIT
    require_keys(table, keys, "daylight")
    table.pop("model", None)
    if model == "none":
        return None
    try:
        return light_of(model, link.transmitters[0].wavelength_nm, table)
    except Refused as error:
        refusal = error.inside("daylight") if error.field != "daylight" else error
        if isinstance(error.__cause__, ImportError):
            return UnavailableDaylight({"model": model, **table}, refusal)
        raise refusal from None


def daylight_config(day: Daylight | UnavailableDaylight) -> Table:
    """Return the table of a light without its wavelength, which follows the transmitter.

    Irradiances, pattern and name that follow from the model and its options are left out.
    """
    if isinstance(day, UnavailableDaylight):
        return day.table
    table = day.model_dump(mode="json", exclude={"wavelength_nm", "recipe"})
    models = (name for name, one in MODELS.items() if one.fields["light"] == day.light)
    model = next(models, "clear")
    options = {k: v for k, v in {**table, **day.recipe}.items() if k not in _IRRADIANCES}
    if not _gives(model, options, day):
        return {"model": model, **table}
    return {"model": model, **_needed(model, options, ("pattern", "light"), day)}


def _gives(model: str, options: Table, day: Daylight) -> bool:
    """Return whether a model with options gives a light."""
    try:
        return bool(light_of(model, day.wavelength_nm, options) == day)
    except Refused:
        return False


def _needed(model: str, options: Table, keys: Iterable[str], day: Daylight) -> Table:
    """Drop those of `keys` that do not change the light."""
    for key in keys:
        rest = {k: v for k, v in options.items() if k != key}
        options = rest if _gives(model, rest, day) else options
    return options


def daylight_values(day: Daylight) -> dict[str, float]:
    """Return the continuous keys of [daylight] and their values, defaults of its model included."""
    table = daylight_config(day)
    model, values = table.pop("model"), {"foam_reflectance": day.foam_reflectance}
    if table.keys().isdisjoint(_IRRADIANCES):
        known = defaults_of(model)
        values |= {key: known[key] for key in MODELS[model].keys if key in known}
    place = {key: getattr(day, key) for key in SUN}
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
    require_keys({key: value}, ["wavelength_nm", *_LIT, *MODELS[model].keys])
    if key == "wavelength_nm" and value != day.wavelength_nm:
        daylight_recipe(day)
    return light_of(model, day.wavelength_nm, {**table, key: value})


def changes_irradiance(key: str) -> bool:
    """Return whether direct and diffuse follow the value at a dotted key of a link file."""
    table, _, name = key.partition(".")
    options = [key for model in MODELS.values() for key in model.keys]
    of_daylight = table == "daylight" and name in ("model", *SUN, *options)
    return of_daylight or name.endswith("wavelength_nm")


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
        irradiances = Described("irradiances other than those of a model")
        raise Refused("daylight", irradiances, "a link file or its plain data, with the model")
    return {"model": model, **_needed(model, table, list(table), day)}
