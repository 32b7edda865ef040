"""What the camera sees: ground · Π over layers of (1 − covered·(1 − transmittance)), blurred."""

from .calibration import CalibrationError, camera_text, load_camera, save_camera
from .camera import Camera, FisheyeCamera, PinholeCamera
from .defects import Defects, Flaws
from .frame import Frame
from .gl import GLMissingError
from .imaging import Imaging, shutter_times
from .membrane import Membrane, MembraneMap
from .noise import add_noise
from .renderers import RENDERERS, Renderer, open_renderer
from .sensor import LAYERS, SensorDesign, SensorError, load_sensor, sensor_names
from .truth import GroundTruth, TruthMap
from .view import View

__all__ = [
    "LAYERS",
    "RENDERERS",
    "CalibrationError",
    "Camera",
    "Defects",
    "FisheyeCamera",
    "Flaws",
    "Frame",
    "GLMissingError",
    "GroundTruth",
    "Imaging",
    "Membrane",
    "MembraneMap",
    "PinholeCamera",
    "Renderer",
    "SensorDesign",
    "SensorError",
    "TruthMap",
    "View",
    "add_noise",
    "camera_text",
    "load_camera",
    "load_sensor",
    "open_renderer",
    "save_camera",
    "sensor_names",
    "shutter_times",
]
