"""Sensitivities: derivatives of a link's quantities by its parameters, with common chains."""
