"""A user's own method: found, told apart, refused with a sentence, and as good as a built-in one."""

import copy
import pickle
from dataclasses import replace

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.methods.table import (
    METHODS,
    OwnMethod,
    entry_of,
    find_method,
    make_proposer,
)
from cluttergen_jax.spec import SceneSpec
from tests.helpers import own_methods
from tests.helpers.own_methods import Weighted, at_rest, near_middle
from tests.helpers.problems import made_up_rules

FILE = own_methods.__file__


def test_every_method_of_the_table_that_needs_no_checkpoint_is_made():
    rules = made_up_rules()
    for name, entry in METHODS.items():
        assert entry.about
        if entry.needs_checkpoint:
            with pytest.raises(ConfigError, match=f"method '{name}'"):
                make_proposer(name, rules)
        elif name != "pile":
            assert callable(make_proposer(name, rules))


@pytest.mark.parametrize("given", [near_middle, at_rest, Weighted(np.full(2, 0.5, np.float32))])
def test_an_own_method_proposes_as_its_function_does(given):
    rules = made_up_rules()
    episode = rules.begin(jax.random.key(1))
    propose = make_proposer(find_method(given), rules)
    asked = given(rules) if given is at_rest else given
    key = jax.random.key(2)
    # It is a pytree, which compiled code is given.
    action = jax.jit(lambda propose: propose(key, episode))(propose)
    np.testing.assert_allclose(action, asked(key, episode), rtol=1e-6)


def test_it_is_a_name_with_a_digest(monkeypatch):
    method = find_method(near_middle)
    assert str(method) == method.name == "near_middle"
    assert method == find_method(method) == find_method(f"{FILE}:near_middle")
    assert find_method("tests.helpers.own_methods:near_middle") == method
    assert method != find_method(at_rest)
    assert method != "near_middle"
    assert (
        len({method, OwnMethod("near_middle", method.digest), OwnMethod("near_middle", "1")}) == 2
    )
    assert copy.deepcopy(method) is method
    spec = SceneSpec(method=near_middle)
    assert spec == SceneSpec(method=f"{FILE}:near_middle")
    assert hash(spec) == hash(SceneSpec(method=near_middle))
    assert method.digest in repr(spec)
    middles = [Weighted(np.full(2, each)) for each in (0.5, 0.5, 0.4)]
    found = [find_method(each).digest for each in middles]
    assert found[0] == found[1] != found[2]
    monkeypatch.setattr(own_methods, "REACH", 0.4)
    assert find_method(near_middle) != method


def test_it_is_pickled_by_where_it_can_be_imported(monkeypatch):
    for given in (near_middle, f"{FILE}:near_middle", Weighted(np.full(2, 0.5))):
        spec = SceneSpec(method=given)
        data = pickle.dumps(spec)
        assert pickle.loads(data) == spec
    data = pickle.dumps(SceneSpec(method=near_middle))
    monkeypatch.setattr(own_methods, "REACH", 0.4)
    with pytest.raises(ConfigError, match="'near_middle', which has the digest"):
        pickle.loads(data)


def test_what_an_own_method_says_it_takes_is_asked_of_it():
    weighted = find_method(Weighted(np.full(2, 0.5)))
    SceneSpec(natural=True, poses="any").check_method(weighted)
    with pytest.raises(ConfigError, match="`tidy` with method"):
        SceneSpec(tidy=True).check_method(weighted)
    with pytest.raises(ConfigError, match="height = 'free'"):
        SceneSpec(height="free").check_method(weighted)
    assert not entry_of(weighted).needs_checkpoint
    assert SceneSpec().with_rules(weighted).order == "random"


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ("short", r"'short', which makes float32\[3\].*action_of_pose"),
        ("failing", r"'failing', which raised AttributeError: .*nothing"),
        ("unclear", "'unclear', which can be called with one argument and two"),
    ],
)
def test_one_that_makes_no_action_is_refused_before_anything_runs(given, match):
    with pytest.raises(ConfigError, match=match):
        find_method(getattr(own_methods, given)).make(made_up_rules())


def named_as(name, function=near_middle):
    def other(key, episode):
        return function(key, episode)

    other.__name__ = name
    return other


@pytest.mark.parametrize(
    ("given", "match"),
    [
        (lambda key, episode: key, "method '<lambda>'.*with a name"),
        (named_as("drop"), "method 'drop' of your own.*attribute `name`"),
        (named_as("hand"), "method 'hand' of your own"),
        (named_as("a, b"), "method 'a, b'"),
        (3, "method 3"),
        (f"{FILE}:near_midle", "Did you mean 'near_middle'"),
        ("missing.py:mine", "there is no file"),
        ("no_such_module:mine", "No module named 'no_such_module'"),
        (":mine", "FILE.py:NAME"),
        ("drp", "Did you mean 'drop'"),
    ],
)
def test_what_is_no_method_is_refused(given, match):
    with pytest.raises(ConfigError, match=match):
        SceneSpec(method=given)


def test_a_module_of_the_folder_one_stands_in_is_found_and_read_anew(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = "def mine(key, episode):\n    return {}\n"
    (tmp_path / "my_own_methods.py").write_text(code.format("key"))
    first = find_method("my_own_methods:mine")
    assert first == find_method("my_own_methods.py:mine")
    (tmp_path / "my_own_methods.py").write_text(code.format("episode"))
    second = find_method("my_own_methods:mine")
    assert first != second
    assert second.part(1, 2) == 2
    (tmp_path / "my_own_methods.py").write_text("1 / 0\n")
    with pytest.raises(ConfigError, match="ZeroDivisionError"):
        find_method("my_own_methods:mine")


def test_of_a_bank_alone_its_name_is_known():
    absent = OwnMethod("mine", "0123")
    assert pickle.loads(pickle.dumps(absent)) == absent
    with pytest.raises(
        ConfigError, match=r"'mine' \(digest 0123\), a user's own that is not at hand"
    ):
        absent.make(made_up_rules())


def test_an_environment_tells_what_its_method_would_do(pool):
    asked = SceneSpec(pool=pool, num_objects=2, method=near_middle)
    env = cg.make_env(asked, history_stride=0, num_cells=0)
    state = jax.jit(env.reset)(jax.random.key(0))
    key = jax.random.key(1)
    action = jax.jit(env.propose)(key, state)
    episode = state.pipeline_state.episode
    np.testing.assert_allclose(action, 2 * near_middle(key, episode) - 1, rtol=1e-5)
    assert np.isfinite(jax.jit(env.step)(state, action).reward)
    plain = cg.make_env(replace(asked, method=None), history_stride=0, num_cells=0)
    with pytest.raises(ConfigError, match="an environment without a method"):
        plain.propose(key, state)
    with pytest.raises(ConfigError, match="action='surface'"):
        cg.make_env(asked, action="surface")
    with pytest.raises(ConfigError, match="'pile'"):
        cg.make_env(replace(asked, method="pile"))
