"""The dataset card: a README in the bank's folder, which says what the folder is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pyarrow as pa

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import public_name
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import HAND, StabilityConfig
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.placement.methods.table import entry_of
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.croissant import write_croissant
from cluttergen_jax.scene.bank.record import READER, Bits, Recipe, cut_runs
from cluttergen_jax.scene.bank.stats import BankStats, stats_of
from cluttergen_jax.scene.bank.table import (
    BY_HAND,
    CERTIFICATE,
    CLUTTER,
    COUNTED,
    DOORS,
    SCHEMA,
    count_column,
    schema_of,
)
from cluttergen_jax.tables import markdown_table
from cluttergen_jax.types import Verdict, small_length

CARD = "README.md"
MARK = "<!-- written by cluttergen; remove this line to keep your own changes -->"

_MOST_RUNS = 8
_FAR = f"{1000 * StabilityConfig.stand_full_shift:g} mm"
_MUCH = f"{math.degrees(StabilityConfig.stand_full_turn):g} degrees"

_COLUMNS = {
    "index": "the scene's number; its random key is fold_in(key(seed), index), in a bank that was cut of "
    "another by the number there",
    "is_success": "every object placed, and all stand together in the last check",
    "is_filled": "every object placed",
    "verdict": "the last word on the scene",
    "drift": "metres, the largest movement in the last check",
    "num_placed": "objects placed",
    "object_index": "slot by slot, the number of the object in the compiled world",
    "objects": "slot by slot, its name; mug#2 is the second mug",
    "is_placed": "slot by slot, whether it was placed",
    "poses": "slot by slot, position (metres) and quaternion wxyz in the world: z up, origin on the floor "
    "below the support's centre",
    "attempts": "slot by slot, attempts at its object, at places that it was taken from again included",
    "steps": "slot by slot, steps of all these attempts",
    "rest_steps": "slot by slot, steps of the attempt that succeeded",
    "simulated_steps": "steps simulated for the scene",
    "levels": "slot by slot, how many objects are below it, one upon the other, -1 where not placed",
    "num_on": "objects that rest on another",
    "num_touching": "pairs of objects that touch",
    "num_in": "objects in others; null where nothing was asked to be in something",
    "num_beside": "pairs of objects that touch from the side; null but for piles and crowds",
    "num_leaning": "objects that lean; null but for crowds",
    "near": "metres, the mean over the objects of the gap in plan to the nearest other one, as boxes",
    "occlusion": "the mean share of an object that others hide from eight cameras 30 degrees up, as boxes",
    "joints": "where the support's joints are in its order, radians or metres",
    "num_door_hits": "how often a door hit an object or did not close",
    "door_hit": "the last time, such as `door_left hits mug`",
    "seconds": "that the person who made the scene spent on it, pauses of more than a minute left out",
    "residual_speed": "after `cluttergen certify`: m/s, the fastest object 0.25 s after the scene is let go",
    "residual_angular_speed": "after `certify`: rad/s, likewise",
    "horizon_drift": "after `certify`: metres, the most that an object moves within the horizon",
    "horizon_turn": "after `certify`: radians, the most that an object turns within the horizon",
    "horizon_seconds": "after `certify`: the horizon",
    "penetration": "after `certify`: metres, the deepest overlap of two bodies",
    "num_contacts": "after `certify`: contact points",
    "shake": "after `certify`: m/s^2, the sideways acceleration of the support, growing slowly, at which an "
    f"object has moved {_FAR}; the smaller of both directions",
    "shake_x": "after `certify`: m/s^2, along world x",
    "shake_y": "after `certify`: m/s^2, along world y",
    "rests_on": "after `certify`: pairs of object_index, who rests and on whom; -1 is the support",
    "margin": "after `certify`: metres, the least support margin of its objects: the distance in plan of an "
    "object's centre of mass to the edge of the polygon of the contacts that carry it; negative outside it",
    "margins": "after `certify`: slot by slot, each object's; null for what no contact carries from below",
    **{
        f"tilt_{angle}": f"after `certify`: of eight directions, the share in which gravity tilted by "
        f"{angle} degrees moves nothing by {_FAR} or {_MUCH} within 2 s"
        for angle in (1, 2, 5)
    },
    "robust": "after `certify`: in soft contact (MuJoCo's default), with 0.7 times the friction and gravity "
    f"tilted by 3 degrees in each of four directions, nothing slides by {_FAR} or turns by {_MUCH} within "
    "2 s",
    "detectors": "after `certify`: with which of MuJoCo's detectors of convex collisions (native, libccd) "
    f"nothing moves by {_FAR} or {_MUCH} within the horizon; drift is the larger of both, the rest native's",
} | {count_column(v): f"attempts that ended {v.label}: {v.sentence}" for v in COUNTED}


def write_card(bank: Bank) -> Path | None:
    """Writes the card, and `croissant.json`, unless the user has such files of their own there.

    Returns:
      The card's path if it was written.

    Raises:
      BankError: the bank holds no scenes yet, or it or one of its assets is damaged.
    """
    stats = stats_of(bank)
    assets = _assets_of(bank, stats)
    columns = schema_of(next(bank.tables()))
    name = bank.path.resolve().name
    write_croissant(bank.path, columns, _COLUMNS, _licences(bank, assets), name)
    return write_unless_own(bank.path, lambda: card_text(bank, stats, assets))


def write_unless_own(folder: Path, text: Callable[[], str]) -> Path | None:
    """Writes a card into a folder, unless the user has a README of their own there; its path if written.

    Args:
      text: makes it; it bears `MARK`.
    """
    path = folder / CARD
    if path.exists() and MARK not in path.read_text(encoding="utf-8", errors="replace"):
        return None
    write_atomically(path, text().encode())
    return path


def card_text(bank: Bank, stats: BankStats, assets: Sequence[ObjectAsset] | None = None) -> str:
    """The card of a bank as Markdown.

    Args:
      assets: its objects; read if not given.
    """
    assets = _assets_of(bank, stats) if assets is None else assets
    sections = [
        front_matter(
            _licences(bank, assets),
            ("robotics", "simulation", "mujoco", "tabletop", "scenes"),
            "cluttered tabletop scenes",
            "'scenes-*.parquet'",
        ),
        _about(bank, stats),
        _figures(stats),
        _files(
            bank.path,
            [
                *(BY_HAND if bank.recipe.get("method") == HAND else ()),
                *(() if stats.door_hits is None else DOORS),
            ],
        ),
        _recipe_section(bank.recipe, bank.record.get("bits", [])),
        _stability(bank),
        assets_section(assets, bank.support),
    ]
    return "\n\n".join(sections) + "\n"


def front_matter(
    licences: Sequence[str],
    tags: Sequence[str],
    title: str,
    data_files: str,
    more: Sequence[str] = (),
) -> str:
    """The block that dataset hubs read, and the mark of a card that may be written again.

    Args:
      licences: of the assets; hubs get their word for one known licence, else all of them by name.
      data_files: which files are the data, as YAML; else pictures would be taken for it.
      more: further lines of YAML.
    """
    known = sorted(set(licences))
    if known == ["Apache-2.0"]:
        lines = ["---", "license: apache-2.0"]
    else:
        lines = ["---", "license: other", f"license_name: {' and '.join(known)!r}"]
    lines += [
        f"tags: [{', '.join(tags)}]",
        f"pretty_name: {title}",
        f"configs: [{{config_name: default, data_files: {data_files}}}]",
        *more,
    ]
    return "\n".join([*lines, "---", MARK])


def _assets_of(bank: Bank, stats: BankStats) -> list[ObjectAsset]:
    """All its objects; of banks that do not name them those that its scenes have."""
    names = sorted(bank.assets["objects"]) or [each.name for each in stats.objects]
    return [bank.object(name) for name in names]


def _licences(bank: Bank, assets: Sequence[ObjectAsset]) -> list[str]:
    return [*(asset.provenance.licence for asset in assets), bank.support.provenance.licence]


def _about(bank: Bank, stats: BankStats) -> str:
    how = "placed one after another on a support until all lie still together"
    if entry_of(bank.recipe.get("method")).is_heap:
        how = "let fall into a heap until all lie still together"
    return (
        f"# {bank.path.resolve().name}\n\n"
        f"{stats.scenes} cluttered tabletop scenes, of which {stats.success} stand: objects {how}, checked "
        "in physics. Failures are kept in the record, so that success rates can be computed from it."
    )


def _figures(stats: BankStats) -> str:
    rows = [
        ("scenes asked for", stats.asked),
        ("scenes here", stats.scenes),
        ("succeed", f"{stats.success} ({stats.success_rate:.1%})"),
        ("objects placed", stats.placed),
        ("attempts", stats.attempts),
        ("steps simulated", stats.simulated_steps),
        ("median movement in the last check", small_length(stats.drift_median)),
        ("most", small_length(stats.drift_most)),
        ("scenes that repeat another", sum(len(group) - 1 for group in stats.duplicates)),
    ]
    rows += [(f"verdict {name}", number) for name, number in stats.verdicts.items()]
    rows += [(f"door: {text}", number) for text, number in (stats.door_hits or {}).items()]
    rows += [(f"clutter: {each.name}", each.line().partition(" ")[2]) for each in stats.clutter]
    facts = (fact.partition(": ") for fact in stats.certificate_lines())
    rows += [(name, value) for name, _, value in facts]
    return "\n".join(["## Figures", "", markdown_table(("", ""), rows)])


_ALONE = (
    "- `bank_reader.py`: reads the bank with NumPy and pyarrow alone, beside any MuJoCo from 2.3.7 on: "
    "`from bank_reader import Bank`, or `python bank_reader.py`."
)


def _files(folder: Path, added: Iterable[pa.Field]) -> str:
    """The files and the columns, with those that only some banks have."""
    lines = [
        "## Files",
        "",
        "- `bank.json`: how the bank was made: every setting, versions, digests of the files.",
        "- `scenes-*.parquet`: a row per scene, failures included, in row groups of 256; "
        "a file each of those, or one of many in a large bank.",
        "- `assets/`: every object once (surfaces, images, convex parts, mass, inertia), and the support.",
        *([_ALONE] if (folder / READER).is_file() else []),
        "- `croissant.json`: the columns for programs that read Croissant.",
        "- `scenes/`: if present, an MJCF file (and a picture) for each scene that stands; poses are in "
        "the bodies and in the keyframe `scene`.",
        "",
        "```python",
        "import jax, cluttergen_jax as cg",
        'bank = cg.load_bank("this folder")  # or "owner/name", where it is on a hub',
        "scene = jax.jit(bank.reset)(jax.random.key(0))  # a scene that stands, for an environment's reset",
        "```",
        "",
    ]
    columns = (*SCHEMA, *CLUTTER, *added, *CERTIFICATE)
    fields = [(f"`{f.name}`", f"`{f.type}`", _COLUMNS[f.name]) for f in columns]
    return "\n".join([*lines, markdown_table(("column", "type", "meaning"), fields)])


def _recipe_section(recipe: Recipe, bits: list[Bits]) -> str:
    placement = recipe.get("placement", {})
    is_by_hand = recipe.get("method") == HAND
    rows = {
        "pool": public_name(str(recipe.get("pool"))),
        "support": Path(str(recipe.get("support"))).name,
        "objects per scene": placement.get("num_objects"),
        "order of objects": placement.get("order"),
        "attempts per object": "as many as were wanted"
        if is_by_hand
        else placement.get("max_attempts"),
        "attempts per scene": placement.get("budget") or "so many for each object",
        "failed attempts after which objects are taken away": placement.get("ruin_after")
        or "none are",
        "method": f"{recipe['method']}, a user's own, digest {recipe['method_digest']}"
        if "method_digest" in recipe
        else recipe.get("method"),
        "checkpoint": recipe.get("checkpoint_hash") or "none",
        "seed": recipe.get("seed"),
        **_rows_of_cut(recipe),
        **_rows_of_request(recipe),
        "engine": recipe.get("engine"),
        "queried region": recipe.get("region"),
        "containment": placement.get("containment"),
        "support margin asked for, metres": placement.get("min_margin", 0),
        "robust": "asked for"
        if recipe.get("stability", {}).get("robust_tilt")
        else "not asked for",
        "overhang": placement.get("overhang", "any"),
        **{
            f"{name} asked for": placement[name]
            for name in (
                "clutter",
                "crowd",
                "natural",
                "sense",
                "seat",
                "tidy",
                "relations",
                "relations_prefer",
            )
            if name in placement
        },
        "versions": ", ".join(
            f"{name} {number}" for name, number in recipe.get("versions", {}).items()
        ),
    }
    if bits:
        rows["computed by"] = "; other scenes by ".join(
            ", ".join(filter(None, each.values())) for each in bits
        )
    return "\n".join(
        ["## How it was made", "", *(f"- {name}: {value}" for name, value in rows.items())]
    )


def _rows_of_request(recipe: Recipe) -> dict[str, str]:
    """The sentence that its layout is from, and who wrote it; nothing where there is none."""
    asked = recipe.get("asked")
    if not isinstance(asked, dict):
        return {}
    tries = asked.get("tries")
    answers = "1 answer" if tries == 1 else f"{tries} answers"
    return {"layout asked for": f"{asked.get('request')!r}, of {asked.get('model')}, {answers}"}


def _rows_of_cut(recipe: Recipe) -> dict[str, str]:
    """Of which bank it was cut; nothing where it was not."""
    runs = [str(first) if first == last else f"{first}-{last}" for first, last in cut_runs(recipe)]
    if not runs:
        return {}
    shown = ", ".join(runs[:_MOST_RUNS]) + (", ..." if len(runs) > _MOST_RUNS else "")
    return {
        "cut of": f"{recipe['cut'].get('bank')}, scenes {shown} of the seed, here numbered from 0"
    }


def _stability(bank: Bank) -> str:
    recipe = bank.recipe
    limits = {
        **recipe.get("stability", {}),
        **{f"contact {k}": v for k, v in recipe.get("contact", {}).items()},
    }
    lines = [
        "## What stable means here",
        "",
        "An attempt lets the object go at rest; it counts if the object comes to rest in time, no other "
        "object is disturbed and nothing overlaps too much. A scene counts if, in addition, all its objects "
        "stand together when simulated from the saved poses with everything awake. Thresholds (SI units, "
        "radians; steps of `timestep`):",
        "",
        ", ".join(f"{name} = {value}" for name, value in limits.items()) + ".",
        "",
        *_other_limits(bank),
        f"Verdicts: {'; '.join(f'{v.label}: {v.sentence}' for v in Verdict if v >= 0)}.",
    ]
    return "\n".join(lines)


def _other_limits(bank: Bank) -> list[str]:
    """What its scenes were asked to be stable by, where those are not the usual limits."""
    try:
        asked = bank.spec.stability
    except BankError:
        return []
    return [f"Asked for, in place of the usual limits: {asked}.", ""] if asked else []


def assets_section(assets: Sequence[ObjectAsset], support: SupportAsset) -> str:
    """Whose assets a folder holds, and on which terms."""
    rows = [
        (
            f"{asset.label} (`{asset.name}`)",
            f"{asset.mass:.3g} kg",
            asset.provenance.source,
            asset.provenance.licence,
            "; ".join(asset.flags),
        )
        for asset in assets
    ]
    source = support.provenance
    rows.append((f"{support.label} (support)", "", source.source, source.licence, ""))
    lines = [
        "## Assets and licences",
        "",
        markdown_table(("asset", "mass", "source", "licence", "notes"), rows),
    ]
    credited = {source.attribution, *(asset.provenance.attribution for asset in assets)}
    credits = sorted(credited - {""})
    return "\n".join([*lines, *(["", *credits] if credits else [])])
