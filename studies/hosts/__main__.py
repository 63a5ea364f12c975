"""Scenes for ten seconds in every host, each in an environment of its own from the package index.

    python -m studies.hosts                     # all; what was measured is kept: run it again to go on
    python -m studies.hosts newton dm_control   # some
    python -m studies.hosts --write             # and the table and commands of docs/guide/hosts.md
    python -m studies.hosts --only-page         # these alone, of what was measured

Environments, one bank, exports and results lie in `--out`. A host that cannot be installed, or that fails, is
told as such, and tried again by the next call. CLUTTERGEN_HOST_PYTHON (CLUTTERGEN_MJLAB_PYTHON, ...) names an
interpreter to be used instead of a new environment.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cluttergen_jax.config import check_range
from cluttergen_jax.errors import ClutterGenError, ConfigError, closest
from cluttergen_jax.kept_folder import lock_beside
from cluttergen_jax.progress import Progress
from studies.hosts.measurement import HostFolder
from studies.hosts.page import table_text, write_page
from studies.hosts.table import HOSTS


@dataclass(frozen=True)
class HostsConfig:
    """What is measured.

    Attributes:
      hosts: their names; all if none is given.
      out: folder of what is made.
      num_scenes: of the bank, each simulated in each host.
      seconds: of simulated time.
      seed: of the bank.
      write: put the table and the commands into docs/guide/hosts.md.
      only_page: do nothing but that.
    """

    hosts: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    out: Path = Path("runs/hosts")
    num_scenes: int = 64
    seconds: float = 10.0
    seed: int = 87
    write: bool = False
    only_page: bool = False


def main(config: HostsConfig) -> int:
    """Measures, prints the table; 1 if a host has none, else 0."""
    for name in config.hosts:
        if name not in HOSTS:
            raise ConfigError(f"host {name!r}", ", ".join(HOSTS), meant=closest(name, HOSTS))
    check_range("num_scenes", config.num_scenes, 1, 10_000, 64)
    if not 0 < config.seconds <= 3600:
        raise ConfigError(f"seconds = {config.seconds:g}", "more than 0, at most 3600", "10")
    folder = HostFolder(config.out, config.num_scenes, config.seconds, config.seed)
    if config.only_page:
        write_page(folder.results())
        return 0
    names = config.hosts or tuple(HOSTS)
    faults = {}
    config.out.mkdir(parents=True, exist_ok=True)
    with lock_beside(config.out), Progress("hosts", len(names), "host") as progress:
        for name in names:
            result = folder.measure(HOSTS[name], progress.note)
            if result.fault:
                faults[name] = result.fault
            progress.update(note=f"{name}: {result.fault or f'{1000 * result.largest:.2g} mm'}")
    results = folder.results()
    print(table_text(results))
    for name, fault in faults.items():
        print(f"{name}: {fault}", file=sys.stderr)
    if config.write:
        write_page(results)
    return int(bool(faults))


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(HostsConfig, description=__doc__)))
    except ClutterGenError as error:
        sys.exit(str(error))
