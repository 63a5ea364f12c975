"""Files that were made to do harm, or ask for too much: each ends in a sentence, and the rest comes in."""

import os
import signal
import struct
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.files import fault_of_file
from cluttergen_jax.importing import run
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.planning import plan_all
from cluttergen_jax.importing.readers import ReadOptions, find_sources, read_shape, read_source
from cluttergen_jax.importing.readers.pieces import whole_of
from cluttergen_jax.importing.readers.xml_tree import parse_text
from cluttergen_jax.importing.run import ImportConfig, import_sources
from cluttergen_jax.judging.scene_files import read_model
from cluttergen_jax.scene.mjcf_file import read_mjcf_scene
from tests.helpers import banks
from tests.helpers.cases import CASES, READERS
from tests.helpers.endings import add, end_by, refuse, spin, take_memory
from tests.helpers.imports import made_here
from tests.helpers.worlds import trio

BOX = '<box size=".1 .1 .1"/>'
GOOD = f'<robot name="r"><link name="l"><visual><geometry>{BOX}</geometry></visual></link></robot>'
BODY = '<body name="b"><freejoint/><geom size=".03"/></body>'
_TIN = "<geometry><box><size>.1 .1 .2</size></box></geometry>"
LINK = f'<link name="l"><visual name="v">{_TIN}{{}}</visual></link>'


def mjcf(world=BODY, assets="", rest=""):
    return f"<mujoco>{rest}<asset>{assets}</asset><worldbody>{world}</worldbody></mujoco>"


def sdf(inside, name="m"):
    return f'<sdf version="1.9"><model name="{name}">{inside}</model></sdf>'


def include(uri, more=""):
    return f"<include><uri>{uri}</uri>{more}</include>"


def said_of(path):
    """What the reader says of the only object of a file."""
    (source,) = find_sources(path)
    with pytest.raises(AssetError) as caught:
        read_shape(source)
    return str(caught.value)


def extents(path):
    """The size of the only object of a file, metres."""
    (shape,) = read_source(path)
    points = np.concatenate([piece.mesh.vertices for piece in shape.pieces])
    return np.ptp(points, axis=0)


def png(width, height):
    """A picture's head, and pixels that are not there."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 100))


def test_the_cases_end_in_a_sentence_and_the_folder_goes_on(tmp_path, monkeypatch, home):
    monkeypatch.setattr(run, "_outcomes", made_here)
    os.symlink(READERS, tmp_path / "cases")
    (tmp_path / "fine.urdf").write_text(GOOD)
    report = import_sources([tmp_path], "strangers", ImportConfig(progress=False))
    assert {each.provenance.source.rpartition("/")[2] for each in report.objects} == {
        "fine.urdf",
        "a.sdf",
    }
    reasons = " ".join(each.reason for each in report.failures)
    assert len(report.failures) == 3
    assert "attaches or includes itself" in reasons
    assert "copies" in reasons
    assert "more than 400 deep" in reasons


def test_undeclared_prefixes_are_read_as_drake_and_gazebo_read_them():
    np.testing.assert_allclose(
        extents(CASES / "28_sdf_undeclared_prefix" / "tin.sdf"), (0.068, 0.068, 0.1), atol=1e-3
    )


@pytest.mark.parametrize(
    "before",
    [
        '\n\n\t<?xml version="1.0"?>',
        'x\n<?xml version="1.0"?>',
        "<!-- a -- b --><?xml version='1.0'?>",
        '\ufeff\n<?xml version="1.0"?>',
        '<?xml version="1.0" encoding="no-such"?>',
        "<!DOCTYPE robot>",
        '<?xml version="1.0" encoding="ascii"?><!-- \u00e9 -->',
    ],
)
def test_what_stands_before_the_root_is_no_hindrance(tmp_path, before):
    (tmp_path / "a.urdf").write_text(before + GOOD, encoding="utf-8")
    np.testing.assert_allclose(extents(tmp_path / "a.urdf"), 0.1)


def test_characters_that_xml_forbids_are_what_they_are():
    root = parse_text(b'<a n="Tom & Jerry &lt;3 < 4" n="second" p:q="1"><p:b/>&nbsp;&#65;\xe9</a>')
    assert root.attrib == {"n": "Tom & Jerry <3 < 4", "{p}q": "1"}
    assert root[0].tag == "{p}b"
    assert root[0].tail == "&nbsp;A\u00e9"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<a><b></a>", "mismatched"),
        ("<a/><b/>", "junk"),
        ("<a", "unclosed"),
        ("", "no element"),
        ("<p:a><b></p:a>", "unbound"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "declares entities"),
        ('<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><a>&b;</a>', "declares entities"),
        ("<a>" * 401 + "</a>" * 401, "more than 400 deep"),
        ("<p:a>" * 401 + "</p:a>" * 401, "more than 400 deep"),
    ],
)
def test_what_is_no_xml_for_anybody_is_refused(text, said):
    with pytest.raises((ValueError, SyntaxError), match=said):
        parse_text(text.encode())


@pytest.mark.parametrize(
    "text", ["<a" + "a" * 10**6, "<!--" * 10**5, "<a " + "b" * 10**6, "&" * 10**6]
)
def test_no_text_makes_the_parser_try_again_and_again(text):
    with pytest.raises((ValueError, SyntaxError)):
        parse_text(text.encode())


def model_folder(folder, versions, name="cup"):
    """A model of Gazebo's, whose size is that of each version."""
    folder.mkdir(parents=True)
    named = "".join(f'<sdf version="{each}">{each}.sdf</sdf>' for each in versions)
    (folder / "model.config").write_text(f"<model><name>{name}</name>{named}</model>")
    for each in versions:
        box = f"<box><size>.1 .1 {each}</size></box>"
        link = f'<link name="l"><visual name="v"><geometry>{box}</geometry></visual></link>'
        (folder / f"{each}.sdf").write_text(sdf("<pose>0 0 9 0 0 0</pose>" + link))


