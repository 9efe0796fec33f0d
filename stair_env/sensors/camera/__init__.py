"""Simulated Intel RealSense D435i: intrinsics, renderers, error models, sensor."""
