"""Work for tests of clusters: at module level, so that a worker finds it by name."""

from __future__ import annotations
















