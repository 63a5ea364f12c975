"""Every training ends beside `random`; the paper's way by one argument."""

import pytest

from cluttergen_jax.learning.training.random_comparison import comparison_lines
from cluttergen_jax.proportions import wilson


def rate(share, trials=256):
    low, high = wilson(round(share * trials), trials)
    return {"success": round(share * trials) / trials, "low95": low, "high95": high, "episodes": trials}


def told(policy, random, curve, training_success=None):
    rows = [{"success": each, "attempts": 3200.0 * (k + 1)} for k, each in enumerate(curve)]
    known = {"random": rate(random), "training_success": training_success or policy}
    return " ".join(comparison_lines(rate(policy) | known, rows))


@pytest.mark.parametrize(
    ("policy", "random", "curve", "training_success", "said"),
    [
        (0.512, 0.461, [0.3] * 10 + [0.4] * 10 + [0.5] * 10, None, "not better; .* still rises"),
        (0.512, 0.461, [0.5] * 40, None, "not better; .* fewer objects"),
        (0.30, 0.46, [0.5] * 40, 0.6, "worse; .* short check"),
        (0.98, 0.98, [0.9] * 40, None, "not better; .* fills this world"),
        (0.1, 0.2, [0.1] * 3, None, "9,600 make 3 updates"),
    ],
)
def test_what_is_not_better_is_said_with_what_is_missing(policy, random, curve, training_success, said):
    lines = told(policy, random, curve, training_success)
    for part in said.split(" .* "):
        assert part in lines
