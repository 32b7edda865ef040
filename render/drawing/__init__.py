"""Renderers, their common model of pixel coverage, and the labels of their images.

`painter` is the default, `mesh_renderer` draws with OpenGL, `supersampled` is the slow reference.
"""

from .coverage import (
    APART,
    EDGE_RANGE,
    covered_by_both,
    covered_slope,
    crossing,
    edge,
    edge_slope,
    edge_width,
    odds_ratio,
    shared_coverage,
    signed_distance,
    togetherness,
)
from .gl import MEND, gl_problem
from .mesh_renderer import MeshRenderer
from .painter import Painter
from .supersampled import polygon_centroids, projected_outlines, supersampled_image

__all__ = [
    "APART",
    "EDGE_RANGE",
    "MEND",
    "MeshRenderer",
    "Painter",
    "covered_by_both",
    "covered_slope",
    "crossing",
    "edge",
    "edge_slope",
    "edge_width",
    "gl_problem",
    "odds_ratio",
    "polygon_centroids",
    "projected_outlines",
    "shared_coverage",
    "signed_distance",
    "supersampled_image",
    "togetherness",
]
