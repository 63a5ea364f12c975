"""Files that are not UTF-8, and files whose headers announce more than they hold."""

import json
import struct
import tracemalloc
from pathlib import Path

import pytest
import trimesh

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import read_source

CASES = Path(__file__).parents[1] / "cases" / "import" / "09_stl_trailing"


def glb(change):
    """A box as GLB whose header is changed by a function."""
    data = trimesh.creation.box((0.05, 0.05, 0.05)).export(file_type="glb")
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return (
        struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
        + text
        + rest
    )


def many(document):
    document["accessors"][0]["count"] = 3_000_000_000


def many_zeros(document):
    many(document)
    del document["accessors"][0]["bufferView"]


def sparse(document):
    part = {"bufferView": 0, "componentType": 5125}
    document["accessors"][0]["sparse"] = {
        "count": 2_000_000_000,
        "indices": part,
        "values": {"bufferView": 0},
    }


def long_view(document):
    document["bufferViews"][0]["byteLength"] = 3_000_000_000


def long_buffer(document):
    document["buffers"][0]["byteLength"] = 3_000_000_000


def negative(document):
    document["accessors"][0]["count"] = -1


def no_number(document):
    document["accessors"][0]["count"] = "many"


def stl_of(triangles):
    data = trimesh.creation.box((0.05, 0.05, 0.05)).export(file_type="stl")
    return data[:80] + struct.pack("<I", triangles) + data[84:]


def ply_of(encoding, rows):
    data = trimesh.creation.box((0.05, 0.05, 0.05)).export(file_type="ply", encoding=encoding)
    return data.replace(b"element face 12", f"element face {rows}".encode())


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.glb", glb(many), "accessor 0 of 3,000,000,000 elements needs"),
        ("a.glb", glb(many_zeros), "accessor 0 of 3,000,000,000 elements"),
        ("a.glb", glb(sparse), "sparse accessor 0"),
        ("a.glb", glb(long_view), "view 0 of buffer 0"),
        ("a.glb", glb(long_buffer), "buffer 0 needs 3,000,000,000 bytes"),
        ("a.glb", glb(negative), "header is damaged"),
        ("a.glb", glb(no_number), "header is damaged"),
        ("a.glb", glb(lambda _: None)[:-50], "damaged"),
        ("a.stl", stl_of(3_000_000_000)[:-50], "3,000,000,000 triangles"),
        ("a.stl", stl_of(12)[:-50], "12 triangles"),
        ("a.stl", stl_of(12)[:-20], "12 triangles"),
        ("a.ply", ply_of("binary", 3_000_000_000), "header announces|promises"),
        ("a.ply", ply_of("ascii", 3_000_000_000), "header announces|promises"),
    ],
)
def test_more_than_there_is_is_refused_before_it_is_read(tmp_path, name, data, message):
    path = tmp_path / name
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(AssetError, match=message):
            read_source(path)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("suffix", ["glb", "gltf", "stl", "ply"])
def test_sound_files_pass(tmp_path, suffix):
    path = tmp_path / f"ball.{suffix}"
    trimesh.creation.icosphere(subdivisions=2, radius=0.05).export(path)
    (shape,) = read_source(path)
    assert len(shape.pieces[0].mesh.faces) == 320


@pytest.mark.parametrize("count", [0, 11, 13, 2**31 - 1, 3_000_000_000, 2**32 - 1])
def test_a_false_count_of_an_stl_file_is_said(tmp_path, count):
    (tmp_path / "a.stl").write_bytes(stl_of(count))
    (shape,) = read_source(tmp_path / "a.stl")
    assert len(shape.pieces[0].mesh.faces) == 12
    assert any(f"announces {count:,} triangles: the 12 " in note for note in shape.notes)


@pytest.mark.parametrize("rest", [b"\0", b"\r\n", b"x" * 50, b"COLOR=" + bytes(200)])
def test_bytes_after_the_last_triangle_of_an_stl_file_are_said(tmp_path, rest):
    (tmp_path / "a.stl").write_bytes(stl_of(12) + rest)
    (shape,) = read_source(tmp_path / "a.stl")
    assert shape.pieces[0].mesh.volume == pytest.approx(0.05**3, rel=1e-5)
    assert any(f"{len(rest)} bytes after its last triangle" in note for note in shape.notes)


def test_a_file_with_a_newline_after_its_triangles():
    """As it was sent."""
    (shape,) = read_source(CASES / "trail.stl")
    assert len(shape.pieces[0].mesh.faces) == 12
    assert any("2 bytes" in note for note in shape.notes)
