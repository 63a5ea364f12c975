"""Looks: what their files may say, what is drawn, and supports that are drawn as furniture."""

import itertools

import mujoco
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import AssetError, BankError, ConfigError
from cluttergen_jax.rendering.assets import render_scene
from cluttergen_jax.rendering.furnish import covering_texture, furnish
from cluttergen_jax.rendering.look import Covering, embedded_looks, find_look, read_look
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, open_scene_renderer
from cluttergen_jax.rendering.surfaces import KINDS, draw_surface
from cluttergen_jax.sensing import FLOOR, SUPPORT, Camera, InstanceSensor
from tests.helpers.drawing import needs_gl
from tests.helpers.placing import write_bank

LEAST = """
about: a test
top: {of: wood}
frame: {of: paint}
floor: {of: concrete}
"""


@pytest.mark.parametrize("name", embedded_looks())
def test_looks_that_come_along_are_read_and_drawn_by_their_seed(name):
    assert find_look(name, 3) == find_look(name, 3)
    for seed in range(5):
        look = find_look(name, seed)
        assert 0 < sum(lamp.strength for lamp in look.lamps) + look.sky.strength < 3


def test_what_a_look_leaves_open_is_drawn_from_its_range(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        LEAST
        + "table: {one_of: [legs, cabinet]}\nroom: {between: [2, 3]}\n"
        + "sky: {colour: {between: [[0, 0, 0], [1, 0.5, 0]]}}\n"
    )
    looks = [find_look(file, seed) for seed in range(40)]
    assert {look.table for look in looks} == {"legs", "cabinet"}
    rooms = [look.room for look in looks]
    assert 2 <= min(rooms) < 2.3 < 2.7 < max(rooms) <= 3
    for look in looks:
        red, green, blue = look.sky.colour
        assert green == pytest.approx(red / 2)
        assert blue == 0
    drawn = {find_look("random", seed).about for seed in range(60)}
    assert len(drawn) > len(embedded_looks()) / 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LEAST + "colour: red", "colour"),
        (LEAST.replace("wood", "wodo"), "'wodo'.*wood.*marble"),
        (LEAST.replace("wood", "missing.png"), "missing.png"),
        (LEAST.replace("{of: wood}", "{of: wood, roughness: 7}"), "roughness"),
        (LEAST.replace("{of: wood}", "{of: {one_of: []}}"), "one_of"),
        (LEAST + "room: {between: [1, two]}", "between"),
        (LEAST + "room: .nan", "room|nan"),
        (LEAST + "sky: {image: sky.txt}", "sky.txt"),
        (LEAST + "table: round", "round"),
        (LEAST + "lamps: []", "lamps"),
        ("[1, 2", "YAML"),
        ("about: only words", "top"),
    ],
)
def test_a_file_that_is_no_look_is_refused_with_what_is_wrong(tmp_path, text, said):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=f"(?s){said}"):
        find_look(file)


def test_an_unknown_look_names_those_that_there_are(tmp_path, capsys):
    with pytest.raises(ConfigError, match=r"kitchen_day.*random, plain") as caught:
        find_look("kitchen_dya")
    assert "kitchen_day" in caught.value.hint
    with pytest.raises(ConfigError, match="No such file"):
        find_look(tmp_path / "none.yaml")
    assert main(["render", "nowhere", "--look", "velvet", "--out", str(tmp_path / "out")]) == 2
    assert "look 'velvet'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_image_may_cover_a_top_and_a_damaged_one_is_refused(tmp_path):
    image = tmp_path / "oak.png"
    Image.fromarray(np.zeros((64, 64, 4), np.uint8)).save(image)
    file = tmp_path / "mine.yaml"
    file.write_text(LEAST.replace("wood", "oak.png"))
    look = read_look(file, np.random.default_rng(0))
    assert look.top.of == str(image)
    # What is transparent is white.
    assert (np.asarray(covering_texture(look.top).image) == 255).all()
    image.write_bytes(image.read_bytes()[:50])
    covering_texture.cache_clear()
    with pytest.raises(AssetError, match="cannot be decoded"):
        furnish(cuboid_table(), look)
    image.write_text("no image")
    with pytest.raises(ConfigError, match=r"oak.png', which holds no image"):
        read_look(file, np.random.default_rng(0))


