"""Scenes, banks and pools that show themselves: pictures, notebooks, a viewer that does not wait."""

import base64
import io
import re
import sys
import urllib.error
import urllib.request
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import Pool
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import BankError, ConfigError, PoolError
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.rendering.gl import RendererError
from tests.helpers import banks
from tests.helpers.drawing import needs_gl

QUICK = {"size": "96x72", "samples": 1}
NUM_SCENES = 6


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The folder of a bank of six scenes, of which number 3 fails."""
    path = tmp_path_factory.mktemp("display") / "bank"
    region = {"center": [0.05, 0.0], "half_extents": [0.2, 0.25], "yaw": 0.25}
    rules = {"relations": ["box left_of prism"], "natural": True, "seat": "+x"}
    recipe = banks.RECIPE | {"region": region, "placement": rules}
    with banks.writer(path, NUM_SCENES, recipe) as writer:
        writer.write_block(0, banks.rows(0, NUM_SCENES))
    return path


@pytest.fixture
def bank(path):
    return cg.read_bank(path)


def pixels(image):
    assert isinstance(image, Image.Image)
    return np.asarray(image)


def drawn(report):
    """The pixels of the only picture that `render` made."""
    assert not report.failures
    (file,) = report.paths
    return np.asarray(Image.open(file))


def without_gl(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")


# A bank is a sequence of scenes.


def test_a_bank_has_each_of_its_scenes_by_number(bank):
    assert len(bank) == NUM_SCENES
    scenes = list(bank)
    rows = list(bank.scenes())
    assert [each.origin.index for each in scenes] == list(range(NUM_SCENES))
    for number, row in enumerate(rows):
        scene = bank[number]
        assert (scene.names, scene.origin.verdict) == (row.objects, row.verdict)
        assert scene.origin.is_success == row.is_success
        np.testing.assert_allclose(scene.poses, row.poses, atol=1e-7)
    assert [scene.origin.index for scene in cg.read_scenes(bank)] == [0, 1, 2, 4, 5]
    assert bank[-1].origin.index == NUM_SCENES - 1
    assert [each.origin.index for each in bank[1:6:2]] == [1, 3, 5]
    assert bank[np.int32(2)].origin.index == 2


def test_a_scene_of_a_bank_knows_what_was_asked_for(bank):
    assert bank[0].region == Rectangle((0.05, 0.0), (0.2, 0.25), 0.25)
    assert (bank[0].seat, bank[0].has_sides) == ("+x", True)


def test_a_bank_refuses_numbers_of_no_scene(bank):
    for number in (NUM_SCENES, -NUM_SCENES - 1):
        with pytest.raises(BankError, match=f"no scene {number}.*0 to 5"):
            bank[number]
    with pytest.raises(TypeError):
        bank["3"]
    with pytest.raises(TypeError):
        bank[1.0]


def test_an_unfinished_bank_says_which_scene_is_not_there_yet(tmp_path):
    with banks.writer(tmp_path / "bank", 300) as writer:
        writer.write_block(0, banks.rows(0))
    bank = cg.read_bank(tmp_path / "bank")
    assert len(bank) == 300
    assert bank[255].origin.index == 255
    with pytest.raises(BankError, match=r"scene 256 is not there yet.*generate"):
        bank[256]


def test_a_loaded_bank_has_the_scenes_that_succeeded(path, bank):
    arrays = cg.load_bank(path)
    assert [each.origin.index for each in arrays] == [0, 1, 2, 4, 5]
    assert arrays[3].origin.index == 4
    np.testing.assert_array_equal(arrays[-1].poses, bank[5].poses)
    assert [each.origin.index for each in arrays[:2]] == [0, 1]
    with pytest.raises(ConfigError, match=r"scene 5.*0 to 4"):
        arrays[5]
    with pytest.raises(ConfigError, match="of one scene"):
        arrays.scene(0)[0]
    with pytest.raises(ConfigError, match="in compiled code"):
        jax.jit(lambda bank: bank[0])(arrays)


def test_a_bank_goes_where_its_folder_goes(path, bank, tmp_path):
    cg.export(bank, tmp_path / "value")
    cg.export(path, tmp_path / "folder")
    files = [
        sorted(each.relative_to(root) for each in root.rglob("*.xml"))
        for root in (tmp_path / "value", tmp_path / "folder")
    ]
    assert files[0] == files[1]
    assert len(files[0]) >= NUM_SCENES - 1


# Pictures are those of `render`.


@needs_gl
@pytest.mark.parametrize(
    "options",
    [{}, {"whole": True}, {"hulls": True}, {"view": CameraView(azimuth=10)}],
)
def test_a_picture_of_a_scene_is_what_render_draws(path, bank, tmp_path, options):
    report = cg.render(f"{path}:2", tmp_path, **QUICK, **options)
    np.testing.assert_array_equal(pixels(bank[2].picture(**QUICK, **options)), drawn(report))


@needs_gl
def test_a_camera_is_drawn_for_a_scene_as_render_draws_it(path, bank, tmp_path):
    asked = {**QUICK, "seed": 3}
    report = cg.render(f"{path}:2", tmp_path, cameras=["free"], **asked)
    seen = pixels(bank[2].picture(camera="free", **asked))
    np.testing.assert_array_equal(seen, drawn(report))
    assert not np.array_equal(seen, pixels(bank[2].picture(camera="free", **(asked | {"seed": 4}))))
    with pytest.raises(ConfigError, match=r"2 pictures.*one"):
        bank[2].picture(camera="free:2", **QUICK)


@needs_gl
def test_a_scene_that_failed_is_drawn_too(path, bank, tmp_path):
    report = cg.render(f"{path}:3", tmp_path, **QUICK)
    np.testing.assert_array_equal(pixels(bank[3].picture(**QUICK)), drawn(report))


@needs_gl
def test_a_sheet_is_what_render_draws(path, bank, tmp_path):
    asked = {**QUICK, "columns": 2, "scenes": "0-3"}
    report = cg.render(path, tmp_path / "named", picture=False, sheet=True, columns=2, **QUICK)
    np.testing.assert_array_equal(pixels(bank.sheet(columns=2, **QUICK)), drawn(report))
    arrays = cg.load_bank(path)
    np.testing.assert_array_equal(pixels(arrays.sheet(columns=2, **QUICK)), drawn(report))
    assert bank.sheet(**asked).size[1] < bank.sheet(columns=2, **QUICK).size[1]


@needs_gl
def test_scenes_that_are_handed_over_are_all_drawn(bank, tmp_path):
    report = cg.render([bank[0], bank[4]], tmp_path, **QUICK)
    assert [file.name for file in report.paths] == ["scenes-000000.png", "scenes-000001.png"]
    for file, number in zip(report.paths, (0, 4), strict=True):
        np.testing.assert_array_equal(
            np.asarray(Image.open(file)), pixels(bank[number].picture(**QUICK))
        )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"turntable": True}, r"picture\(turntable=\.\.\.\).*quality.*render\(\.\.\., turntable"),
        ({"scenes": [1]}, r"picture\(scenes"),
        ({"cameras": ["free"]}, "Did you mean 'camera'"),
        ({"qualty": "fine"}, "Did you mean 'quality'"),
        ({"quality": "worst"}, "worst.*draft"),
        ({"size": "3x"}, "size"),
    ],
)
def test_what_is_not_of_one_picture_is_refused(bank, options, said):
    with pytest.raises(ConfigError, match=said):
        bank[0].picture(**options)


def test_what_is_not_of_a_sheet_is_refused(bank):
    with pytest.raises(ConfigError, match=r"sheet\(camera"):
        bank.sheet(camera="free")
    with pytest.raises(BankError, match="no scene 9"):
        bank.sheet(scenes=[9])


@pytest.mark.parametrize("given", [[], [1], 3, SimpleNamespace(is_success=True)])
def test_what_is_no_scene_is_refused_as_a_source(given, tmp_path):
    with pytest.raises(ConfigError, match="`Scene`"):
        cg.render(given, tmp_path / "out")
    assert not list(tmp_path.glob("out/*.png"))


# In a notebook.


def images_in(html):
    """The pictures within a page."""
    found = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    return [Image.open(io.BytesIO(base64.b64decode(each))) for each in found]


@needs_gl
def test_a_notebook_shows_a_scene_as_a_png(bank):
    data = bank[0]._repr_png_()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    assert Image.open(io.BytesIO(data)).size == (640, 480)


@needs_gl
def test_a_notebook_shows_a_bank_with_figures_and_pictures(path, bank):
    page = bank._repr_html_()
    (image,) = images_in(page)
    assert image.size[0] > 3 * 240
    text = re.sub(r"<[^>]*>", " ", page)
    assert "6, of which 5 succeed" in text
    assert {"trio", "made up"} <= {part.strip() for part in re.split(r"\s{2,}", text)}
    assert cg.load_bank(path)._repr_html_() == page
    assert cg.load_bank(path).scene(0)._repr_html_() is None


@needs_gl
def test_a_bank_whose_scenes_all_failed_shows_these(tmp_path):
    with banks.writer(tmp_path / "<b>", 1) as writer:
        rows = banks.rows(0, 1).to_pylist()[0] | {"is_success": False, "verdict": "displaced"}
        writer.write_block(0, banks.rows(0, 1).from_pylist([rows], schema=banks.SCHEMA))
    page = cg.read_bank(tmp_path / "<b>")._repr_html_()
    assert "1, of which 0 succeed" in page
    assert len(images_in(page)) == 1
    assert "<b>Bank &lt;b&gt;</b>" in page


@needs_gl
def test_a_pool_shows_its_objects(pool, bank):
    found = cg.load_pool(pool)
    page = found._repr_html_()
    assert f"{len(found)} objects" in page
    assert repr(found) == "Pool('trio', 3 objects: box, prism, tall)"
    assert len(images_in(page)) == 1
    one = found.sheet(objects=found.names[:1], samples=1)
    assert found.sheet(columns=1, samples=1).size[1] > 2 * one.size[1]


def test_a_pool_refuses_objects_and_options_that_it_has_not(pool):
    found = cg.load_pool(pool)
    with pytest.raises(PoolError, match="no object 'mugg'"):
        found.sheet(objects=["mugg"])
    with pytest.raises(ConfigError, match="sequence of names"):
        found.sheet(objects=found.names[0])
    with pytest.raises(ConfigError, match=r"sheet\(size"):
        found.sheet(size="1x1")
    with pytest.raises(ConfigError, match="columns = 0"):
        found.sheet(columns=0)
    many = Pool("many", [replace(found.objects[0], name=f"object_{each}") for each in range(201)])
    with pytest.raises(ConfigError, match=r"all 201 objects.*up to 200.*objects=pool\.names"):
        many.sheet()


def test_without_opengl_a_picture_is_refused_and_a_notebook_says_why(bank, pool, monkeypatch):
    without_gl(monkeypatch)
    with pytest.raises(RendererError, match="MUJOCO_GL"):
        bank[0].picture()
    with pytest.raises(RendererError, match="MUJOCO_GL"):
        bank.sheet()
    with pytest.warns(UserWarning, match="no picture of the scene.*MUJOCO_GL"):
        assert bank[0]._repr_png_() is None
    for page in (bank._repr_html_(), cg.load_pool(pool)._repr_html_()):
        assert "No pictures: " in page
        assert "MUJOCO_GL" in page
        assert not images_in(page)
    assert "6, of which 5 succeed" in bank._repr_html_()


def test_a_scene_of_no_bank_is_shown_too(bank):
    scene = cg.Scene(bank[0].names, bank[0].objects, bank[0].poses, bank[0].support)
    assert (scene.region, scene.seat, scene.has_sides) == (None, "", False)
    model = scene.to_mjspec().compile()
    assert model.nbody == 2 + len(scene.names)


# The viewer.


def answer(url):
    """The status of a request, None where nobody answers."""
    try:
        with urllib.request.urlopen(url, timeout=20) as found:
            return found.status
    except urllib.error.HTTPError as error:
        return error.code
    except OSError:
        return None


@pytest.fixture
def lines():
    pytest.importorskip("viser", reason="needs the extra viewer")
    return []


def open_quietly(source, lines, **options):
    return cg.view(source, port=0, browser=False, show=lines.append, **options)


@pytest.mark.parametrize("kind", ["path", "bank", "scene", "scenes"])
def test_a_viewer_need_not_wait(path, bank, lines, kind):
    source = {"path": path, "bank": bank, "scene": bank[1], "scenes": [bank[0], bank[1]]}[kind]
    with open_quietly(source, lines, block=False) as viewer:
        assert answer(viewer.url) == 200
        assert viewer.url in repr(viewer)
        assert any(viewer.url in line and "close()" in line for line in lines)
        assert f'<iframe src="{viewer.url}"' in viewer._repr_html_()
    assert answer(viewer.url) is None
    assert "closed" in repr(viewer)
    assert "<iframe" not in viewer._repr_html_()
    viewer.close()


def test_a_notebook_is_not_made_to_wait_and_opens_no_browser(bank, lines, monkeypatch):
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    with bank[0].show(show=lines.append) as viewer:
        assert answer(viewer.url) == 200
    assert not opened


def test_a_viewer_that_waits_ends_with_ctrl_c(bank, lines, monkeypatch):
    class Waiting:
        def wait(self):
            raise KeyboardInterrupt

    monkeypatch.setattr(
        "cluttergen_jax.generation.sources.viewing.threading", SimpleNamespace(Event=Waiting)
    )
    assert bank.show(browser=False, show=lines.append) is None
    assert lines[-1].endswith("ended")


def test_a_viewer_that_cannot_be_opened_says_why(bank, lines):
    with open_quietly(bank, lines, block=False) as viewer:
        port = viewer.server.get_port()
        with pytest.raises(ConfigError, match=rf"{port} cannot be listened on.*port=0"):
            cg.view(bank, port=port, block=False, show=lines.append)
    with pytest.raises(ConfigError, match="block=False with native=True"):
        cg.view(bank, native=True, block=False)
    with pytest.raises(ConfigError, match="scenes of int"):
        cg.view(3, block=False, port=0, show=lines.append)
