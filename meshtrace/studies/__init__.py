"""Studies of links: many surfaces, times, links and parameters; see `options.StudyOptions`."""

from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