@pytest.mark.parametrize("seed", range(3))
def test_what_may_be_drawn_is_looked_for_whichever_is_drawn(seed, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(LEAST.replace("wood", "{one_of: [wood, missing.png]}"))
    with pytest.raises(ConfigError, match=r"missing.png"):
        read_look(file, np.random.default_rng(seed))


@pytest.mark.parametrize("kind", KINDS)
def test_surfaces_tile_and_are_the_same_for_the_same_seed(kind):
    colours = ((0.8, 0.7, 0.6), (0.3, 0.2, 0.1))
    image = draw_surface(kind, colours, 5).astype(float)
    assert np.array_equal(image, draw_surface(kind, colours, 5))
    for axis in (0, 1):
        steps = np.abs(np.diff(image, axis=axis)).mean((1 - axis, 2))
        seam = np.abs(np.take(image, 0, axis) - np.take(image, -1, axis)).mean()
        assert seam <= 1.5 * np.quantile(steps, 0.995) + 1


@pytest.mark.parametrize("size", [(0.6, 0.7, 0.7), (0.25, 1.6, 0.4), (0.9, 0.9, 0.1)])
@pytest.mark.parametrize("name", ["studio", "marble_bar"])
def test_furniture_is_drawn_within_what_collides_and_ends_at_its_top(name, size):
    support = cuboid_table(*size)
    drawn = furnish(support, find_look(name))
    assert drawn.boxes == support.boxes
    (box,) = support.boxes
    points = np.concatenate([piece.mesh.vertices for piece in drawn.pieces])
    assert (np.abs(points - box.center) <= np.array(box.half_extents) + 1e-9).all()
    top = points[np.abs(points[:, 2] - support.top) < 1e-9]
    assert np.ptp(top[:, :2], axis=0) == pytest.approx(np.array(size[:2]), abs=0.01)
    assert all(piece.uv is not None for piece in drawn.pieces)
    for one, other in itertools.combinations(drawn.pieces, 2):
        # No two boards share a face, which would flicker.
        assert not np.array_equal(one.mesh.bounds, other.mesh.bounds)


def test_a_support_with_surfaces_of_its_own_keeps_them():
    cupboard = find_support("cupboard")
    assert (furnish(cupboard, find_look("studio")) is cupboard) == bool(cupboard.pieces)
    table = cuboid_table()
    assert furnish(table, None) is table


def test_labels_and_depth_are_those_of_the_furniture_that_is_drawn():
    table = cuboid_table()
    eye = np.array([1.5, 0.0, 0.35])
    camera = Camera.looking(eye, np.array([0.0, 0.0, 0.35]), 160, 120, 150)
    middle = 60, 80
    block = InstanceSensor((), table).sense_scene(np.zeros((0, 7)), camera)
    legs = InstanceSensor((), furnish(table, find_look("studio"))).sense_scene(
        np.zeros((0, 7)), camera
    )
    assert block.label[middle] == SUPPORT
    # Between the legs there is nothing.
    assert legs.label[middle] == FLOOR
    assert (legs.label == SUPPORT).any()


@needs_gl
def test_a_picture_has_the_colours_of_its_look():
    mug = find_pool("dining")["mug"]
    table = cuboid_table()
    poses = np.array([[0, 0, 0.7 + mug.half_extents[2], 1, 0, 0, 0]], float)
    points = np.array([[-0.3, -0.35, 0.7], [0.3, 0.35, 0.8]])
    means = {}
    for name in ("plain", "marble_bar", "study_night"):
        look = find_look(name)
        picture = PictureConfig(160, 120, 2, look=look)
        with open_scene_renderer([mug], table, points, picture) as renderer:
            image = renderer.picture([RenderStyle(poses[0])])
            label = renderer.measure([RenderStyle(poses[0])]).label
        means[name] = image[label == SUPPORT].mean()
    assert means["marble_bar"] > means["plain"] + 15
    assert means["study_night"] < means["plain"] - 15
    # Whatever knows nothing of looks draws as it always did.
    assert np.array_equal(
        render_scene([mug], poses, table, width=64, height=48, samples=2),
        render_scene([mug], poses, table, width=64, height=48, samples=2),
    )


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("looks") / "bank", 2)


def test_an_export_takes_the_drawn_table_along_and_collides_as_without(bank, tmp_path):
    models = []
    for look in ("plain", "marble_bar"):
        folder = cg.export(bank, tmp_path / look, "mjcf", look=look)
        models.append(mujoco.MjModel.from_xml_path(str(folder / "scenes" / "000000.xml")))
    plain, drawn = models
    assert drawn.ntex > plain.ntex
    for model in models:
        collides = model.geom_contype != 0
        assert collides.sum() == (plain.geom_contype != 0).sum()
        assert np.array_equal(model.geom_size[collides], plain.geom_size[plain.geom_contype != 0])
    # The top's roughness is told to whoever reads it.
    assert drawn.mat_roughness.max() > 0
    with pytest.raises(ConfigError, match="velvet"):
        cg.export(bank, tmp_path / "other", "mjcf", look="velvet")


@needs_gl
def test_a_dataset_is_furnished_and_says_how(bank, tmp_path):
    seen = {"cameras": "overhead", "size": "64x48"}
    views = {}
    for look in ("plain", "marble_bar"):
        made = cg.make_dataset(bank, tmp_path / look, look=look, **seen)
        (file,) = made.path.glob("*.parquet")
        views[look] = pq.read_table(file).to_pylist()[0]
    assert views["plain"]["rgb"] != views["marble_bar"]["rgb"]
    # Seen from above a table has the outline of its block.
    assert views["plain"]["label"] == views["marble_bar"]["label"]
    with pytest.raises(BankError, match="look"):
        cg.make_dataset(bank, tmp_path / "plain", look="marble_bar", **seen)


def test_images_of_coverings_are_drawn_once():
    covering = Covering("paper")
    assert covering_texture(covering) is covering_texture(Covering("paper"))
