"""Which engine `auto` is, by the machine and how many scenes are simulated side by side."""

import pytest

import cluttergen_jax as cg
from cluttergen_jax.config import ROBUST_TILT, StabilityConfig
from cluttergen_jax.physics import engine_of, engines, step_seconds

CONFIG = StabilityConfig()


@pytest.fixture
def nvidia(monkeypatch):
    monkeypatch.setattr(engines, "has_nvidia", lambda: True)


def test_without_such_a_gpu_it_is_native(monkeypatch):
    monkeypatch.setattr(engines, "has_nvidia", lambda: False)
    assert engine_of("auto", CONFIG, 10_000, 1) == "native"
    assert engine_of("warp", CONFIG) == "warp"


@pytest.mark.usefixtures("nvidia")
def test_few_scenes_are_quicker_on_the_cores():
    assert engine_of("auto", CONFIG, 16, 16) == "native"
    assert engine_of("auto", CONFIG, 1024, 16) == "warp"
    assert engine_of("auto", CONFIG) == "warp"
    assert engine_of("auto", StabilityConfig(robust_tilt=ROBUST_TILT), 1024, 16) == "native"


def test_a_step_costs_a_gpu_the_same_up_to_many_scenes():
    assert step_seconds("warp", 1) == step_seconds("warp", 512)
    assert step_seconds("warp", 8192) > step_seconds("warp", 512)
    assert step_seconds("native", 64, 2) == 2 * step_seconds("native", 64, 4)


def test_a_gpu_of_another_maker_is_none_of_nvidias(monkeypatch):
    class Client:
        platform_version = "PJRT C API\nrocm 6.2"

    class Device:
        client = Client()

    monkeypatch.setattr(engines.jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(engines.jax, "devices", lambda: [Device()])
    assert not engines.has_nvidia()
    Client.platform_version = "PJRT C API\ncuda 13000"
    assert engines.has_nvidia()


def test_a_sampler_of_the_reference_says_that_it_compiles_for_minutes():
    with pytest.warns(UserWarning, match="minutes for ninety"):
        cg.make_sampler("dining", num_objects=2, engine="jax", objects=("mug", "fork"))
