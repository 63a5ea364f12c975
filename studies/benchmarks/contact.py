"""Evidence for the one contact configuration: what each candidate does to real objects and to known answers.

Measured for each candidate: objects placed alone (the stability rule, random yaw, 0 to 3 mm above the top);
scenes of `clear` on the paper's table and of `drop` on a tight one, left for ten seconds, everything awake;
a stack of five boxes, 2 kg on 30 g, an apple in a bowl, a mug on a book; a box on a slope; boxes and prisms
dropped, in float64 (native) and in float32 (Warp).

    python -m studies.benchmarks.contact [--pool NAME|PATH ...] [--write]
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import tyro

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.world import make_world
from studies.benchmarks.contact_drops import drops
from studies.benchmarks.contact_pool import Creep, SceneMaker, Solo, solo
from studies.benchmarks.contact_scenes import Rest, SmallScenes, small_scenes
from studies.benchmarks.section import prose, report, table

MUJOCO = ContactConfig(
    friction=(1.0, 0.005, 0.0001),
    solref=(0.02, 1.0),
    solimp=(0.9, 0.95, 0.001, 0.5, 2.0),
    condim=3,
    cone="pyramidal",
)


def candidates() -> dict[str, ContactConfig]:
    """MuJoCo's own defaults, ours, and ours with one thing changed at a time."""
    ours = ContactConfig()

    def friction(sliding: float) -> ContactConfig:
        return replace(ours, friction=(sliding, *ours.friction[1:]))

    def impedance(least: float, most: float) -> ContactConfig:
        return replace(ours, solimp=(least, most, *ours.solimp[2:]))

    return {
        "ours": ours,
        "MuJoCo's defaults": MUJOCO,
        "solref 0.02": replace(ours, solref=(0.02, 1.0)),
        "solref 3 dt": replace(ours, solref=(3 / 240, 1.0)),
        "solimp .9 .95": impedance(0.9, 0.95),
        "solimp .95 .99": impedance(0.95, 0.99),
        "solimp .98 .98": impedance(0.98, 0.98),
        "condim 3": replace(ours, condim=3),
        "condim 6": replace(ours, condim=6),
        "pyramidal": replace(ours, cone="pyramidal"),
        "impratio 10": replace(ours, impratio=10.0),
        "noslip 5": replace(ours, noslip_iterations=5),
        "friction 0.25": friction(0.25),
        "friction 0.8": friction(0.8),
        "friction 1.0": friction(1.0),
        "20 iterations": replace(ours, iterations=20),
    }


@dataclass(frozen=True)
class Contact:
    """Compare contact configurations.

    Attributes:
      pool: pools by name or folder; scenes are made of the first one's objects.
      support: where `clear` places them; tight_support: where `drop` does.
      trials: placements of each object alone.
      num_scenes: scenes by each method.
      warp: drop things on Warp too, which compiles for some seconds for each candidate.
      only: names of the candidates to run; all if empty.
      write: renew this program's section of reports/benchmarks.md.
    """

    pool: tuple[str, ...] = ("dining", "study")
    support: str = "table"
    tight_support: str = "table-0.40x0.50"
    trials: int = 24
    num_scenes: int = 24
    warp: bool = True
    only: tuple[str, ...] = ()
    write: bool = False


@dataclass(frozen=True)
class Outcome:
    """All that was measured of one candidate."""

    contact: ContactConfig
    solo: list[Solo] = field(repr=False)
    clear: Creep = field(repr=False)
    tight: Creep = field(repr=False)
    small: SmallScenes = field(repr=False)
    drops: tuple[float, float] = field(repr=False)


def main(args: Contact) -> None:
    """Runs the comparison and prints it."""
    chosen = candidates()
    if unknown := set(args.only) - set(chosen):
        raise ConfigError(f"candidates {sorted(unknown)}", ", ".join(chosen), "--only ours")
    outcomes = measure({name: chosen[name] for name in args.only or chosen}, args)
    report("contact", body_of(outcomes, args), write=args.write)


def measure(chosen: dict[str, ContactConfig], args: Contact) -> dict[str, Outcome]:
    """Every candidate, one after another, on the same placements and with the same keys."""
    pools = [find_pool(name) for name in args.pool]
    support = find_support(args.support)
    known = {asset.name: asset for pool in pools for asset in pool.objects}
    clear = SceneMaker(pools[0].objects, support, "clear")
    tight = SceneMaker(pools[0].objects, find_support(args.tight_support), "drop")
    outcomes = {}
    for name, contact in chosen.items():
        worlds = [make_world(pool.objects, support, StabilityConfig(), contact) for pool in pools]
        outcomes[name] = Outcome(
            contact,
            [solo(world, args.trials) for world in worlds],
            clear.creep(contact, args.num_scenes),
            tight.creep(contact, args.num_scenes),
            small_scenes(contact, known),
            (drops(contact, "native"), drops(contact, "warp") if args.warp else math.nan),
        )
    return outcomes


