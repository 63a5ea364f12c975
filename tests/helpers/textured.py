"""A slab with a picture on it, in every format that can carry one: each corner has its own colour."""

import io

import numpy as np
import trimesh
from PIL import Image

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import CLOUD_SIZE, ObjectAsset, RestingPose
from cluttergen_jax.assets.shape import Piece, Provenance, Texture
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.scene import Scene

SIZE = (0.12, 0.10, 0.03)
"""Metres."""
QUADRANTS = {
    (-1, 1): (220, 30, 30),
    (1, 1): (30, 200, 30),
    (-1, -1): (30, 30, 220),
    (1, -1): (230, 210, 20),
}
"""The colour over each quarter of the top, by the signs of x and y: the image's upper left is at -x, +y."""


def picture(side=64):
    """The image: four colours, and grey in a strip below them for the other faces."""
    pixels = np.zeros((side, side, 3), np.uint8)
    half = side // 2
    for (x, y), colour in QUADRANTS.items():
        rows = slice(0, half) if y > 0 else slice(half, side)
        pixels[rows, slice(half, side) if x > 0 else slice(0, half)] = colour
    return Image.fromarray(pixels)


def png(image):
    """The bytes of an image as PNG."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def slab():
    """f64[V, 3], i[F, 3], f64[V, 2]: a box, each face with vertices of its own; v runs up the image.

    The picture is seen upright on the top, with x to the right and y up; the other faces show one place each.
    """
    box = trimesh.creation.box(SIZE)
    vertices = box.vertices[box.faces].reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    uv = vertices[:, :2] / SIZE[:2] + 0.5
    is_top = np.repeat(box.face_normals[:, 2] > 0.5, 3)
    return vertices, faces, np.where(is_top[:, None], uv, [0.25, 0.75])


def colour_at(piece, x, y):
    """u8[3]: what a piece of the slab shows at a place of its top, by its own uv and image."""
    triangles = piece.mesh.vertices[piece.mesh.faces]
    is_top = (triangles[..., 2] > triangles[..., 2].max() - 1e-4).all(1)
    for face, corners in zip(piece.mesh.faces[is_top], triangles[is_top], strict=True):
        weights = np.linalg.solve(np.vstack([corners[:, :2].T, np.ones(3)]), [x, y, 1.0])
        if weights.min() >= -1e-9:
            shown = piece.texture.at((weights @ piece.uv[face])[None])[0] * piece.rgba[:3]
            return tuple(np.round(255 * shown).astype(int).tolist())
    raise AssertionError("no triangle of the top is there")


def quarters():
    """The middle of each quarter of the top, x and y in metres, and the colour that belongs there."""
    return [((x * SIZE[0] / 4, y * SIZE[1] / 4), colour) for (x, y), colour in QUADRANTS.items()]


def obj_text(material="slab.mtl"):
    """The slab as OBJ."""
    vertices, faces, uv = slab()
    lines = [f"mtllib {material}", "usemtl printed"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv]
    lines += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in face) for face in faces]
    return "\n".join(lines) + "\n"


def write_obj(folder, name="slab", image="slab.png", kd="1 1 1"):
    """OBJ, MTL and PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.obj"
    path.write_text(obj_text(f"{name}.mtl"))
    (folder / f"{name}.mtl").write_text(f"newmtl printed\nKd {kd}\nmap_Kd {image}\n")
    (folder / image).write_bytes(png(picture()))
    return path


def write_gltf(folder, name="slab.glb"):
    """GLB, or GLTF with its files beside it; y up, so that the top is +y."""
    folder.mkdir(parents=True, exist_ok=True)
    vertices, faces, uv = slab()
    material = trimesh.visual.material.PBRMaterial(name="printed", baseColorTexture=picture())
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    turned = vertices[:, [0, 2, 1]] * [1, 1, -1]
    mesh = trimesh.Trimesh(turned, faces, visual=visual, process=False)
    path = folder / name
    trimesh.Scene(mesh).export(str(path))
    return path


