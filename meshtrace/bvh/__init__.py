"""Ray-mesh intersection: Embree, and brute force as its reference."""

from meshtrace.bvh.intersectors import BruteForceIntersector as BruteForceIntersector
from meshtrace.bvh.intersectors import EmbreeIntersector as EmbreeIntersector
from meshtrace.bvh.intersectors import Hits as Hits
from meshtrace.bvh.intersectors import Intersector as Intersector
