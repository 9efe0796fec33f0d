"""Three renderers behind one interface; see `stair_env.sensors.camera.renderers.base`."""

from stair_env.sensors.camera.renderers.base import Frame, Renderer
from stair_env.sensors.camera.renderers.factory import RENDERERS, make_renderer

__all__ = ["RENDERERS", "Frame", "Renderer", "make_renderer"]
