"""Studies of links: many surfaces, times, links and parameters; see `options.StudyOptions`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
