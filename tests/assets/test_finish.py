"""Finishes of surfaces: what they may be, what files keep of them, and MuJoCo's materials."""

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object_files import object_hash, read_object, write_object
from cluttergen_jax.assets.shape import Piece, Shape, Texture
from cluttergen_jax.assets.support_file import read_support, support_hash, write_support
from cluttergen_jax.assets.visuals import simplify_pieces
from cluttergen_jax.errors import PoolError
from cluttergen_jax.importing.supports import support_with_notes
from tests.helpers import shiny, textured
from tests.helpers.shapes import SOURCE

ORM = Texture.of(shiny.gloss(0.5, 0.8))
GLASS = Finish(0.0, 0.0, 1.0)
_ROLE = mujoco.mjtTextureRole


@pytest.mark.parametrize("field", ["roughness", "metallic", "transmission"])
@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan, math.inf])
def test_a_finish_is_of_numbers_from_0_to_1(field, value):
    with pytest.raises(ValueError, match="from 0 to 1"):
        Finish(**{field: value})


def test_coordinates_come_with_images_and_with_nothing_else():
    piece = textured.piece()
    bare = {"mesh": piece.mesh, "finish": replace(shiny.FINISH, normal=None)}
    assert Piece(**bare).images == ()
    assert Piece(piece.mesh, uv=piece.uv, finish=shiny.FINISH).images == (shiny.FINISH.normal,)
    for wrong in (bare | {"uv": piece.uv}, {"mesh": piece.mesh, "finish": shiny.FINISH}):
        with pytest.raises(ValueError, match="uv"):
            Piece(**wrong)


def test_rougher_is_duller_and_metal_is_brighter():
    finishes = [Finish(share) for share in np.linspace(0, 1, 21)]
    for name in ("specular", "exponent", "shininess"):
        values = [getattr(each, name) for each in finishes]
        assert values == sorted(values, reverse=True)
        assert min(values) >= 0
    assert max(each.specular for each in finishes) <= 1
    assert max(each.shininess for each in finishes) <= 1
    assert (Finish(1.0).specular, Finish(1.0).shininess) == (0, 0)
    assert all(replace(each, metallic=1.0).specular >= each.specular for each in finishes)
    # What a map makes rough is as dull as what a number makes so.
    mapped = Finish(1.0, 1.0, orm=ORM)
    mean = mapped.without_maps
    assert (mean.roughness, mean.metallic) == pytest.approx((0.5, 0.8), abs=3e-3)
    assert mean.images == ()
    assert mapped.specular == mapped.without_maps.specular


@pytest.mark.parametrize("has_image", [True, False])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"orm": ORM},
        {"transmission": Finish().transmission},
        {"normal": None},
        {"transmission": 0.5, "metallic": 0.0},
    ],
)
def test_objects_keep_their_finish(tmp_path, has_image, changes):
    asset = shiny.asset(has_image=has_image, **changes)
    plain = replace(asset, pieces=(textured.piece(),))
    write_object(tmp_path / "a", asset)
    back = read_object(tmp_path / "a")
    (piece,) = back.pieces
    assert piece.finish == asset.pieces[0].finish
    assert piece.images == asset.pieces[0].images
    assert (piece.uv is None) == (not piece.images)
    assert object_hash(back) == object_hash(asset) != object_hash(plain)
    (stored,) = json.loads((tmp_path / "a" / "object.json").read_text())["finishes"]
    assert ("transmission" in stored) == (piece.finish.transmission > 0)
    assert {path.name for path in (tmp_path / "a").glob("*.png")} == {
        image.file_name for image in piece.images
    }
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a" / "object.xml"))
    assert model.mat_roughness == pytest.approx([piece.finish.roughness])
    assert model.mat_metallic == pytest.approx([piece.finish.metallic])
    expected = {
        _ROLE.mjTEXROLE_RGB: piece.texture,
        _ROLE.mjTEXROLE_NORMAL: piece.finish.normal,
        _ROLE.mjTEXROLE_ORM: piece.finish.orm,
    }
    for role, image in expected.items():
        index = model.mat_texid[0, role]
        assert (index < 0) == (image is None)
        if image is not None:
            assert model.texture(int(index)).name == image.file_name.removesuffix(".png")


def test_what_has_no_finish_is_stored_as_before(tmp_path):
    write_object(tmp_path / "a", textured.asset())
    record = json.loads((tmp_path / "a" / "object.json").read_text())
    assert "finishes" not in record
    assert "roughness" not in (tmp_path / "a" / "object.xml").read_text()


