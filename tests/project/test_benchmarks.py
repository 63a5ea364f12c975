"""The benchmarks run at their smallest, and the README's sections are replaced as they should be."""

import json

import numpy as np
import pytest

from benchmarks import (
    ablation,
    bank_reading,
    bullet,
    contact,
    engines,
    gpu,
    gpu_engines,
    last_check,
    other_mujoco,
    profile,
    trained,
)
from benchmarks.bodies import apple, box
from benchmarks.contact_drops import drops
from benchmarks.contact_scenes import small_scenes
from benchmarks.recorded import small_attempts
from benchmarks.rows import OutOfTimeError, Rows
from benchmarks.section import prose, provenance, replace_section, table
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.training.train import recipe_of
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.types import Verdict
from tests.helpers import banks


@pytest.fixture
def pool(tmp_path):
    objects = (box("brick", (0.03, 0.04, 0.05), 0.2), box("slab", (0.05, 0.05, 0.01), 0.3))
    return str(write_pool(tmp_path / "blocks", Pool("blocks", objects)))


def test_section_goes_to_the_end_of_a_new_readme(tmp_path):
    readme = tmp_path / "README.md"
    replace_section(readme, "one", "first")
    replace_section(readme, "two", "second")
    text = readme.read_text()
    assert text.startswith("# Benchmarks")
    assert text.index("first") < text.index("second")


def test_section_replaces_itself_and_nothing_else(tmp_path):
    readme = tmp_path / "README.md"
    for name in ("one", "two", "three"):
        replace_section(readme, name, f"old {name}")
    before = readme.read_text()
    # A backslash and a group reference must come through as they are.
    replace_section(readme, "two", r"new \1 \g<0> two")
    assert readme.read_text() == before.replace("old two", r"new \1 \g<0> two")


def test_section_written_twice_is_the_same_file(tmp_path):
    readme = tmp_path / "README.md"
    replace_section(readme, "one", "text")
    once = readme.read_text()
    replace_section(readme, "one", "text")
    assert readme.read_text() == once


def test_section_keeps_what_was_written_by_hand(tmp_path):
    readme = tmp_path / "README.md"
    readme.write_text("# By hand\n\nabove\n\n<!-- one: begin -->\nold\n<!-- one: end -->\n\nbelow\n")
    replace_section(readme, "one", "new")
    assert readme.read_text() == (
        "# By hand\n\nabove\n\n<!-- one: begin -->\nnew\n<!-- one: end -->\n\nbelow\n"
    )


def test_table_has_a_rule_and_equal_rows():
    lines = table(["name", "value"], [["a", 1], ["b", 2.5]]).splitlines()
    assert {line.count("|") for line in lines} == {3}
    assert lines[1] == "| --- | ---: |"
    assert lines[3] == "| b | 2.5 |"


def test_provenance_names_command_and_versions():
    text = provenance("contact", ["mujoco", "no-such-package"])
    assert "python -m benchmarks.contact" in text
    assert "mujoco 3." in text
    assert "no-such-package not installed" in text


def test_prose_is_one_line():
    assert prose("a\n    b\n  c ") == "a b c"


def test_apple_is_round_and_small_enough_for_a_part():
    vertices = apple("apple", 0.03, 0.1).parts[0].vertices
    assert len(np.unique(vertices.round(9), axis=0)) == len(vertices) == 32
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.03)


def test_small_scenes_know_friction_from_ice():
    rough, smooth = (small_scenes(ContactConfig(friction=(mu, 0.005, 0.0001)), known={}) for mu in (0.5, 0.1))
    assert rough.stack.creep < 1e-3
    assert rough.bowl is None
    # A slope of 10 degrees is steeper than the angle of friction of 0.1.
    assert rough.slope_speed < 0.001 < 0.1 < smooth.slope_speed
    np.testing.assert_allclose(rough.slides_at, np.degrees(np.arctan(0.5)), atol=1.0)


