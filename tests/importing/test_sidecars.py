"""JSON beside an object: what known sets state is used, and what others state is an alarm."""

import gzip
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cluttergen_jax.importing.planning import plan_all
from cluttergen_jax.importing.readers import ReadOptions, read_shape
from tests.helpers.cases import CASES
from tests.helpers.shapes import save_box


def plan(folder, layout="auto", **options):
    return plan_all([folder], ReadOptions(**options), layout=layout)


def only(folder, layout="auto", **options):
    (planned,) = plan(folder, layout, **options).objects
    return planned


def shape_of(planned):
    return read_shape(planned.source, planned.options)


def sides(planned):
    return np.ptp(np.concatenate([each.mesh.vertices for each in shape_of(planned).pieces]), axis=0)


def save(folder, document, name, mesh="mug.obj"):
    """A cube of 5 cm with a JSON beside it."""
    save_box(folder / mesh)
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(document if isinstance(document, str) else json.dumps(document))
    return folder


def test_robotwin_scale_and_folder_name():
    planned = only(CASES / "22_json_robotwin")
    assert sides(planned).max() == pytest.approx(0.2, abs=1e-3)
    assert (planned.source.name, planned.source.label) == ("22_json_robotwin", "json robotwin")
    assert "scale 0.4 as model_data0.json states (RoboTwin)" in shape_of(planned).notes
    assert not planned.alarms


def test_habitat_scale_mass_and_up():
    planned = only(CASES / "23_json_habitat")
    assert sides(planned)[2] == pytest.approx(0.125, abs=1e-3)
    assert (planned.options.mass, planned.options.friction, planned.options.up) == (0.35, 0.9, "y")
    assert planned.up.reason == "as can.object_config.json says"


def test_variants_of_a_robotwin_folder_keep_their_numbers(tmp_path):
    for number, scale in ((0, 0.5), (7, [2.0, 2.0, 2.0])):
        save(
            tmp_path / "001_bottle",
            {"scale": scale},
            f"model_data{number}.json",
            f"visual/base{number}.obj",
        )
    objects = plan(tmp_path).objects
    assert [(each.source.name, each.options.scale) for each in objects] == [
        ("001_bottle-0", 0.5),
        ("001_bottle-7", 2.0),
    ]


def test_configs_of_a_habitat_tree_name_meshes_and_collision_shapes(tmp_path):
    """ReplicaCAD keeps configs, meshes and collision shapes apart."""
    save_box(tmp_path / "objects" / "vase.glb")
    save_box(tmp_path / "objects" / "convex" / "vase_cv_decomp.glb")
    config = {"render_asset": "../../objects/vase.glb", "mass": 1.5, "COM": [0, 0, 0]}
    config["collision_asset"] = "../../objects/convex/vase_cv_decomp.glb"
    save(tmp_path / "other", config, "../configs/objects/vase.object_config.json", "cup.obj")
    for source in (tmp_path, tmp_path / "objects", tmp_path / "objects" / "vase.glb"):
        found = {each.source.name: each.options.mass for each in plan(source).objects}
        assert found == {"vase": 1.5} | ({"cup": None} if source == tmp_path else {})


def test_unequal_scales_stretch_a_mesh(tmp_path):
    save(tmp_path, {"render_asset": "mug.obj", "scale": [1, 2, 4]}, "mug.object_config.json")
    np.testing.assert_allclose(sides(only(tmp_path)), [0.05, 0.1, 0.2], rtol=1e-9)
    np.testing.assert_allclose(sides(only(tmp_path, scale=2.0)), [0.1] * 3, rtol=1e-9)


def test_labels_and_terms_of_metadata(tmp_path):
    document = {"uid": "mug", "name": "Tea  mug", "license": "by", "unit": "cm"}
    document["user"] = {"displayName": "Ann"}
    planned = only(save(tmp_path, document, "metadata.json"), scale=1.0)
    assert planned.source.label == "Tea mug"
    assert (planned.options.licence, planned.options.attribution) == ("by", "Ann")
    assert planned.options.scale == 0.01


