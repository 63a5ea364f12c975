"""Readers: every format tells the same object, whatever its unit, axis, joints or scale."""

import re
import struct

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.mesh import clean_mesh, join_meshes
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import read_source

SIZE = np.array([0.06, 0.04, 0.11])


def bounds(shape):
    return join_meshes([piece.mesh for piece in shape.pieces]).bounds


def save_box(path, colour=(200, 40, 40, 255), size=SIZE):
    box = trimesh.creation.box(size)
    box.visual.face_colors = colour
    path.parent.mkdir(parents=True, exist_ok=True)
    box.export(str(path))
    return path


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "gltf", "dae"])
def test_every_mesh_format_gives_the_same_box(tmp_path, suffix):
    path = save_box(tmp_path / f"crate.{suffix}")
    (shape,) = read_source(path)
    # What a GLTF or a DAE holds is y up, and is turned.
    size = SIZE[[0, 2, 1]] if suffix in ("glb", "gltf", "dae") else SIZE
    np.testing.assert_allclose(np.ptp(bounds(shape), axis=0), size, atol=1e-6)
    mesh = clean_mesh(join_meshes([piece.mesh for piece in shape.pieces]))
    assert len(mesh.vertices) == 8
    assert len(mesh.faces) == 12
    assert mesh.volume == pytest.approx(SIZE.prod())
    assert (shape.name, shape.label) == ("crate", "crate")


@pytest.mark.parametrize("suffix", ["ply", "glb"])
def test_colours_are_read(tmp_path, suffix):
    (shape,) = read_source(save_box(tmp_path / f"crate.{suffix}"))
    np.testing.assert_allclose(shape.pieces[0].rgba[:3], np.array([200, 40, 40]) / 255, atol=0.02)


def test_colours_are_read_as_early_ply_files_call_them(tmp_path):
    path = save_box(tmp_path / "crate.ply")
    path.write_bytes(re.sub(rb"uchar (red|green|blue)", rb"uchar diffuse_\1", path.read_bytes()))
    (shape,) = read_source(path)
    np.testing.assert_allclose(shape.pieces[0].rgba[:3], np.array([200, 40, 40]) / 255, atol=0.02)


URDF = """<robot name="r">
  <material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
  <link name="base"/>
  <link name="a">
    <visual>
      <origin xyz="0 0 0.05" rpy="1.5707963267948966 0 0"/>
      <geometry><mesh filename="{mesh}" scale="1 1 0.5"/></geometry><material name="red"/>
    </visual>
    <collision><geometry><box size="0.06 0.04 0.1"/></geometry></collision>
  </link>
  <link name="b"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>
  <link name="c"><visual><geometry><cylinder radius="0.01" length="0.04"/></geometry></visual></link>
  <joint name="fix" type="fixed"><parent link="base"/><child link="a"/><origin xyz="0.1 0 0"/></joint>
  <joint name="turn" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.1"/>
    <axis xyz="0 0 1"/><limit lower="1.0" upper="2.0"/></joint>
  <joint name="slide" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="0 0 0"/>
    <axis xyz="1"/><limit lower="0.2" upper="0.4"/></joint>
</robot>"""


def make_urdf(folder, mesh="crate.stl"):
    save_box(folder / "crate.stl")
    (folder / "mobility.urdf").write_text(URDF.format(mesh=mesh))
    return folder


def test_urdf_links_origins_scales_and_joints(tmp_path):
    (shape,) = read_source(make_urdf(tmp_path / "gadget" / "0"))
    assert shape.name == "gadget"
    box, ball, rod = (piece.mesh.bounds for piece in shape.pieces)
    # Half of the height, then a quarter turn about x: z goes to -y.
    np.testing.assert_allclose(np.ptp(box, axis=0), [0.06, 0.055, 0.04], atol=1e-6)
    np.testing.assert_allclose(box.mean(0), [0.1, 0, 0.05], atol=1e-6)
    np.testing.assert_allclose(ball.mean(0), [0.1, 0, 0.1], atol=1e-6)
    slid = 0.2 * np.array([np.cos(1.0), np.sin(1.0)])
    np.testing.assert_allclose(rod.mean(0), [0.1 + slid[0], slid[1], 0.1], atol=1e-4)
    assert shape.pieces[0].rgba == (0.8, 0.1, 0.1, 1.0)
    assert len(shape.parts) == 1


def exported(suffix, **options):
    return trimesh.Trimesh.export(trimesh.creation.box(SIZE), file_type=suffix, **options)


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 684\n"
MIXED_PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    + np.eye(4, 3, dtype="<f4").tobytes()
    + struct.pack("<B3iB4i", 3, 0, 1, 2, 4, 0, 1, 2, 9)
)


def obj_with(line):
    return (exported("obj") + f"\n{line}\n").encode()


NAN_DAE = re.sub(rb"(<float_array[^>]*>)\S+", rb"\1-NaN", exported("dae"), count=1)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.obj", obj_with("f 1 2 99"), "line 24 has a face with vertex 99, of 8 vertices"),
        ("a.obj", obj_with("f -1 -2 -99"), "line 24 has a face with vertex -99, of 8 vertices"),
        ("a.obj", obj_with("f 0 1 2"), "line 24 has a face with vertex 0"),
        ("a.obj", obj_with("f a b c"), "line 24 has a face with vertex 'a'"),
        ("a.obj", obj_with("f 1 2 99999999999999999999"), "line 24 has a face with vertex 9999"),
        ("a.obj", obj_with("v nan 0 0\nf 1 2 9"), "vertices that are not finite"),
        ("a.obj", b"", "is empty"),
        ("a.obj", POINTER, "a pointer of Git LFS in place of the file.*Try: `git lfs pull`"),
        ("a.stl", POINTER, "a pointer of Git LFS"),
        ("a.urdf", POINTER, "a pointer of Git LFS"),
        (
            "a.stl",
            b"\n<!DOCTYPE html><html>Not found</html>" * 9,
            "a page of HTML in place of the file",
        ),
        ("a.ply", MIXED_PLY, "its faces differ in their number of corners"),
        ("a.stl", exported("stl")[:-30], "12 triangles needs 684 bytes"),
        ("a.stl", exported("stl_ascii").encode()[:-60], "its last triangle has no end"),
        (
            "a.ply",
            exported("ply", encoding="ascii")[:-20],
            "promises 20 vertices and faces, it has 18",
        ),
        ("a.ply", exported("ply")[:-30], "cannot be read"),
        ("a.ply", exported("ply")[:100], "damaged, cut short or of another format"),
        ("a.glb", exported("glb")[:-50], "is damaged"),
        ("a.dae", exported("dae")[:900], "cannot be read"),
        ("a.dae", NAN_DAE, "a vertex at '-NaN'"),
        ("a.dae", b"<COLLADA/>", "damaged, cut short or of another format"),
    ],
)
def test_damage_is_told_in_words(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(AssetError, match=message) as error:
        read_source(tmp_path / name)
    assert str(tmp_path / name) in str(error.value)
    assert re.search(r"\wError:", str(error.value)) is None
