"""Banks: resumed, verified, refused; through the command line, as a user would."""

import errno
import pickle
import re

import mujoco
import numpy as np
import pytest
from PIL import Image

from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import BankError
from cluttergen_jax.judging import verify
from cluttergen_jax.judging.verify import verify_scene
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.scene.bank import read_bank


@pytest.fixture(scope="module")
def bank(tmp_path_factory, pool):
    path = tmp_path_factory.mktemp("banks") / "bank"
    assert generate(pool, path, "-n", "260") == 0
    return path


def generate(pool, path, *more):
    method = [] if "--method" in more else ["--method", "random"]
    return main(["generate", "--pool", pool, "--out", str(path), "--no-render", *method, *more])


def test_holds_every_index_once_failures_included(bank):
    table = read_bank(bank).table
    np.testing.assert_array_equal(table["index"], np.arange(260))
    files = {int(path.stem) for path in (bank / "scenes").glob("*.xml")}
    assert files == {scene.index for scene in read_bank(bank).scenes() if scene.is_success}


def test_a_bank_that_was_read_goes_to_another_process(bank):
    here = read_bank(bank)
    rows = here.table
    assert pickle.loads(pickle.dumps(here)).table.equals(rows)


def test_interrupted_bank_is_continued_to_the_same_bits(bank, pool, tmp_path):
    path = tmp_path / "bank"
    assert generate(pool, path, "-n", "3", "--max-files", "0") == 0
    assert not (path / "scenes").exists()
    assert generate(pool, path, "-n", "260", "--max-files", "0") == 0
    assert read_bank(path).table.equals(read_bank(bank).table)
    (path / "scenes-000000.parquet").unlink()
    assert generate(pool, path, "-n", "260", "--max-files", "0") == 0
    assert read_bank(path).table.equals(read_bank(bank).table)


def test_files_hold_the_poses_twice_and_stand(bank):
    scenes = [scene for scene in read_bank(bank).scenes() if scene.is_success][:5]
    assert scenes
    for scene in scenes:
        path = bank / "scenes" / f"{scene.index:06d}.xml"
        model = mujoco.MjModel.from_xml_path(str(path))
        np.testing.assert_array_equal(
            model.key("scene").qpos.astype(np.float32), scene.poses.ravel()
        )
        np.testing.assert_allclose(model.qpos0, scene.poses.ravel(), atol=1e-6)
        assert model.opt.timestep == 1 / 480
        assert verify_scene(path).stands


def test_verify_tells_what_it_saw_where_nothing_can_be_written(bank, capsys, monkeypatch):
    def refuse(path, data):
        raise OSError(errno.EROFS, "Read-only file system", str(path))

    monkeypatch.setattr(verify, "write_atomically", refuse)
    assert main(["verify", str(bank), "--seconds", "0.1"]) == 0
    shown = capsys.readouterr()
    assert "scenes stand" in shown.out
    assert "Read-only file system" in shown.err


@pytest.mark.slow
def test_damaged_files_of_scenes_are_mended(pool, tmp_path):
    path = tmp_path / "bank"
    words = ["generate", "--pool", pool, "--out", str(path), "-n", "3", "--method", "clear"]
    pictures = renderer_status()[0]
    assert main(words) == 0
    files = [path / "scenes" / "000000.xml", path / "assets" / "objects" / "box" / "part-00.obj"]
    files += [path / "scenes" / "000001.png"] if pictures else []
    whole = [file.read_bytes() for file in files]
    for file, data in zip(files, whole, strict=True):
        file.write_bytes(data[: len(data) // 2])
    assert main(["verify", str(path)]) == 1
    assert main(words) == 0
    assert [file.read_bytes() for file in files[:2]] == whole[:2]
    for picture in files[2:]:
        Image.open(picture).load()
    assert main(["verify", str(path), "--seconds", "0.1"]) == 0


def test_verify_sees_a_scene_that_does_not_stand(bank, tmp_path, capsys):
    source = next((bank / "scenes").glob("*.xml"))
    text = source.read_text().replace('meshdir="../assets"', f'meshdir="{bank / "assets"}"')
    lifted = re.sub(r'(name="tall" pos="\S+ \S+) \S+"', r'\1 0.95"', text)
    key = re.search(r'qpos="([^"]+)"', text)[1].split()
    order = re.findall(r'body name="(\w+)" pos', text)
    key[7 * order.index("tall") + 2] = "0.95"
    lifted = re.sub(r'qpos="[^"]+"', f'qpos="{" ".join(key)}"', lifted)
    (tmp_path / "lifted.xml").write_text(lifted)
    assert not verify_scene(tmp_path / "lifted.xml").stands
    assert main(["verify", str(tmp_path / "lifted.xml")]) == 1
    assert "0 of 1" in capsys.readouterr().out
    (tmp_path / "torn.xml").write_text(lifted.replace(' pos="', ' pos="1 ', 1))
    with pytest.raises(BankError):
        verify_scene(tmp_path / "torn.xml")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--num-objects", "4"], "--repeat"),
        (["--pool", "nothing-of-that-name"], "no pool"),
        (["--method", "magic"], "clear"),
        (["--region", "0.4"], "WxD"),
        (["--region", "9x9"], "beyond support"),
        (["--region", "nanxnan"], "finite"),
        (["--keep-out", "1,2"], "X,Y,W,D"),
        (["--keep-out", "0,0,9,9"], "leave some"),
        (["--max-files", "-3"], "0 or more"),
        (["--num-threads", "99999999"], "0 to 4096"),
        (["--num-scenes", "0"], "1 to"),
        (["--start", "nowhere:0"], "not a bank"),
        (["--objects", "mug"], "no object"),
        (["--support", "table-0.001x0.5"], "between"),
        (["--engine", "hand"], "native"),
    ],
)
def test_bad_input_is_explained_and_leaves_nothing(pool, tmp_path, capsys, more, says):
    assert generate(pool, tmp_path / "bank", *more) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "bank").exists()


@pytest.mark.slow
def test_repeat_start_and_keep_out(pool, bank, tmp_path):
    path = tmp_path / "more"
    more = ["--keep-out", "0.2,0,0.2,0.7", "--start", f"{bank}:0", "--repeat", "--num-objects", "5"]
    assert generate(pool, path, "-n", "6", "--method", "clear", *more) == 0
    first = next(read_bank(bank).scenes())
    scenes = [scene for scene in read_bank(path).scenes() if scene.is_success]
    assert scenes
    for scene in scenes:
        assert len(scene.objects) == 3 + 5
        # What stood there still does, and may lie in the keep-out box; what is new may not.
        np.testing.assert_allclose(scene.poses[:3], first.poses, atol=0.003)
        assert (scene.poses[3:, 0] < 0.1).all()
    assert verify_scene(path / "scenes" / f"{scenes[0].index:06d}.xml").stands
