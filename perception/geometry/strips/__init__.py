"""Depth between neighbouring lines: planes fitted to it, which of them are treads, which way the camera hangs."""
