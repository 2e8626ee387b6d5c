"""Published measurements as data, and the suite that compares them with computed values."""

from .suite import HEADINGS as HEADINGS
from .suite import Experiment as Experiment
from .suite import MeasuredTable as MeasuredTable
from .suite import band_of as band_of
from .suite import experiments as experiments
from .suite import run as run
