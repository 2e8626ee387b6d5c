"""Daylight: spectra, position of the sun, patterns of the sky, glint, light out of the water."""

from meshtrace.daylight.light import Daylight as Daylight
from meshtrace.daylight.light import clear_irradiance as clear_irradiance
from meshtrace.daylight.light import moon_phase_factor as moon_phase_factor
from meshtrace.daylight.light import sky as sky
from meshtrace.daylight.light import sky_radiance as sky_radiance
from meshtrace.daylight.upward import QuasiSingle as QuasiSingle
from meshtrace.daylight.upward import glint_radiance as glint_radiance
