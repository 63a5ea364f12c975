"""Datasets of views: what they hold is what cameras see, whoever makes them and in whatever order."""

import io
import json
import tarfile
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.api.render import parse_splits
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene.bank.scene import read_scenes
from cluttergen_jax.sensing import parse_cameras
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import InstanceSensor
from cluttergen_jax.views import dataset as plans
from cluttergen_jax.views.dataset import ViewConfig
from tests.helpers.drawing import needs_gl
from tests.helpers.placing import write_bank

SIZE = (64, 48)
PLAIN = {"cameras": ("free:2", "overhead"), "size": SIZE, "colour": False, "seed": 3}


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("bank") / "bank", 5)


@pytest.fixture(scope="module")
def plain(bank, tmp_path_factory):
    return cg.make_dataset(bank.path, tmp_path_factory.mktemp("sets") / "plain", **PLAIN)


def rows_of(dataset, split="train"):
    files = sorted(dataset.path.glob(f"{split}-*.parquet"))
    return [row for file in files for row in pq.read_table(file).to_pylist()]


def image(cell):
    """Of a cell of a row, or of the bytes of a file."""
    return np.array(Image.open(io.BytesIO(cell if isinstance(cell, bytes) else cell["bytes"])))


def test_a_view_is_what_its_camera_sees(bank, plain):
    assert plain.num_views == {"train": 15}
    rows = rows_of(plain)
    assert [(row["scene"], row["camera"]) for row in rows] == [
        (scene, camera) for scene in range(5) for camera in ("free-0", "free-1", "overhead")
    ]
    scenes = {scene.origin.index: scene for scene in read_scenes(bank)}
    for row in rows[::4]:
        scene = scenes[row["scene"]]
        camera = Camera(
            *SIZE, np.reshape(row["K"], (3, 3)), np.reshape(row["T_world_camera"], (4, 4))
        )
        seen, instances = InstanceSensor(scene.objects, scene.support).sense(scene.poses, camera)
        np.testing.assert_array_equal(image(row["label"]), seen.label)
        depth = np.where(np.isfinite(seen.depth), np.round(1000 * seen.depth), 0)
        np.testing.assert_array_equal(image(row["depth"]), depth)
        assert row["names"] == list(scene.names)
        np.testing.assert_allclose(row["poses"], scene.poses)
        for place, each in enumerate(instances):
            np.testing.assert_array_equal(image(row["amodal"][place]), each.mask)
            assert row["visible"][place] == pytest.approx(each.visible_share)
            left, top, width, height = row["box_visible"][place]
            is_in_box = np.zeros(SIZE[::-1], bool)
            is_in_box[top : top + height, left : left + width] = True
            assert np.array_equal(is_in_box & (seen.label == 2 + place), seen.label == 2 + place)
    fixed = {tuple(row["T_world_camera"]) for row in rows if row["camera"] == "overhead"}
    drawn = {tuple(row["T_world_camera"]) for row in rows if row["camera"] != "overhead"}
    assert (len(fixed), len(drawn)) == (1, 10)


def test_what_is_missing_is_made_and_nothing_else(bank, plain, tmp_path):
    out = tmp_path / "set"
    cg.make_dataset(bank.path, out, num_scenes=2, **PLAIN)
    again = cg.make_dataset(bank.path, out, **PLAIN)
    assert rows_of(again) == rows_of(plain)
    (file,) = out.glob("*.parquet")
    before = file.stat().st_mtime_ns
    cg.make_dataset(bank.path, out, **PLAIN)
    assert file.stat().st_mtime_ns == before
    whole = file.read_bytes()
    for damaged in (whole[:-200], whole[:5000] + bytes(8) + whole[5008:]):
        file.write_bytes(damaged)
        assert rows_of(cg.make_dataset(bank.path, out, **PLAIN)) == rows_of(plain)
    # Nothing goes where fewer are asked for.
    fewer = cg.make_dataset(bank.path, out, num_scenes=1, **PLAIN)
    assert fewer.num_views == {"train": 15}
    assert file.read_bytes() == whole
    with pytest.raises(BankError, match=r"2 of its scenes stand\. Allowed: at least the 5"):
        cg.make_dataset(write_bank(tmp_path / "bank", 2).path, out, **PLAIN)
    for changed in (
        {"seed": 4},
        {"size": (32, 32)},
        {"form": "webdataset"},
        {"form": "bop"},
        {"splits": "val"},
    ):
        with pytest.raises(BankError, match="holds views made with another"):
            cg.make_dataset(bank.path, out, **(PLAIN | changed))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    with pytest.raises(BankError, match="no views"):
        cg.make_dataset(bank.path, tmp_path / "other", **PLAIN)


