"""Depth by matching a rendered infrared pair, as an active stereo camera does; see `stair_env.camera.stereo.sensor`."""

from stair_env.camera.stereo.config import StereoConfig
from stair_env.camera.stereo.sensor import StereoDepth

__all__ = ["StereoConfig", "StereoDepth"]
