"""Inference of the parameters of a link from measured gains."""

from meshtrace.studies.inference.result import Inference
from meshtrace.studies.inference.study import infer

__all__ = ["Inference", "infer"]
