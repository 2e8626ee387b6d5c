"""What all tracers share as compiled functions: vectors, random numbers, medium, facets, scene."""