@pytest.mark.parametrize("uri", ["model://cup", "cup", "file://{}/cup", "{}/cup", "cup/0.3.sdf"])
def test_an_include_is_the_latest_version_where_the_include_puts_it(tmp_path, uri):
    model_folder(tmp_path / "cup", ["0.2", "0.3", "0.10"][:2])
    inside = LINK.format("") + include(
        uri.format(tmp_path), "<pose>0 0 1 0 0 0</pose><name>other</name>"
    )
    (tmp_path / "both.sdf").write_text(sdf(inside))
    # A box 0.2 m tall at 0, and one 0.3 m tall at 1 m: its own pose at 9 m does not count.
    np.testing.assert_allclose(extents(tmp_path / "both.sdf"), (0.1, 0.1, 0.1 + 1 + 0.15))


def test_includes_within_includes_name_files_from_their_own_folder(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "part.obj").write_text(
        "v 0 0 0\nv .1 0 0\nv 0 .2 0\nv 0 0 .3\nf 1 3 2\nf 1 2 4\n"
    )
    mesh = "<mesh><uri>part.obj</uri></mesh>"
    link = f'<link name="l"><visual name="v"><geometry>{mesh}</geometry></visual></link>'
    (tmp_path / "a" / "b" / "inner.sdf").write_text(sdf(link, "inner"))
    (tmp_path / "a" / "middle.sdf").write_text(sdf(include("b/inner.sdf"), "middle"))
    (tmp_path / "outer.sdf").write_text(sdf(include("a/middle.sdf"), "outer"))
    np.testing.assert_allclose(extents(tmp_path / "outer.sdf"), (0.1, 0.2, 0.3))
    # In a folder they are parts of it.
    assert [each.path.name for each in find_sources(tmp_path)] == ["outer.sdf"]


