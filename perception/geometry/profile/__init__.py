"""Depth over the whole image as one cross-section: where it bends and where it jumps."""
