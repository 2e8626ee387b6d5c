"""Photons followed one by one: analog, or joined to the receivers at every event."""
