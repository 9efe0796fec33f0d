"""Stable-Baselines3 policies: training, evaluation, shipped weights."""

from stair_env.common import moved

moved.install(__name__)
