"""Write the reference of the keys of link files, link_file.md, from the models that read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshtrace as mt
from meshtrace.comms.ook import OokLink
from meshtrace.link.receivers import Aperture
from meshtrace.link.sources import Source
from meshtrace.models import Family, Model
from meshtrace.optics.bubbles import BubblePopulation
from meshtrace.optics.phase import PhaseFunction
from meshtrace.scenario import Scenario
from meshtrace.scenario.files import unset_keys
from meshtrace.surfaces import Spectrum, Spreading, Surface

PAGE = Path(__file__).with_name("link_file.md")

INTRODUCTION = """\
# Keys of a link file

A link file is TOML. Every key has a default, and `meshtrace new` prints a file with all of them.
On the command line `--set table.key=value` replaces a value, in Python
`Scenario.load(path, {"table.key": value})`. Paths are relative to the folder of the file. Several
transmitters, receivers or parts of a sea are written as `[[transmitter]]`, `[[receiver]]` and
`[[sea.part]]`.

A study file of `meshtrace sweep` also has the tables `[sweep]` and `[sweep.parameters]`.

This page is written from the models by `docs/make_link_file.py`.
"""

TOP = {
    "wind_speed": ("5.0", "Wind speed at 10 m [m s-1], 0 to 60, of the sea, bubbles and whitecaps"),
    "physics": ('"physical"', 'Correct physics, "paper" for the published forms, or a table'),
    "whitecaps": ('"w_0225"', 'Foam: "w_0225", "monahan80", "paper_0255", "none" or a table'),
    "n_air": ("1.0", "Refractive index of the air, 1 to 2"),
}

SECTIONS: list[tuple[str, str, list[type[Model]] | type[Family]]] = [
    ("[physics]", "Switches, each between the correct and the published form.", [mt.Physics]),
    (
        "[sea]",
        "`spectrum` names the kind of sea or of spectrum; also the keys of the mesh.",
        Surface,
    ),
    (
        "[sea]: mesh",
        "Time, resolution and waves at which the sea is triangulated.",
        [mt.Meshing],
    ),
    ("[sea.spectrum]", "A table, or a word beside the keys in [sea].", Spectrum),
    ("[sea.spreading]", "A table or a word.", Spreading),
    ("[water]", "", [mt.Water]),
    ("[water.phase]", "", PhaseFunction),
    ("[bubbles]", '`model = "none"` for no bubbles.', BubblePopulation),
    ("[transmitter]", "", Source),
    ("[receiver]", "", Aperture),
    (
        "[planes]",
        "Irradiance planes in the water, for the analog estimator.",
        [mt.IrradiancePlanes],
    ),
    ("[detector]", "Fields that replace those of a `preset`.", [OokLink]),
    ("[uav]", "Fields that replace those of a `preset`.", [mt.Uav]),
    (
        "[daylight]",
        "The wavelength is that of the transmitter. Without `direct` and `diffuse` these follow "
        "from the model, for which the keys of the first table are.",
        [mt.Daylight],
    ),
    (
        "[run]",
        "Options of the run; those of the estimator are keys of the same table.",
        [type(mt.Scenario.from_toml("").run), mt.Forced, mt.Analog],
    ),
    ("[sweep]", "In a study file of `meshtrace sweep`, see [](guides/sweep.md).", []),
    ("[sweep.parameters]", "", []),
]


def shown(value: Any) -> str:
    """Return a default as TOML writes it, or nothing."""
    if value is None or repr(value).startswith("PydanticUndefined"):
        return ""
    if isinstance(value, Family):
        return f"`{value.kind}`"
    if isinstance(value, Model):
        return "table"
    text = {True: "true", False: "false"}.get(value) if isinstance(value, bool) else None
    return f"`{text or repr(value).replace(chr(39), chr(34))}`"


def rows(model: type[Model]) -> list[str]:
    """Return the keys of a model as rows of a table."""
    notes = model.notes()
    found = ["| key | default | meaning |", "|---|---|---|"]
    for name, field in model.model_fields.items():
        if name not in ("kind", "source", "recipe"):
            default = field.get_default(call_default_factory=True)
            note = notes.get(name, "").replace("|", "\\|")
            found.append(f"| `{name}` | {shown(default)} | {note} |")
    return found


def rows_of_unset(title: str) -> list[str]:
    """Return the keys of a table that no model has, with an example, as rows of a table."""
    found = []
    for line in unset_keys().get(title.strip("[]"), []):
        key, _, rest = line.partition(" = ")
        example, _, note = rest.partition("  # ")
        key = key.strip('"')
        found.append(f"| `{key}` | `{example}` | {note} |")
    return ["| key | example | meaning |", "|---|---|---|", *found, ""] if found else []


def inner(model: type[Model]) -> list[tuple[str, type[Model]]]:
    """Return the tables inside a model."""
    fields = {n: f.get_default(call_default_factory=True) for n, f in model.model_fields.items()}
    return [
        (name, type(part))
        for name, part in fields.items()
        if isinstance(part, Model) and not isinstance(part, Family)
    ]


def section(title: str, text: str, models: list[type[Model]] | type[Family]) -> list[str]:
    """Return a section with a table for each model."""
    lines = [f"## {title}", ""] + ([text, ""] if text else []) + rows_of_unset(title)
    if isinstance(models, list):
        for model in models:
            if set(model.model_fields) - {"kind"}:
                lines += [f"`{model.__name__}`:", ""] if len(models) > 1 else []
                lines += [*rows(model), ""]
        for model in models:
            for name, part in inner(model):
                lines += section(f"[{title.strip('[]')}.{name}]", "", [part])
        return lines
    for kind, model in models.registered.items():
        summary = (model.__doc__ or "").strip().splitlines()[0]
        lines += [f"### `{kind}`", "", summary, ""]
        if set(model.model_fields) - {"kind"}:
            lines += [*rows(model), ""]
    return lines


def page() -> str:
    """Return the page."""
    lines = [INTRODUCTION, "## Keys at the top", "", "| key | default | meaning |", "|---|---|---|"]
    lines += [f"| `{name}` | `{default}` | {note} |" for name, (default, note) in TOP.items()]
    lines.append("")
    for one in SECTIONS:
        lines += section(*one)
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    assert TOP.keys() <= set(Scenario.from_toml("").to_config())
    PAGE.write_text(page(), encoding="utf-8")
