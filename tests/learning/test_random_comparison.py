"""Every training ends beside `random`; the paper's way by one argument."""

import pytest

from cluttergen_jax.learning.training.run_logger import comparison_lines, difference_interval
from cluttergen_jax.statistics import wilson


def rate(share, trials=256):
    low, high = wilson(round(share * trials), trials)
    return {"success": round(share * trials) / trials, "low95": low, "high95": high, "episodes": trials}


def told(policy, random, curve, training_success=None):
    rows = [{"success": each, "attempts": 3200.0 * (k + 1)} for k, each in enumerate(curve)]
    known = {"random": rate(random), "training_success": training_success or policy}
    return " ".join(comparison_lines(rate(policy) | known, rows))


def test_the_interval_of_a_difference():
    # Newcombe (1998), table II: 56/70 and 48/80, method 10.
    low, high = difference_interval(rate(56 / 70, 70), rate(48 / 80, 80))
    assert (low, high) == pytest.approx((0.0524, 0.3339), abs=2e-4)
    assert difference_interval(rate(0.5), rate(0.5))[0] < 0 < difference_interval(rate(0.5), rate(0.5))[1]


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
