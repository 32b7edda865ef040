"""Triangle meshes as distance grids: against formulas, what is mended and what is refused."""

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.model import meshes
from chromagrip import kept_arrays
from chromagrip.errors import UserError
from chromagrip.model import Dome, Solid, press_and_move, shapes, simulate_contact

igl = pytest.importorskip("igl")
trimesh = pytest.importorskip("trimesh")

#: Meshes of these tests are in mm, and told from the middle of their box.
mesh_shape = partial(shapes.mesh, scale=1e-3, centred=True)


@pytest.fixture(autouse=True)
def no_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Folder of kept grids, which is empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache/chromagrip/meshes"


def near(mesh, spread: float, count: int = 1500) -> np.ndarray:
    """Points around the surface of a mesh in mm, in the shape's frame [m]."""
    places, _ = trimesh.sample.sample_surface(mesh, count, seed=1)
    noise = np.random.default_rng(1).uniform(-spread, spread, places.shape)
    return (places - mesh.bounds.mean(axis=0)) * 1e-3 + noise


@pytest.mark.parametrize("name", meshes.MESHES)
def test_distances_and_signs_of_ten_meshes(name: str) -> None:
    mesh = meshes.MESHES[name]()
    shape = mesh_shape(mesh, cells=40)
    assert shape.notes == ()
    p = near(mesh, 1.5 / shape.cells)
    vertices = (mesh.vertices - mesh.bounds.mean(axis=0)) * shape.cells * 1e-3
    faces = np.asarray(mesh.faces, np.int64)
    exact = igl.signed_distance(
        p * shape.cells, vertices, faces, sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    )[0]
    gap, normal = shapes.distances(shape, p)
    error = gap * shape.cells - exact  # in cells; edges are rounded
    assert np.median(np.abs(error)) < 0.05
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.abs(error).max() < 0.7
    inside = igl.winding_number(vertices, faces, p[:300] * shape.cells) > 0.5
    sure = np.abs(exact[:300]) > 0.5
    np.testing.assert_array_equal((gap[:300] < 0.0)[sure], inside[sure])
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)


def test_a_fine_mesh_is_the_ring_it_was_made_of() -> None:
    mesh = meshes.ring()
    p = near(mesh, 0.2e-3)
    gap, normal = shapes.distances(mesh_shape(mesh), p)
    exact, direction = shapes.distances(shapes.torus(6e-3, 2e-3), p)
    assert np.abs(gap - exact).max() < 16e-6
    assert np.linalg.norm(normal - direction, axis=1).max() < 0.1


def test_the_normal_is_the_slope_and_does_not_jump() -> None:
    shape = mesh_shape(meshes.screw(), cells=48)
    start = np.array([2.2e-3, 0.3e-3, -5e-3])
    line = start + np.linspace(0.0, 1.0, 20001)[:, None] * np.array([1e-3, 1e-3, 9e-3])
    gap, normal = shapes.distances(shape, line)
    slope = np.diff(gap) / 9.11e-3 * 20000
    along = (normal[1:] + normal[:-1]) / 2 @ np.array([1.0, 1.0, 9.0]) / np.sqrt(83.0)
    sure = np.abs(along) > 0.3
    np.testing.assert_array_equal(np.sign(slope[sure]), np.sign(along[sure]))
    assert np.linalg.norm(np.diff(normal, axis=0), axis=1).max() < 0.03  # a step is 0.5 µm


def test_beyond_its_grid_a_mesh_tells_a_lower_bound() -> None:
    shape = mesh_shape(meshes.ball(), cells=32)
    p = np.random.default_rng(2).uniform(-0.1, 0.1, (2000, 3))
    p = p[np.abs(p).max(axis=1) > 7e-3]
    gap, normal = shapes.distances(shape, p)
    exact = np.linalg.norm(p, axis=1) - 5e-3
    assert (gap > 0.0).all()
    assert (gap <= exact + 0.5 / shape.cells).all()
    assert (gap >= 0.6 * exact).all()
    assert ((normal * p).sum(axis=1) > 0.5 * np.linalg.norm(p, axis=1)).all()


def test_the_corner_of_a_cube_comes_to_lie_on_the_tip_of_a_dome() -> None:
    dome = Dome(pitch=0.7e-3, reach=math.radians(45.0))
    shape = mesh_shape(meshes.corner(), cells=32)
    assert shape.reach_down() == pytest.approx(np.sqrt(3.0) * 4e-3)
    motion = press_and_move(0.4e-3, shift=(0.6e-3, 0.1e-3), twist=0.2, press_s=0.02, move_s=0.04)
    run = simulate_contact(dome, Solid(shape=shape), motion, 2e-3, keep=2)
    assert run.unconverged == 0
    assert run.total_forces[-1, 2] < 0.0


