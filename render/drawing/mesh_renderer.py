"""The mesh renderer: both layers as triangles through OpenGL (pyrender).

pyrender has no fisheye, its alpha is not subtractive and its shader relights colours. So vertices
are projected here, and each layer is drawn alone, orthographically, flat, opaque and white on
black: this is the layer's coverage. Transmittances are multiplied before the blur of the lens.
"""

from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...extras import need, require
from ..colour import encoding_table
from ..design.sensor import SensorDesign
from ..ground import ground_image
from ..membrane import Membrane, rest_membrane
from ..outlines import outline_points, outlines
from .gl import MEND, gl_problem, prepare
from .paint_kernels import encode

#: Corners of a disc; its area is short of the circle's by 0.2 %.
CORNERS = 48
#: Pixels drawn for one of the image along each side: multisampling alone has too few levels.
OVERSAMPLING = 4


class MeshRenderer:
    """Draws each marker as a projected polygon mesh.

    Parameters
    ----------
    sensor: design of the sensor
    oversampling: drawn pixels per image pixel along each side

    Raises
    ------
    UserError
        When no off-screen OpenGL context can be opened.
    """

    #: Pixels on which the lens' blur is computed, for one of the image along each side.
    _fine = 2

    def __init__(self, sensor: SensorDesign, oversampling: int = OVERSAMPLING) -> None:
        require("gl")  # the probe would not name what installs it
        problem = gl_problem()
        if problem is not None:
            raise UserError(f"renderer pyrender cannot run here: {problem}; mend: {MEND}")
        prepare()
        pyrender = need("pyrender", "gl")  # fails without libGL even where it is not used

        self._pyrender = pyrender
        self._view = sensor.view
        self._dyes = sensor.transmittance
        # Width over which edges fade [px]: samples follow a ramp far better than a step. The fade
        # is part of the lens' blur; the rest of it is added to the picture. A wider fade would
        # absorb too much light where both layers' edges coincide, because each layer fades by
        # itself.
        fade_px = 0.2
        # A step faded linearly over w has the variance w²/12 of a box.
        fade = min(fade_px, 3.0 * sensor.camera.blur_px)
        self._blur = self._fine * float(np.sqrt(sensor.camera.blur_px**2 - fade**2 / 12.0))
        half = fade / 2 / _mean_half(sensor)
        self._ground = ground_image(sensor)
        self._encoding = encoding_table()
        count = len(sensor.places)
        circle = _outline(sensor.markers.form)
        # Of each disc: corners of the white core, black corners of the fade around it, the centre.
        self._outline = np.concatenate([(1 - half) * circle, (1 + half) * circle, np.zeros((1, 2))])
        inner = np.arange(CORNERS)
        after = np.roll(inner, -1)
        fan = np.stack([np.full(CORNERS, 2 * CORNERS), inner, after], axis=1)
        ring = [[inner, inner + CORNERS, after], [after, inner + CORNERS, after + CORNERS]]
        disc = np.concatenate([fan, *(np.stack(part, axis=1) for part in ring)])
        corners = 2 * CORNERS + 1
        self._faces = (disc + corners * np.arange(count)[:, None, None]).reshape(-1, 3)
        white = np.ones((corners, 4), dtype=np.float32)
        white[CORNERS:-1, :3] = 0.0
        self._colours = np.tile(white, (count, 1))
        width, height = self._view.width, self._view.height
        self._scene = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 1.0])
        camera = pyrender.OrthographicCamera(xmag=width / 2, ymag=height / 2, znear=0.1, zfar=10.0)
        pose = np.eye(4)
        pose[2, 3] = 1.0
        self._scene.add(camera, pose=pose)
        self._renderer = pyrender.OffscreenRenderer(oversampling * width, oversampling * height)
        # pyrender ends the display together with a context, but others of the process share it.
        platform = self._renderer._platform
        if hasattr(platform, "_egl_context"):
            end = need("OpenGL.EGL", "gl").eglDestroyContext
            platform.delete_context = partial(end, platform._egl_display, platform._egl_context)

    def render(self, membrane: Membrane) -> NDArray[np.uint8]:
        """Noise-free sRGB image of the membrane, shape (H, W, 3)."""
        pixels = self._view.project(outline_points(membrane, self._outline))
        magenta, yellow = (self._coverage(layer.reshape(-1, 2)) for layer in pixels)
        # Light passes both dyes before the lens blurs it and pixels collect it.
        both = magenta * yellow
        first, second = (1.0 - self._dyes).astype(np.float32)
        absorbed = [first, second, -first * second]
        parts = (self._collected(plane) for plane in (magenta, yellow, both))
        light = 1.0 - sum(p[:, :, None] * a for p, a in zip(parts, absorbed, strict=True))
        linear = self._ground * light
        image = np.empty(linear.shape, dtype=np.uint8)
        encode(linear, self._encoding, image)
        return image

    def _collected(self, plane: NDArray[np.float32]) -> NDArray[np.float32]:
        """Blur an image of finer pixels, and average it over each pixel, shape (H, W)."""
        size = (self._view.width, self._view.height)
        fine = (self._fine * size[0], self._fine * size[1])
        fewer = cv2.resize(plane, fine, interpolation=cv2.INTER_AREA)
        blurred = cv2.GaussianBlur(fewer, (0, 0), self._blur)
        return np.asarray(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA))

    def _coverage(self, pixels: NDArray[np.float64]) -> NDArray[np.float32]:
        """Draw a layer with vertices at `pixels`; return the coverage 0…1 of the finer pixels."""
        # OpenGL's y runs upwards, and its pixel edges, not centres, lie at integers.
        width, height = self._view.width, self._view.height
        vertices = np.column_stack(
            [
                pixels[:, 0] + 0.5 - width / 2,
                height / 2 - pixels[:, 1] - 0.5,
                np.zeros(len(pixels)),
            ]
        )
        white = self._pyrender.MetallicRoughnessMaterial(
            baseColorFactor=[1.0, 1.0, 1.0, 1.0], doubleSided=True
        )
        primitive = self._pyrender.Primitive(
            positions=vertices.astype(np.float32),
            color_0=self._colours,
            indices=self._faces,
            material=white,
        )
        # Changing a primitive's positions is silently ignored: replace the mesh.
        node = self._scene.add(self._pyrender.Mesh([primitive]))
        colour, _ = self._renderer.render(self._scene, flags=self._pyrender.RenderFlags.FLAT)
        self._scene.remove_node(node)
        return np.asarray(colour[:, :, 0].astype(np.float32) / 255.0)

    def close(self) -> None:
        """Release the OpenGL context."""
        self._renderer.delete()


def _outline(form: str) -> NDArray[np.float64]:
    """Corners of a marker's outline in its own coordinates, shape (CORNERS, 2)."""
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return circle if form == "disc" else circle / abs(circle).max(axis=-1, keepdims=True)


def _mean_half(sensor: SensorDesign) -> float:
    """Mean half size of the resting markers in the image [px]."""
    axes = outlines(rest_membrane(sensor), sensor.view)[:, :, 1:3]
    return float(np.sqrt(abs(np.linalg.det(axes))).mean())
