"""Communications: devices, pulses, receiver models, error rates, link budgets and capacity."""

import lazy_loader

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
        "receivers",
    ],
    submod_attrs={
        "decisions": ["Decision"],
        "devices": ["LedDriver", "OpticalFrontEnd", "SiPM", "Tia"],
        "ook": ["OokLink"],
        "receivers": ["ReceiverModel"],
    },
)
