"""Simulated sensors: the RGB-D camera and the inertial unit."""
