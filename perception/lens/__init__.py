"""Cameras that are no pinholes: calibration files, distortion, depth moved into another camera."""
