"""Estimators of the light through water and surface; kernels stand beside their drivers."""
