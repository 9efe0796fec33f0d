"""Bullet, and the arithmetic of the trunk's motion."""
