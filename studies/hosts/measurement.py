"""One host: its environment, its export, and 10 s of each scene, each kept and resumed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import cluttergen_jax as cg
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.files import write_atomically
from studies.benchmarks.section import ROOT
from studies.hosts.table import OWN, Host

_LAST = 300
"""Letters of a program's last words that are told where it fails."""
Note = Callable[[str], None]


@dataclass(frozen=True)
class Measurement:
    """What a host did with the scenes.

    Attributes:
      host: its name. fault: why there is nothing, in words; "" where there is.
      versions: of its packages, by name.
      moves: metres that an object of each scene was away at most, at any time that was looked at.
      is_finite: all poses at all times. num_worlds: side by side in one model.
      seconds: of simulated time. cpu_seconds: of the program and all that it started.
      date: when, ISO.
    """

    host: str
    fault: str = ""
    versions: dict[str, str] | None = None
    moves: tuple[float, ...] = ()
    is_finite: bool = False
    num_worlds: int = 0
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    date: str = ""

    @property
    def largest(self) -> float:
        """Metres; NaN where nothing was measured."""
        return max(self.moves, default=float("nan"))

    @property
    def median(self) -> float:
        """Metres; NaN where nothing was measured."""
        return float(np.median(self.moves)) if self.moves else float("nan")


class HostFolder:
    """What is made for the hosts: one bank, and for each host an environment, an export and a result.

    Args:
      path: the folder; what is there is kept and used again.
      num_scenes: of the bank. seconds: of simulated time. seed: of the bank.
    """

    def __init__(self, path: Path, num_scenes: int, seconds: float, seed: int) -> None:
        self.path = path
        self._num_scenes = num_scenes
        self._seconds = seconds
        self._seed = seed

    def measure(self, host: Host, note: Note) -> Measurement:
        """What the host does, kept from an earlier call or measured now; a fault is kept as well.

        Args:
          note: told what is at work.
        """
        file = self._result_file(host)
        if (kept := read_measurement(file)) is not None and not kept.fault:
            return kept
        try:
            note(f"{host.name}: environment")
            python = self._python(host, note)
            note(f"{host.name}: export")
            export = self._export(host)
            result = self._run(host, python, export, note)
        except HostError as error:
            result = Measurement(host.name, fault=str(error), date=_today())
        record = json.dumps(asdict(result), indent=1) + "\n"
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(file, record.encode())
        return result

    def results(self) -> dict[str, Measurement]:
        """What was measured so far with this setting, by host."""
        files = sorted((self.path / self._setting).glob("*.json"))
        found = [read_measurement(file) for file in files]
        return {each.host: each for each in found if each is not None}

    @property
    def _setting(self) -> str:
        return f"results-{self._num_scenes}-{self._seconds:g}-{self._seed}"

    def _result_file(self, host: Host) -> Path:
        return self.path / self._setting / f"{host.name}.json"

    def _python(self, host: Host, note: Note) -> Path:
        """The interpreter of the host's environment, which is made if it is not whole.

        CLUTTERGEN_HOST_PYTHON names one that is there, as of tests.
        """
        if named := os.environ.get(f"CLUTTERGEN_{host.name.upper()}_PYTHON"):
            return Path(named)
        folder = (self.path / "environments" / host.name).absolute()
        python = folder / "bin/python"
        asked = json.dumps(host.packages)
        ready = folder / "packages.json"
        if ready.is_file() and ready.read_text() == asked:
            return python
        base = shutil.which(f"python{host.python}") if host.python else sys.executable
        if base is None:
            raise HostError(f"cannot be installed: no python{host.python} is on the PATH")
        _call([base, "-m", "venv", "--clear", folder], "cannot be installed", None)
        packages = [each.replace(OWN, str(ROOT)) for each in host.packages]
        note(f"{host.name}: {host.pip_line}")
        _call([python, "-m", "pip", "install", "--quiet", *packages], "cannot be installed", None)
        write_atomically(ready, asked.encode())
        return python

    def _export(self, host: Host) -> Path:
        name = f"{self._num_scenes}-{self._seed}"
        bank = self.path / f"bank-{name}"
        _generate(bank, self._num_scenes, self._seed)
        out = self.path / f"exports-{name}" / f"in_{host.format}"
        try:
            return cg.export(bank, out, host.format, overwrite=True)
        except ClutterGenError as error:
            raise HostError(f"no export: {error}") from error

    def _run(self, host: Host, python: Path, export: Path, note: Note) -> Measurement:
        words = [python, host.program, export, self._seconds, self._num_scenes]
        before = os.times()
        printed = _call(words, "fails", lambda line: note(f"{host.name}: {line}"))
        after = os.times()
        told = json.loads(printed.splitlines()[-1])
        versions = json.loads(_call([python, "-c", _VERSIONS, *host.versions], "fails", None))
        return Measurement(
            host=host.name,
            versions=versions,
            moves=tuple(told["moves"]),
            is_finite=told["is_finite"],
            num_worlds=told["num_worlds"],
            seconds=self._seconds,
            cpu_seconds=sum(after[2:4]) - sum(before[2:4]),
            date=_today(),
        )


_VERSIONS = "import json, sys\nfrom importlib.metadata import version\n"
_VERSIONS += "print(json.dumps({each: version(each) for each in sys.argv[1:]}))"


class HostError(Exception):
    """Why a host measured nothing."""


def read_measurement(file: Path) -> Measurement | None:
    """A kept measurement; None if there is none, or it is none."""
    try:
        fields = json.loads(file.read_text(encoding="utf-8"))
        return Measurement(**{**fields, "moves": tuple(fields["moves"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _generate(out: Path, num_scenes: int, seed: int) -> None:
    """Six dining objects in each scene, so that most scenes have others; what is there is kept."""
    cg.generate(out, pool="dining", num_objects=6, num_scenes=num_scenes, seed=seed, render=False)


def _call(words: Sequence[object], fault: str, note: Note | None) -> str:
    """What a program prints; its other words go to `note` line by line.

    Raises:
      HostError: it fails; with its last words.
    """
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    last: list[str] = []
    # A pipe that nobody reads would fill up: compilers of kernels print much.
    with tempfile.TemporaryFile("w+") as printed_file:
        with subprocess.Popen(
            [str(each) for each in words],
            stdout=printed_file,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        ) as program:
            for line in program.stderr or ():
                last = [*last[-20:], line.strip()]
                if note is not None:
                    note(line.strip()[:80])
        printed_file.seek(0)
        printed = printed_file.read()
    if program.returncode != 0:
        words_left = " ".join(each for each in last if each)[-_LAST:]
        raise HostError(f"{fault}: {words_left or f'status {program.returncode}'}")
    return printed


def _today() -> str:
    return time.strftime("%Y-%m-%d")
