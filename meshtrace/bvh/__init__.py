"""Ray-mesh intersection: Embree, and brute force as its reference."""

from meshtrace.bvh.intersectors import (
    BruteForceIntersector,
    EmbreeIntersector,
    Hits,
    Intersector,
)

__all__ = ["BruteForceIntersector", "EmbreeIntersector", "Hits", "Intersector"]
