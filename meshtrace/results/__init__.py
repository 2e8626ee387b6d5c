"""Results of runs: gains, series, maps, impulse responses, and their files."""

from meshtrace.results.daylight import Background as Background
from meshtrace.results.daylight import BackgroundSeries as BackgroundSeries
from meshtrace.results.daylight import IrradianceSeries as IrradianceSeries
from meshtrace.results.gain import Fate as Fate
from meshtrace.results.gain import GainResult as GainResult
from meshtrace.results.gain import merge as merge
from meshtrace.results.impulse import ImpulseResponse as ImpulseResponse
from meshtrace.results.impulse import impulse_response as impulse_response
from meshtrace.results.series import ByWavelength as ByWavelength
from meshtrace.results.series import CoverageMap as CoverageMap
from meshtrace.results.series import GainSeries as GainSeries
from meshtrace.stored import load as load
