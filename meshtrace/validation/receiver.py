"""Tilt of the aircraft and electronics of the receiver against published and derived values."""

from __future__ import annotations

import math
from collections.abc import Iterator

from meshtrace.comms.devices import SiPM
from meshtrace.comms.ook import OokLink
from meshtrace.uav.airframe import Uav
from meshtrace.uav.wind import Dryden
from meshtrace.validation.check import Check, exact, printed

WAVELENGTH = 470e-9
PAPER = "Nennouche et al., printed"
DERIVED = "independent derivation"

# preset, wind speed: standard deviation of the tilt [degrees]
TILTS = {
    ("paper", 5.0): 0.48300619891786867,
    ("paper", 13.0): 3.0243678091154886,
    ("physical", 5.0): 0.8482939811689599,
    ("physical", 13.0): 5.207172074235661,
}
# scatter of a record of 1000 s
PRINTED_TILTS = {5.0: (0.479, 0.06), 13.0: (3.04, 0.034)}

# receiver model: bit error rate at 1e-10 W and 1 and 5 Mbit/s, no saturation; relative accuracy
BIT_ERRORS: dict[str, tuple[float, float, float]] = {
    "GP": (7.53779e-15, 2.82205e-4, 1e-5),
    "G0": (1.33835e-14, 2.94563e-4, 1e-4),
    "PC": (1.33882e-14, 2.74800e-3, 1e-4),
    "A": (1.05397e-3, 4.24599e-3, 1e-4),
}
# receiver model: power for 1e-3 at 1 Mbit/s [W]
REQUIRED: dict[str, str] = {
    "GP": "1.69360e-11",
    "G0": "1.70067e-11",
    "PC": "1.70069e-11",
    "A": "1.01038e-10",
}


def receiver_checks(photons: int) -> Iterator[Check]:
    """Yield the checks of tilt, noise and bit errors; none of them draws random numbers."""
    del photons
    yield from (*_tilt_checks(), *_noise_checks(), *_error_checks())


def _tilt_checks() -> Iterator[Check]:
    drag, name = 1.574722597e-3, "tilt: drag coefficient K [s2 m-2]"
    yield Check(name, DERIVED, drag, Uav().tilt_coefficient, tolerance=5e-13)
    for (preset, wind_speed), expected in TILTS.items():
        wind = Dryden.preset(preset, wind_speed=wind_speed, height=5.0)  # type: ignore[arg-type]
        got = math.degrees(Uav().tilt_law(wind, "exact").std())
        label = f"tilt, {wind_speed:g} m/s, {preset}: std [deg]"
        yield Check(label, DERIVED, expected, got, tolerance=1e-5)
        if preset == "paper":
            text, scatter = PRINTED_TILTS[wind_speed]
            yield exact(label, f"{PAPER}, record of 1000 s", text, got, scatter)


def _noise_checks() -> Iterator[Check]:
    sipm = SiPM(pde=0.4)
    yield printed("NEP, PDE 40 % [W Hz-1/2]", PAPER, "3.42e-15", sipm.nep_paper(WAVELENGTH))
    for bit_rate, text in ((1e6, "2.42e-12"), (5e6, "5.41e-12"), (1e7, "7.65e-12")):
        got = sipm.noise_power_paper(WAVELENGTH, 0.5 * bit_rate)
        yield printed(f"noise power, {bit_rate / 1e6:g} Mbit/s [W]", PAPER, text, got)


def _error_checks() -> Iterator[Check]:
    for model, (slow, fast, accuracy) in BIT_ERRORS.items():
        for bit_rate, expected in ((1e6, slow), (5e6, fast)):
            link = OokLink(bit_rate=bit_rate, model=model, saturation=False)
            label = f"BER {model}, {bit_rate / 1e6:g} Mbit/s, 1e-10 W"
            yield exact(label, DERIVED, expected, link.ber(1e-10), accuracy)
    for model, text in REQUIRED.items():
        got = OokLink(bit_rate=1e6, model=model, saturation=False).required_power(1e-3)
        yield printed(f"power {model} for 1e-3, 1 Mbit/s [W]", DERIVED, text, got)
