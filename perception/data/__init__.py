"""Labelled RGB-D frames: drawing, reading, writing and augmenting them."""
