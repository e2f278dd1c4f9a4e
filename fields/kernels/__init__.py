"""Compiled loops of this package. Modules here import numba, and are imported on use."""
