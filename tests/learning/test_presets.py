"""Presets and variants: the paper's numbers, what differs in its code, and encoders that must be given."""

import dataclasses
import importlib.util
from pathlib import Path

import pytest

from cluttergen_jax.learning.training.presets import make_settings

DOCS = Path(__file__).parents[2] / "docs"
PAPERS = ("paper", "paper_code", "paper_cpu")


@pytest.mark.parametrize("preset", PAPERS)
def test_the_papers_numbers(preset):
    settings = make_settings(preset, "policy")
    ppo = settings.ppo
    network = settings.network
    assert (ppo.batch_size, ppo.steps_of_minibatch, ppo.num_attempts) == (3200, 1000, 2_500_000)
    assert (ppo.discount, ppo.gae_lambda, ppo.clip) == (0.99, 0.95, 0.2)
    # The printed 0.5 is of the mean square, and `value_cost` of half of it.
    assert (ppo.value_cost, ppo.max_gradient_norm) == (1.0 if preset == "paper" else 0.5, 0.5)
    # What two cores can bear differs in what keeps it from learning, too.
    is_printed = preset != "paper_cpu"
    assert (ppo.learning_rate, ppo.entropy_cost) == ((1e-4, 0.01) if is_printed else (1e-3, 0.0))
    assert ppo.anneals == (preset != "paper")
    assert (network.head, network.height_precision) == ("beta_free", 0)
    # Five layers, the output among them; the shipped policies have one more.
    layers = (4, 256, 256) if is_printed else (5, 256, 128)
    assert (network.num_layers, network.width, network.history_width) == layers
    assert network.encoder_frozen
    assert network.reads_clouds
    assert (settings.placement.order, settings.placement.max_attempts) == ("random", 5)


def test_the_page_of_settings_agrees_with_the_presets():
    spec = importlib.util.spec_from_file_location("make_paper", DOCS / "make_paper.py")
    make_paper = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make_paper)
    assert make_paper.PAGE.read_text(encoding="utf-8") == make_paper.page()


@pytest.mark.parametrize("preset", PAPERS)
@pytest.mark.parametrize(
    ("variant", "changed"),
    [
        ("normal", {"head": "normal"}),
        ("open_loop", {"history_width": 0}),
        ("short_memory", {"history_length": 1}),
    ],
)
def test_rivals_change_one_thing_of_the_papers_method(preset, variant, changed):
    full, rival = (make_settings(preset, each) for each in ("policy", variant))
    assert rival == dataclasses.replace(full, network=dataclasses.replace(full.network, **changed))
