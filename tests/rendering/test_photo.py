"""Photos: cameras and outlines as OpenGL's pictures have them, clear glass, and clear errors."""

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.shape import Texture
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.rendering import photo
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.config import PhotoConfig
from cluttergen_jax.rendering.furnish import furnish
from cluttergen_jax.rendering.look import Covering, find_look, read_look
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, open_scene_renderer
from cluttergen_jax.sensing import FLOOR, Camera, InstanceSensor
from tests.helpers import shiny
from tests.helpers.placing import write_bank

SIZE = (160, 120)


def poses_of(objects, places):
    return np.array(
        [
            [x, y, 0.7 + each.half_extents[2], 1, 0, 0, 0]
            for each, (x, y) in zip(objects, places, strict=True)
        ]
    )


def take(names, places, camera=None, samples=4, look="studio", **settings):
    """A photo of dining objects on the paper's table, and what its camera sees by rays."""
    pytest.importorskip("mitsuba", reason="needs the extra photo")
    objects = [find_pool("dining")[name] for name in names]
    poses = poses_of(objects, places)
    support = furnish(cuboid_table(), find_look(look))
    picture = PictureConfig(*SIZE, samples, look=find_look(look), photo=PhotoConfig(**settings))
    points = close_points(objects, poses, support)
    with open_scene_renderer(objects, support, points, picture) as renderer:
        renderer.camera = camera or renderer.camera
        image = renderer.picture([RenderStyle(pose) for pose in poses])
        seen = InstanceSensor(objects, support).sense_scene(poses, renderer.camera)
    return image, seen


@pytest.mark.slow
@pytest.mark.parametrize("is_square", [True, False])
def test_a_photo_has_the_outlines_that_rays_see(is_square):
    camera = None
    if not is_square:
        eye = np.array([1.0, -0.9, 1.5])
        place = Camera.looking(eye, np.array([0.05, 0.0, 0.7]), *SIZE, 150).T_world_camera
        # No picture of a real camera has its axis exactly in its middle, nor square pixels.
        K = np.array([[150.0, 0, 85.3], [0, 180.0, 56.9], [0, 0, 1]])
        camera = Camera(*SIZE, K, place)
    image, seen = take(
        ["mug", "soup_can"], [(-0.1, 0.1), (0.1, -0.1)], camera, 8, is_transparent=True
    )
    assert image.shape == (*SIZE[::-1], 4)
    is_thing = seen.label != FLOOR
    is_drawn = image[..., 3] > 127
    assert (is_thing & is_drawn).sum() > 0.97 * (is_thing | is_drawn).sum()


QUARTERS = np.array([[[220, 30, 30], [30, 200, 30]], [[30, 30, 220], [235, 235, 235]]], np.uint8)
"""An image that is like itself in no other place, turned by no angle, and mirrored by no axis."""


def quarter_of(image):
    """i[...]: which of the four colours a pixel shows best, in any light."""
    shown = image / np.maximum(image.max(-1, keepdims=True), 1)
    colours = (QUARTERS.reshape(4, 3) / QUARTERS.reshape(4, 3).max(-1, keepdims=True)).astype(float)
    return np.linalg.norm(shown[..., None, :] - colours, axis=-1).argmin(-1)


@pytest.mark.slow
def test_images_lie_as_opengl_lays_them(tmp_path):
    pytest.importorskip("mitsuba", reason="needs the extra photo")
    Image.fromarray(QUARTERS.repeat(32, 0).repeat(32, 1)).save(tmp_path / "quarters.png")
    text = (
        "about: a test\ntop: {of: quarters.png, tile: 1.1}\nfloor: {of: quarters.png, tile: 1.5}\n"
    )
    (tmp_path / "look.yaml").write_text(text + "frame: {of: paint}\n")
    look = read_look(tmp_path / "look.yaml", np.random.default_rng(0))
    support = furnish(cuboid_table(), look)
    points = np.array([[-0.6, -0.6, 0.0], [0.6, 0.6, 1.0]])
    camera = Camera.looking(np.array([0.9, -1.2, 2.4]), np.array([0.0, 0.0, 0.5]), *SIZE, 100)
    found = []
    for config in (None, PhotoConfig()):
        picture = PictureConfig(*SIZE, 4, look=look, photo=config)
        with open_scene_renderer([], support, points, picture) as renderer:
            renderer.camera = camera
            found.append(quarter_of(renderer.picture([]).astype(float)))
    assert set(found[0].ravel()) == {0, 1, 2, 3}
    assert (found[0] == found[1]).mean() > 0.9


def test_an_image_that_covers_a_top_is_not_mirrored(tmp_path):
    Image.fromarray(QUARTERS.repeat(8, 0).repeat(8, 1)).save(tmp_path / "quarters.png")
    for size in ((0.6, 0.4), (0.4, 0.6)):
        covering = Covering(str(tmp_path / "quarters.png"), tile=2.0)
        look = msgspec.structs.replace(find_look("studio"), top=covering)
        for piece in furnish(find_support(f"table-{size[0]:.2f}x{size[1]:.2f}"), look).pieces[:1]:
            corners = piece.mesh.corners
            outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            sides = np.diff(piece.uv.reshape(-1, 3, 2).astype(float), axis=1)
            turns = np.linalg.det(sides)
            is_large = np.linalg.norm(outward, axis=-1) > 1e-6
            assert (turns[is_large] > 0).all()


