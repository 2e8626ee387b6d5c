"""Communications: devices, pulses, receiver models, error rates, link budgets and capacity."""

import meshtrace.comms.receivers  # noqa: F401, the built-in models join their family
from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