def test_a_world_is_its_own_models_in_a_folder_and_all_where_it_is_given(tmp_path):
    model_folder(tmp_path / "cup", ["0.3"])
    world = f"<sdf version='1.9'><world name='w'>{include('model://cup')}{include('model://no')}</world></sdf>"
    (tmp_path / "w.sdf").write_text(world)
    assert [each.path.name for each in find_sources(tmp_path)] == ["0.3.sdf"]
    (source,) = find_sources(tmp_path / "w.sdf")
    assert any("model://no" in note for note in read_shape(source).notes)


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (include("a.sdf"), "includes itself: a.sdf -> a.sdf"),
        (include("model://nowhere"), "which is not there"),
        (include("https://fuel.gazebosim.org/x"), "from the internet"),
        ("<include merge='true'><uri>b.sdf</uri></include>", "merge"),
        (include("c.urdf"), "no SDF"),
        (include("d.sdf"), "holds no model"),
        (include("e0.sdf"), "includes more than 1,000 files"),
        (
            "".join(
                f'<frame name="f{i}"><pose relative_to="f{i + 1}"/></frame>' for i in range(999)
            )
            + LINK.replace("<visual", '<pose relative_to="f0">0 0 0 0 0 0</pose><visual').format(
                ""
            ),
            "more than 100 others in a row",
        ),
    ],
)
def test_includes_and_frames_without_end_are_sentences(tmp_path, inside, said):
    (tmp_path / "a.sdf").write_text(sdf(inside))
    (tmp_path / "b.sdf").write_text(sdf(LINK.format("")))
    (tmp_path / "c.urdf").write_text(GOOD)
    (tmp_path / "d.sdf").write_text("<sdf version='1.9'/>")
    for i in range(12):
        (tmp_path / f"e{i}.sdf").write_text(sdf(2 * include(f"e{i + 1}.sdf")))
    (tmp_path / "e12.sdf").write_text(sdf(LINK.format("")))
    assert said in said_of(tmp_path / "a.sdf")


@pytest.mark.parametrize(
    "script",
    [
        "material" + " " * 10**5,
        "material x\n{ diffuse " + " " * 10**5 + "z }",
        "material x\n{" * 20_000,
        "material x\n{\n" + 'texture "a\n' * 20_000,
        ("material x " + " " * 50 + "\n") * 5000,
    ],
)
def test_no_script_makes_its_pattern_try_for_ever(tmp_path, script):
    (tmp_path / "x.material").write_text(script)
    material = "<material><script><uri>.</uri><name>y</name></script></material>"
    (tmp_path / "a.sdf").write_text(sdf(LINK.format(material)))
    (shape,) = read_source(tmp_path / "a.sdf")
    assert any("nowhere defined" in note for note in shape.notes)


@pytest.mark.parametrize("line", ["mtllib", "mtllib a", "usemtl a"])
def test_no_line_of_a_mesh_makes_its_pattern_try_for_ever(tmp_path, line):
    box = "v 0 0 0\nv .1 0 0\nv 0 .2 0\nv 0 0 .3\nf 1 3 2\nf 1 2 4\n"
    (tmp_path / "a.obj").write_text(f"{line}{' ' * 10**5}b\n{box}")
    np.testing.assert_allclose(extents(tmp_path / "a.obj"), (0.1, 0.2, 0.3))


def test_no_name_of_a_file_makes_a_pattern_try_for_ever():
    assert whole_of("mug" + "_part_1" * 30 + "!") == ""
    assert whole_of("mug_part_1") == "mug"