@pytest.mark.slow
def test_a_background_is_where_nothing_is_and_pictures_repeat(tmp_path):
    image, seen = take(["mug"], [(0.0, 0.0)], background="#20c040")
    again, _ = take(["mug"], [(0.0, 0.0)], background="#20c040")
    assert np.array_equal(image, again)
    is_behind = (image == (0x20, 0xC0, 0x40)).all(-1)
    assert (is_behind & (seen.label == FLOOR)).sum() > 0.95 * (seen.label == FLOOR).sum()
    assert not is_behind[seen.label > FLOOR].all()


@pytest.mark.slow
def test_what_stands_behind_glass_is_seen_through_it():
    # The camera looks along +y at a can that a water glass hides from rays.
    camera = Camera.looking(np.array([0.0, -0.8, 0.78]), np.array([0.0, 0.0, 0.74]), *SIZE, 400)
    alone, _ = take(["water_glass"], [(0.0, -0.1)], camera, 8)
    behind, seen = take(["water_glass", "soup_can"], [(0.0, -0.1), (0.0, 0.12)], camera, 8)
    is_glass = seen.label == 2
    assert is_glass.sum() > 500
    change = np.abs(behind.astype(int) - alone)[is_glass].mean()
    assert change > 8


@pytest.mark.slow
def test_finishes_are_seen():
    """The slab, matte, as a mirror, as a mirror with bumps, and with a map that makes it rough again."""
    pytest.importorskip("mitsuba", reason="needs the extra photo")
    rough = Texture.of(shiny.gloss(1.0, 1.0))
    flat = {"normal": None, "has_image": False}
    slabs = {
        "matte": shiny.asset(roughness=1.0, metallic=0.0, **flat),
        "mirror": shiny.asset(roughness=0.05, metallic=1.0, **flat),
        "bumpy": shiny.asset(roughness=0.05, metallic=1.0, has_image=False),
        "rough": shiny.asset(roughness=1.0, metallic=1.0, normal=None, orm=rough, has_image=False),
    }
    images = {}
    look = find_look("studio")
    support = furnish(cuboid_table(), look)
    for name, slab in slabs.items():
        poses = poses_of([slab], [(0.0, 0.0)])
        picture = PictureConfig(*SIZE, 8, look=look, photo=PhotoConfig())
        points = close_points([slab], poses, None)
        with open_scene_renderer([slab], support, points, picture) as renderer:
            image = renderer.picture([RenderStyle(poses[0])]).astype(float).mean(-1)
            seen = InstanceSensor([slab], support).sense_scene(poses, renderer.camera)
        images[name] = image[seen.label == 2]
        # No triangle is black for want of a direction along its image.
        assert (images[name] < 3).mean() < 0.02
    assert images["mirror"].mean() < images["matte"].mean() - 20
    assert np.abs(images["bumpy"] - images["mirror"]).mean() > 5
    assert np.abs(images["rough"] - images["mirror"]).mean() > 5


@pytest.mark.slow
def test_a_lens_leaves_what_is_far_from_its_focus_soft():
    # The scene's middle is half a metre away, and the box stands far behind it.
    camera = Camera.looking(np.array([0.0, -0.5, 0.9]), np.array([0.0, 0.0, 0.72]), *SIZE, 150)
    things = ["mug", "cereal_box"], [(0.0, 0.0), (0.0, 0.31)]
    sharp, seen = take(*things, camera)
    soft, _ = take(*things, camera, f_number=0.7)
    edges = [np.abs(np.diff(each.astype(float), axis=1)).max(-1) for each in (sharp, soft)]
    is_box = seen.label[:, 1:] == 3
    assert is_box.sum() > 500
    assert np.quantile(edges[1][is_box], 0.98) < 0.7 * np.quantile(edges[0][is_box], 0.98)


@pytest.mark.slow
def test_a_dataset_of_photos_has_the_labels_of_drafts(tmp_path):
    pytest.importorskip("mitsuba", reason="needs the extra photo")
    bank = write_bank(tmp_path / "bank", 1)
    views = []
    for quality in ("draft", "photo"):
        made = cg.make_dataset(
            bank, tmp_path / quality, cameras="free", size="64x48", quality=quality, look="studio"
        )
        (file,) = made.path.glob("*.parquet")
        views.append(pq.read_table(file).to_pylist()[0])
    draft, photo = views
    assert draft["rgb"] != photo["rgb"]
    for name in ("label", "depth"):
        assert draft[name] == photo[name]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"is_transparent": True, "background": "white"}, "one of the two"),
        ({"f_number": 0.0}, "f-number"),
        ({"f_number": float("nan")}, "f-number"),
        ({"f_number": "2.8"}, "f-number"),
    ],
)
def test_what_a_photo_cannot_be_is_refused(settings, said):
    with pytest.raises(ConfigError, match=said):
        PhotoConfig(**settings)


def test_a_background_that_is_neither_colour_nor_image_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("no image")
    for background, said in (("blurple", "a colour such as"), (tmp_path / "text.png", "no image")):
        with pytest.raises(ConfigError, match=said):
            photo.check_photo(PhotoConfig(background=str(background)))
    Image.new("RGB", (30, 10), (255, 0, 0)).save(tmp_path / "red.png")
    assert photo.read_backdrop(str(tmp_path / "red.png"), 8, 8)[0, 0].tolist() == [1, 0, 0]


def test_without_the_extra_the_error_names_it(monkeypatch):
    monkeypatch.setattr(photo, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="photo"):
        photo.check_photo(PhotoConfig())


def test_options_of_photos_ask_for_a_photo(tmp_path, capsys):
    assert main(["render", "nowhere", "--transparent", "--out", str(tmp_path / "out")]) == 2
    assert "quality 'photo'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