def test_objects_share_the_images_of_their_finish(tmp_path):
    images = tmp_path / "assets" / "textures"
    for name in ("one", "two"):
        folder = tmp_path / "assets" / "objects" / name
        write_object(folder, shiny.asset(name, orm=ORM), images)
        assert not list(folder.glob("*.png"))
        assert read_object(folder, images).pieces[0].finish.orm == ORM
        assert mujoco.MjModel.from_xml_path(str(folder / "object.xml")).ntex == 3
    assert len(list(images.iterdir())) == 3


@pytest.mark.parametrize(
    "harm",
    [
        lambda files: files["finishes"][0].update(roughness=7),
        lambda files: files["finishes"][0].update(metallic="x"),
        lambda files: files["finishes"][0].update(normal="../../x.png"),
        lambda files: files["finishes"][0].update(normal="0" * 64),
        lambda files: files["finishes"].append(None),
    ],
)
def test_a_damaged_finish_is_refused(tmp_path, harm):
    from cluttergen_jax.assets.object_files import _canonical
    from cluttergen_jax.schema import digest_of

    write_object(tmp_path / "a", shiny.asset())
    path = tmp_path / "a" / "object.json"
    record = json.loads(path.read_text())
    record.pop("hash")
    harm(record)
    path.write_text(json.dumps({**record, "hash": digest_of(_canonical(record))}))
    with pytest.raises(PoolError, match=r"object\.json"):
        read_object(tmp_path / "a")


def test_supports_keep_their_finish(tmp_path):
    piece = shiny.asset(orm=ORM).pieces[0]
    large = replace(piece, mesh=Mesh(piece.mesh.vertices * 5, piece.mesh.faces))
    support, _ = support_with_notes(Shape("tray", "tray", (large,), SOURCE))
    back = read_support(write_support(tmp_path / "tray", support))
    assert support_hash(back) == support_hash(support)
    assert back.pieces[0].finish == piece.finish
    (tmp_path / "tray" / ORM.file_name).write_bytes(textured.png(shiny.gloss(0.1)))
    with pytest.raises(PoolError, match=ORM.file_name):
        read_support(tmp_path / "tray")


def test_surfaces_of_unlike_finish_stay_apart():
    boxes = [trimesh.creation.box((0.1, 0.1, 0.1)) for _ in range(4)]
    finishes = (None, Finish(0.1), Finish(0.1), Finish(0.2))
    pieces = [
        Piece(Mesh(box.vertices + np.array([k, 0, 0]), box.faces), shiny.BRASS, finish=finish)
        for k, (box, finish) in enumerate(zip(boxes, finishes, strict=True))
    ]
    small = simplify_pieces(pieces)
    assert [each.finish for each in small] == [None, Finish(0.1), Finish(0.2)]
    assert [len(each.mesh.faces) for each in small] == [12, 24, 12]


def test_a_map_stays_where_it_is_on_a_simplified_surface():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    uv = ball.vertices[:, :2] / 0.2 + 0.5
    ramp = np.zeros((64, 64, 3), np.uint8)
    ramp[..., 0] = np.arange(64) * 4
    finish = Finish(0.1, 1.0, normal=Texture.of(Image.fromarray(ramp)))
    piece = Piece(Mesh(ball.vertices, ball.faces), shiny.BRASS, uv, finish=finish)
    (small,) = simplify_pieces([piece], max_textured=3000)
    assert len(small.mesh.faces) <= 3000 < len(ball.faces)
    assert (small.texture, small.finish) == (None, finish)
    np.testing.assert_allclose(small.uv, small.mesh.vertices[:, :2] / 0.2 + 0.5, atol=0.02)


def test_a_model_has_one_material_for_equal_looks():
    assets = [shiny.asset("one"), shiny.asset("two"), shiny.asset("three", roughness=0.9)]
    glass = shiny.asset("four", has_image=False, normal=None, metallic=0.0, transmission=1.0)
    model = textured.scene(*assets, glass, textured.asset("plain")).to_mjspec().compile()
    own = [model.geom_matid[model.geom(f"{name}.visual-0").id] for name in ("one", "two", "three")]
    assert own[0] == own[1] != own[2]
    assert model.mat_specular[own[0]] > model.mat_specular[own[2]]
    assert model.mat_shininess[own[0]] > model.mat_shininess[own[2]]
    plain = model.geom_matid[model.geom("plain.visual-0").id]
    assert (model.mat_roughness[plain], model.mat_metallic[plain]) == (-1, -1)
    for index in own[:1]:
        np.testing.assert_allclose(model.mat_rgba[index], shiny.BRASS, atol=1e-6)
