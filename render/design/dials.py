"""Defects of a real sensor, as settings."""

from typing import Annotated

from msgspec import Meta

from ...strict_toml import Table

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Electrons = Annotated[float, Meta(ge=0.0, le=1e6)]
Blur = Annotated[float, Meta(ge=0.0, le=20.0)]
Half = Annotated[float, Meta(ge=0.0, le=0.5)]
Frames = Annotated[int, Meta(ge=1, le=10**6)]
Offset = Annotated[float, Meta(ge=0.0, le=2.0)]
Width = Annotated[float, Meta(ge=0.0, le=10.0)]
Few = Annotated[int, Meta(ge=0, le=100)]


class Defects(Table, frozen=True):
    """Defects of a real sensor's images; all are off by default.

    Faded markers are not possible, because a renderer has one dye per layer.

    Attributes
    ----------
    shot_noise_electrons: full well, the electrons of linear light 1; fewer are noisier, 0: off
    read_noise_electrons: standard deviation, for the full well above or one of 10 000 [electrons]
    vignette: share of light lost in the image's farthest corner; grows with the square of distance
    uneven_leds: largest deviation of the skin's illumination from its mean
    defocus_px: standard deviation of a blur in addition to the lens' own [px]
    motion_blur: share of the frame's period in which the shutter is open
    white_balance_drift: largest deviation of red over blue from its mean
    drift_frames: time in which the white balance drifts from one value to the next [frames]
    gain_step: relative size of exposure jumps, up and down in turn around the nominal exposure
    gain_step_frames: mean time between jumps [frames]
    bayer: whether each pixel measures one colour, RGGB, and the others are interpolated
    jpeg_quality: 1…100 as in libjpeg, in 4:2:2 as cameras send it; 0: off
    h264_crf: 1…51 as in x264, in 4:2:0, each frame by itself; 0: off
    dust: number of specks on the skin's image
    specular: number of LEDs that the silicone mirrors
    missing_markers: share of each layer's markers that are missing
    worn_markers: share of the outer layer's markers that are rubbed off, in a patch with a ragged
        edge around the middle, where the sensor touches
    seam_tint: strength of the tint of the gores' seams (the design's seams, or four)
    misalignment_mm: shift of the yellow layer along the skin, and largest shift at the rim by a
        turn [mm]
    misplacement_mm: standard deviation of each marker's place, along each direction of the skin
        [mm]
    crookedness_mm: standard deviation of the place of a pair, common to both its markers [mm]
    gore_misalignment_mm: largest shift of the yellow layer along the skin in a gore [mm]; each gore
        has its own direction and size
    rubbed_markers: share of each layer's markers that are partly rubbed off
    seam_width_mm: largest width of the gores' seams [mm]; 0: the design's
    seam_wander_mm: distance of a seam from its half plane, and of its bends [mm]
    seam_gaps: share of a seam's length that is invisible
    glow: additional light in the middle; light above white is clipped
    blotches: contrast of bluish and brownish clouds, as a share of the light
    grain: standard deviation of a fine structure of the skin, as a share of the light
    threads: number of hairs and threads of glue
    """

    shot_noise_electrons: Electrons = 0.0
    read_noise_electrons: Electrons = 0.0
    vignette: Share = 0.0
    uneven_leds: Share = 0.0
    defocus_px: Blur = 0.0
    motion_blur: Share = 0.0
    white_balance_drift: Half = 0.0
    drift_frames: Frames = 500
    gain_step: Share = 0.0
    gain_step_frames: Frames = 200
    bayer: bool = False
    jpeg_quality: Annotated[int, Meta(ge=0, le=100)] = 0
    h264_crf: Annotated[int, Meta(ge=0, le=51)] = 0
    dust: Annotated[int, Meta(ge=0, le=1000)] = 0
    specular: Annotated[int, Meta(ge=0, le=100)] = 0
    missing_markers: Share = 0.0
    worn_markers: Share = 0.0
    seam_tint: Share = 0.0
    misalignment_mm: Offset = 0.0
    misplacement_mm: Offset = 0.0
    crookedness_mm: Offset = 0.0
    gore_misalignment_mm: Offset = 0.0
    rubbed_markers: Share = 0.0
    seam_width_mm: Width = 0.0
    seam_wander_mm: Width = 0.0
    seam_gaps: Share = 0.0
    glow: Share = 0.0
    blotches: Half = 0.0
    grain: Half = 0.0
    threads: Few = 0
