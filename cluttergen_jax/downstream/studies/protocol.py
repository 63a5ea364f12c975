"""The study `protocol`: placers measured as the paper measures, beside what the same proposals are worth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cluttergen_jax.downstream.placer.evaluation.tables import Row, with_interval
from cluttergen_jax.downstream.placer.examples import TESTING
from cluttergen_jax.downstream.studies.study import DownstreamStudy, Found, SuiteFolder
from cluttergen_jax.downstream.studies.trained import SEEDS_NOTE, Variant, grouped, pooled, rows_of
from cluttergen_jax.tables import Table

_NOTES = (
    "the paper's protocol: pairs split at random, 80 : 10 : 10, so that pairs to learn from and to test with "
    "are of the same scenes; every object quiet for 20 steps within 60, at 2 deg/s, neighbours may be "
    "pushed; pairs where neither the proposal nor the scene's own pose counts are left out; no noise",
    "strict: the first proposal comes to rest as docs/contract.md asks, disturbs nothing, and then the whole "
    "scene stands",
    "scenes never seen: the queries of the study `placement`, asked of the same placers",
)


def run(suite: SuiteFolder) -> Found:
    """Every head, trained and tested on one set's pairs."""
    scale, pairs = suite.scale, suite.household()
    size, variants = pairs.split("train")["num_pairs"], []
    for head in scale.chosen("regression", "mixture", "scored"):
        runs = {
            seed: suite.trained(f"protocol-{head}-{size}", pairs, head, seed, noise="off", held_out="pairs")
            for seed in scale.training_seeds
        }
        variants.append(Variant({"head": head}, runs))
    variants += [Variant({"head": name}, name) for name in ("random", "geometry-occupied")]
    shared = rows_of(suite.trials(pairs, "train", tenth=TESTING), variants, (0.0,))
    apart = rows_of(suite.trials(suite.test_set()), variants, (0.0,))
    return Found([*shared, *apart], [_table(grouped(shared), grouped(apart))])


def _table(shared: Sequence[list[Row]], apart: Sequence[list[Row]]) -> Table:
    """One line for each head: the same proposals by four counts, then queries of scenes never seen."""
    columns = (
        "head",
        "seeds",
        "paper's protocol",
        "none left out",
        "strict",
        "strict, scenes never seen",
        "paper's count, scenes never seen",
    )
    cells = [
        (
            rows[0]["variant"]["head"],
            "-" if rows[0]["training_seed"] is None else str(len(rows)),
            *(_told(rows, name) for name in ("paper_without_invalid", "paper", "success")),
            *(_told(others, name) for name in ("success", "paper")),
        )
        for rows, others in zip(shared, apart, strict=True)
    ]
    asked, others = shared[0][0]["trial"], apart[0][0]["trial"]
    title = f"{asked['queries']} test pairs of the paper's protocol, {others['queries']} of scenes never seen"
    return Table(title, columns, tuple(cells), (*_NOTES, SEEDS_NOTE))


def _told(rows: list[Row], name: str) -> str:
    shares: list[dict[str, Any]] = [row["figures"][name] for row in rows]
    if len(rows) == 1:
        return with_interval(shares[0])
    return with_interval(pooled(shares, rows[0]["trial"]["queries"]))


PROTOCOL = DownstreamStudy("protocol", "The paper's own protocol, and what it hides", run)