def test_scenes_keep_their_split_and_none_is_in_two(bank, plain, tmp_path):
    grown = {"splits": "train=0.6, test=0.4", **PLAIN}

    def scenes_of(dataset):
        return {
            split: {row["scene"] for row in rows_of(dataset, split)} for split in ("train", "test")
        }

    part = scenes_of(cg.make_dataset(bank.path, tmp_path / "set", num_scenes=3, **grown))
    whole = cg.make_dataset(bank.path, tmp_path / "set", **grown)
    now = scenes_of(whole)
    assert [len(part[split]) for split in ("train", "test")] == [2, 1]
    assert [len(now[split]) for split in ("train", "test")] == [3, 2]
    assert now["train"].isdisjoint(now["test"])
    assert all(part[split] <= now[split] for split in part)
    made = rows_of(whole) + rows_of(whole, "test")
    assert sorted(made, key=lambda row: row["scene"]) == rows_of(plain)
    assert scenes_of(cg.make_dataset(bank.path, tmp_path / "set", num_scenes=1, **grown)) == now


def plan_of_banks(sizes, shares, monkeypatch, seed=0, rounds=None, **more):
    """The plan of a dataset of banks, each of so many scenes that all stand."""
    tables = {
        f"bank{place}": pa.table({"index": np.arange(size), "is_success": np.ones(size, bool)})
        for place, size in enumerate(sizes)
    }
    monkeypatch.setattr(
        plans, "read_bank", lambda path: SimpleNamespace(tables=lambda columns: [tables[path]])
    )
    config = ViewConfig(parse_cameras(["overhead"], None), seed)
    return plans.DatasetPlan.of(list(tables), shares, None, config, (), rounds, **more)


def plan_of(index, is_success, shares, seed=0, num_scenes=None, rounds=(), monkeypatch=None):
    """The plan of a dataset of a bank of which only these numbers are known."""
    table = pa.table({"index": index, "is_success": is_success})
    monkeypatch.setattr(
        plans, "read_bank", lambda path: SimpleNamespace(tables=lambda columns: [table])
    )
    config = ViewConfig(parse_cameras(["overhead"], None), seed)
    return plans.DatasetPlan.of(["bank"], shares, num_scenes, config, (), rounds)


