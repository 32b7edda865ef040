"""Triangle meshes as shapes: read, mended where that is safe, and turned into a distance grid."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UserError, located
from ...extras import need
from ...kept_arrays import content_key, keep, kept
from ..checks import finite
from ..kernels.dome.distance_kernels import GRID
from .mesh_grid import spline_grid
from .shape import Shape, make_shape, moved

Array = NDArray[np.float64]

# trimesh writes its reasons, with tracebacks, where nobody listens; our own sentence says why.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

#: Folder of the user's cache; its grids are made anew when the version changes.
KIND = "meshes"
VERSION = "mesh grid 2"
#: More faces are refused.
MOST_FACES = 500_000


def mesh(
    source: str | Path | Any,
    *,
    scale: float = 1.0,
    rotation: ArrayLike | None = None,
    cells: int = 96,
    centred: bool = False,
) -> Shape:
    """Shape of a triangle mesh, with the origin of its file.

    Its signed distance is a cubic spline on a grid, so that the normal is smooth; edges are rounded
    by about a cell, which is the longest side over `cells`. The grid is kept in the user's cache by
    the mesh's content. `Shape.notes` says what was mended.

    Parameters
    ----------
    source: a file that trimesh reads (STL, OBJ, PLY, OFF …), or a `trimesh.Trimesh`
    scale: metres in a unit of the mesh: 1e-3 for a file in mm
    rotation: (3, 3) from the mesh's axes to the shape's; by default they are the same
    cells: of the grid along the longest side
    centred: whether the origin is the middle of its turned box, instead of the file's

    Raises
    ------
    UserError
        When the extra `mesh` is missing, the file is no mesh, or the mesh bounds no body, is far
        too fine, or has an absurd size.
    """
    trimesh = need("trimesh", "mesh")
    igl = need("igl", "mesh")
    finite("scale of a mesh", scale, "m", above=0.0)
    fewest = 16  # fewest and most cells along the longest side
    most = 256
    if cells != int(cells) or not fewest <= cells <= most:
        text = f"an integer in {fewest}…{most}, got {cells!r}"
        raise UserError(f"cells of a mesh must be {text}")
    turn = _rotation(rotation)
    path = Path(source) if isinstance(source, str | Path) else None
    if path is None and not hasattr(source, "vertices"):
        raise UserError(f"a mesh is a file or a trimesh.Trimesh, not {source!r}")
    given: Any = source
    with located("mesh" if path is None else f"mesh {path}"):
        read = given.copy() if path is None else _read(trimesh, path)
        vertices, faces = np.asarray(read.vertices, float), np.asarray(read.faces, np.int64)
        _check(vertices, faces, scale)
        pose = np.array([scale, int(cells), *turn.ravel()])
        key = content_key(VERSION, vertices, faces, pose)
        found = _kept_shape(key)
        if found is None:
            notes = _mend(trimesh, read)
            _check_body(igl, read)
            found = _shape(igl, read, scale, turn, int(cells), notes)
            _keep_shape(key, *found)
    shape, middle = found
    shape = replace(shape, name="mesh" if path is None else path.name)
    return shape if centred else moved(shape, middle)


def _rotation(rotation: ArrayLike | None) -> Array:
    turn = np.eye(3) if rotation is None else np.asarray(rotation, float)
    if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6):
        raise UserError("rotation of a mesh must be a 3 × 3 matrix of orthogonal unit vectors")
    if np.linalg.det(turn) < 0.0:
        raise UserError("rotation of a mesh must not mirror it; its determinant must be 1")
    return turn


def _read(trimesh: Any, path: Path) -> Any:
    """Mesh of a file, several bodies of it put together."""
    if not path.is_file():
        raise UserError("it is a folder" if path.is_dir() else "there is no such file")
    kinds = sorted(trimesh.available_formats())
    if path.suffix[1:].lower() not in kinds:
        raise UserError(f"no mesh file ends in {path.suffix!r}; formats are {', '.join(kinds)}")
    try:
        with np.errstate(all="ignore"):  # absurd numbers are refused afterwards
            return trimesh.load(path, force="mesh")
    except Exception as error:  # each format has errors of its own
        raise UserError(f"it cannot be read as a triangle mesh: {error}") from None


def _check(vertices: Array, faces: NDArray[np.int64], scale: float) -> None:
    """Refuse what is no mesh of a sensible fineness and size."""
    if not len(faces):
        raise UserError("it has no triangles")
    if len(faces) > MOST_FACES:
        raise UserError(
            f"it has {len(faces)} faces, more than {MOST_FACES}; simplify it, as by "
            "trimesh's simplify_quadric_decimation"
        )
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        raise UserError(f"its triangles name vertices that are not among its {len(vertices)}")
    if vertices.shape[1:] != (3,) or not (abs(vertices) < 1e12).all():
        raise UserError("its vertices must be finite numbers, three of each")
    sides = np.ptp(vertices[np.unique(faces)], axis=0)
    longest = float(sides.max()) * scale
    smallest = 0.5e-3  # smallest and largest of a mesh's longest side [m]
    largest = 0.5
    if not smallest <= longest <= largest:
        allowed = f"{smallest * 1e3:g}…{largest * 1e3:g} mm"
        raise UserError(
            f"its longest side is {longest * 1e3:.4g} mm at the scale {scale:g}, must lie in "
            f"{allowed}; give the unit of the file: `scale` in m, or object.mesh_unit_mm of a scene"
        )
    middled = vertices - vertices.mean(axis=0)
    spread = np.linalg.svd(middled.T @ middled, compute_uv=False)
    if spread[2] < 1e-12 * spread[0]:
        raise UserError("all its points lie in a plane, so that it bounds no body")


def _mend(trimesh: Any, mesh: Any) -> tuple[str, ...]:
    """Mend a mesh in its place; one sentence about each thing that was wrong.

    Raises
    ------
    UserError
        When it stays open.
    """
    notes = []
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    before = len(mesh.faces)
    mesh.update_faces(mesh.unique_faces() & mesh.nondegenerate_faces(height=0.0))
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) < before:
        notes.append(f"{before - len(mesh.faces)} doubled or empty faces were left out")
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
        notes.append("faces that looked the other way than their neighbours were turned")
    if not mesh.is_watertight:
        before = len(mesh.faces)
        trimesh.repair.fill_holes(mesh, use_fan=True)
        if not mesh.is_watertight:
            count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)[1]
            raise UserError(
                f"it is not closed and could not be mended: {int((count != 2).sum())} of its "
                f"{len(count)} edges do not have two faces; close it in a mesh editor"
            )
        notes.append(f"holes were closed with {len(mesh.faces) - before} flat faces")
    if mesh.volume < 0.0:
        mesh.invert()
        notes.append("it was inside out and was turned")
    return tuple(notes)


def _check_body(igl: Any, mesh: Any) -> None:
    """Refuse faces that have not the body behind them and nothing in front, as where parts overlap.

    Raises
    ------
    UserError
        When they are too many.
    """
    vertices, faces = _arrays(mesh)
    sides = np.ptp(vertices, axis=0)
    if mesh.volume <= 1e-9 * float(sides.max()) ** 3:
        raise UserError("it encloses no volume")
    tested = 2000  # faces on whose two sides it is tested what is inside
    some = np.unique(np.linspace(0, len(faces) - 1, tested).astype(int))
    corners = vertices[faces[some]]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    step = 1e-3 * np.minimum(np.sqrt(length), sides.max() / 100.0) * across / length
    middle = corners.mean(axis=1)
    inside = igl.fast_winding_number(vertices, faces, np.ascontiguousarray(middle - step))
    outside = igl.fast_winding_number(vertices, faces, np.ascontiguousarray(middle + step))
    wrong = (np.abs(inside - 1.0) > 0.4) | (np.abs(outside) > 0.4)
    most_wrong = 0.02  # largest share of them that may be wrong
    if wrong.mean() > most_wrong:
        raise UserError(
            f"{100.0 * wrong.mean():.0f} % of its faces do not bound one body: parts of it overlap "
            "or are inside out; unite them in a mesh editor"
        )


def _shape(
    igl: Any, mesh: Any, scale: float, turn: Array, cells: int, notes: tuple[str, ...]
) -> tuple[Shape, Array]:
    """Shape of a mended mesh around the middle of its box, and that middle in its axes [m], (3,).

    What is kept of it is in single precision, and so it is here.
    """
    from scipy.spatial import ConvexHull

    vertices, faces = _arrays(mesh)
    points = vertices @ turn.T * scale
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    points -= middle
    sides = np.ptp(points, axis=0)
    cell = float(sides.max()) / cells
    grid = spline_grid(igl, np.ascontiguousarray(points / cell), faces, cells) * cell
    corners = points[np.sort(ConvexHull(points).vertices)]
    thin = 3.0  # a mesh thinner than this has details that its grid does not show [cells]
    if sides.min() < thin * cell:
        thick = f"{sides.min() / cell:.2g} cells of {cell * 1e3:.2g} mm"
        notes = (*notes, f"its thinnest side is only {thick}; more cells show it better")
    shape = make_shape(
        "mesh",
        GRID,
        grid=grid.astype(np.float32),
        origin=-(np.array(grid.shape) - 1) / 2.0 * cell,
        cells=1.0 / cell,
        bounds=[points.min(axis=0), points.max(axis=0)],
        corners=corners,
        notes=notes,
    )
    return shape, middle


def _arrays(mesh: Any) -> tuple[Array, NDArray[np.int64]]:
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64)
    return vertices, np.ascontiguousarray(mesh.faces, dtype=np.int64)


def _keep_shape(key: str, shape: Shape, middle: Array) -> None:
    keep(
        KIND,
        key,
        {
            "grid": shape.grid.astype(np.float32),
            "origin": shape.origin,
            "cells": np.array(shape.cells),
            "bounds": shape.bounds,
            "corners": shape.corners,
            "middle": middle,
            "notes": np.array(shape.notes, dtype=str),
        },
    )


def _kept_shape(key: str) -> tuple[Shape, Array] | None:
    found = kept(KIND, key)
    if found is None:
        return None
    try:
        notes = tuple(str(note) for note in found["notes"])
        arrays = {name: found[name] for name in ("grid", "origin", "bounds", "corners")}
        shape = make_shape("mesh", GRID, cells=float(found["cells"]), notes=notes, **arrays)
        return shape, np.asarray(found["middle"], float)
    except (KeyError, ValueError, TypeError):  # not one of ours
        return None
