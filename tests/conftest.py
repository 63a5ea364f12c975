"""With CLUTTERGEN_STRICT_SKIPS set, a skip whose reason allowed_skips.txt lacks fails the run."""

import ctypes
import datetime
import gc
import json
import os
import platform
import re
import signal
import subprocess
import sys
from functools import cache, lru_cache
from pathlib import Path

import pytest

HERE = Path(__file__).parent
MOST_KEPT = 1_200_000_000
"""Bytes of a process between two modules; above, what it has compiled is dropped."""
# Many tests compile the same programs: what one process has compiled the others read.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(HERE.parent / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# Traces make millions of objects that stay; looking for garbage among them took a seventh of the time.
gc.set_threshold(50_000, 20, 20)


def is_allowed(reason: str) -> bool:
    """Whether a test may be skipped for it."""
    lines = (HERE / "allowed_skips.txt").read_text().splitlines()
    patterns = [line for line in lines if line and not line.startswith("#")]
    return any(re.fullmatch(each, reason.removeprefix("Skipped: "), re.DOTALL) for each in patterns)


def pytest_addoption(parser):
    parser.addoption(
        "--record", default=None, help="write commit, date and counts of this run to a JSON file"
    )


@pytest.fixture
def home(tmp_path, monkeypatch):
    """The folder of a user's own pools and supports, empty and nobody's."""
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    """The path of a pool of three small objects."""
    from cluttergen_jax.assets.pool import Pool, write_pool
    from tests.helpers.worlds import trio

    return str(write_pool(tmp_path_factory.mktemp("pools") / "trio", Pool("trio", tuple(trio()))))


@pytest.fixture(scope="session", autouse=True)
def embedded_objects():
    """Objects of the embedded pools, which no test changes, are read and cut into columns once a process."""
    from cluttergen_jax.assets import pool

    root = pool.embedded_root()
    read = pool.read_object
    read_once = cache(read)

    def read_object(folder):
        return (read_once if root in folder.parents else read)(folder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "read_object", read_object)
        if world := sys.modules.get("cluttergen_jax.placement.world"):
            patch.setattr(world, "height_profile_of", lru_cache(256)(world.height_profile_of))
        yield


@pytest.fixture(autouse=True)
def keeps_ctrl_c():
    """What answers Ctrl-C after a test is what did before."""
    before = signal.getsignal(signal.SIGINT)
    yield
    after = signal.signal(signal.SIGINT, before)
    assert after is before, f"the test left {after} to answer Ctrl-C"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item, nextitem):
    """What modules compiled goes with them once it is much; kept to the end, it comes to 5 GB a process."""
    result = yield
    is_last = nextitem is None or nextitem.path != item.path
    if is_last and (jax := sys.modules.get("jax")) and _resident_bytes() > MOST_KEPT:
        jax.clear_caches()
        gc.collect()
        if sys.platform == "linux":
            # The C library keeps what was freed unless it is told not to.
            ctypes.CDLL(None).malloc_trim(0)
    return result


def _resident_bytes() -> int:
    """Memory of this process; more than enough where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 2 * MOST_KEPT


def _skipped(reporter) -> list[tuple[str, str]]:
    reports = reporter.stats.get("skipped", [])
    return [
        (r.nodeid, r.longrepr[2] if isinstance(r.longrepr, tuple) else str(r.longrepr))
        for r in reports
    ]


def pytest_sessionfinish(session, exitstatus):
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None:  # One of several processes: the one that started them counts.
        return
    if os.environ.get("CLUTTERGEN_STRICT_SKIPS"):
        unlisted = [
            f"{node} ({reason})" for node, reason in _skipped(reporter) if not is_allowed(reason)
        ]
        if unlisted:
            reporter.write_line(f"skipped without leave: {', '.join(unlisted)}", red=True)
            session.exitstatus = 1
    if path := session.config.getoption("--record"):
        Path(path).write_text(json.dumps(_record(reporter), indent=1) + "\n")


def _record(reporter) -> dict:
    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, cwd=HERE, check=False
    )
    kinds = ("passed", "failed", "error", "skipped", "xfailed", "xpassed")
    return {
        "commit": commit.stdout.strip(),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "counts": {kind: len(reporter.stats.get(kind, [])) for kind in kinds},
        "skipped": [f"{node}: {reason}" for node, reason in _skipped(reporter)],
    }
