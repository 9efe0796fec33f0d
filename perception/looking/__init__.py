"""Frames of any source measured, and shown with what was measured."""
