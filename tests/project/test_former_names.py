"""Public names of the previous release: understood in this one, with a warning that names the new one."""

import pytest

import cluttergen_jax as cg


@pytest.mark.parametrize(
    ("former", "name"),
    [
        ("SampledScene", "SceneBatch"),
        ("SceneBank", "BankArrays"),
        ("StoredArrays", "BankArrays"),
        ("StoredScene", "BankArrays"),
    ],
)
def test_a_former_name_is_the_new_class_and_says_so(former, name):
    with pytest.warns(DeprecationWarning, match=f"{former} is now called {name}"):
        found = getattr(cg, former)
    assert found is getattr(cg, name)
    assert found.__name__ == name
    assert former not in cg.__all__
    assert former not in dir(cg)
