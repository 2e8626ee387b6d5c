"""One registry of variables: CF units, long name and symbol, read by results, plots and docs."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Field(NamedTuple):
    """Metadata of a variable: UDUNITS `units`, `long_name`, and `symbol` as TeX without dollars."""

    units: str
    long_name: str
    symbol: str


FIELDS: Mapping[str, Field] = MappingProxyType(
    {
        # channel gain
        "gain": Field("1", "channel gain", "h"),
        "gain_stderr": Field("1", "standard error of the channel gain", r"\sigma_h"),
        "gain_ballistic": Field("1", "channel gain of unscattered light", "h_0"),
        "gain_scattered": Field("1", "channel gain of scattered light", "h_s"),
        "gain_bound": Field(
            "1", "upper bound of the channel gain at 95 percent confidence", r"h_\mathrm{max}"
        ),
        "gain_reflected": Field(
            "1", "channel gain of light that the surface had reflected back", r"h_r"
        ),
        "gain_order": Field("1", "channel gain by the number of scatterings", "h_n"),
        "gain_mean": Field("1", "mean channel gain", r"\bar h"),
        "gain_mean_stderr": Field(
            "1", "standard error of the mean channel gain", r"\sigma_{\bar h}"
        ),
        "gain_median": Field("1", "median channel gain", r"h_{50}"),
        "photons": Field("1", "number of photons", "N"),
        "fate": Field("1", "fate of a photon", r"\mathrm{fate}"),
        "fate_photons": Field("1", "number of photons of a fate", r"N_f"),
        "fate_weight": Field("1", "weight of the photons of a fate", r"W_f"),
        "delay": Field("s", "delay after the first light", r"\tau"),
        "delay_edges": Field("s", "edges of the bins in delay", r"\tau"),
        "first_arrival": Field("s", "delay of the first light from its emission", "t_0"),
        "mean_delay": Field("s", "mean delay", r"\bar\tau"),
        "rms_delay_spread": Field("s", "rms delay spread", r"\tau_\mathrm{rms}"),
        "impulse_response": Field("s-1", "impulse response", r"h(\tau)"),
        "arrival_receiver": Field("1", "index of the receiver of an arrival", "i"),
        "arrival_weight": Field("1", "contribution of an arrival to the channel gain", "w"),
        "arrival_water_path": Field("m", "path length in water", r"\ell_w"),
        "arrival_air_path": Field("m", "path length in air", r"\ell_a"),
        "arrival_group": Field("1", "group of independent arrivals, -1 without error", "g"),
        # radiometry; over whole planes and per emitted power
        "irradiance": Field("W m-2", "irradiance", "E"),
        "map_x": Field("m", "distance down-wind of the centre of a cell", "x"),
        "map_y": Field("m", "distance across the wind of the centre of a cell", "y"),
        "map_irradiance": Field("m-2", "irradiance per emitted power", "E"),
        "plane_depth": Field("m", "depth of a plane below still water", "d"),
        "e_d": Field("1", "downward plane irradiance, integrated over the plane", "E_d"),
        "e_u": Field("1", "upward plane irradiance, integrated over the plane", "E_u"),
        "e_od": Field("1", "downward scalar irradiance, integrated over the plane", "E_{od}"),
        "e_ou": Field("1", "upward scalar irradiance, integrated over the plane", "E_{ou}"),
        "radiance": Field("sr-1", "radiance, integrated over the plane, per emitted power", "L"),
        "cosine": Field("1", "cosine of the zenith angle of the light's travel", r"\mu"),
        "cosine_edges": Field("1", "edges of the bins in the cosine", r"\mu"),
        "azimuth": Field("rad", "azimuth of the light's travel from +x", r"\varphi"),
        "azimuth_edges": Field("rad", "edges of the bins in azimuth", r"\varphi"),
        # geometry
        "depth": Field("m", "depth below still water", "d"),
        "height": Field("m", "height above still water", "h_\\mathrm{Rx}"),
        "radius": Field("m", "radius of the aperture", "r"),
        "x": Field("m", "distance down-wind", "x"),
        "y": Field("m", "distance across the wind", "y"),
        "z": Field("m", "height above still water", "z"),
        "offset": Field("m", "horizontal offset of the receiver", r"\Delta x"),
        "fov_deg": Field("degree", "full field of view", r"\phi"),
        "half_angle_deg": Field("degree", "half angle at half power", r"\theta_{1/2}"),
        "tilt_deg": Field("degree", "tilt of the receiver", r"\alpha"),
        "time": Field("s", "time", "t"),
        "spacing": Field("m", "mesh spacing", r"\Delta"),
        # sea
        "wind_speed": Field("m s-1", "wind speed at 10 m height", "U_{10}"),
        "fetch": Field("m", "fetch", "F"),
        "hs": Field("m", "significant wave height", "H_s"),
        "tp": Field("s", "peak wave period", "T_p"),
        "omega": Field("rad s-1", "angular frequency of the waves", r"\omega"),
        "omega_p": Field("rad s-1", "peak angular frequency of the waves", r"\omega_p"),
        "k": Field("rad m-1", "wave number", "k"),
        "spectrum": Field("m2 s rad-1", "wave frequency spectrum", r"S(\omega)"),
        "mss": Field("1", "mean square slope", r"\mathrm{mss}"),
        "elevation": Field("m", "sea surface elevation", r"\eta"),
        "slope_x": Field("1", "sea surface slope down-wind", r"\partial_x \eta"),
        "slope_y": Field("1", "sea surface slope across the wind", r"\partial_y \eta"),
        # water and bubbles
        "wavelength_nm": Field("nm", "wavelength in vacuum", r"\lambda"),
        "a": Field("m-1", "absorption coefficient", "a"),
        "b": Field("m-1", "scattering coefficient", "b"),
        "c": Field("m-1", "attenuation coefficient", "c"),
        "albedo": Field("1", "single scattering albedo", r"\omega_0"),
        "theta": Field("rad", "scattering angle", r"\theta"),
        "phase_function": Field("sr-1", "phase function", r"\tilde\beta"),
        "vsf": Field("m-1 sr-1", "volume scattering function", r"\beta"),
        "g": Field("1", "mean cosine of the scattering angle", "g"),
        "b_bub": Field("m-1", "scattering coefficient of bubbles", r"b_\mathrm{bub}"),
        "n_bubbles": Field("m-3", "number density of bubbles", "N_b"),
        # receiver
        "received_power": Field("W", "received optical power", r"P_\mathrm{Rx}"),
        "snr_db": Field("dB", "signal to noise ratio", r"\mathrm{SNR}"),
        "bit_rate": Field("s-1", "bit rate", "R_b"),
        "ber": Field("1", "bit error ratio", r"\mathrm{BER}"),
        "capacity": Field("s-1", "capacity in bits", "C"),
        "required_power": Field(
            "W", "optical power required for the limit of the bit error ratio", r"P_\mathrm{req}"
        ),
        "photons_per_bit": Field("1", "photons on the detector in a bit", r"n_\mathrm{ph}"),
        "margin_optical_db": Field("dB", "link margin, ratio of optical powers", r"M_\mathrm{opt}"),
        "margin_electrical_db": Field(
            "dB", "link margin, ratio of squared photocurrents", r"M_\mathrm{el}"
        ),
        "capacity_hard": Field(
            "s-1", "ergodic capacity in bits after hard decisions", r"C_\mathrm{hard}"
        ),
        "capacity_soft": Field(
            "s-1", "ergodic capacity in bits from full counts", r"C_\mathrm{soft}"
        ),
        "capacity_hard_outage": Field(
            "s-1", "hard-decision rate of all but 1 percent of the fades", r"C_\mathrm{out}"
        ),
        "range": Field(
            "m",
            "depth down to which the limit of the bit error ratio is reached",
            r"d_\mathrm{max}",
        ),
        # fading
        "scintillation_index": Field("1", "scintillation index", r"\sigma_I^2"),
        "noise_share": Field(
            "1", "share of Monte Carlo noise in the gain variance", r"\eta_\mathrm{MC}"
        ),
        "threshold": Field("1", "fade threshold", "h_T"),
        "outage": Field("1", "outage probability", r"P_\mathrm{out}"),
        "level_crossing_rate": Field("s-1", "downward level crossing rate", "N_T"),
        "mean_fade_duration": Field("s", "mean fade duration", r"\bar\tau_T"),
        "lag": Field("s", "time lag", r"\tau"),
        "autocorrelation": Field("1", "autocorrelation of the channel gain", r"\rho(\tau)"),
        "coherence_time": Field("s", "coherence time at 1/e", r"\tau_c"),
        "gain_bin": Field("1", "channel gain at the centre of a bin", "h"),
        "gain_bin_edge": Field("1", "channel gain at the edges of the bins", "h"),
        "gain_bin_width": Field("1", "width of a channel gain bin", r"\Delta h"),
        "gain_pdf": Field("1", "probability density of the channel gain", "f(h)"),
        "gain_pdf_stderr": Field(
            "1", "standard error of the probability density of the channel gain", r"\sigma_f"
        ),
        "gain_cdf_low": Field("1", "lower confidence limit of the distribution function", "F_-"),
        "gain_cdf_high": Field("1", "upper confidence limit of the distribution function", "F_+"),
        "gain_cdf": Field("1", "distribution function of the channel gain", "F(h)"),
        "model": Field("1", "fitted law", r"\mathrm{law}"),
        "fit_parameter": Field("1", "name of a parameter of the fitted law", r"\mathrm{name}"),
        "fit_value": Field("1", "parameter of the fitted law", r"\hat\vartheta"),
        "aic": Field("1", "Akaike information criterion", r"\mathrm{AIC}"),
        "ks": Field("1", "Kolmogorov-Smirnov distance", "D"),
        "ks_p_value": Field("1", "p-value of the Kolmogorov-Smirnov distance", "p"),
    }
)


def field(name: str) -> Field:
    """Return the registered field of a variable.

    Parameters
    ----------
    name : str
        Name of the variable, as in results and datasets.

    Returns
    -------
    Field
        Units, long name and symbol.

    Raises
    ------
    KeyError
        If the name is not registered; the message offers similar names.

    Examples
    --------
    >>> field("wind_speed").units
    'm s-1'
    """
    try:
        if name not in FIELDS and name.endswith("_stderr"):
            units, long_name, symbol = FIELDS[name.removesuffix("_stderr")]
            return Field(units, f"standard error of the {long_name}", rf"\sigma({symbol})")
        return FIELDS[name]
    except KeyError:
        close = difflib.get_close_matches(name, FIELDS)
        hint = f"; did you mean {' or '.join(close)}?" if close else ""
        raise KeyError(f"{name}: not in meshtrace.fields.FIELDS{hint}") from None


def attrs(name: str) -> dict[str, str]:
    """Return the attributes of a variable for xarray: units, long_name and symbol.

    Parameters
    ----------
    name : str
        Name of the variable, as in results and datasets.

    Returns
    -------
    dict
        A new dictionary at each call.

    Raises
    ------
    KeyError
        If the name is not registered.

    Examples
    --------
    >>> attrs("hs")
    {'units': 'm', 'long_name': 'significant wave height', 'symbol': 'H_s'}
    """
    return field(name)._asdict()
