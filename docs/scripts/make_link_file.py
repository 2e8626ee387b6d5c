"""Write the reference of the keys of link files, link_file.md, from the models that read them."""

from __future__ import annotations

import inspect
import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from itertools import groupby
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from places import DOCS

import meshtrace as mt
from meshtrace.comms import ReceiverModel
from meshtrace.comms.ook import OokLink
from meshtrace.comms.response import ChannelResponse
from meshtrace.comms.spectra import Curve
from meshtrace.fields import entries
from meshtrace.link.receivers import Aperture
from meshtrace.link.sources import Source
from meshtrace.models import Family, Model
from meshtrace.optics.bubbles import BubblePopulation
from meshtrace.optics.phase import PhaseFunction
from meshtrace.scenario import Scenario
from meshtrace.scenario.files import unset_keys
from meshtrace.surfaces import (
    Band,
    MeshSequence,
    Spectrum,
    Spreading,
    Surface,
    from_gauge,
    from_wavespectra,
    gauge_spectrum,
)
from meshtrace.surfaces.gram_charlier import GramCharlier

PAGE = DOCS / "link_file.md"

INTRODUCTION = """\
# Keys of a link file

A link file is TOML; `meshtrace new` prints one with all keys at their defaults.
`--set table.key=value` replaces a value, in Python `Scenario.load(path, {"table.key": value})`.
Paths are relative to the file. Several transmitters, receivers or parts of a sea are
`[[transmitter]]`, `[[receiver]]`, `[[sea.part]]`.

A key has its default and other words, or its type in parentheses. Keys of some kinds alone stand
below their names.
"""

TOP = {
    "wind_speed": ("float", "5.0", "Wind speed at 10 m [m s-1], 0 to 60, of sea, bubbles, foam"),
    "physics": ("word or table", '"physical"', 'Correct physics, or "paper": the published forms'),
    "whitecaps": ("word or table", '"w_0225"', 'Foam: "w_0225", "monahan80", "paper_0255", "none"'),
    "n_air": ("float", "1.0", "Refractive index of the air, 1 to 2"),
}

Part = list[type[Model]] | type[Family]
SECTIONS: list[tuple[str, str, Part]] = [
    ("[physics]", "Switches, each between the correct and the published form.", [mt.Physics]),
    ("[whitecaps]", "", [mt.physics.Whitecaps]),
    ("[sea]", "`spectrum` names a sea, or one of the spectra of `[sea.spectrum]`.", Surface),
    (
        "[sea]: mesh",
        "Time, resolution and waves at which the sea is triangulated.",
        [mt.Meshing],
    ),
    ("[sea.spectrum]", "A table, or a word beside the keys in [sea].", Spectrum),
    ("[sea.spreading]", "A table or a word.", Spreading),
    ("[sea.waves]", "", [Band]),
    ("[sea.slope_law]", "", [GramCharlier]),
    ("[water]", "", [mt.Water]),
    ("[water.phase]", "", PhaseFunction),
    ("[bubbles]", '`model = "none"` for no bubbles.', BubblePopulation),
    ("[transmitter]", "", Source),
    ("[transmitter.tracker]", "Of beams.", [mt.Tracker]),
    ("[receiver]", "", Aperture),
    (
        "[planes]",
        "Irradiance planes in the water, for the analog estimator.",
        [mt.IrradiancePlanes],
    ),
    (
        "[[objects]]",
        "Bodies beside the sea, one table each. Paths are relative to the file.",
        [mt.Body],
    ),
    ("[detector]", "Fields that replace those of a `preset`.", [OokLink]),
    ("[detector.model]", "A word.", ReceiverModel),
    (
        "[detector.led.spectrum]",
        'A table over wavelength, or `{file = "led.csv"}` with columns of both; so may be '
        "`gain_spectrum`, `filter_transmission` and `pde`.",
        [Curve],
    ),
    (
        "[detector.response]",
        "By default the response of the channel, from the chains of the link, with its gain over "
        "the spectrum of the lamp.",
        [ChannelResponse],
    ),
    ("[uav]", "Fields that replace those of a `preset`.", [mt.Uav]),
    (
        "[daylight]",
        "The wavelength is that of the transmitter. Without `direct` and `diffuse` these follow "
        "from the model, for which the keys of the first table are.",
        [mt.Daylight],
    ),
    (
        "[run]",
        "Options of the run, those of its estimator, and `normals` of the mesh, "
        '"vertex" (interpolated) or "facet".',
        [type(mt.Scenario.from_toml("").run), mt.Forced, mt.Analog],
    ),
    ("[sweep]", "In a study file of `meshtrace sweep`, see [](guides/sweep.md).", []),
    ("[sweep.parameters]", "", []),
]