def test_recorded_small_attempts_come_to_rest():
    world, attempts = small_attempts(StabilityConfig(), ContactConfig(), 6)
    result = NativePhysics(world.layout, StabilityConfig()).settle_batch(
        attempts.poses, attempts.is_placed, attempts.focus, np.ones(6, bool)
    )
    assert (result.verdict == Verdict.STABLE).all()
    # Those let go above the flat box end on it.
    assert np.ptp(result.poses[::2, 2, 2] - result.poses[1::2, 2, 2] - 0.02) < 1e-3


def test_pybullet_judges_like_native():
    pytest.importorskip("pybullet", reason="needs the extra peers")
    config = StabilityConfig()
    world, attempts = small_attempts(config, ContactConfig(), 4)
    poses = attempts.poses.copy()
    poses[3, 2, :2] = (0.4, 0.0)
    everyone = np.ones(4, bool)
    native = NativePhysics(world.layout, config).settle_batch(
        poses, attempts.is_placed, attempts.focus, everyone
    )
    for tuned in (True, False):
        peer = bullet.BulletPhysics(world, config, ContactConfig(), tuned=tuned)
        result = peer.settle_batch(poses, attempts.is_placed, attempts.focus, everyone)
        assert (result.verdict[:3] == Verdict.STABLE).all()
        assert (result.verdict == Verdict.STABLE).tolist() == (native.verdict == Verdict.STABLE).tolist()
        # Bullet keeps hulls a millimetre apart on either side.
        np.testing.assert_allclose(result.poses[:3], native.poses[:3], atol=4e-3)
        standing = peer.stand_batch(result.poses[:3], attempts.is_placed[:3], everyone[:3])
        assert (standing.verdict == Verdict.STABLE).all()
        peer.close()


def test_native_drops_come_to_rest():
    assert drops(ContactConfig(), "native") == 1.0


@pytest.mark.slow
def test_contact_runs(pool):
    args = contact.Contact(pool=(pool,), trials=2, num_scenes=2, warp=False, only=("ours", "pyramidal"))
    outcomes = contact.measure({name: contact.candidates()[name] for name in args.only}, args)
    assert outcomes["ours"].solo[0].rate == 1.0
    assert "| pyramidal |" in contact.body_of(outcomes, args)


@pytest.mark.slow
def test_last_check_runs(pool):
    args = last_check.LastCheck(
        pool=pool, support=("table",), method=("clear",), num_scenes=4, num_verified=2
    )
    checks = last_check.measure(args)
    assert len(checks[0].full) == 4
    assert checks[0].is_verified.sum() == 2
    assert "| clear, table | 4 | 4 |" in last_check.body_of(checks, args)


@pytest.mark.slow
def test_engines_run(pool):
    args = engines.Engines(pool=pool, num_scenes=2, rounds=1, num_awake=1, num_replayed=0)
    contenders = engines.compete(args)
    assert contenders["native, 1 thread"].success == 1.0
    assert all(each.turns[0].attempts > 0 for each in contenders.values())
    assert "| native, 1 thread |" in engines.body_of(contenders, [], args)


@pytest.mark.parametrize("is_libccd", [False, True])
@pytest.mark.parametrize(("turn", "expected"), [("1 0 0 0", True), ("0.95 0.31 0 0", False)])
def test_a_saved_scene_stands_or_falls_in_any_mujoco(turn, expected, is_libccd, tmp_path):
    (tmp_path / "scene.xml").write_text(f"""<mujoco><worldbody><geom type="plane" size="1 1 1"/>
      <body name="box" pos="0 0 0.05" quat="{turn}">
      <freejoint/><geom type="box" size="0.02 0.02 0.05"/></body>
      </worldbody><keyframe><key name="scene" qpos="0 0 0.05 {turn}"/></keyframe></mujoco>""")
    assert other_mujoco.stands(tmp_path / "scene.xml", is_libccd) is expected


