"""StairNetV2 and the geometry that turns its lines into steps."""

from stair_env.common import moved

moved.install(__name__)