def test_a_grid_is_made_once(
    no_kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "gear.stl"
    meshes.gear().export(path)
    made = mesh_shape(path, cells=32)
    (file,) = no_kept.iterdir()
    content = file.read_bytes()
    again = mesh_shape(path, cells=32)
    assert made.name == again.name == "gear.stl"
    for name in ("grid", "origin", "bounds", "corners"):
        assert getattr(made, name).tobytes() == getattr(again, name).tobytes()
    file.write_bytes(content[:1000])  # as after a full disk
    assert mesh_shape(path, cells=32).grid.tobytes() == made.grid.tobytes()
    monkeypatch.setattr(kept_arrays, "MOST", 2)
    for cells in (16, 17, 18):  # only the grids used last are kept
        mesh_shape(path, cells=cells)
    assert len([*no_kept.iterdir()]) == 2


@pytest.mark.parametrize(
    ("spoil", "note"),
    [
        (lambda mesh: mesh.invert(), "inside out"),
        (lambda mesh: mesh.update_faces(np.arange(len(mesh.faces)) > 0), "closed with 1 flat"),
        (lambda mesh: mesh.update_faces(mesh.vertices[mesh.faces][..., 2].min(1) < 2.9), "holes"),
        (lambda mesh: _turn_some(mesh), "were turned"),
    ],
)
def test_small_flaws_are_mended_and_said(spoil, note: str) -> None:
    whole = mesh_shape(meshes.tube().convex_hull, cells=24)
    flawed = meshes.tube().convex_hull
    spoil(flawed)
    mended = mesh_shape(flawed, cells=24)
    assert any(note in one for one in mended.notes)
    p = np.random.default_rng(5).uniform(-4e-3, 4e-3, (2000, 3))
    gaps = [shapes.distances(shape, p)[0] for shape in (whole, mended)]
    np.testing.assert_allclose(*gaps, atol=0.1e-3)


def _turn_some(mesh) -> None:
    mesh.faces[::7] = mesh.faces[::7, ::-1]


def _boxes(size: float, other, apart: tuple[float, float, float] = (0.0, 0.0, 0.0)):
    """A box, and another body beside it."""
    other.apply_translation(apart)
    return trimesh.util.concatenate([trimesh.creation.box((size, size, size)), other])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: trimesh.Trimesh(), "it has no triangles"),
        (
            lambda: _boxes(4.0, trimesh.creation.box((4.0, 4.0, 4.0)), (4.0, 4.0, 0.0)),
            "could not be mended: 1 of its 35 edges do",
        ),
        (lambda: trimesh.creation.box(extents=(1e3, 1, 1)), "longest side is 1000 mm"),
        (lambda: trimesh.creation.box(extents=(0.01, 0.01, 0.01)), "object.mesh_unit_mm"),
        (lambda: trimesh.Trimesh([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]]), "lie in a plane"),
        (lambda: _boxes(8.0, trimesh.creation.icosphere(radius=5)), "parts of it overlap"),
        (lambda: meshes.ball(), "5120 faces, more than 2000; simplify it"),
        (lambda: Path("part.stl"), r"part\.stl: there is no such file"),
    ],
)
def test_what_is_no_body_is_refused(make, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("chromagrip.model.shapes.triangle_mesh.MOST_FACES", 2000)
    with pytest.raises(UserError, match=words):
        mesh_shape(make())


def test_what_a_mesh_cannot_be_is_refused_or_said() -> None:
    with pytest.raises(UserError, match="must not mirror"):
        mesh_shape(meshes.ball(), rotation=np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(UserError, match="cells of a mesh must be an integer in"):
        mesh_shape(meshes.ball(), cells=7)
    shape = mesh_shape(trimesh.creation.box(extents=(20.0, 20.0, 0.5)), cells=48)
    assert "its thinnest side is only 1.2 cells of 0.42 mm" in shape.notes[0]
    assert shapes.distances(shape, [[0.0, 0.0, 0.0]])[0][0] < 0.0


OBJ = "v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex {0}\nproperty float x\nproperty float y\n"
    "property float z\nelement face {1}\nproperty list uchar int vertex_indices\nend_header\n"
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.ply", PLY.format(10**12, 10**12)),
        ("a.ply", PLY.format(4, 4) + "0 0 0\n9 0 0\n0 9 0\n0 0 9\n" + "3 0 1 99\n" * 4),
        ("a.obj", OBJ.replace("f 2 3 4", "f 2 3 999")),
        ("a.obj", OBJ.replace("v 9 0 0", "v 1e308 0 0")),
        ("a.obj", "mtllib /dev/zero\nmtllib ../../../../dev/zero\n"),
        ("a.stl", "solid\nfacet normal 0 0 x\nvertex 1 2\n" * 50),
    ],
)  # fmt: skip
def test_what_is_no_mesh_is_one_sentence(
    tmp_path: Path, name: str, text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Not a line of trimesh, whose log has tracebacks."""
    (tmp_path / name).write_text(text)
    with pytest.raises(UserError, match=f"mesh {tmp_path / name}"):
        mesh_shape(tmp_path / name, cells=16)
    assert capfd.readouterr() == ("", "")


def test_a_mesh_keeps_the_origin_of_its_file(tmp_path: Path) -> None:
    box = trimesh.creation.box((10e-3, 10e-3, 10e-3))
    box.apply_translation((20e-3, 0.0, 5e-3))
    path = tmp_path / "beside.stl"
    box.export(path)
    turn = Rotation.from_euler("y", 170.0, degrees=True).as_matrix()
    for _ in range(2):  # made, and read from the cache
        shape = shapes.mesh(path, cells=32)
        np.testing.assert_allclose(shape.bounds, box.bounds, atol=1e-7)
        gap, _ = shapes.distances(shape, [[20e-3, 0.0, 5e-3], [20e-3, 0.0, 11e-3]])
        np.testing.assert_allclose(gap, [-5e-3, 1e-3], atol=1e-4)
    turned = shapes.mesh(path, rotation=turn, cells=32)
    middle = turn @ [20e-3, 0.0, 5e-3]
    np.testing.assert_allclose(turned.bounds.mean(axis=0), middle, atol=1e-7)
    assert turned.reach_down() == pytest.approx(-turned.bounds[0, 2])
    centred = shapes.mesh(path, rotation=turn, cells=32, centred=True)
    np.testing.assert_array_equal(centred.grid, turned.grid)
    np.testing.assert_allclose(centred.bounds.mean(axis=0), 0.0, atol=1e-9)
