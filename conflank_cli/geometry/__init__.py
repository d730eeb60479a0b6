"""Surfaces, footpoints, swept gaps and screening: the geometry under all stages."""