def split_of(plan):
    return {
        scene: split
        for shard in plan.shards
        for split, some in shard.scenes.items()
        for scene in some
    }


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("number", "shares", "counts"),
    [
        (7, {"train": 0.7, "test": 0.3}, (5, 2)),
        (100, {"train": 0.8, "val": 0.1, "test": 0.1}, (80, 10, 10)),
        (7, {"train": 0.8, "val": 0.1, "test": 0.1}, (5, 1, 1)),
        (1, {"train": 0.5, "test": 0.5}, (1, 0)),
    ],
)
def test_shares_of_scenes_are_exact(number, shares, counts, seed, monkeypatch):
    plan = plan_of(np.arange(number), np.ones(number, bool), shares, seed, monkeypatch=monkeypatch)
    assert tuple(plan.num_views().values()) == counts
    again = plan_of(np.arange(number), np.ones(number, bool), shares, seed, monkeypatch=monkeypatch)
    assert split_of(plan) == split_of(again)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("sizes", "shares", "counts"),
    [
        ((1,) * 7, {"train": 0.7, "test": 0.3}, (5, 2)),
        ((2, 5), {"train": 0.7, "test": 0.3}, (5, 2)),
        ((2, 2, 2, 2), {"train": 0.8, "val": 0.1, "test": 0.1}, (6, 1, 1)),
        ((100, 3), {"train": 0.9, "test": 0.1}, (93, 10)),
    ],
)
def test_shares_are_exact_of_all_banks_together(sizes, shares, counts, seed, monkeypatch):
    plan = plan_of_banks(sizes, shares, monkeypatch, seed)
    assert tuple(plan.num_views().values()) == counts
    for bank, size in enumerate(sizes):
        for split, share in shares.items():
            number = sum(
                len(each.scenes.get(split, ())) for each in plan.shards if each.bank == bank
            )
            assert abs(number - share * size) < 2


def test_banks_that_come_and_grow_leave_each_scene_in_its_split(monkeypatch):
    shares = {"train": 0.7, "test": 0.3}
    rounds = None
    before = {}
    for sizes in ((3,), (3, 1), (5, 1, 2), (5, 1, 2), (20, 30, 2)):
        plan = plan_of_banks(sizes, shares, monkeypatch, rounds=rounds)
        rounds = plan.rounds
        now = {
            (shard.bank, scene): split
            for shard in plan.shards
            for split, some in shard.scenes.items()
            for scene in some
        }
        assert before.items() <= now.items()
        assert len(now) == sum(sizes)
        assert plan.num_views() == {
            "train": round(0.7 * len(now)),
            "test": len(now) - round(0.7 * len(now)),
        }
        before = now


def test_shares_of_each_bank_are_those_of_datasets_that_were_made_so(monkeypatch):
    shares = {"train": 0.7, "test": 0.3}
    plan = plan_of_banks((1,) * 7, shares, monkeypatch, shares_are="exact")
    assert plan.num_views() == {"train": 7, "test": 0}
    both = plan_of_banks((10, 20), shares, monkeypatch, shares_are="exact")
    alone = plan_of_banks((10,), shares, monkeypatch)
    assert (
        split_of(alone).items()
        <= split_of(
            SimpleNamespace(shards=[each for each in both.shards if each.bank == 0])
        ).items()
    )


def test_a_dataset_whose_splits_were_drawn_goes_on_by_draws(bank, tmp_path):
    asked = {"splits": "train=0.6, test=0.4", **PLAIN, "cameras": ("overhead",)}
    # As the first versions wrote it: no word of shares, and only the number of scenes.
    shares = {"train": 0.6, "test": 0.4}
    config = ViewConfig(parse_cameras(["overhead"], SIZE), 3, colour=False)
    made = plans.DatasetPlan.of([bank.path], shares, 3, config, shares_are="drawn")
    (tmp_path / "set").mkdir()
    plans.VIEWS.write_record(
        tmp_path / "set", {"recipe": made.recipe() | {"form": "parquet"}, "num_scenes": [3]}
    )
    whole = cg.make_dataset(bank.path, tmp_path / "set", **asked)
    found = {row["scene"]: split for split in shares for row in rows_of(whole, split)}
    # Each scene's draw: of the seed, the bank's place, its number, and the number of this draw.
    drawn = [np.random.default_rng([3, 0, scene, 11]).uniform() for scene in range(5)]
    assert found == {scene: "train" if draw < 0.6 else "test" for scene, draw in enumerate(drawn)}
    assert "shares_are" not in plans.VIEWS.read_record(tmp_path / "set")["recipe"]


def test_a_seed_decides_which_scenes_are_where(monkeypatch):
    def split(seed):
        plan = plan_of(
            np.arange(40),
            np.ones(40, bool),
            {"train": 0.5, "test": 0.5},
            seed,
            monkeypatch=monkeypatch,
        )
        return tuple(split_of(plan).items())

    assert len({split(seed) for seed in range(8)}) == 8