def test_options_and_settings_go_before_a_json_and_that_before_a_set(tmp_path):
    config = {"scale": 0.5, "mass": 2.0, "up": [0, 1, 0], "front": [0, 0, 1]}
    folder = save(tmp_path, config, "mug.object_config.json")
    by_option = only(folder, mass=3.0, up="z").options
    assert (by_option.scale, by_option.mass, by_option.up, by_option.front) == (
        0.5,
        3.0,
        "z",
        "auto",
    )
    (folder / "objects.toml").write_text('["mug.obj"]\nscale = 1\nup = "x"\n')
    by_settings = only(folder).options
    assert (by_settings.scale, by_settings.mass, by_settings.up) == (1.0, 2.0, "x")
    for name in ("AlphabetSoup", "BBQSauce", "Ketchup"):
        save_box(tmp_path / "hope" / f"{name}.obj")
    save(tmp_path / "hope", {"scale": 0.02}, "Ketchup.object_config.json", "Ketchup.obj")
    scales = {each.source.name: each.options.scale for each in plan(tmp_path / "hope").objects}
    assert scales == {"alphabetsoup": 0.01, "bbqsauce": 0.01, "ketchup": 0.02}


def test_without_knowledge_of_sets_it_is_an_alarm():
    planned = only(CASES / "22_json_robotwin", layout="none")
    assert planned.options.scale == 1.0
    assert any("scale [0.4, 0.4, 0.4]" in each for each in planned.alarms)


@pytest.mark.parametrize(
    ("name", "document", "told"),
    [
        ("mug.json", {"scale": 0.01}, '"mug.obj".scale = 0.01'),
        ("mug.json", {"physics": {"unit_scale": "0.01"}}, "physics/unit_scale"),
        ("info.json", {"globalScaling": [0.1, 0.1, 0.1]}, '"mug.obj".scale = 0.1'),
        ("mug_data.json", {"massKg": 0.3}, '"mug.obj".mass = 0.3'),
        ("mug.json", {"weight_g": 300}, '"mug.obj".mass = 0.3'),
        ("info.json", {"upAxis": "Y"}, '"mug.obj".up = "y"'),
        ("mug.json", {"up": [0, -1, 0]}, '"mug.obj".up = "-y"'),
        ("mug.json", {"units": "millimeters"}, '"mug.obj".scale = 0.001'),
        ("info.json", {"objects": [{"file": "mug.obj", "scale": 0.2}]}, '"mug.obj".scale = 0.2'),
        ("info.json", {"mug": {"scale": 0.2}}, '"mug.obj".scale = 0.2'),
        ("info.json", [{"scale": 0.2}], '"mug.obj".scale = 0.2'),
        ("mug.json", {"metersPerUnit": 0.01}, '"mug.obj".scale = 0.01'),
        ("mug.json", '{"scale": NaN}', "scale NaN"),
        ("mug.json", {"scale": -1}, "scale -1"),
        ("mug.json", {"mass": "300 g"}, "mass 300 g"),
        ("mug.json", "{", "cannot be read"),
    ],
)
def test_what_an_unknown_json_states_is_an_alarm(tmp_path, name, document, told):
    found = plan(save(tmp_path, document, name))
    (planned,) = found.objects
    assert any(told in each for each in planned.alarms), planned.alarms
    assert planned.options == ReadOptions()
    assert planned.source.notes == planned.alarms
    assert all(each.startswith("mug.obj: ") for each in found.unused)


def test_what_an_alarm_advises_ends_it(tmp_path):
    save(tmp_path, {"scale": 0.01, "mass": 0.3}, "mug.json")
    assert len(only(tmp_path).alarms) == 2
    (tmp_path / "objects.toml").write_text('"mug.obj".scale = 0.01\n"mug.obj".mass = 0.3\n')
    planned = only(tmp_path)
    assert (planned.alarms, planned.options.scale, planned.options.mass) == ((), 0.01, 0.3)


