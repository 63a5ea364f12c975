"""Errors: each says what was given, what is allowed, and what to try."""


class ClutterGenError(Exception):
    """Base of every error that this package raises on purpose."""

    def __init__(self, given: str, allowed: str = "", hint: str = "") -> None:
        self.given, self.allowed, self.hint = given, allowed, hint
        parts = [given.rstrip(".") + "."]
        if allowed:
            parts.append(f"Allowed: {allowed.rstrip('.')}.")
        if hint:
            parts.append(f"Try: {hint.rstrip('.')}.")
        super().__init__(" ".join(parts))


class ConfigError(ClutterGenError, ValueError):
    """A setting is outside its range or contradicts another."""


class AssetError(ClutterGenError):
    """A mesh, an object or a support cannot be made into a sound body."""


class PoolError(ClutterGenError):
    """A pool, a support or a checkpoint cannot be found or read."""


class BankError(ClutterGenError):
    """A bank of scenes cannot be read, written or continued."""


class UnsafePathError(ClutterGenError):
    """A name that a file gave leads out of the folder that it belongs to."""


class MissingExtraError(ClutterGenError, ImportError):
    """An optional dependency is not installed."""

    def __init__(self, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the optional extra {extra!r}, which is not installed",
            hint=f"pip install 'cluttergen_jax[{extra}]'",
        )
