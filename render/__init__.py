"""What the camera sees: I = ground · Π over layers of (1 − coverage·(1 − transmittance))."""

from .camera import FisheyeCamera
from .frame import Frame
from .gl import GLMissingError
from .membrane import Membrane, MembraneMap
from .noise import add_noise
from .renderers import RENDERERS, Renderer, open_renderer
from .sensor import LAYERS, SensorDesign, load_sensor, sensor_names

__all__ = [
    "LAYERS",
    "RENDERERS",
    "FisheyeCamera",
    "Frame",
    "GLMissingError",
    "Membrane",
    "MembraneMap",
    "Renderer",
    "SensorDesign",
    "add_noise",
    "load_sensor",
    "open_renderer",
    "sensor_names",
]
