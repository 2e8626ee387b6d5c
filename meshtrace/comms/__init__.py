"""Communications: devices, pulses, receiver models, error rates, link budgets and capacity."""

import lazy_loader

import meshtrace.comms.receivers  # noqa: F401, the built-in models join their family

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submodules=[
        "budget",
        "capacity",
        "decisions",
        "devices",
        "interleaving",
        "ook",
        "pulses",
        "receiver_base",
        "receivers",
    ],
    submod_attrs={
        "decisions": ["Decision"],
        "devices": ["LedDriver", "OpticalFrontEnd", "SiPM", "Tia"],
        "ook": ["OokLink"],
        "receiver_base": ["ReceiverModel"],
    },
)
