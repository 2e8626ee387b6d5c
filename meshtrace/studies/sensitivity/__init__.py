"""Sensitivities: derivatives of a link's quantities by its parameters, with common chains."""

from meshtrace.studies.sensitivity.result import Row, Sensitivities
from meshtrace.studies.sensitivity.study import sensitivities
from meshtrace.studies.sensitivity.swings import Swing, swings

__all__ = ["Row", "Sensitivities", "Swing", "sensitivities", "swings"]
