"""From an ideal image to a camera's: light, blur, exposure, noise, mosaic, compression.

In this order; sums and blurs are of linear light. Static defects depend on the seed alone, others
on the seed and the frame's number: frames may be computed in any order.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..colour import decoding_table, encode_srgb
from ..design.dials import Defects
from ..design.sensor import SensorDesign
from .defects import GAIN, NOISE, WHITE_BALANCE
from .lighting import glare_map, light_map

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Image32 = NDArray[np.float32]


#: Level of linear light 1 in 16 bits.
_WHITE = 65535
# OpenCV takes four numbers for a pixel, which its type hints do not know.
_TO_WHITE: Any = (float(_WHITE),) * 4
#: Linear light of each 8-bit sRGB level.
_DECODE = decoding_table().astype(np.float32)
#: 8-bit sRGB level of each 16-bit level of linear light.
_ENCODE = np.rint(encode_srgb(np.linspace(0.0, 1.0, _WHITE + 1))).astype(np.uint8)


class Imaging:
    """Optics, sensor and compression of one camera, made once and used for every frame.

    Parameters
    ----------
    sensor: design
    defects: of its images
    seed: of the run
    """

    def __init__(self, sensor: SensorDesign, defects: Defects, seed: int) -> None:
        d = defects
        self._defects, self._seed = d, seed
        self._map = light_map(sensor, d, seed)
        self._glare = glare_map(sensor, d, seed)
        full_well = 1e4  # full well where only read noise is set [electrons]
        well = d.shot_noise_electrons or full_well
        self._shot = 1.0 / well if d.shot_noise_electrons else 0.0
        self._read = d.read_noise_electrons / well
        self._gains = bool(d.gain_step or d.white_balance_drift)
        self._noise = bool(self._shot or self._read)
        static = self._map is not None or self._glare is not None
        self._linear = bool(static or d.defocus_px or self._gains or self._noise or d.bayer)

    def measured(self, exposures: Image | Sequence[Image], index: int) -> Image:
        """Image that the sensor reads out; the ideal image itself where no defect is set.

        Parameters
        ----------
        exposures: ideal sRGB image (H, W, 3), or those of an open shutter, see `shutter_times`
        index: of the frame, 0 or more
        """
        images = [exposures] if isinstance(exposures, np.ndarray) else list(exposures)
        image = images[0]
        if self._linear or len(images) > 1:
            image = self._measure(self._light(images), index)
        return image

    def compressed(self, image: Image) -> Image:
        """Image as the camera sends it, its noise included; itself where nothing compresses it."""
        if self._defects.jpeg_quality:
            image = through_jpeg(image, self._defects.jpeg_quality)
        if self._defects.h264_crf:
            image = through_h264([image], self._defects.h264_crf)[0]
        return image

    def _light(self, images: list[Image]) -> Image32:
        """Linear light that reaches the sensor."""
        light: Any = cv2.LUT(images[0], _DECODE)
        for image in images[1:]:
            light += cv2.LUT(image, _DECODE)
        if len(images) > 1:
            light *= np.float32(1.0 / len(images))
        if self._map is not None:
            light *= self._map
        if self._glare is not None:
            light += self._glare
        if self._defects.defocus_px:
            light = cv2.GaussianBlur(light, (0, 0), self._defects.defocus_px)
        return light

    def _measure(self, light: Image32, index: int) -> Image:
        """Image that the sensor reads out of that light, sRGB."""
        if self._gains:
            red, blue = white_balance(self._defects, self._seed, index)
            gain = exposure(self._defects, self._seed, index)
            gains: Any = (gain * red, gain, gain * blue, 1.0)
            light = np.asarray(cv2.multiply(light, gains))
        if self._defects.bayer:
            light = mosaic(light)
        if self._noise:
            # Poisson's numbers are normal from some ten electrons on, and these are quick.
            rng = np.random.Generator(np.random.SFC64([self._seed, index, NOISE]))
            noise = rng.standard_normal(light.shape, dtype=np.float32)
            noise *= cv2.sqrt(light * np.float32(self._shot) + np.float32(self._read**2))
            light = light + noise
        # Rounded, and cut off where the well is full.
        raw: Any = cv2.multiply(light, _TO_WHITE, dtype=cv2.CV_16U)
        if self._defects.bayer:
            raw = cv2.demosaicing(raw, cv2.COLOR_BayerRGGB2RGB)
        return np.asarray(cv2.LUT(raw, _ENCODE))


def shutter_times(defects: Defects, period: float) -> Array:
    """Instants whose images make up a frame's, before the frame's time [s].

    The shutter closes at the frame's time, so that no later state is needed.

    Parameters
    ----------
    defects: `motion_blur` is the share of the period that the shutter is open
    period: of the frames [s]
    """
    if not defects.motion_blur:
        return np.zeros(1)
    exposures = 5  # instants at which an open shutter is sampled
    # Spread a little wider than evenly, so that their variance is that of every instant, 1/12.
    middle = (np.arange(exposures) + 0.5) / exposures - 0.5
    middle /= np.sqrt(1.0 - exposures**-2)
    return defects.motion_blur * period * (middle - 0.5)


def white_balance(defects: Defects, seed: int, index: int) -> tuple[float, float]:
    """Gains of red and blue in a frame: their ratio is 1 on average."""
    place, frame = divmod(index, defects.drift_frames)
    share = frame / defects.drift_frames
    before, after = (
        np.random.default_rng([seed, place + i, WHITE_BALANCE]).uniform(-1.0, 1.0) for i in (0, 1)
    )
    drift = before + (after - before) * share**2 * (3.0 - 2.0 * share)
    red = float(np.sqrt(1.0 + defects.white_balance_drift * drift))
    return red, 1.0 / red


def exposure(defects: Defects, seed: int, index: int) -> float:
    """Gain of a frame: one jump in each span of `gain_step_frames`, up and down in turn."""
    span, frame = divmod(index, defects.gain_step_frames)
    jump = np.random.default_rng([seed, span, GAIN]).integers(defects.gain_step_frames)
    first = np.random.default_rng([seed, GAIN]).integers(2)
    jumps = span + int(frame >= jump) + int(first)
    return 1.0 + defects.gain_step * (0.5 if jumps % 2 else -0.5)


def mosaic(light: Image32) -> Image32:
    """The one colour that each pixel measures: rows of red and green, of green and blue."""
    raw = light[..., 1].copy()
    raw[::2, ::2] = light[::2, ::2, 0]
    raw[1::2, 1::2] = light[1::2, 1::2, 2]
    return raw


def through_jpeg(image: Image, quality: int) -> Image:
    """Image after JPEG in 4:2:2."""
    half = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, half]
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    decoded: Any = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB))


def through_h264(images: Sequence[Image], crf: int) -> list[Image]:
    """Images after H.264 in 4:2:0, as one stream; all of one shape."""
    import av

    height, width = images[0].shape[:2]
    encoder = av.CodecContext.create("libx264", "w")
    # Chroma is stored for two by two pixels.
    encoder.width, encoder.height = width + width % 2, height + height % 2
    encoder.pix_fmt, encoder.time_base = "yuv420p", Fraction(1, 25)
    # More than one thread would cut the picture into as many slices as there are cores.
    encoder.options = {"crf": str(crf), "preset": "veryfast", "tune": "zerolatency", "threads": "1"}
    packets = []
    for i, image in enumerate(images):
        even: Any = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
        frame = av.VideoFrame.from_ndarray(even, format="rgb24")
        frame.pts = i
        packets += encoder.encode(frame)
    packets += encoder.encode(None)
    decoder = av.CodecContext.create("h264", "r")
    frames = [frame for packet in packets for frame in decoder.decode(packet)]
    frames += decoder.decode(None)
    return [np.asarray(f.to_ndarray(format="rgb24")[:height, :width]) for f in frames]
