"""Description of an optical link: water, bubbles, sources, receivers and physics."""

from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
