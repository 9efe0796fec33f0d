"""Gymnasium stair climbing for legged robots with a simulated RealSense D435i."""
