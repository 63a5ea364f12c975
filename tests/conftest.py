"""Skips are counted: with CLUTTERGEN_STRICT_SKIPS set, one that allowed_skips.txt lacks fails the run."""

import datetime
import json
import os
import platform
import subprocess
from pathlib import Path

HERE = Path(__file__).parent
# Many tests compile the same programs: what one process has compiled the others read.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(HERE.parent / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")


def pytest_addoption(parser):
    parser.addoption(
        "--record", default=None, help="write commit, date and counts of this run to a JSON file"
    )


def _skipped(reporter) -> list[tuple[str, str]]:
    reports = reporter.stats.get("skipped", [])
    return [(r.nodeid, r.longrepr[2] if isinstance(r.longrepr, tuple) else str(r.longrepr)) for r in reports]


def pytest_sessionfinish(session, exitstatus):
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None:  # One of several processes: the one that started them counts.
        return
    if os.environ.get("CLUTTERGEN_STRICT_SKIPS"):
        lines = (HERE / "allowed_skips.txt").read_text().splitlines()
        allowed = {line.strip() for line in lines if line.strip() and not line.startswith("#")}
        unlisted = [node for node, _ in _skipped(reporter) if node.split("[")[0] not in allowed]
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
