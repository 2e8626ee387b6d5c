"""Communications: devices, pulses, receiver models, error rates, link budgets and capacity."""

import lazy_loader

import meshtrace.comms.receivers  # noqa: F401, the built-in models join their family

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
