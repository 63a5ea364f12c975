"""Commands under accidents: killed, interrupted, without streams, on a full disk; the result is the same.

`python -m tests.helpers.accidents SECONDS SEED [COMMAND...]` tries each command so long at random moments,
and prints what went wrong. `test_accidents.py` does the same a few times.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import trimesh

from cluttergen_jax.assets.pool import Pool, write_pool
from tests.helpers import banks
from tests.helpers.placing import seen_trio, write_bank

_OF_THE_MOMENT = re.compile(r"(\.tfevents|(?:^|/)last/state)[./].*")
"""Names that differ each time: of logs for TensorBoard, and of the arrays of a training that can go on."""
REDIRECTIONS = ("<&-", ">&-", "2>&-", "<&- >&- 2>&-", "2>/dev/full", "2>&1 | head -c 0")
SIGNALS = (signal.SIGKILL, signal.SIGINT)
_HEARD = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
os.execv(sys.executable, [sys.executable, "-m", *sys.argv[1:]])
"""
"""A job in the background hears no Ctrl-C, and neither would what it starts."""
_ENDS = 60
"""Seconds within which a command that got a signal has to end, on a busy machine."""


@dataclass(frozen=True)
class Command:
    """A command line whose files are compared.

    Attributes:
      words: of it; {bank}, {pool}, {meshes} and {pairs} are `Inputs`, "out" is the folder that it writes.
      begins_as: the input that "out" is a copy of, for commands that add to a folder.
      home: whether the user's own folder is "out".
      needs_gl: whether it draws.
      is_once: whether it refuses a folder that is there, which has to be whole then.
      module: that Python runs.
    """

    words: str
    begins_as: str = ""
    home: bool = False
    needs_gl: bool = False
    is_once: bool = False
    module: str = "cluttergen_jax"


COMMANDS = {
    "generate": Command(
        "generate --pool {pool} --num-objects 2 --method random -n 600 --max-files 8 --out out"
    ),
    "verify": Command("verify out --seconds 0.2 --jobs 1", begins_as="scenes"),
    "certify": Command("certify out --seconds 0.2 --jobs 1", begins_as="scenes"),
    "export": Command("export {bank} --format urdf --out out", is_once=True),
    "dataset": Command(
        "dataset {bank} --no-colour --cameras free:4 --size 160x120 --splits train=0.7,test=0.3 --out out"
    ),
    "bop": Command(
        "dataset {bank} --no-colour --form bop --cameras free:2 --size 160x120 --out out"
    ),
    "coco": Command(
        "dataset {bank} --form coco --cameras free:2 --size 64x48 --splits train=0.7,val=0.3 --out out",
        needs_gl=True,
    ),
    "yolo": Command(
        "dataset {bank} --form yolo-seg --cameras free:2 --size 64x48 --out out", needs_gl=True
    ),
    "render": Command(
        "render {bank} --bop --no-picture --views 1 --size 64x48 --out out", needs_gl=True
    ),
    "import": Command("import {meshes} --pool mine --jobs 1 --trials 16", home=True),
    "evaluate": Command(
        "evaluate --methods random clear --pools {pool} --num-objects 2 --trials 8 --out out"
    ),
    "train": Command(
        "train --pool {pool} --num-objects 2 --num-envs 8 --num-attempts 1536 --eval-every 512 "
        "--eval-episodes 4 --out out"
    ),
    "pretrain": Command(
        "pretrain --num-shapes 1 --num-held-out 1 --num-epochs 4 --batch-size 8 --object-points 256 --out out"
    ),
    "placer data": Command("placer data {bank} --num-pairs 60 --out out"),
    "placer train": Command(
        "placer train {pairs} --num-epochs 4 --batch-size 8 --noise off --out out"
    ),
    "perception data": Command(
        "data --pool {pool} --num-views 12 --arm 0 --out out",
        needs_gl=True,
        module="studies.perception",
    ),
    "robot grasps": Command("robot grasps {pool} --num-grasps 4", home=True),
    "rearrange": Command("rearrange --num-episodes 2 --no-films --num-threads 1 --out out"),
}


