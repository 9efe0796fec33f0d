"""Evaluation of policies on paired flights."""