def test_rows_are_made_once_and_what_failed_or_goes_on_is_made_again(tmp_path):
    made, said = [], []

    def case(name, row=None, error=None):
        def make():
            made.append(name)
            if error is not None:
                raise error
            return {"value": 1.5} if row is None else row

        return name, make

    def cases():
        return iter(
            [
                case("whole"),
                case("longer", row={"goes_on": True}),
                case("poor", error=ConfigError("no", "yes")),
            ]
        )

    for _ in range(2):
        Rows(tmp_path / "rows.json", say=said.append).make("part", cases())
    assert made == ["whole", "longer", "poor", "longer"]
    assert "part: whole: kept" in said
    rows = Rows(tmp_path / "rows.json", retries=True, say=said.append)
    assert set(rows.of("part")) == {"whole", "longer"}
    rows.make("part", cases())
    assert made[4:] == ["longer", "poor"]


def test_no_row_is_begun_without_time(tmp_path):
    made = []
    rows = Rows(tmp_path / "rows.json", minutes=0.0, say=lambda text: None)
    with pytest.raises(OutOfTimeError, match="part: one"):
        rows.make("part", iter([("one", lambda: made.append(1) or {})]))
    assert not made
    assert not rows.file.exists()


def left_by(out, row, **known):
    """What a run of the row leaves: `known` of its policy."""
    recipe = recipe_of(*ablation.settings_of(row, out, "dining", 1000, 0, None))
    for name, record in (("last", {"num_updates": 3}), ("policy", known)):
        (out / row.name / name).mkdir(parents=True, exist_ok=True)
        text = json.dumps({"format": 1, **recipe, **record})
        (out / row.name / name / "record.json").write_text(text)
    lines = "update,attempts,attempts_per_second,success,entropy\n0,100,50.0,1.0,2.0\n"
    (out / row.name / "progress.csv").write_text(lines)


EVALUATION = {"success": 0.5, "low95": 0.4, "high95": 0.6}


def test_a_row_is_trained_until_it_has_been_evaluated(tmp_path, monkeypatch):
    trainings = []

    def run_training(config, settings, interrupt):
        trainings.append(config.folder.name)

    monkeypatch.setattr(ablation, "run_training", run_training)
    stopped, whole = ablation.Row("stopped", "Stopped"), ablation.Row("whole", "Whole", variant="beta")
    left_by(tmp_path, stopped)
    left_by(tmp_path, whole, evaluation=EVALUATION)
    for row in (stopped, whole, ablation.Row("new", "New")):
        ablation.train(row, tmp_path, "dining", 1000, 0, None)
    assert trainings == ["stopped", "new"]
    assert ablation.cells(whole, tmp_path)[-2] == "0.500 [0.400, 0.600]"
    for other in ({"num_attempts": 2000}, {"seed": 1}, {"pool": "study"}):
        asked = {"pool": "dining", "num_attempts": 1000, "seed": 0} | other
        with pytest.raises(ConfigError, match="whole holds a run with another"):
            ablation.train(whole, tmp_path, encoder=None, **asked)


def test_runs_are_named_by_what_is_not_usual_and_may_lack_an_evaluation(tmp_path):
    usual, other = (ablation.Row(name, "", preset=name) for name in ("cpu", "gpu"))
    left_by(tmp_path, usual)
    left_by(tmp_path, other, evaluation=EVALUATION)
    name, *_, success = trained.cells(tmp_path / "cpu")
    assert ("preset" in name, success) == (False, "-")
    name, *_, success = trained.cells(tmp_path / "gpu")
    assert ("preset gpu" in name, success) == (True, "0.500 [0.400, 0.600]")


