"""Name by which programs that write into a pipe import `pipe_bytes`."""

from ..sources.pipe import pipe_bytes

__all__ = ["pipe_bytes"]
