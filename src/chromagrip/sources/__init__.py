"""Frames from cameras, files, pipes, bags, and sources of one's own.

source = open_source("camera:0(fps=60, width=640, height=480)")
for frame in source.frames():
frame.image, frame.time
"""

from .open import open_source
from .pipe import pipe_bytes
from .source import SOURCES, FrameSource, NoSourceError, Source

__all__ = ["SOURCES", "FrameSource", "NoSourceError", "Source", "open_source", "pipe_bytes"]
