"""Ray-mesh intersection: Embree, and brute force as its reference."""

from meshtrace.engine.bvh.intersectors import BruteForceIntersector as BruteForceIntersector
from meshtrace.engine.bvh.intersectors import EmbreeIntersector as EmbreeIntersector
from meshtrace.engine.bvh.intersectors import Hits as Hits
from meshtrace.engine.bvh.intersectors import Intersector as Intersector
