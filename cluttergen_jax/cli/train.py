"""`cluttergen train`: the policy, from scratch or from where it stopped; or all policies of a suite."""

from __future__ import annotations

import sys

from cluttergen_jax.api.train import train, train_suite
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.config import Suite
from cluttergen_jax.errors import ConfigError

_OF_PROCESSES = ("coordinator", "num_processes", "process_id")


@options_from(train, train_suite, suite=Suite | None)
class Train(Options):
    """Train a placement policy with PPO. Rerun to resume.

    Example: `cluttergen train --pool dining --preset cpu`
    """

    def run(self) -> int:
        if self.suite is None:
            self.call(train, "without a suite", "--suite paper")
            return 0
        if self.coordinator is not None:
            raise ConfigError(
                "a suite on several processes", "one run at a time there", "--suite-list"
            )
        hint = "leaving it out: each run has its own"
        report = self.call(train_suite, "with a suite", hint, ignored=_OF_PROCESSES)
        for name, error in report.failed.items():
            print(f"error: {name}: {with_flags(error, type(self))}", file=sys.stderr)
        if report.failed:
            print(
                f"failed: {', '.join(report.failed)}; the same command tries them again",
                file=sys.stderr,
            )
        return 1 if report.failed else 0
