"""Three renderers behind one interface; see `stair_env.camera.renderers.base`."""

from stair_env.camera.renderers.base import Frame, Renderer
from stair_env.camera.renderers.factory import RENDERERS, make_renderer

__all__ = ["RENDERERS", "Frame", "Renderer", "make_renderer"]