def write_dae(folder):
    """COLLADA that names an image beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "slab.png").write_bytes(png(picture()))
    vertices, faces, uv = slab()
    index = " ".join(f"{k} {k}" for k in faces.ravel())

    def numbers(values):
        return " ".join(map(str, values.ravel()))

    text = f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="im"><init_from>slab.png</init_from></image></library_images>
<library_effects><effect id="ef"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>im</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source></sampler2D></newparam>
<technique sid="c"><lambert><diffuse><texture texture="sa" texcoord="UV0"/></diffuse></lambert></technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id="ma"><instance_effect url="#ef"/></material></library_materials>
<library_geometries><geometry id="ge"><mesh>
<source id="p"><float_array id="pa" count="{vertices.size}">{numbers(vertices)}</float_array>
<technique_common><accessor source="#pa" count="{len(vertices)}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="t"><float_array id="ta" count="{uv.size}">{numbers(uv)}</float_array>
<technique_common><accessor source="#ta" count="{len(uv)}" stride="2"><param name="S" type="float"/>
<param name="T" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{len(faces)}" material="m0"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#t" offset="1" set="0"/><p>{index}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="vs"><node id="n"><instance_geometry url="#ge"><bind_material>
<technique_common><instance_material symbol="m0" target="#ma"><bind_vertex_input semantic="UV0"
input_semantic="TEXCOORD" input_set="0"/></instance_material></technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#vs"/></scene></COLLADA>"""
    path = folder / "slab.dae"
    path.write_text(text)
    return path


def write_urdf(folder, with_own_material=True):
    """A URDF whose mesh has the picture, or whose <material> names it."""
    write_obj(folder)
    material = ""
    if not with_own_material:
        (folder / "slab.obj").write_text(
            obj_text().replace("mtllib slab.mtl\nusemtl printed\n", "")
        )
        material = '<material name="m"><texture filename="slab.png"/></material>'
    path = folder / "slab.urdf"
    path.write_text(
        '<robot name="slab"><link name="slab"><inertial><mass value="0.2"/><inertia ixx="2e-4" iyy="2e-4" '
        'izz="2e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<visual><geometry><mesh filename="slab.obj"/></geometry>'
        f"{material}</visual></link></robot>"
    )
    return path


def write_mjcf(folder):
    """MJCF with the picture on a mesh."""
    write_obj(folder)
    path = folder / "slab.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="slab.obj"/><texture name="t" type="2d" file="slab.png"/>'
        '<material name="a" texture="t"/></asset><worldbody><body name="slab"><freejoint/>'
        '<geom type="mesh" mesh="m" material="a"/></body></worldbody></mujoco>'
    )
    return path


def piece():
    """The slab as a reader hands it on."""
    vertices, faces, uv = slab()
    return Piece(Mesh(vertices, faces), (1.0, 1.0, 1.0, 1.0), uv, Texture.of(picture()))


def asset(name="slab", surface=None):
    """The slab as a body, made by hand."""
    half = np.array(SIZE) / 2
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    rng = np.random.default_rng(0)
    return ObjectAsset(
        name=name,
        label=name,
        pieces=(surface or piece(),),
        parts=(Mesh.points(corners),),
        mass=0.2,
        center_of_mass=np.zeros(3),
        inertia=np.eye(3) * 2e-4,
        cloud=(rng.uniform(-1, 1, (CLOUD_SIZE, 3)) * half).astype(np.float32),
        resting=(RestingPose((1.0, 0.0, 0.0, 0.0), SIZE[2] / 2, 1.0),),
        provenance=Provenance("test", "Apache-2.0"),
    )


def scene(*assets):
    """Slabs side by side on a table, none turned: 0.2 m from one to the next, along x."""
    assets = assets or (asset(),)
    table = cuboid_table(0.6, 0.7, 0.7)
    poses = np.zeros((len(assets), 7))
    poses[:, 0] = 0.2 * np.arange(len(assets))
    poses[:, 2] = table.top + SIZE[2] / 2
    poses[:, 3] = 1.0
    return Scene(tuple(each.name for each in assets), tuple(assets), poses, table)


def assert_upright(piece, factor=1.0):
    """Each quarter of the slab's top has the colour that belongs there."""
    for (x, y), colour in quarters():
        np.testing.assert_allclose(colour_at(piece, x, y), np.array(colour) * factor, atol=3)
