"""Wrong uses of all rooms, for mypy: an error that it does not find is an unused ignore."""

from meshtrace.surfaces import FlatSea
from meshtrace.viz import SceneStyle

x: int = FlatSea(height="a").nonsense  # type: ignore[attr-defined]
y: int = SceneStyle().nonsense  # type: ignore[attr-defined]
FlatSea(hieght=1.0)  # type: ignore[call-arg]
