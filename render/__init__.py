"""The camera's picture of two layers of coloured markers on a deformed skin.

The light of a pixel is

    light = blur(ground · Π over layers of (1 − covered · (1 − transmittance)))

with the light of the unmarked sensor (`ground`), the share of the pixel that a layer's markers
cover (`covered`), the transmittance of its dye, and the blur of the lens. The skin carries the
markers (`harmonics`, `membrane`) and the camera projects them through the silicone's surface
(`optics`, `outlines`). `design` describes the sensors, `drawing` has the renderers, and `flaws`
turns an ideal image into a real camera's.
"""

from .colour import decode_srgb, decoding_table, encode_srgb, encoding_table
from .design.dials import Defects
from .design.sensor import (
    FILES_NAMED,
    LAYERS,
    CameraSettings,
    Geodesic,
    SensorDesign,
    load_sensor,
    sensor_names,
)
from .dome_map import DomeMap, layer_depths
from .drawing.coverage import edge_width
from .drawing.gl import gl_problem
from .drawing.painter import Painter
from .drawing.renderers import RENDERERS, Renderer, open_renderer
from .drawing.truth import GroundTruth, MarkerTruth, TruthMap, marker_truth
from .flaws.defects import Flaws
from .flaws.imaging import Imaging, shutter_times
from .flaws.noise import add_noise
from .frame import Frame
from .ground import ground_image, inside_rim, pixel_places
from .harmonics import harmonic_map
from .membrane import Membrane, MembraneMap, carried_axes, outline_axes, rest_membrane
from .optics.board import Board, board_picture
from .optics.calibration import camera_text, load_camera, save_camera
from .optics.camera import Camera, FisheyeCamera, PinholeCamera
from .optics.view import View
from .outlines import areas, centroids, outline_points, outlines

__all__ = [
    "FILES_NAMED",
    "LAYERS",
    "RENDERERS",
    "Board",
    "Camera",
    "CameraSettings",
    "Defects",
    "DomeMap",
    "FisheyeCamera",
    "Flaws",
    "Frame",
    "Geodesic",
    "GroundTruth",
    "Imaging",
    "MarkerTruth",
    "Membrane",
    "MembraneMap",
    "Painter",
    "PinholeCamera",
    "Renderer",
    "SensorDesign",
    "TruthMap",
    "View",
    "add_noise",
    "areas",
    "board_picture",
    "camera_text",
    "carried_axes",
    "centroids",
    "decode_srgb",
    "decoding_table",
    "edge_width",
    "encode_srgb",
    "encoding_table",
    "gl_problem",
    "ground_image",
    "harmonic_map",
    "inside_rim",
    "layer_depths",
    "load_camera",
    "load_sensor",
    "marker_truth",
    "open_renderer",
    "outline_axes",
    "outline_points",
    "outlines",
    "pixel_places",
    "rest_membrane",
    "save_camera",
    "sensor_names",
    "shutter_times",
]
