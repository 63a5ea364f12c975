"""Polygons of concave outline: the triangles of each format cover it once, and folded ones are cut anew."""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.folds import without_folds
from cluttergen_jax.assets.mesh import Mesh, clean_mesh
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import read_source

CASES = Path(__file__).parents[1] / "cases" / "import" / "01_ngon_concave"
HEIGHT = 0.03


def area(mesh):
    return float(np.linalg.norm(mesh.normals, axis=1).sum() / 2)


def outline(seed):
    """f64[N, 2]: a star with random arms, counter-clockwise, and the area in it by the shoelace rule."""
    rng = np.random.default_rng(seed)
    number = int(rng.integers(4, 15))
    turn = (
        np.sort(rng.uniform(0, 2 * np.pi, number)) * 0.05
        + np.arange(number) / number * 2 * np.pi * 0.95
    )
    points = rng.uniform(0.02, 0.1, (number, 1)) * np.stack([np.cos(turn), np.sin(turn)], 1)
    x, y = points.T
    return points, float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def prism(points, start):
    """Vertices and polygons of a prism; its two caps begin with corner `start`."""
    number = len(points)
    vertices = np.concatenate([np.c_[points, np.full(number, height)] for height in (0.0, HEIGHT)])
    ring = np.roll(np.arange(number), -start)
    walls = [[i, (i + 1) % number, (i + 1) % number + number, i + number] for i in range(number)]
    return vertices, [list(ring[::-1]), list(ring + number), *walls]


def as_obj(vertices, polygons):
    """With a texture coordinate of its own for each corner."""
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    lines += [f"vt {vertices[i][0]} {vertices[i][1]}" for polygon in polygons for i in polygon]
    corners = iter(range(1, 10_000))
    lines += ["f " + " ".join(f"{i + 1}/{next(corners)}" for i in polygon) for polygon in polygons]
    return "\n".join(lines).encode()


def as_ply(vertices, polygons, order=""):
    kind = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = (
        f"ply\nformat {kind} 1.0\nelement vertex {len(vertices)}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {len(polygons)}\nproperty uchar flags\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    if not order:
        rows = [" ".join(map(str, row)) for row in vertices]
        rows += [" ".join(map(str, [7, len(polygon), *polygon])) for polygon in polygons]
        return (head + "\n".join(rows) + "\n").encode()
    body = b"".join(struct.pack(order + "3d", *row) for row in vertices)
    return (
        head.encode()
        + body
        + b"".join(struct.pack(f"{order}BB{len(each)}i", 7, len(each), *each) for each in polygons)
    )


def as_dae(vertices, polygons):
    numbers = " ".join(str(value) for value in vertices.reshape(-1))
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{vertices.size}">{numbers}</float_array><technique_common>
<accessor source="#a" count="{len(vertices)}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="{len(polygons)}"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>{" ".join(str(len(each)) for each in polygons)}</vcount>
<p>{" ".join(str(i) for each in polygons for i in each)}</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>""".encode()


WRITERS = {
    "prism.obj": as_obj,
    "text.ply": as_ply,
    "prism.dae": as_dae,
}


@pytest.mark.parametrize("name", ["L_poly.ply", "bracket_segv.obj", "bracket_spin.obj"])
def test_an_l_bracket_is_one(name):
    (shape,) = read_source(CASES / name)
    mesh = shape.pieces[0].mesh
    assert mesh.volume == pytest.approx(1.53e-4, rel=1e-6)
    assert area(mesh) == pytest.approx(0.0222, rel=1e-6)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("seed", range(4))
def test_every_format_covers_an_outline_once(name, seed, tmp_path):
    points, inside = outline(seed)
    around = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum()
    for start in range(0, len(points), 3):
        (tmp_path / name).write_bytes(WRITERS[name](*prism(points, start)))
        (shape,) = read_source(tmp_path / name)
        mesh = clean_mesh(shape.pieces[0].mesh)
        assert mesh.volume == pytest.approx(inside * HEIGHT, rel=1e-4)
        assert area(mesh) == pytest.approx(2 * inside + around * HEIGHT, rel=1e-4)
        assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight


@pytest.mark.parametrize("order", ["<", ">"])
def test_faces_of_a_binary_ply_have_as_many_corners(order, tmp_path):
    """The parser takes the first face's number for all: refused, not read as something else."""
    path = tmp_path / "prism.ply"
    path.write_bytes(as_ply(*prism(outline(0)[0], 0), order))
    with pytest.raises(AssetError, match=r"number of corners.*triangulated faces, or as text"):
        read_source(path)
    # As many bytes as of four corners each.
    vertices, polygons = prism(np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]), 0)
    polygons[4:] = [polygons[4][:3], [*polygons[5], polygons[4][0]]]
    path.write_bytes(as_ply(vertices, polygons, order))
    with pytest.raises(AssetError, match=r"number of corners.*triangulated faces, or as text"):
        read_source(path)


def fanned(points, start):
    vertices, polygons = prism(points, start)
    faces = [[each[0], each[i], each[i + 1]] for each in polygons for i in range(1, len(each) - 1)]
    return Mesh(vertices, np.array(faces))


@pytest.mark.parametrize("is_soup", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_what_arrives_folded_is_cut_anew(seed, is_soup):
    points, inside = outline(seed)
    around = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum()
    for start in range(len(points)):
        mesh = fanned(points, start)
        if is_soup:
            mesh = Mesh(mesh.corners.reshape(-1, 3), np.arange(3 * len(mesh.faces)))
        mended = without_folds(mesh)
        assert area(mended) == pytest.approx(2 * inside + around * HEIGHT, rel=1e-6)
        assert mended.volume == pytest.approx(inside * HEIGHT, rel=1e-6)


def test_sound_surfaces_stay_the_same_object():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    sheet = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    blade = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.03, 0.001], [0, 0.03, -0.001]])
    for mesh in (
        Mesh(ball.vertices, ball.faces),
        Mesh(sheet, np.array([[0, 1, 2], [0, 2, 1]])),
        Mesh(blade, np.array([[0, 1, 2], [1, 0, 3], [0, 2, 3], [1, 3, 2]])),
    ):
        assert without_folds(mesh) is mesh
