"""Datasets for detectors: COCO by COCO's own library, YOLO by the rules by which Ultralytics reads it."""

import io
import sys
from itertools import pairwise

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.errors import BankError, ConfigError, MissingExtraError
from cluttergen_jax.sensing import FIRST_OBJECT, View
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import Instance
from cluttergen_jax.views import detection
from cluttergen_jax.views.detection import DetectionFiles
from cluttergen_jax.views.maker import SeenScene
from cluttergen_jax.views.outlines import outline_of
from cluttergen_jax.views.shards import ViewSource
from tests.helpers.drawing import needs_gl
from tests.helpers.placing import seen_trio, write_bank

WIDTH = 64
HEIGHT = 48
LABELS = ("box", "prism", "tall")
SEEN = {"cameras": ("free:2",), "size": (WIDTH, HEIGHT), "seed": 3}
FORMS = ("coco", "yolo", "yolo-seg")


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("bank") / "bank", 3)


def tree(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def view_of(rng, shares=(0.3, 0.02, 0.0)):
    """A view with colours and masks by chance: many parts and holes, and an object that is not seen."""
    draw = rng.uniform(size=(HEIGHT, WIDTH))
    label = np.zeros((HEIGHT, WIDTH), np.int32)
    for index, (low, share) in enumerate(zip(np.cumsum([0, *shares]), shares, strict=False)):
        label[(low <= draw) & (draw < low + share)] = FIRST_OBJECT + index
    instances = []
    for index in range(len(shares)):
        visible = label == FIRST_OBJECT + index
        mask = visible | (rng.uniform(size=visible.shape) < 0.1)
        instances.append(Instance(mask, visible, int(mask.sum()) + 7, (-4, 60, 0, 47)))
    camera = Camera.looking(np.array([1.0, 0.2, 1.5]), np.zeros(3), WIDTH, HEIGHT, 60.0)
    rgb = rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    return View(np.ones((HEIGHT, WIDTH), np.float32), label, camera, rgb, tuple(instances))


def scene_of(number, rng):
    objects = seen_trio()
    return SeenScene(
        number, [asset.name for asset in objects], objects, rng.uniform(size=(3, 7)), None, None
    )


def write_by_hand(out, form, numbers=(0, 7)):
    """A dataset of views by chance; the views by the stem of their images."""
    files = DetectionFiles(out, form, LABELS)
    name = files.name_of("train", 0, 0)
    writer = files.writer(name, "train")
    views = {}
    for number in numbers:
        for camera in range(2):
            rng = np.random.default_rng([number, camera])
            view = view_of(rng)
            source = ViewSource("bank", 0, f"free-{camera}", camera, 2)
            writer.add(view, scene_of(number, rng), source)
            views[f"bank-{number:06d}-free-{camera}"] = view
    writer.finish()
    files.write_index({"train": [name], "test": []}, {"train": len(views), "test": 0})
    assert files.is_whole(name, len(views), None)
    return views


def coco_of(path):
    return pytest.importorskip("pycocotools.coco", reason="needs the extra coco").COCO(str(path))


def is_inside(polygon):
    """bool[H, W]: which pixels' middles a polygon f[P, 2] holds, by counting crossings."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    inside = np.zeros((HEIGHT, WIDTH), bool)
    for (x1, y1), (x2, y2) in pairwise([*polygon.tolist(), polygon[0].tolist()]):
        if y1 != y2:
            is_between = (y1 > y) != (y2 > y)
            inside ^= is_between & (x < x1 + (x2 - x1) * (y - y1) / (y2 - y1))
    return inside


def lines_of(path):
    """The rows of a label file: the class and its numbers."""
    rows = [line.split() for line in path.read_text().splitlines()]
    return [(int(row[0]), np.array(row[1:], float)) for row in rows]


def test_coco_has_each_mask_to_the_pixel(tmp_path):
    views = write_by_hand(tmp_path, "coco")
    coco = coco_of(tmp_path / "annotations" / "instances_train.json")
    assert [each["name"] for each in coco.loadCats(coco.getCatIds())] == list(LABELS)
    assert len(coco.imgs) == len(views) == 4
    for image in coco.loadImgs(coco.getImgIds()):
        view = views[image["file_name"].removesuffix(".png")]
        picture = Image.open(tmp_path / "images" / "train" / image["file_name"])
        assert picture.size == (image["width"], image["height"])
        np.testing.assert_array_equal(np.array(picture), view.rgb)
        np.testing.assert_allclose(image["T_world_camera"], view.camera.T_world_camera)
        np.testing.assert_allclose(image["K"], view.camera.K)
        assert [each["label"] for each in image["objects"]] == list(LABELS)
        annotations = coco.loadAnns(coco.getAnnIds(imgIds=image["id"]))
        # The third object is not seen, and its pose is there all the same.
        assert [each["object"] for each in annotations] == [0, 1]
        for each in annotations:
            instance = view.instances[each["object"]]
            assert each["category_id"] == each["object"] + 1
            assert each["attributes"]["name"] == LABELS[each["object"]]
            np.testing.assert_array_equal(coco.annToMask(each), instance.visible)
            whole = coco.annToMask({**each, "segmentation": each["segmentation_amodal"]})
            np.testing.assert_array_equal(whole, instance.mask)
            rows, columns = np.nonzero(instance.visible)
            box = [columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]
            assert each["bbox"] == box
            assert (each["area"], each["iscrowd"]) == (len(rows), 0)
            assert each["bbox_amodal"] == [-4, 0, 65, 48]
            assert each["visibility"] == pytest.approx(len(rows) / instance.num_pixels)
    empty = coco_of(tmp_path / "annotations" / "instances_test.json")
    assert (len(empty.imgs), len(empty.cats)) == (0, 3)


@pytest.mark.parametrize("form", ["yolo", "yolo-seg"])
def test_yolo_has_boxes_and_outlines_of_what_is_seen(form, tmp_path):
    views = write_by_hand(tmp_path, form)
    for stem, view in views.items():
        assert (tmp_path / "images" / "train" / f"{stem}.png").is_file()
        rows = lines_of(tmp_path / "labels" / "train" / f"{stem}.txt")
        assert [number for number, _ in rows] == [0, 1]
        for (_, numbers), instance in zip(rows, view.instances, strict=False):
            assert numbers.min() >= 0
            assert numbers.max() <= 1
            y, x = np.nonzero(instance.visible)
            corners = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1])
            if form == "yolo":
                box = numbers * [WIDTH, HEIGHT, WIDTH, HEIGHT]
                found = np.concatenate([box[:2] - box[2:] / 2, box[:2] + box[2:] / 2])
                np.testing.assert_allclose(found, corners, atol=1e-4)
                continue
            polygon = numbers.reshape(-1, 2) * [WIDTH, HEIGHT]
            np.testing.assert_array_equal(is_inside(polygon), instance.visible)
            found = np.concatenate([polygon.min(0), polygon.max(0)])
            np.testing.assert_allclose(found, corners, atol=0.02)
    told = yaml.safe_load((tmp_path / "data.yaml").read_text())
    # Training looks for `val`, which this dataset has not; an empty `test` is none.
    assert told == {
        "train": "images/train",
        "val": "images/train",
        "test": None,
        "names": {0: "box", 1: "prism", 2: "tall"},
    }


def shape_of(name):
    mask = np.zeros((HEIGHT, WIDTH), bool)
    if name == "pixel":
        mask[0, 0] = True
    elif name == "line":
        mask[-1] = True
    elif name == "whole":
        mask[:] = True
    elif name == "grid":
        mask[2:-2, 2:-2] = True
        mask[4::5, 4::5] = False
    elif name == "diagonal":
        mask[np.arange(HEIGHT), np.arange(HEIGHT)] = True
    elif name == "ring in a ring":
        for first in (2, 6, 10):
            mask[first : HEIGHT - first, first : WIDTH - first] ^= True
    return mask


@pytest.mark.parametrize("name", ["pixel", "line", "whole", "grid", "diagonal", "ring in a ring"])
def test_an_outline_holds_the_mask_and_nothing_else(name):
    mask = shape_of(name)
    polygon = outline_of(mask)
    np.testing.assert_array_equal(is_inside(polygon), mask)
    # Where readers fill from corners rounded down, these are pixels of the mask.
    x, y = np.floor(polygon).astype(int).T
    assert mask[y, x].all()
    assert len(polygon) >= 3


@pytest.mark.parametrize("form", FORMS)
def test_a_file_that_is_damaged_or_gone_is_noticed(form, tmp_path):
    write_by_hand(tmp_path, form)
    files = DetectionFiles(tmp_path, form, LABELS)
    name = files.name_of("train", 0, 0)
    for path in (tmp_path / name, next((tmp_path / "images" / "train").iterdir())):
        whole = path.read_bytes()
        path.write_bytes(whole[:-9] + bytes(9))
        assert not files.is_whole(name, 4, None)
        path.unlink()
        assert not files.is_whole(name, 4, None)
        path.write_bytes(whole)
        assert files.is_whole(name, 4, None)
    assert not files.is_whole(name, 5, None)
    assert not files.is_whole(name, 4, "another")


@needs_gl
def test_coco_is_what_the_cameras_see_and_grows_without_a_change(bank, tmp_path):
    asked = {**SEEN, "splits": "train=0.6, test=0.4", "form": "coco"}
    out = tmp_path / "set"
    first = cg.make_dataset(bank.path, out, num_scenes=2, **asked)
    assert first.num_views == {"train": 2, "test": 2}
    before = tree(out / "images")
    known = {
        split: coco_of(out / "annotations" / f"instances_{split}.json") for split in first.num_views
    }
    other = write_bank(tmp_path / "other", 2, seed=1)
    made = cg.make_dataset([bank.path, other.path], out, **asked)
    assert sum(made.num_views.values()) == 10
    assert "without    depth" in str(made)
    assert before.items() <= tree(out / "images").items()
    plain = cg.make_dataset(
        [bank.path, other.path], tmp_path / "plain", colour=False, **{**SEEN, "splits": "train"}
    )
    rows = {
        (row["bank"], row["scene"], row["camera"]): row
        for file in plain.path.glob("*.parquet")
        for row in pq.read_table(file).to_pylist()
    }
    numbers = []
    for split in made.num_views:
        coco = coco_of(out / "annotations" / f"instances_{split}.json")
        for kind in ("imgs", "anns", "cats"):
            assert getattr(known[split], kind).items() <= getattr(coco, kind).items()
        numbers += [*coco.imgs]
        assert len(coco.imgs) == made.num_views[split]
        for number, image in coco.imgs.items():
            row = rows.pop((image["bank"], image["scene"], image["camera"]))
            label = np.array(Image.open(io.BytesIO(row["label"]["bytes"])))
            seen = np.zeros_like(label)
            for each in coco.loadAnns(coco.getAnnIds(imgIds=number)):
                seen[coco.annToMask(each) > 0] = FIRST_OBJECT + each["object"]
                assert each["bbox"] == row["box_visible"][each["object"]]
                assert each["bbox_amodal"] == row["box_amodal"][each["object"]]
            np.testing.assert_array_equal(seen, np.where(label >= FIRST_OBJECT, label, 0))
            np.testing.assert_allclose([each["pose"] for each in image["objects"]], row["poses"])
    assert not rows
    assert len(set(numbers)) == len(numbers)
    with pytest.raises(BankError, match="holds views made with another banks"):
        cg.make_dataset(other.path, out, **asked)


@needs_gl
def test_yolo_goes_on_after_an_end_at_any_file(bank, tmp_path, monkeypatch):
    asked = {**SEEN, "form": "yolo-seg", "cameras": ("overhead",)}
    whole = cg.make_dataset(bank.path, tmp_path / "whole", **asked)
    assert "val        is train" in str(whole)
    out = tmp_path / "cut"
    write = detection.write_atomically

    def write_some(path, data):
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        write(path, data)

    written = []
    with monkeypatch.context() as patched:
        patched.setattr(detection, "write_atomically", write_some)
        with pytest.raises(KeyboardInterrupt):
            cg.make_dataset(bank.path, out, **asked)
    # No image without its labels, which would be one of nothing.
    assert {path.parts[-3] for path in written} == {"labels", "images"}
    assert written[0].parts[-3] == "labels"
    assert not (out / "data.yaml").exists()
    cg.make_dataset(bank.path, out, **asked)
    assert tree(out) == tree(whole.path)


@pytest.mark.parametrize("form", FORMS)
def test_detectors_need_colours(form, bank, tmp_path):
    with pytest.raises(ConfigError, match=rf"form = '{form}' without colours"):
        cg.make_dataset(bank.path, tmp_path / "set", form=form, colour=False, **SEEN)
    assert not (tmp_path / "set").exists()


@needs_gl
def test_coco_names_its_extra_where_it_is_missing(bank, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycocotools", None)
    monkeypatch.setitem(sys.modules, "pycocotools.mask", None)
    with pytest.raises(MissingExtraError, match=r"'\.\[coco\]'"):
        cg.make_dataset(bank.path, tmp_path / "set", form="coco", **SEEN)
    assert not (tmp_path / "set").exists()
