"""What helps the paper's own method to learn: one thing changed at a time, the budget the same.

    cluttergen pretrain --encoder pointnet --features 256 --object-points 256 --out encoder
    python -m studies.benchmarks.paper_method --encoder-weights encoder --write

A row that has been trained is kept in `--out` and not trained again; Ctrl-C and the same command go on. A row
that was trained with other settings is refused.
"""

from __future__ import annotations

from typing import Any

from studies.benchmarks.ablation import Row, compare

_SLOW = {"learning_rate": 1e-4, "anneals": False}
_PLAIN = {"reward_scale": 1.0, "reward_limit": None}
_SET = {"scene_encoder": "set", "encoder_frozen": False, "object_features": 64, "object_points": 64}


def _paper(name: str, title: str, **changed: Any) -> Row:
    return Row(name, title, **{"variant": "beta_free", "preset": "paper_cpu"} | changed)


ROWS = (
    _paper(
        "paper",
        "preset `paper_cpu`: the paper's method, no entropy bonus, a learning rate from 1e-3 to 0",
    ),
    _paper("entropy", "its entropy bonus of 0.01 again", ppo={"entropy_cost": 0.01}),
    _paper("slow", "its learning rate of 1e-4 all the time again", ppo=_SLOW),
    _paper("printed", "both again: as printed", ppo=_SLOW | {"entropy_cost": 0.01}),
    _paper("unlimited", "penalties of any size, as printed", ppo={"reward_limit": None}),
    _paper(
        "compressed",
        "reward `compressed`, as `policy` has it",
        placement={"reward": "compressed"},
        ppo=_PLAIN,
    ),
    _paper("nearer", "discount 0.97", ppo={"discount": 0.97}),
    _paper(
        "near",
        "discount and GAE 0.9, as `policy` has them",
        ppo={"discount": 0.9, "gae_lambda": 0.9},
    ),
    _paper("open_loop", "no history", variant="open_loop"),
    _paper("normal", "a truncated normal a coordinate", variant="normal"),
    _paper("unimodal", "a Beta with its mode inside the region", network={"head": "beta"}),
    _paper(
        "prior",
        "that, z about rest on the bare top",
        network={"head": "beta", "height_precision": 20_000.0},
    ),
    _paper("set", "it sees the objects' poses, no point cloud of the scene", network=_SET),
    _paper("fixed", "objects in one order, always the same", placement={"order": "fixed"}),
)


if __name__ == "__main__":
    compare(
        ROWS, "paper_method", "What helps the paper's method", "dining", __doc__, needs_encoder=True
    )