def test_no_scene_changes_its_split_when_blocks_come_between_or_after(monkeypatch):
    shares = {"train": 0.75, "val": 0.15, "test": 0.1}
    rng = np.random.default_rng(0)
    good = rng.uniform(size=1000) < 0.6
    rounds = ()
    before = {}
    for index in (
        np.arange(100, 200),
        np.arange(400),
        np.r_[700:1000, :400],
        np.arange(1000),
    ):
        plan = plan_of(index, good[index], shares, rounds=rounds, monkeypatch=monkeypatch)
        now = split_of(plan)
        rounds = plan.rounds
        assert now.keys() == set(index[good[index]].tolist())
        assert before.items() <= now.items()
        for split, share in shares.items():
            assert abs(plan.num_views()[split] - share * len(now)) < 1
        before = now
    assert (
        rounds == plan_of(index, good[index], shares, rounds=rounds, monkeypatch=monkeypatch).rounds
    )


def test_two_banks_are_two(bank, tmp_path):
    other = write_bank(tmp_path / "other", 2, seed=1)
    both = cg.make_dataset([bank.path, other.path], tmp_path / "both", **PLAIN)
    assert both.num_views == {"train": 21}
    assert {row["bank"] for row in rows_of(both)} == {"bank", "other"}
    alone = cg.make_dataset(bank.path, tmp_path / "grown", **PLAIN)
    before = rows_of(alone)
    grown = cg.make_dataset([bank.path, other.path], tmp_path / "grown", **PLAIN)
    assert rows_of(grown) == rows_of(both)
    assert rows_of(grown)[: len(before)] == before
    with pytest.raises(BankError, match="made with another banks"):
        cg.make_dataset([other.path, bank.path], tmp_path / "grown", **PLAIN)
    twin = write_bank(tmp_path / "twin" / "bank", 2)
    with pytest.raises(ConfigError, match="no two folders of one name"):
        cg.make_dataset([bank.path, twin.path], tmp_path / "twins", **PLAIN)
    with pytest.raises(ConfigError, match="each bank once"):
        cg.make_dataset([bank.path, bank.path], tmp_path / "twice", **PLAIN)


def test_tar_files_have_what_rows_have(bank, plain, tmp_path):
    tarred = cg.make_dataset(bank.path, tmp_path / "tars", form="webdataset", **PLAIN)
    (file,) = tarred.path.glob("*.tar")
    row = rows_of(plain)[1]
    with tarfile.open(file) as tar:
        names = tar.getnames()
        key = "bank-000000-free-1"
        own = [name.removeprefix(f"{key}.") for name in names if name.startswith(f"{key}.")]
        assert own == [
            "depth.png16",
            "label.png",
            *(f"amodal-{k:03d}.png" for k in range(3)),
            "json",
        ]
        assert tar.extractfile(f"{key}.depth.png16").read() == row["depth"]["bytes"]
        told = json.load(tar.extractfile(f"{key}.json"))
    assert told == {name: value for name, value in row.items() if name in told}
    # Files of one view follow each other, as the readers of such files need it.
    keys = [name.split(".")[0] for name in names]
    assert (
        len([k for k, each in enumerate(keys) if k == 0 or keys[k - 1] != each])
        == len(set(keys))
        == 15
    )


def test_bop_has_the_cameras_that_are_asked_for(bank, tmp_path):
    made = cg.make_dataset(bank.path, tmp_path / "bop", form="bop", num_scenes=2, **PLAIN)
    assert made.num_views == {"train": 6}
    told = json.loads((made.path / "train" / "000001" / "scene_camera.json").read_text())
    assert len(told) == 3
    assert (made.path / "train" / "000001" / "mask_visib" / "000002_000001.png").is_file()
    each = {"eye": [1, 0, 1], "width": 64}
    cameras = tmp_path / "cameras.json"
    cameras.write_text(
        json.dumps({"cameras": [{"name": "a", **each}, {"name": "b", **each, "height": 64}]})
    )
    with pytest.raises(ConfigError, match="cameras of different sizes"):
        cg.make_dataset(bank.path, tmp_path / "sizes", form="bop", cameras=[cameras], colour=False)


