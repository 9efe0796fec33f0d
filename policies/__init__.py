"""Stable-Baselines3 policies: training, evaluation, shipped weights."""