HFIELD = '<geom type="hfield" hfield="h"/>' + BODY
MESH = '<body><freejoint/><geom type="mesh" mesh="m"/></body>'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (mjcf(BODY, '<model name="x" file="b.xml"/>'), "attaches or includes itself"),
        ('<mujoco><include file="c.xml"/></mujoco>', "attaches or includes itself"),
        (mjcf(f'<replicate count="1e9">{BODY}</replicate>'), "copies"),
        (mjcf(3 * '<replicate count="90">' + BODY + 3 * "</replicate>"), "copies"),
        (
            mjcf(HFIELD, '<hfield name="h" nrow="9999" ncol="9999" size="1 1 1 1"/>'),
            "9999 x 9999 cells",
        ),
        (mjcf(HFIELD, '<hfield name="h" file="h.bin" size="1 1 1 1"/>'), "200000 x 200000 cells"),
        (mjcf(HFIELD, '<hfield name="h" file="h.png" size="1 1 1 1"/>'), "pixels"),
        (
            mjcf(BODY, '<texture name="t" type="2d" builtin="flat" width="99999" height="99999"/>'),
            "pixels",
        ),
        (mjcf(MESH, '<mesh name="m" builtin="sphere" params="12"/>'), "params"),
        (mjcf('<body><flexcomp type="grid" count="900 900 900" name="f"/></body>'), "cells"),
        (mjcf(rest='<size memory="900G"/>'), "up to 4G"),
        (mjcf(rest='<size nuser_geom="2000000000"/>'), "nuser_geom"),
        (mjcf(MESH, '<mesh name="m" file="pipe.obj"/>'), "named pipe"),
        (mjcf(MESH, '<mesh name="m" file="/dev/zero"/>'), "a device"),
        (
            "<mujoco><worldbody>" + "<body>" * 401 + "</body>" * 401 + "</worldbody></mujoco>",
            "400 deep",
        ),
    ],
)
def test_mjcf_that_asks_for_too_much_is_refused_before_mujoco_reads_it(tmp_path, text, said):
    path = tmp_path / "a.xml"
    path.write_text(text)
    attach = '<body name="b"><geom size=".1"/><attach model="x" body="b" prefix="p"/></body>'
    (tmp_path / "b.xml").write_text(mjcf(attach, '<model name="x" file="b.xml"/>'))
    (tmp_path / "c.xml").write_text('<mujocoinclude><include file="a.xml"/></mujocoinclude>')
    (tmp_path / "h.bin").write_bytes(struct.pack("<ii", 200_000, 200_000))
    (tmp_path / "h.png").write_bytes(png(60_000, 60_000))
    os.mkfifo(tmp_path / "pipe.obj")
    assert said in said_of(path)
    for reader in (read_model, read_mjcf_scene):
        with pytest.raises(AssetError, match=said):
            reader(path)


def test_what_ends_the_process_with_limits_ends_nothing_else(tmp_path):
    assert call_limited(tmp_path, add, 1, 2) == 3
    with pytest.raises(AssetError, match="not done after 1 s"):
        call_limited(tmp_path, spin, seconds=1)
    with pytest.raises(AssetError, match="SIGSEGV"):
        call_limited(tmp_path, end_by, signal.SIGSEGV)
    with pytest.raises(AssetError, match="GB of memory"):
        call_limited(tmp_path, take_memory)
    with pytest.raises(TypeError):
        call_limited(tmp_path, add, 1, "2")
    with pytest.raises(ConfigError, match=r"up = 'w'. Allowed: an axis. Try: z.") as caught:
        call_limited(tmp_path, refuse)
    assert caught.value.hint == "z"
    assert call_limited(tmp_path, add, 1, 2) == 3


def test_only_regular_files_are_opened(tmp_path):
    for name in ("a.obj", "b.urdf", "c.xml", "m.obj", "label.json"):
        os.mkfifo(tmp_path / name)
    os.symlink("/dev/zero", tmp_path / "d.stl")
    (tmp_path / "e.urdf").write_text(GOOD.replace(BOX, '<mesh filename="m.obj"/>'))
    (tmp_path / "f.urdf").write_text(GOOD)
    plan = plan_all([tmp_path], ReadOptions())
    assert {each.source.path.name for each in plan.objects} == {"e.urdf", "f.urdf"}
    assert {each.name.rpartition("/")[2] for each in plan.skipped} >= {
        "a.obj",
        "b.urdf",
        "c.xml",
        "d.stl",
    }
    assert "not there" in said_of(tmp_path / "e.urdf")
    for name in ("a.obj", "d.stl"):
        with pytest.raises(AssetError, match=r"a named pipe|a device"):
            read_source(tmp_path / name)
    assert "named pipe" in fault_of_file(tmp_path / "a.obj")
    assert "path" in fault_of_file("a\0b")
    assert fault_of_file(tmp_path / "nowhere") == ""


