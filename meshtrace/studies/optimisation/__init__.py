"""Optimisation of a link over common seas, validated on fresh ones."""