class Inputs:
    """What commands read, made when it is first asked for.

    Args:
      folder: of the inputs.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, name: str) -> Path:
        """An input by its name in a command line."""
        path = self.folder / name
        if not path.exists():
            getattr(self, f"_{name}")(path)
        return path

    def _bank(self, path: Path) -> None:
        write_bank(path, 24)

    def _scenes(self, path: Path) -> None:
        banks.with_files(path)

    def _pool(self, path: Path) -> None:
        write_pool(path, Pool(path.name, tuple(seen_trio())))

    def _meshes(self, path: Path) -> None:
        path.mkdir(parents=True)
        for number in range(4):
            trimesh.creation.box((0.03 + 0.01 * number, 0.04, 0.05)).export(
                path / f"box{number}.obj"
            )

    def _pairs(self, path: Path) -> None:
        words = ["placer", "data", self.path("bank"), "--num-pairs", "40", "--out", path]
        subprocess.run([sys.executable, "-m", "cluttergen_jax", *map(str, words)], check=True)


def facts_of(folder: Path) -> dict[str, object]:
    """What a folder holds: a value for each leaf of a JSON file and column of a CSV file, else a digest."""
    found: dict[str, object] = {}
    for path in sorted(each for each in folder.rglob("*") if each.is_file() or each.is_symlink()):
        name = _OF_THE_MOMENT.sub(r"\1", str(path.relative_to(folder)))
        found[name] = "a file"
        if path.suffix == ".json":
            found |= {
                f"{name}:{key}": value for key, value in _leaves(json.loads(path.read_bytes()))
            }
        elif path.suffix == ".csv":
            header, *rows = csv.reader(path.read_text().splitlines())
            found |= {
                f"{name}:{key}": column
                for key, column in zip(header, zip(*rows, strict=True), strict=False)
            }
        else:
            found[f"{name}:"] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def _leaves(value: object, key: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(value, dict | list):
        for name, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _leaves(inner, f"{key}.{name}")
    else:
        yield key, value


@dataclass
class Bench:
    """One command, what it makes without accidents, and what differs there from one time to the next.

    Args:
      name: of the command. inputs: of all commands. folder: for the files of this one.
    """

    name: str
    inputs: Inputs
    folder: Path
    seconds: float = 0.0
    usual: dict[str, object] = field(default_factory=dict)
    num_tries: int = 0

    def __post_init__(self) -> None:
        self.command = COMMANDS[self.name]
        names = ("bank", "pool", "meshes", "pairs")
        paths = {
            each: self.inputs.path(each) for each in names if "{" + each + "}" in self.command.words
        }
        self.words = [word.format(**paths) for word in self.command.words.split()]

    def measure(self) -> set[str]:
        """Runs it twice; which facts are of the moment: dates, seconds."""
        made = []
        for _ in range(2):
            place = self.place()
            started = time.monotonic()
            self.finish(place)
            # The first time programs are compiled.
            self.seconds = time.monotonic() - started
            made.append(facts_of(place / "out"))
        passing = {key for key in made[0] | made[1] if made[0].get(key) != made[1].get(key)}
        self.usual = {key: value for key, value in made[0].items() if key not in passing}
        return passing

    def place(self) -> Path:
        """A new folder to run it in."""
        self.num_tries += 1
        place = self.folder / str(self.num_tries)
        place.mkdir(parents=True)
        if self.command.begins_as:
            shutil.copytree(self.inputs.path(self.command.begins_as), place / "out")
        return place

    def start(self, place: Path, redirection: str = "") -> subprocess.Popen[str]:
        """The command as a process, in a session of its own."""
        home = place / "out" if self.command.home else self.folder / "home"
        shell = ["bash", "-c", f'"$@" {redirection}; exit "${{PIPESTATUS[0]}}"', "bash"]
        log = _log(place).open("a")
        return subprocess.Popen(
            [
                *(shell if redirection else ()),
                sys.executable,
                "-c",
                _HEARD,
                self.command.module,
                *self.words,
            ],
            cwd=place,
            env=_environment() | {"CLUTTERGEN_HOME": str(home)},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            text=True,
            start_new_session=True,
        )

    def finish(self, place: Path, redirection: str = "") -> None:
        """Runs it to its end (AssertionError: it fails)."""
        if self.command.is_once and (place / "out").exists():
            return
        status = self.start(place, redirection).wait()
        assert status == 0, f"status {status} {redirection}: {_last_lines(place)}"

    def check(self, place: Path) -> None:
        """Holds what was made against what is made without accidents (AssertionError: they differ)."""
        made = facts_of(place / "out")
        left = sorted(name for name in made if ".partial" in name or ".lock" in name)
        assert not left, f"left behind: {left}"
        names = [{key for key in each if ":" not in key} for each in (made, self.usual)]
        assert names[0] == names[1], f"other files: {sorted(names[0] ^ names[1])}"
        other = sorted(key for key, value in self.usual.items() if made.get(key) != value)
        assert not other, f"different: {other[:8]}"

    def kill(self, draw: random.Random, most: int = 3) -> None:
        """Sends signals at random moments, up to `most` times, then lets it end."""
        place = self.place()
        for _ in range(draw.randint(1, most)):
            process = self.start(place)
            number = draw.choice(SIGNALS)
            is_alone = draw.random() < 0.5
            try:
                process.wait(draw.uniform(0, 1.1 * self.seconds))
                break
            except subprocess.TimeoutExpired:
                if number == signal.SIGKILL and not is_alone:
                    os.killpg(process.pid, number)
                else:
                    process.send_signal(number)
                status = process.wait(_ENDS)
                allowed = {-number} if number == signal.SIGKILL else {130, -number, 0}
                assert status in allowed, (
                    f"status {status} after signal {number}: {_last_lines(place)}"
                )
        self.finish(place)
        self.check(place)

    def redirect(self, draw: random.Random) -> None:
        """Closes or breaks streams."""
        place = self.place()
        self.finish(place, draw.choice(REDIRECTIONS))
        self.check(place)

    def fill(self, draw: random.Random) -> None:
        """Runs it on a disk that is too small, enlarges the disk, and runs it again."""
        place = self.folder / str(self.num_tries + 1)
        with small_disk(place) as resize:
            self.place_on(place)
            needed = sum(
                each.stat().st_size for each in self._reference().rglob("*") if each.is_file()
            )
            resize(
                int(draw.uniform(0.05, 1) * needed)
                + (_used(place) if self.command.begins_as else 0)
            )
            status = self.start(place).wait()
            said = _last_lines(place)
            assert status in (0, 2), f"status {status} on a full disk: {said}"
            assert status == 0 or "error: " in said, f"no error on a full disk: {said}"
            assert "Traceback" not in said, said
            resize(needed * 4 + 50_000_000)
            self.finish(place)
            self.check(place)

    def place_on(self, place: Path) -> None:
        """As `place`, in a folder that exists."""
        self.num_tries += 1
        if self.command.begins_as:
            shutil.copytree(self.inputs.path(self.command.begins_as), place / "out")

    def _reference(self) -> Path:
        return self.folder / "1" / "out"


def accidents(bench: Bench) -> dict[str, Callable[[random.Random], None]]:
    """The kinds of accident, by name; a disk is filled where one can be mounted."""
    kinds = {"kill": bench.kill, "redirect": bench.redirect}
    return kinds | ({"fill": bench.fill} if why_no_disk() is None else {})


@contextmanager
def small_disk(folder: Path) -> Iterator[Callable[[int], None]]:
    """A file system in memory at a folder; the function sets its size in bytes."""

    def mount(size: int, *options: str) -> None:
        sized = ",".join((*options, f"size={max(size, 4096)}"))
        command = ["mount", "-t", "tmpfs", "-o", sized, "cluttergen-test", str(folder)]
        subprocess.run(command, check=True, capture_output=True)

    folder.mkdir(parents=True)
    mount(1 << 30)
    try:
        yield lambda size: mount(size, "remount")
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def why_no_disk() -> str | None:
    """Why no small disk can be mounted here; None where one can."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            with small_disk(Path(folder) / "disk"):
                return None
        except (OSError, subprocess.CalledProcessError) as error:
            return getattr(error, "stderr", b"").decode().strip() or str(error)


