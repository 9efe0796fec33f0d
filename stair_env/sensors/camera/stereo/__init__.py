"""Depth by matching a rendered infrared pair, as an active stereo camera does."""

from stair_env.sensors.camera.stereo.config import StereoConfig
from stair_env.sensors.camera.stereo.stereo_depth import StereoDepth

__all__ = ["StereoConfig", "StereoDepth"]