@pytest.mark.parametrize(
    "name", ["../other/part.obj", "{}/other/part.obj", "file://{}/other/part.obj"]
)
@pytest.mark.parametrize("kind", ["urdf", "sdf", "xml", "obj"])
def test_files_from_outside_are_noted(tmp_path, kind, name):
    (tmp_path / "other").mkdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "other" / "part.obj").write_text(
        "v 0 0 0\nv .1 0 0\nv 0 .2 0\nv 0 0 .3\nf 1 3 2\nf 1 2 4\n"
    )
    name = name.format(tmp_path)
    texts = {
        "urdf": GOOD.replace(BOX, f'<mesh filename="{name}"/>'),
        "sdf": sdf(
            LINK.format("").replace(
                "<box><size>.1 .1 .2</size></box>", f"<mesh><uri>{name}</uri></mesh>"
            )
        ),
        "xml": mjcf(MESH, f'<mesh name="m" file="{name}"/>'),
        "obj": f"mtllib {name}\n" + (tmp_path / "other" / "part.obj").read_text(),
    }
    (tmp_path / "mine" / f"thing.{kind}").write_text(texts[kind])
    (found,) = plan_all([tmp_path / "mine"], ReadOptions()).objects
    outside = found.source.outside
    if kind == "xml" and name.startswith("file://"):
        # MuJoCo knows no such names.
        assert outside == ()
        return
    assert [each.rpartition("/")[2] for each in outside] == ["part.obj"]
    # Whoever gives the folder of both gives both.
    assert all(not each.source.outside for each in plan_all([tmp_path], ReadOptions()).objects)


def test_a_bank_of_files_from_outside_leaves_by_consent_alone(tmp_path, home, capsys):
    objects = {asset.name: asset for asset in trio()}
    tall = objects["tall"]
    provenance = replace(tall.provenance, outside=("private/things/mug.obj",))
    objects["tall"] = replace(tall, provenance=provenance)
    with banks.writer(tmp_path / "bank", 8, objects=objects) as bank:
        bank.write_block(0, banks.rows(0, 8))
    (tmp_path / "hub").mkdir()
    push = ["push", str(tmp_path / "bank"), "me/bank", "--hub", str(tmp_path / "hub")]
    assert main(push) != 0
    message = capsys.readouterr().err
    assert "tall (private/things/mug.obj)" in message
    assert "--allow-outside" in message
    assert not list((tmp_path / "hub").iterdir())
    assert main([*push, "--allow-outside"]) == 0


def test_an_object_knows_which_files_it_took_from_outside(tmp_path, home, monkeypatch):
    monkeypatch.setattr(run, "_outcomes", made_here)
    (tmp_path / "mine").mkdir()
    os.symlink(CASES / "28_sdf_undeclared_prefix" / "tin.sdf", tmp_path / "mine" / "tin.sdf")
    for _ in range(2):
        # Also what the cache has.
        report = import_sources([tmp_path / "mine"], "linked", ImportConfig(progress=False))
        (asset,) = report.pool.objects
        assert asset.provenance.outside == ("import/28_sdf_undeclared_prefix/tin.sdf",)
        assert sum("outside its folder" in note for note in asset.notes) == 1


@pytest.mark.parametrize("path", ["", "a" * 5000, "nowhere"])
def test_odd_paths_are_sentences(path):
    plan = plan_all([path], ReadOptions())
    assert not plan.objects
    assert len(plan.failures) == 1


def test_a_message_has_an_end(tmp_path):
    (tmp_path / "a.urdf").write_text(GOOD.replace(BOX, f'<mesh filename="{"a" * 10**6}"/>'))
    assert len(said_of(tmp_path / "a.urdf")) < 3000


def test_a_module_of_the_folder_one_stands_in_is_not_taken(tmp_path):
    (tmp_path / "numpy.py").write_text("raise SystemExit('the wrong numpy')")
    path = CASES / "24_mjcf_flat_visual" / "bracket_oldlabel.xml"
    script = "import sys; from cluttergen_jax.importing.readers import read_source; read_source(sys.argv[1])"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    words = [sys.executable, "-P", "-c", script, path]
    done = subprocess.run(
        words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