def _used(folder: Path) -> int:
    return shutil.disk_usage(folder).used


def _environment() -> dict[str, str]:
    programs = os.environ.get(
        "JAX_COMPILATION_CACHE_DIR", str(Path(tempfile.gettempdir()) / "programs")
    )
    root = str(Path(__file__).parents[2])
    return os.environ | {"JAX_COMPILATION_CACHE_DIR": programs, "PYTHONPATH": root}


def _log(place: Path) -> Path:
    """Beside the folder, which may be a disk that is full."""
    return place.with_name(f"{place.name}.log")


def _last_lines(place: Path) -> str:
    return "\n".join(_log(place).read_text(errors="replace").splitlines()[-12:])


def _hunt(name: str, seconds: float, seed: int) -> None:
    """Tries accidents of one command, and prints what went wrong; then its files stay where it says."""
    folder = Path(tempfile.mkdtemp(prefix="accidents-"))
    bench = Bench(name, Inputs(folder / "inputs"), folder / "runs")
    passing = bench.measure()
    files = sorted({key.split(":")[0] for key in passing})
    print(
        f"{name}: {bench.seconds:.1f} s; of the moment: {', '.join(files) or 'nothing'}", flush=True
    )
    draw = random.Random(seed)
    end = time.monotonic() + seconds
    tries = 0
    failures = 0
    kinds = accidents(bench)
    while time.monotonic() < end:
        kind = draw.choice(list(kinds))
        tries += 1
        try:
            kinds[kind](draw)
        except (AssertionError, OSError, ValueError, subprocess.TimeoutExpired) as error:
            failures += 1
            print(f"{name}: {kind} in {folder}/runs/{bench.num_tries}: {error!s:.1500}", flush=True)
        else:
            shutil.rmtree(folder / "runs" / str(bench.num_tries), ignore_errors=True)
    if not failures:
        shutil.rmtree(folder)
    print(f"{name}: {tries} accidents, {failures} went wrong", flush=True)


if __name__ == "__main__":
    for each in sys.argv[3:] or COMMANDS:
        _hunt(each, float(sys.argv[1]), int(sys.argv[2]))
