"""The robot's side of everything: sensors in, joint targets out; without torch, Gymnasium and PyBullet."""
