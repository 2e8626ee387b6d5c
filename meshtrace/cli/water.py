"""`meshtrace water`: absorption, scattering and index of a water over the wavelength."""

from __future__ import annotations

from pathlib import Path

import typer

from meshtrace.cli.app import app
from meshtrace.cli.made import described, numbers
from meshtrace.cli.options import Changes, LinkFile, check_plot, draw
from meshtrace.errors import Described, Refused


@app.command()
@described
def water(
    *,
    link: LinkFile = None,
    type_: str | None = None,
    chlorophyll: float | None = None,
    cdom: float | None = None,
    minerals: float | None = None,
    temperature_c: float | None = None,
    salinity: float | None = None,
    file: Path | None = None,
    wavelengths: str | None = None,
    plot: Path | None = None,
    changes: Changes,
) -> None:
    """Print absorption, scattering, attenuation and index of a water over the wavelength.

    The water is that of a link file, or of the options, whose keys in a link file are in [water].

    Parameters
    ----------
    type_ : NAME
        Known water, such as coastal, jerlov-IB or pure-sea.
    chlorophyll : C
        Chlorophyll [mg m-3].
    cdom : A
        Absorption of dissolved matter at 440 nm [m-1].
    minerals : M
        Mineral particles [g m-3].
    temperature_c : T
        Temperature [degree Celsius].
    salinity : S
        Salinity [g/kg].
    file : FILE
        SeaBASS file, BGC-Argo profile or text table.
    wavelengths : NM,NM,...
        Wavelengths [nm], or start:stop:step; default: 400 to 700 nm.
    plot : A.PNG
        Draw the coefficients.
    """
    from meshtrace.optics.water import Water
    from meshtrace.scenario.parts import spectrum_of
    from meshtrace.tables import text_table

    check_plot(plot, link)
    keys = {"type": type_, "chlorophyll": chlorophyll, "cdom": cdom, "minerals": minerals,
            "temperature_c": temperature_c, "salinity": salinity}  # fmt: skip
    own = {key: value for key, value in keys.items() if value is not None}
    if own or file is not None:
        if link is not None or changes.set_:
            given = Described(f"{link or changes.set_} beside options of a water")
            raise Refused("link", given, "one of them")
        spectrum = spectrum_of(own, None if file is None else str(file))
        low, high = spectrum.limits_nm
        found = Water(spectrum=spectrum, wavelength_nm=min(max(low, 470.0), high))
    else:
        lamp = changes.scenario(link).link
        found = lamp.water
        if found.spectrum is None and wavelengths is None and plot is None:
            typer.echo(found.described(lamp.transmitters[0].wavelength_nm))
            return
    data = found.spectra(None if wavelengths is None else numbers("--wavelengths", wavelengths))
    columns = [data[name].values for name in ("wavelength_nm", *"abcn")]
    rows = [(f"{w:g}", *(f"{x:.4g}" for x in abc), f"{n:.4f}")
            for w, *abc, n in zip(*columns, strict=True)]  # fmt: skip
    headings = ("wavelength [nm]", "a [m-1]", "b [m-1]", "c [m-1]", "n")
    where = ", at the surface" if found.layers else ""
    typer.echo(f"{data.attrs['source']}{where}\n\n{text_table(rows, headings)}")
    draw(data, plot)
