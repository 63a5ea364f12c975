"""What docs/guide/hosts.md takes from here: the table, and the command that each section begins with."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from cluttergen_jax.files import write_atomically
from studies.benchmarks.section import ROOT, replace_section
from studies.hosts.measurement import Measurement
from studies.hosts.table import HOSTS, Host

PAGE = ROOT / "docs/guide/hosts.md"
GUIDES = (PAGE, ROOT / "docs/guide/export.md")
_SECTION = "hosts"
_COMMAND = "```bash\npip install "
_BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
_WORDS = (
    "Other objects: in worlds side by side, or *in each* one that is made. Lines: of Python, below."
)
"""What the table's words mean."""
_HEADER = ("host", "format", "opened by", "moves in 10 s (mm)", "other objects", "trains", "lines")


def table_text(results: Mapping[str, Measurement]) -> str:
    """The table in Markdown: a row for each host, measured or not."""
    lines = [_HEADER, ["---"] * len(_HEADER)]
    lines += [_row(host, results.get(host.name)) for host in HOSTS.values()]
    # Without spaces: bars that stand alone would count as words of the guide.
    return "\n".join(f"|{'|'.join(line)}|" for line in lines)


def write_page(results: Mapping[str, Measurement], guides: Sequence[Path] = GUIDES) -> None:
    """Puts commands into the sections of guides, and the table into the first; all else stays."""
    for guide in guides:
        text = guide.read_text(encoding="utf-8")
        write_atomically(guide, with_commands(text).encode())
    replace_section(guides[0], _SECTION, f"{table_text(results)}\n\n{_origin(results)}".strip())


def with_commands(text: str) -> str:
    """A guide whose sections of hosts begin with the command that makes their environment."""
    for host in HOSTS.values():
        heading = f"\n## {host.title}\n\n"
        before, found, after = text.partition(heading)
        if found:
            text = before + heading + _with_command(after, host.pip_line)
    return text


def _with_command(section: str, line: str) -> str:
    """A section that begins with the command, in the place of another one or before all else."""
    if section.startswith(_COMMAND):
        _, _, rest = section.removeprefix(_COMMAND).partition("\n")
        return f"```bash\n{line}\n{rest}"
    return f"```bash\n{line}\n```\n\n{section}"


def num_lines(host: Host) -> int:
    """Lines of Python that the guide asks of a user, in the host's own section; 0 if there is none."""
    _, section = _section_of(host)
    blocks = _BLOCK.findall(section)
    return sum(bool(line.strip()) for block in blocks for line in block.splitlines())


def _section_of(host: Host) -> tuple[Path, str]:
    """The guide that has a host's section, and that section."""
    for guide in GUIDES:
        _, found, rest = guide.read_text(encoding="utf-8").partition(f"\n## {host.title}\n")
        if found:
            return guide, rest.partition("\n## ")[0]
    return PAGE, ""


def _title(host: Host) -> str:
    """The host's name, with a link where its section is in another guide."""
    guide, _ = _section_of(host)
    anchor = re.sub(r"[^a-z0-9_ -]", "", host.title.lower()).replace(" ", "-")
    return host.title if guide == PAGE else f"[{host.title}]({guide.name}#{anchor})"


def _row(host: Host, result: Measurement | None) -> list[str]:
    opened = "not measured"
    moves = "-"
    if result is not None and result.fault:
        opened = result.fault.partition(":")[0]
    elif result is not None:
        opened = ", ".join(f"{name} {each}" for name, each in (result.versions or {}).items())
        moves = f"{1000 * result.largest:.2g} ({1000 * result.median:.2g})"
        moves = moves if result.is_finite else "not finite"
    return [
        _title(host),
        f"`{host.format}`",
        opened,
        moves,
        host.others,
        host.trains,
        str(num_lines(host) or "-"),
    ]


def _origin(results: Mapping[str, Measurement]) -> str:
    done = [each for each in results.values() if not each.fault]
    if not done:
        return ""
    numbers = sorted({len(each.moves) for each in done})
    dates = sorted({each.date for each in done})
    return (
        f"Moves: of the object that moves most, in the worst scene (the median one) of "
        f"{' or '.join(map(str, numbers))} of six dining objects, each {done[0].seconds:g} s on a CPU: "
        f"`python -m studies.hosts --write`, {' to '.join(dates)}. {_WORDS}"
    )