READERS: dict[str, tuple[Callable[..., Any], ...]] = {
    'file, `spectrum = "measured"`': (from_wavespectra,),
    'file, `spectrum = "gauge"`': (from_gauge, gauge_spectrum),
    "`meshes`": (MeshSequence,),
}
"""Functions whose parameters are keys of [sea] beside a file, with a title."""

NO_KEYS = {"kind", "source", "recipe", "record", "gauge", "parts"}
"""Fields that files name otherwise, or that readers fill."""

ELSEWHERE: dict[type[Model], set[str]] = {
    mt.Daylight: {"wavelength_nm"},
    mt.Meshing: {"normals"},
    mt.Body: {"sha256"},
    mt.Water: {"spectrum", "wavelength_nm"},
}
"""Fields that another table, or other keys, give."""


class Row(NamedTuple):
    """Key with its type, its default as TOML writes it or an example, and its meaning."""

    key: str
    type: str
    default: str
    meaning: str

    @property
    def head(self) -> str:
        """Key with its default and other words, or with its type where a default does not tell."""
        words = re.findall(r'"[^"]*"', self.type) if self.type.startswith("{") else []
        if self.default.startswith("e.g."):
            return f"`{self.key}` ({self.type}, {self.default})"
        if not self.default:
            return f"`{self.key}` ({'/'.join(f'`{word}`' for word in words) or self.type})"
        others = [f"`{word}`" for word in words if f"`{word}`" != self.default]
        told = words or re.fullmatch(
            r"float|int|bool|str|\(?(float, )*float\)?|array of float", self.type
        )
        rest = "" if told else f" ({self.type})"
        return f"`{self.key}` = {'/'.join([self.default, *others])}{rest}"


def shown(value: Any) -> str:
    """Return a default as TOML writes it, or nothing."""
    if value in (None, inspect.Parameter.empty) or repr(value).startswith("PydanticUndefined"):
        return ""
    if isinstance(value, Family):
        return f'`"{value.kind}"`'
    if isinstance(value, Model):
        return ""
    value = list(value) if isinstance(value, tuple) else value
    text = {True: "true", False: "false"}.get(value) if isinstance(value, bool) else None
    return f"`{text or repr(value).replace(chr(39), chr(34))}`"


def typed(words: str, annotation: Any = None) -> str:
    """Return the type of a docstring, or else of an annotation, in the words of TOML."""
    words = re.sub(r",? ?(?:optional|or None)$", "", words or annotated(annotation))
    words = re.sub(r"\b(?:sequence|tuple)s?\b", "array", words).replace(" or str or dict", "")
    words = words.replace("Forced or Analog, or ", "")
    found = re.sub(r"\b(?:Spreading|PhaseFunction|Estimator)\b", "word or table", words)
    return re.sub(r"\b[A-Z][a-z]\w+\b", "table", found) or "str"


def annotated(annotation: Any) -> str:
    """Return a type in the words of docstrings."""
    args = get_args(annotation)
    if get_origin(annotation) is Literal:
        return "{" + ", ".join(json.dumps(word) for word in args) + "}"
    if get_origin(annotation) is Annotated:
        return annotated(args[0])
    if get_origin(annotation) is tuple:
        parts = list(map(annotated, args))
        return f"array of {parts[0]}" if args[-1] is ... else f"({', '.join(parts)})"
    if args:
        return " or ".join(word for word in map(annotated, args) if word)
    if annotation in (type(None), None, ...):
        return ""
    return getattr(annotation, "__name__", str(annotation))


def rows(model: type[Model]) -> list[Row]:
    """Return the keys of a model."""
    notes, types = model.notes(), entries(model)
    skipped = NO_KEYS | ELSEWHERE.get(model, set())
    found = []
    for name, field in model.model_fields.items():
        if name not in skipped:
            default = field.get_default(call_default_factory=True)
            type_ = typed(types.get(name, ("", ""))[0], field.annotation)
            found.append(Row(name, type_, shown(default), notes.get(name, "")))
    if issubclass(model, Family) and hasattr(model, "from_file"):
        columns = " and ".join(f"`{row.key}`" for row in found[:2])
        found.append(Row("file", "str", "", f"Text file with columns of {columns}, in their place"))
    return found