@pytest.mark.parametrize(
    "document",
    [
        {"scale": 1.0, "units": "m", "up": [0, 0, 1]},
        {"texture": {"scale": 2}, "center_of_mass": [0, 0, 1], "grayscale": 3, "weight": "bold"},
        {"name": "mug", "tags": ["scale", "mass"], "unit": "kg", "scale": None, "scaled": True},
    ],
)
def test_what_asks_for_nothing_is_no_alarm(tmp_path, document):
    assert only(save(tmp_path, document, "mug.json")).alarms == ()


def test_a_json_of_another_mesh_says_nothing(tmp_path):
    save(tmp_path, {"scale": 0.01}, "cup.json", "mug.obj")
    save(tmp_path, {"scale": 0.01}, "bowl.json", "cup.obj")
    alarms = {each.source.name: len(each.alarms) for each in plan(tmp_path).objects}
    assert alarms == {"cup": 1, "mug": 0}


VALUES = [
    "NaN",
    "-1",
    "0",
    '"x"',
    "[1, 2]",
    "[]",
    "{}",
    "true",
    "1e400",
    "[NaN, 1, 1]",
    '"\\ud800"',
    "[[1]]",
]
FILES = {
    "mug.object_config.json": [
        "scale",
        "up",
        "front",
        "mass",
        "friction_coefficient",
        "render_asset",
    ],
    "model_data.json": ["scale"],
    "metadata.json": ["scale", "unit", "up", "mass", "name", "license", "user"],
    "annotations.json": ["mass", "category", "scale", "license_info"],
    "mug.json": ["scale", "mass", "up", "unit"],
}


@pytest.mark.parametrize("value", VALUES)
def test_bad_values_are_alarms_and_nothing_else(tmp_path, value):
    for number, (name, key) in enumerate(
        (name, key) for name, keys in FILES.items() for key in keys
    ):
        save(tmp_path / str(number), f'{{"uid": "mug", "{key}": {value}}}', name)
    for planned in plan(tmp_path).objects:
        assert planned.options.scale == 1.0 or '"scale"' not in value
        assert all(text.isprintable() for text in (*planned.alarms, planned.source.label))
        assert np.isfinite(sides(planned)).all()


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b"[]", b"null", b"\xff\xfe\x00", b"[" * 100_000, b'{"scale": 1, "scale": 2}'],
)
def test_broken_files_are_alarms(tmp_path, data):
    for name in FILES:
        save_box(tmp_path / name / "mug.obj")
        (tmp_path / name / name).write_bytes(data)
    for planned in plan(tmp_path).objects:
        assert planned.options.scale == 1.0
        assert bool(planned.alarms) == (data not in (b"[]", b"null"))


def test_huge_and_irregular_files_are_not_read(tmp_path):
    save_box(tmp_path / "mug.obj")
    with (tmp_path / "mug.json").open("wb") as file:
        file.truncate(1 << 30)
    assert "1024 MB" in only(tmp_path).alarms[0]


KEYS = [
    "scale",
    "mass",
    "up",
    "units",
    "name",
    "render_asset",
    "uid",
    "mug",
    "mug.obj",
    "annotations",
    "user",
]
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(KEYS)
)
DOCUMENTS = st.recursive(
    LEAVES,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(KEYS) | st.text(max_size=4), inner)
    ),
    max_leaves=8,
)


@settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(document=DOCUMENTS)
def test_any_document_ends_in_a_sound_plan(tmp_path, document):
    for name in FILES:
        save(tmp_path / name, document, name)
    for planned in plan(tmp_path).objects:
        assert np.isfinite(planned.options.scale)
        assert all(text.isprintable() for text in (*planned.alarms, *planned.source.decisions))


def test_objaverse_in_its_own_folders(tmp_path):
    save_box(tmp_path / "glbs" / "000-001" / "uid1.glb")
    about = {"uid1": {"uid": "uid1", "name": "Red Cup", "license": "by-nc"}}
    (tmp_path / "metadata").mkdir()
    with gzip.open(tmp_path / "metadata" / "000-001.json.gz", "wt") as file:
        json.dump(about, file)
    planned = only(tmp_path)
    assert planned.source.label == "Red Cup"
    assert "licence by-nc" in planned.source.decisions[0]