def test_gpu_is_measured_in_miniature_and_written(tmp_path, capsys):
    args = gpu.Gpu(parts=("doctor",), out=tmp_path / "out", small=True)
    readme = tmp_path / "README.md"
    for _ in range(2):
        gpu.main(args, readme)
    said = capsys.readouterr().out
    assert said.count("doctor: machine: kept") == 1
    assert not readme.exists()
    # A miniature's rows are not taken for those of full size.
    assert not (args.out / "rows.json").exists()
    rows = Rows(args.folder / "rows.json")
    rows.parts["steps"] = {
        "warp, 2": {"lanes": 2, "steps/s awake": 12345.6},
        "warp, 4": {"failed": "no room"},
    }
    text = gpu.body_of(rows)
    assert "| warp, 2 |" in text
    assert "12,346" in text
    assert "- steps: warp, 4: no room" in text
    assert rows.of("doctor")["machine"]["machine"] in text
    assert "miniature" in text
    gpu.main(gpu.Gpu(out=args.out, small=True, write=True), readme)
    assert "miniature" in readme.read_text()


def test_gpu_says_which_parts_there_are(tmp_path):
    with pytest.raises(ConfigError, match="Did you mean 'steps'"):
        gpu.main(gpu.Gpu(parts=("stepz",), out=tmp_path))


def test_gpu_measures_the_engines_and_numbers_of_scenes_that_are_asked_for():
    whole = gpu_engines.Scale()
    scale = gpu.chosen(whole, gpu.Gpu(engines=("native", "warp"), lanes=(64,)))
    assert (scale.engines, scale.compared, scale.lanes) == (("native", "warp"), ("native", "warp"), (64,))
    assert gpu.chosen(whole, gpu.Gpu()) == whole
    with pytest.raises(ConfigError, match="Did you mean 'warp'"):
        gpu.chosen(whole, gpu.Gpu(engines=("warb",)))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("part", gpu.PARTS)
def test_every_part_about_a_gpu_runs_in_miniature(part, tmp_path):
    pytest.importorskip("warp", reason="needs the extra gpu")
    rows = gpu.measure(gpu.Gpu(parts=(part,), out=tmp_path, minutes=25.0, small=True))
    made = rows.parts[part]
    assert made
    assert not [row for row in made.values() if "failed" in row or "goes_on" in row]
    if part == "agreement":
        assert all(row["equal"] == row["attempts"] for row in made.values())
    if part == "scenes":
        assert {row["success"] for row in made.values()} == {1.0}
    assert part == "doctor" or f"### {part}" in gpu.body_of(rows)


@pytest.mark.slow
def test_the_pieces_of_a_profile_add_up_to_the_whole():
    shares = profile.sampling("random", "dining", 1)
    pieces = {profile.SEARCH, profile.RULES, profile.STEPS, profile.CONTACTS, profile.PHYSICS, profile.ROWS}
    assert set(shares) == pieces | {profile.REST}
    assert min(shares[name] for name in pieces) > 0
    assert abs(shares[profile.REST]) < 0.2 * sum(shares.values())


@pytest.fixture(scope="module")
def repeated(tmp_path_factory):
    """Two blocks and a piece of one, all of the same scenes."""
    path = tmp_path_factory.mktemp("repeated")
    banks.write(path / "one", 1)
    bank_reading.repeat(read_bank(path / "one"), path / "bank", 600)
    return path / "bank"


def test_a_big_bank_repeats_a_block(repeated):
    rows, first = read_bank(repeated).table, banks.rows(0)
    assert rows["index"].to_pylist() == list(range(600))
    assert rows["poses"].to_pylist() == (3 * first["poses"].to_pylist())[:600]


@pytest.mark.slow
def test_a_big_bank_is_read_in_every_way(repeated):
    stand = sum(read_bank(repeated).table["is_success"].to_pylist())
    found = {name: bank_reading.measured(name, repeated) for name in bank_reading.WAYS}
    scenes = {name: int(scenes) for name, (_, _, scenes) in found.items()}
    assert {number for name, number in scenes.items() if "bank`, " in name} == {stand}
    assert [number for name, number in scenes.items() if "bank`, " not in name] == [0, 600, 1]