def rows_of(functions: tuple[Callable[..., Any], ...]) -> list[Row]:
    """Return the parameters of functions that read a file."""
    found: dict[str, Row] = {}
    for function in functions:
        notes = entries(function)
        for name, parameter in inspect.signature(function).parameters.items():
            type_, text = notes.get(name, ("", ""))
            if name not in NO_KEYS and not text.startswith("As in"):
                note = re.split(r"(?<=\w)[.:;](?: |$)", text, maxsplit=1)[0]
                row = Row(name, typed(type_), shown(parameter.default), note)
                found.setdefault(name, row)
    return list(found.values())


def rows_of_unset(title: str, covered: str) -> list[Row]:
    """Return the keys of a table that no model has, with an example as default."""
    found = []
    for line in unset_keys().get(title.strip("[]"), []):
        key, _, rest = line.partition(" = ")
        example, _, note = rest.partition("  # ")
        name = key.strip('"')
        type_ = type(tomllib.loads(f"x = {example}")["x"]).__name__.replace("list", "array")
        if not re.search(rf"(?:^- |, )`{name}`", covered, re.MULTILINE):
            found.append(Row(name, type_, f"e.g. `{example}`", note))
    return found


def items(found: Iterable[Row]) -> list[str]:
    """Return rows as lines of a list with an empty line; neighbours of one meaning share a line."""
    lines = [
        f"- {', '.join(row.head for row in group)}: {meaning.rstrip('.')}"
        for meaning, group in groupby(found, key=lambda row: row.meaning)
    ]
    return [*lines, ""] if lines else []


def family(kinds: Mapping[str, type[Model]]) -> list[str]:
    """Return a list of the kinds, and one of their keys for each group of kinds that have them."""
    about = [f"- **{k}**: {(m.__doc__ or '').strip().splitlines()[0]}" for k, m in kinds.items()]
    owners: dict[Row, list[str]] = {}
    for kind, model in kinds.items():
        for row in rows(model):
            owners.setdefault(row, []).append(kind)
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row, of in owners.items():
        groups.setdefault(tuple(of), []).append(row)
    lines = [*about, ""]
    for of, group in sorted(groups.items(), key=lambda item: -len(item[0])):
        lines += ["All:" if len(of) == len(kinds) else f"*{', '.join(of)}*:", "", *items(group)]
    return lines


def seas() -> list[str]:
    """Return the seas of [sea], with each spectrum under its one name, and the keys of files."""
    kinds = dict(Surface.registered)
    spectral, jonswap = kinds["spectral"], kinds.pop("jonswap")
    both = {*spectral.model_fields, *Spectrum.registered["jonswap"].model_fields}
    assert set(jonswap.model_fields) <= both  # the same sea by another name in Python
    del kinds["spectral"], kinds["sum"]
    lines = family({**kinds, "a spectrum": spectral, "[[sea.part]]": Surface.registered["sum"]})
    told = set(rows(kinds["measured"]))
    for title, functions in READERS.items():
        found = [row for row in rows_of(functions) if row not in told]
        lines += [f"### {title[0].upper()}{title[1:]}", "", *items(found)]
    return lines


def inner(model: type[Model]) -> list[tuple[str, type[Model]]]:
    """Return the tables inside a model."""
    fields = {n: f.get_default(call_default_factory=True) for n, f in model.model_fields.items()}
    return [
        (name, type(part))
        for name, part in fields.items()
        if isinstance(part, Model) and not isinstance(part, Family)
    ]


def section(title: str, text: str, models: Part) -> list[str]:
    """Return a section with a list for each model."""
    lines = [f"## {title}", ""] + ([text, ""] if text else [])
    if not isinstance(models, list):
        found = seas() if models is Surface else family(models.registered)
        return lines + items(rows_of_unset(title, "\n".join(found))) + found
    own = [line for model in models for line in items(rows(model))]
    lines += items(rows_of_unset(title, "\n".join(own)))
    for model in models:
        found = items(rows(model))
        lines += [f"`{model.__name__}`:", "", *found] if found and len(models) > 1 else found
    for model in models:
        for name, part in inner(model):
            lines += section(f"[{title.strip('[]')}.{name}]", "", [part])
    return lines


def page() -> str:
    """Return the page."""
    top = [Row(key, type_, f"`{value}`", note) for key, (type_, value, note) in TOP.items()]
    lines = [INTRODUCTION, "## Keys at the top", "", *items(top)]
    for one in SECTIONS:
        lines += section(*one)
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    assert TOP.keys() <= set(Scenario.from_toml("").to_config())
    PAGE.write_text(page(), encoding="utf-8")