def body_of(outcomes: dict[str, Outcome], args: Contact) -> str:
    """The section: what was measured, and two tables."""
    real = f"""Ours is `ContactConfig()`; every other row changes what it names, the second row everything.
        Objects of {", ".join(args.pool)} alone, {args.trials} times each: stable, mean steps, deepest overlap
        at rest. Then {args.num_scenes} scenes of ten objects of {args.pool[0]} by each of: `clear` on
        {args.support}, `drop` on {args.tight_support}; those that were filled are left for 10 s awake (the
        largest movement in a scene: median, 90 % and 99 %). Speed: steps of an awake scene per CPU-second,
        one thread. No-slip iterations do not exist in MJX."""
    small = """Known answers: after 1 s of settling (the apple: 6 s) the movement within 10 s and the deepest
        overlap; a box on a slope of 10 degrees creeps at what speed; at what tilt it slides along a side and
        across a corner, and the angle of friction, at which it should; the share of boxes and hexagonal
        prisms that come to rest by the rule, let go upright 0 to 20 mm above the table, in float64 (native)
        and in float32 (Warp). Textbook tables put wood or metal on wood near a friction of 0.5 at rest and
        0.3 sliding, rubber on dry ground near 1."""
    parts = [
        "## Contact parameters",
        prose(real),
        _real_table(outcomes),
        prose(small),
        _small_table(outcomes),
    ]
    return "\n\n".join(parts)


def _real_table(outcomes: dict[str, Outcome]) -> str:
    header = ["", "alone", "worst object", "steps", "overlap mm"]
    for name in ("`clear`", "`drop`"):
        header += [f"{name}: success", "attempts", "10 s: median mm", "90 %", "99 %"]
    return table([*header, "steps per CPU-s"], [_real_row(*item) for item in outcomes.items()])


def _real_row(name: str, outcome: Outcome) -> list[str]:
    solos = outcome.solo
    worst, who = min(each.worst for each in solos)
    row = [
        name,
        f"{100 * np.mean([each.rate for each in solos]):.1f} %",
        f"{who} {100 * worst:.0f} %" if worst < 1 else "-",
        f"{np.nanmean([each.steps for each in solos]):.1f}",
        f"{1000 * np.nanmean([each.penetration for each in solos]):.3f}",
    ]
    for creep in (outcome.clear, outcome.tight):
        moved = np.percentile(creep.moved, [50, 90, 99]) if len(creep.moved) else np.full(3, np.nan)
        row += [
            f"{100 * creep.success:.0f} %",
            f"{creep.attempts:.1f}",
            *(f"{1000 * each:.4f}" for each in moved),
        ]
    return [*row, f"{outcome.clear.steps_per_second:,.0f}"]


def _small_table(outcomes: dict[str, Outcome]) -> str:
    header = [
        "",
        "five boxes: mm in 10 s",
        "overlap mm",
        "2 kg on 30 g",
        "overlap mm",
        "apple in bowl",
    ]
    header += ["mug on book", "slope: mm/s", "slides at: degrees", "across", "should"]
    header += ["dropped: stable", "on Warp"]
    return table(header, [_small_row(*item) for item in outcomes.items()])


def _small_row(name: str, outcome: Outcome) -> list[str]:
    small = outcome.small
    should = math.degrees(math.atan(outcome.contact.friction[0]))
    return [
        name,
        f"{1000 * small.stack.creep:.4f}",
        f"{1000 * small.stack.penetration:.3f}",
        f"{1000 * small.heavy.creep:.4f}",
        f"{1000 * small.heavy.penetration:.3f}",
        _moved(small.bowl),
        _moved(small.book),
        f"{1000 * small.slope_speed:.4f}",
        *(f"{degrees:.1f}" for degrees in small.slides_at),
        f"{should:.1f}",
        *("-" if math.isnan(rate) else f"{100 * rate:.0f} %" for rate in outcome.drops),
    ]


def _moved(rest: Rest | None) -> str:
    return "-" if rest is None else f"{1000 * rest.creep:.4f}"


if __name__ == "__main__":
    main(tyro.cli(Contact))
