"""Ten meshes of objects, made by script; all closed, in mm, below 11 000 faces.

They need the extra `mesh`.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chromagrip.extras import need

Mesh = Any
Array = NDArray[np.float64]


def _trimesh() -> Any:
    return need("trimesh", "mesh")


def ball() -> Mesh:
    """A ball of 5 mm, of 5120 faces."""
    return _trimesh().creation.icosphere(subdivisions=4, radius=5.0)


def ring() -> Mesh:
    """A torus around the axis y, of 10 000 faces."""
    mesh = _trimesh().creation.torus(6.0, 2.0, major_sections=100, minor_sections=50)
    mesh.apply_transform(_trimesh().transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return mesh


def tube() -> Mesh:
    """A short pipe that stands upright."""
    return _trimesh().creation.annulus(r_min=2.0, r_max=4.0, height=6.0)


def capsule() -> Mesh:
    """A rod with round ends along the axis y."""
    mesh = _trimesh().creation.capsule(height=6.0, radius=2.0, count=[64, 64])
    mesh.apply_transform(_trimesh().transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return mesh


def cone() -> Mesh:
    """A cone whose tip points away from the dome."""
    return _trimesh().creation.cone(radius=3.0, height=6.0, sections=128)


def corner() -> Mesh:
    """A cube that stands on a corner."""
    mesh = _trimesh().creation.box(extents=(8.0, 8.0, 8.0))
    mesh.apply_transform(_trimesh().geometry.align_vectors([1, 1, 1], [0, 0, -1]))
    return mesh


def blade() -> Mesh:
    """A wedge whose edge is sharp: 12 long, 6 high, 1 thick at its back."""
    return _trimesh().convex.convex_hull(
        [[s, x, z] for x in (-6.0, 6.0) for s, z in ((0.0, -3.0), (-0.5, 3.0), (0.5, 3.0))]
    )


def pencil() -> Mesh:
    """A hexagonal pencil of 7 mm with a sharpened end."""
    angles = np.arange(6) * np.pi / 3
    rim = np.stack([3.5 * np.cos(angles), 3.5 * np.sin(angles)], axis=1)
    ends = [np.column_stack([rim, np.full(6, z)]) for z in (0.0, 20.0)]
    return _trimesh().convex.convex_hull(np.concatenate([*ends, [[0.0, 0.0, -10.0]]]))


def gear() -> Mesh:
    """A spur wheel of 16 teeth."""
    angles = np.linspace(0.0, 2 * np.pi, 160, endpoint=False)
    radii = 6.0 + 0.7 * np.clip(2.0 * np.sin(16 * angles), -1.0, 1.0)
    return _stack([_ring(angles, radii, z) for z in (-2.0, 2.0)])


def screw() -> Mesh:
    """A rod of 6 mm with a thread of pitch 1.5 mm."""
    angles = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    levels = np.linspace(-6.0, 6.0, 97)
    phases = [(z / 1.5 - angles / (2 * np.pi)) % 1.0 for z in levels]
    radii = [3.0 - 0.9 * np.abs(2.0 * phase - 1.0) for phase in phases]
    return _stack([_ring(angles, r, z) for r, z in zip(radii, levels, strict=True)])


#: By name.
MESHES: dict[str, Callable[[], Mesh]] = {
    made.__name__: made
    for made in (ball, ring, tube, capsule, cone, corner, blade, pencil, gear, screw)
}


def _ring(angles: Array, radii: Array, z: float) -> Array:
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles), 0 * angles + z])


def _stack(rings: list[Array]) -> Mesh:
    """Closed mesh around rings of equally many points, with a point in the middle of each end."""
    n, last = len(rings[0]), len(rings) - 1
    here = np.arange(n)
    after = (here + 1) % n
    ends = [points.mean(axis=0) * [0, 0, 1] for points in (rings[0], rings[-1])]
    vertices = np.concatenate([*rings, ends])
    faces = []
    for k in range(last):
        a, b = k * n, (k + 1) * n
        faces += [np.stack([a + here, a + after, b + after], axis=1)]
        faces += [np.stack([a + here, b + after, b + here], axis=1)]
    low, high = len(vertices) - 2, len(vertices) - 1
    faces += [np.stack([after, here, 0 * here + low], axis=1)]
    faces += [np.stack([last * n + here, last * n + after, 0 * here + high], axis=1)]
    return _trimesh().Trimesh(vertices, np.concatenate(faces))
