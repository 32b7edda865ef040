"""What the camera sees: ground · Π over layers of (1 − covered·(1 − transmittance)), blurred."""

from .design.sensor import LAYERS, SensorDesign, load_sensor, sensor_names
from .drawing.renderers import RENDERERS, Renderer, open_renderer
from .drawing.truth import GroundTruth, TruthMap
from .flaws.defects import Defects, Flaws
from .flaws.imaging import Imaging, shutter_times
from .flaws.noise import add_noise
from .frame import Frame
from .membrane import Membrane, MembraneMap
from .optics.calibration import camera_text, load_camera, save_camera
from .optics.camera import Camera, FisheyeCamera, PinholeCamera
from .optics.view import View

__all__ = [
    "LAYERS",
    "RENDERERS",
    "Camera",
    "Defects",
    "FisheyeCamera",
    "Flaws",
    "Frame",
    "GroundTruth",
    "Imaging",
    "Membrane",
    "MembraneMap",
    "PinholeCamera",
    "Renderer",
    "SensorDesign",
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
