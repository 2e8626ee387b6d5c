"""The parts of a scenario except the sea: link, mesh, run, detector, UAV and daylight.

Each is read from its table of a link file, completed by values shared with other tables (wind,
wavelength, index of the water), and written back without the keys that follow from these.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, get_args

from meshtrace.daylight import light as daylight
from meshtrace.daylight.light import MODEL_KEYS, MODELS, SUN, Daylight, UnavailableDaylight
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.engine.setup.options import Meshing, Run, run_keys
from meshtrace.errors import Described, Refused, require_keys, require_word, within
from meshtrace.link import Link, Physics, Source, Whitecaps
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Model
from meshtrace.optics.bubbles import BubblePopulation, HallNovarini
from meshtrace.optics.phase import FournierForand
from meshtrace.optics.spectra import WaterSpectrum
from meshtrace.optics.water import Water
from meshtrace.optics.water_files import read_spectrum
from meshtrace.scenario.files import M, Table, plain, split, unshared, validated
from meshtrace.uav import UAVS, Uav

if TYPE_CHECKING:
    from meshtrace.comms.ook import OokLink

DEFAULT_WIND_SPEED = 5.0

_UNSHARED = ("physics", "transmitter", "receiver", "planes", "objects", "n_air")
"""Keys of the link whose values do not depend on other tables."""

_PRINTED_BUBBLES = {"psi": "paper", "q": 2.0, "depth": "mean_level"}
"""Options of `HallNovarini` bubbles as published, see `Scenario.from_config`."""


def follows_wind(model: type[Model]) -> bool:
    """Return whether a model takes its wind speed from the link file by default.

    Measured ones do not: they have no wind speed, or one that is None by default.
    """
    field = model.model_fields.get("wind_speed")
    return field is not None and field.default is not None


def in_wind(
    model: type[M], table: Table, shared: Table, keys: Sequence[str] = ()
) -> tuple[M, bool]:
    """Return the model of a table completed by shared values, and whether its wind speed is 0.

    Spectra and bubbles refuse a wind speed of 0. They are validated at `DEFAULT_WIND_SPEED`, so
    that their other keys are still checked; the caller leaves them out. `keys` are further ones
    that errors name as allowed.
    """
    follows = follows_wind(model)
    if follows:
        table = {k: v for k, v in shared.items() if k in model.model_fields} | table
    speed = table.get("wind_speed")
    calm = follows and speed == 0.0 and not isinstance(speed, bool)  # False == 0.0 in Python
    if calm:
        table["wind_speed"] = DEFAULT_WIND_SPEED
    return validated(model, table, "", keys), calm


def read_link(tables: Table, wind_speed: float, printed: bool) -> Link:
    """Return the link that the tables of a link file describe.

    With `printed`, water, bubbles and whitecaps have the published forms unless the tables name
    others.
    """
    fields = {key: tables[key] for key in _UNSHARED if key in tables}
    default = sources = Link.model_fields["transmitter"].default
    if "transmitter" in fields:
        with within("transmitter"):
            sources = fields["transmitter"] = Source.read_several(fields["transmitter"])
    # an empty list of sources gets the default here, and is refused by `Link` below
    first = next(iter(sources), default) if isinstance(sources, tuple) else sources
    fields["water"] = water = _water(tables["water"], first.wavelength_nm, printed)
    shared = {"wind_speed": wind_speed, "wavelength_nm": first.wavelength_nm, "n_water": water.n}
    with within("bubbles"):
        fields["bubbles"] = _bubbles(tables["bubbles"], shared, printed)
    with within("whitecaps"):
        fields["whitecaps"] = _whitecaps(tables["whitecaps"], wind_speed, printed)
    return Link.model_validate(fields)


def read_meshing(sea: Table, keys: Iterable[str], run: Table) -> Meshing:
    """Return the options of the mesh: `keys` of [sea], and `normals` of [run]."""
    try:
        normals = {key: value for key, value in run.items() if key == "normals"}
        return Meshing.model_validate({key: sea[key] for key in keys} | normals)
    except Refused as error:
        raise error.inside("run" if error.field == "normals" else "sea") from None


def read_run(table: Table, link: Link) -> Run:
    """Return the options of [run], by default analog if forced detection cannot follow the link."""
    options = {key: value for key, value in table.items() if key != "normals"}
    try:
        crossing_reach(link)  # refuses links that forced detection cannot follow
    except Refused:
        options = {"estimator": "analog"} | options
    return validated(Run, options, "run", run_keys())


_SHARED = ("spectrum", "wavelength_nm")
"""Fields of `Water` that are not keys of [water]: its spectrum and [transmitter] give them."""


def _water(table: Table, wavelength_nm: float, printed: bool) -> Water:
    """Return the water of [water] at the wavelength [nm] of the transmitter."""
    kinds = spectrum_keys()
    fields = [key for key in Water.model_fields if key not in _SHARED]
    require_keys(table, [*kinds, "file", *fields], "water")
    spectral, table = split(table, [*kinds, "file"])
    try:
        if spectral.keys() == {"type"}:
            # beside a and b, or layers, a type gives the phase function alone
            water = Water.from_type(spectral["type"], wavelength_nm, **table)
        else:
            if spectral and ({"a", "b"} <= table.keys() or "layers" in table):
                key, value = next(iter(spectral.items()))
                raise Refused(key, value, "without a and b, or layers")
            if spectral:
                table |= {"spectrum": spectrum_of(spectral), "wavelength_nm": wavelength_nm}
            water = Water.model_validate(table)
    except Refused as error:
        raise error.inside("transmitter" if error.field == "wavelength_nm" else "water") from None
    phase = water.phase
    # the published cumulative phase function has another coefficient, see `FournierForand`
    if printed and isinstance(phase, FournierForand) and "cdf_coef" not in phase.model_fields_set:
        return water.replace("phase.cdf_coef", "paper")
    return water


def spectrum_keys() -> dict[str, type[WaterSpectrum]]:
    """Return the keys of [water] that describe a spectrum, each with its class."""
    members = WaterSpectrum.registered.values()
    return {key: kind for kind in members for key in kind.model_fields if key != "kind"}


def gives_spectrum(key: str) -> bool:
    """Return whether a dotted key of a link file describes the spectrum of the water."""
    table, _, name = key.partition(".")
    return table == "water" and name in (*spectrum_keys(), "file")


def spectrum_of(table: Table) -> WaterSpectrum:
    """Return the spectrum described by keys of [water], on top of a file if one is named."""
    if "file" not in table:
        return spectrum_keys()[next(iter(table))].model_validate(table)
    file, keys = split(table, ["file"])
    if not isinstance(file["file"], str):
        raise Refused("file", file["file"], "the path of a file")
    return read_spectrum(file["file"]).model_copy(update=keys)


def _bubbles(table: Table, shared: Table, printed: bool) -> BubblePopulation | None:
    """Return the bubbles of [bubbles]; None without any, and in a calm."""
    # link files name the kind of bubbles by "model"; "kind" is the name of the field
    key = "kind" if "kind" in table else "model"
    kind, table = split(table, [key])
    if kind.get(key) == "none":
        require_keys(table, ("model", *HallNovarini.model_fields))
        return None
    model = BubblePopulation.member(kind.get(key, "hall-novarini"), key)
    shared = shared | _PRINTED_BUBBLES if printed else shared
    bubbles, calm = in_wind(model, table, shared)
    return None if calm else bubbles


def _whitecaps(table: Table, wind_speed: float, printed: bool) -> Whitecaps | None:
    """Return the whitecaps of [whitecaps]; None without any, and in a calm."""
    table = {"wind_speed": wind_speed, "model": "paper_0255" if printed else "w_0225"} | table
    if absent := table["model"] == "none":
        del table["model"]  # the other keys are still checked
    whitecaps = Whitecaps.model_validate(table)
    return None if absent or whitecaps.wind_speed == 0.0 else whitecaps


def _read_preset(presets: Mapping[str, M], table: Table | None, path: str) -> M | None:
    """Return the preset named by a table (default: the first), updated by the other keys.

    Without a table the result is None.
    """
    if table is None:
        return None
    word, table = split(table, ["preset"])
    name = word.get("preset", next(iter(presets)))
    require_word(name, presets, f"{path}.preset")
    # validated as a whole: values that replace several fields may be allowed only together
    fields = dict(presets[name])
    for key, value in table.items():
        part = fields.get(key)
        # a table inside replaces single fields of that part: the others keep the preset's values
        inner: Any = dict(part) if isinstance(part, Model) and isinstance(value, dict) else None
        fields[key] = value if inner is None else inner | value
    return validated(type(presets[name]), fields, path, ["preset"])


def read_detector(table: Table | None) -> OokLink | None:
    """Return the detector of [detector]: a preset with replaced fields."""
    if table is None:
        return None
    from meshtrace.comms.ook import OokLink, Preset  # here: most link files have no detector

    presets = {name: OokLink.preset(name) for name in get_args(Preset)}
    return _read_preset(presets, table, "detector")


def valid_detector(value: Any) -> OokLink | None:
    """Return a detector from a detector or plain data."""
    if value is None:
        return None
    from meshtrace.comms.ook import OokLink

    if not isinstance(value, OokLink | Mapping):
        raise Refused("detector", value, "a table")
    return OokLink.model_validate(value)


def read_uav(table: Table | None) -> Uav | None:
    """Return the airframe of [uav]: a member of `UAVS`, updated by the other keys."""
    return _read_preset(UAVS, table, "uav")


OF_LINK = {"led": ("power", "wavelength"), "optics": ("radius", "fov_deg", "medium_index")}
"""Fields of a detector, by part, that `OokLink.of_link` takes from the link."""


def detector_of(detector: OokLink, link: Link) -> OokLink:
    """Return the detector with the power, wavelength, aperture and field of view of a link.

    It is unchanged for a link with several receivers, whose apertures may differ.
    """
    return type(detector).of_link(link, detector) if len(link.receivers) == 1 else detector


def require_of_link(table: Table, detector: OokLink | None) -> None:
    """Refuse keys of [detector] that contradict the link."""
    for part, names in OF_LINK.items():
        for name, value in split(table.get(part, {}), names)[0].items():
            of_link = getattr(getattr(detector, part), name)
            if not math.isclose(value, of_link, rel_tol=1e-9):
                allowed = f"nothing, or {of_link:g}, which the link gives"
                raise Refused(f"detector.{part}.{name}", value, allowed)


def detector_config(detector: OokLink | None, link: Link) -> Table | None:
    """Return the table [detector] without the keys that follow the link."""
    table: Table | None = plain(detector)
    if table and len(link.receivers) == 1:
        for part, names in OF_LINK.items():
            _, table[part] = split(table[part], names)
    return table


def water_config(link: Link) -> Table:
    """Return the table [water] without values that follow its spectrum, layers or wavelength."""
    water = link.water
    _, table = split(plain(water), _SHARED)
    # a and b of layered water are those of the first layer
    following = {"a", "b"} if water.layers else set()
    if water.spectrum and water.wavelength_nm == link.transmitters[0].wavelength_nm:
        following = {"a", "b", "n", "phase", "layers"} - water.model_fields_set
        table = plain(water.spectrum) | table
        del table["kind"]
    return split(table, following)[1]


def objects_config(link: Link) -> list[Table] | None:
    """Return the tables [[objects]] without digests, which follow from the files; None for none."""
    for body in link.bodies:
        if isinstance(body.mesh, TriangleMesh):
            raise Refused("objects", Described("a TriangleMesh"), "meshes of files in a link file")
    return [split(table, ["sha256"])[1] for table in plain(link.objects)] or None


def physics_config(physics: Physics) -> Any:
    """Return the name of the preset that the physics equals, or else its fields."""
    names = [name for name in ("physical", "paper") if Physics.preset(name) == physics]
    return names[0] if names else physics.model_dump()


def bubbles_config(link: Link, wind_speed: float) -> Table:
    """Return the table [bubbles] without keys that follow the wind, water or transmitter."""
    if link.bubbles is None:
        return {"model": "none"}
    wavelength_nm = link.transmitters[0].wavelength_nm
    shared = {"wind_speed": wind_speed, "wavelength_nm": wavelength_nm, "n_water": link.water.n}
    table = unshared(link.bubbles.model_dump(mode="json"), shared)
    return {"model": table.pop("kind")} | table


def whitecaps_config(link: Link, wind_speed: float) -> Any:
    """Return the name of the whitecap model, or a table if whitecaps have a separate wind."""
    if link.whitecaps is None:
        return "none"
    table = unshared(link.whitecaps.model_dump(), {"wind_speed": wind_speed})
    return table if "wind_speed" in table else table["model"]


_IRRADIANCES = ("direct", "diffuse")
_ANY_MODEL = ("model", *_IRRADIANCES, "pattern", "water", "foam_reflectance", "light", *SUN)
"""Keys of [daylight] that all models have; each has further ones, `MODEL_KEYS`."""


def read_daylight(table: Table, link: Link) -> Daylight | UnavailableDaylight | None:
    """Return the daylight of [daylight] at the wavelength of the transmitter; None for "none".

    With `direct` and `diffuse` [W m-2 nm-1] no spectral model is evaluated. A model whose package
    is not installed is refused only where it is used, see `UnavailableDaylight`.
    """
    # a table without a model has a clear sky; `expand_words` gives a file without the table "none"
    model = table.get("model", "clear")
    require_word(model, [*MODELS, "none"], "daylight.model")
    keys = (*_ANY_MODEL, *MODEL_KEYS.get(model, ()))
    require_keys(table, keys, "daylight")
    if model == "none":
        return None
    options = {key: value for key, value in table.items() if key != "model"}
    try:
        return daylight.light_of(model, link.transmitters[0].wavelength_nm, options)
    except Refused as error:
        refusal = error.inside("daylight") if error.field != "daylight" else error
        if isinstance(error.__cause__, ImportError):
            return UnavailableDaylight({"model": model} | options, refusal)
        raise refusal from None


def daylight_config(day: Daylight | UnavailableDaylight | None) -> Table | None:
    """Return the table [daylight] without the wavelength, which follows the transmitter.

    Irradiances, pattern and name that follow from the model and its options are left out.
    """
    if day is None or isinstance(day, UnavailableDaylight):
        return None if day is None else day.table
    fields = day.model_dump(mode="json", exclude={"wavelength_nm", "recipe"})
    # the name of the light tells the model; a light named by the user is taken for "clear"
    names = (name for name, model in MODELS.items() if model["light"] == day.light)
    model = next(names, "clear")
    options = split(fields | day.recipe, _IRRADIANCES)[1]
    # follows: the model gives these irradiances, so that they can be left out
    try:
        follows = daylight.light_of(model, day.wavelength_nm, options) == day
    except Refused:
        follows = False
    if not follows:
        return {"model": model} | fields
    defaults, _ = split(_defaults(model), ["pattern", "light"])
    return {"model": model} | unshared(options, defaults)


def _defaults(model: str) -> Table:
    """Return the fields of `Daylight` that a model has without options."""
    fields = {name: field.default for name, field in Daylight.model_fields.items()}
    return fields | MODELS[model]


def daylight_values(day: Daylight) -> dict[str, float]:
    """Return the real-valued keys of [daylight] and their values, model defaults included."""
    table: Any = daylight_config(day)
    model, values = table["model"], {key: getattr(day, key) for key in ("foam_reflectance", *SUN)}
    if table.keys().isdisjoint(_IRRADIANCES):
        values |= split(daylight.defaults_of(model), MODEL_KEYS[model])[0]
    values |= table
    return {key: value for key, value in values.items() if isinstance(value, float)}


def daylight_with(day: Daylight, key: str, value: Any) -> Daylight:
    """Return a daylight with another value of a key of [daylight]; irradiances follow their model.

    Raises
    ------
    Refused
        If there is no such key, the value is out of range, or the wavelength of irradiances that
        no model gives would change.
    """
    table: Any = daylight_config(day)
    model = table.pop("model")
    require_keys({key: value}, ["wavelength_nm", *_ANY_MODEL, *MODEL_KEYS[model]])
    if key == "wavelength_nm" and value != day.wavelength_nm:
        daylight_recipe(day)  # refuses irradiances that no model gives
    return daylight.light_of(model, day.wavelength_nm, table | {key: value})


def changes_irradiance(key: str) -> bool:
    """Return whether the irradiances of [daylight] depend on a dotted key of a link file."""
    table, _, name = key.partition(".")
    options = [key for keys in MODEL_KEYS.values() for key in keys]
    of_daylight = table == "daylight" and name in ("model", *SUN, *options)
    return of_daylight or name.endswith("wavelength_nm")


def daylight_recipe(day: Daylight) -> Table:
    """Return the table [daylight] without irradiances, which follow from the model.

    Raises
    ------
    Refused
        If the irradiances are not those of the model.
    """
    table: Any = daylight_config(day)
    if not table.keys().isdisjoint(_IRRADIANCES):
        irradiances = Described("irradiances other than those of a model")
        raise Refused("daylight", irradiances, "a link file or its plain data, with the model")
    # without the model's defaults, which would fix values that may follow the parameters of a sweep
    return unshared(table, _defaults(table["model"]))