@needs_gl
def test_colours_vary_as_asked_and_do_not_depend_on_other_scenes(bank, tmp_path):
    asked = {"cameras": ("overhead",), "size": SIZE, "seed": 3}
    plain, varied = (
        [
            image(row["rgb"])
            for row in rows_of(cg.make_dataset(bank.path, tmp_path / name, **asked, **more))
        ]
        for name, more in (("plain", {}), ("varied", {"vary": ("texture", "light", "colour")}))
    )
    assert all(each.shape == (48, 64, 3) for each in plain)
    corner = np.array([each[0, 0] for each in plain]).astype(int)
    assert np.ptp(corner, axis=0).max() <= 2
    assert np.ptp(np.array([each[0, 0] for each in varied]).astype(int), axis=0).max() > 20
    alone = cg.make_dataset(
        bank.path, tmp_path / "alone", num_scenes=1, vary=("texture", "light", "colour"), **asked
    )
    np.testing.assert_array_equal(image(rows_of(alone)[0]["rgb"]), varied[0])


@needs_gl
def test_bop_varies_what_is_asked_for_and_nothing_else(bank, tmp_path):
    asked = {"cameras": ("free:2",), "size": SIZE, "seed": 3, "form": "bop", "num_scenes": 2}
    plain = cg.make_dataset(bank.path, tmp_path / "plain", **asked).path / "train"
    vary = ("texture", "light", "colour")
    varied = cg.make_dataset(bank.path, tmp_path / "varied", vary=vary, **asked).path / "train"
    files = {each.relative_to(plain) for each in plain.rglob("*") if each.is_file()}
    assert files == {each.relative_to(varied) for each in varied.rglob("*") if each.is_file()}
    differing = {
        each for each in files if (plain / each).read_bytes() != (varied / each).read_bytes()
    }
    colours = {each for each in files if each.parent.name == "rgb"}
    assert differing == colours | {each for each in files if each.name == "origin.json"}
    again = cg.make_dataset(bank.path, tmp_path / "again", vary=vary, **asked).path / "train"
    assert all((varied / each).read_bytes() == (again / each).read_bytes() for each in files)
    origin = json.loads((varied / "000000" / "origin.json").read_bytes())
    assert origin["settings"]["vary"] == "colour, light, texture"
    with pytest.raises(BankError, match="holds views made with another vary"):
        cg.make_dataset(bank.path, varied.parent, **asked)


@pytest.mark.parametrize(
    "text", ["", "training", "train=0.5", "train=0.5,train=0.5", "train=0.5,test", "train=2,val=-1"]
)
def test_splits_that_are_none_are_refused(text):
    with pytest.raises(ConfigError, match="splits ="):
        parse_splits(text)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"form": "voc"}, "parquet, webdataset, bop, coco, yolo, yolo-seg"),
        ({"quality": "best"}, "draft, fine"),
        ({"vary": ("lights",)}, "texture, light, colour"),
        ({"vary": ("light",)}, "without colours"),
        ({"vary": "light"}, "a sequence of words"),
        ({"form": "bop", "vary": ("light",)}, "without colours"),
        ({"form": "bop", "cluster": "local"}, "with form 'bop'"),
        ({"size": "9x9"}, "16 to 8192 pixels"),
        ({"num_scenes": 0}, "num_scenes = 0"),
    ],
)
def test_settings_that_are_none_are_refused(bank, tmp_path, changed, message):
    with pytest.raises(ConfigError, match=message):
        cg.make_dataset(bank.path, tmp_path / "set", **(PLAIN | changed))
    assert not (tmp_path / "set").exists()
