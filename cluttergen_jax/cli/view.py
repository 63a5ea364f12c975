"""`cluttergen view`: scenes in a browser, or in MuJoCo's own viewer."""

from __future__ import annotations

import threading
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from cluttergen_jax.config import Method
from cluttergen_jax.errors import BankError

if TYPE_CHECKING:
    import mujoco

    from cluttergen_jax.placement.recording import Recording
    from cluttergen_jax.sources import LiveConfig


@dataclass(frozen=True)
class View:
    """Look at scenes in a browser: objects, hulls, clouds, attempts, and new scenes when asked for.

    Example: `cluttergen view out`, or `cluttergen view --pool dining --method drop`

    Attributes:
      source: a bank; one scene of it, BANK:INDEX or BANK/scenes/000003.xml; any MJCF file with free bodies;
        or a checkpoint, whose policy then makes the scenes. Without it, --method makes them from --pool.
      pool: a pool's name or folder to sample from where no bank says it; a checkpoint's own if one is given.
      method: random, clear, drop, or a trained policy; the checkpoint's own, else drop.
      num_objects: all of the pool's (40 at most) if not given.
      support: a support's name or folder.
      native: open MuJoCo's own viewer instead (needs a screen).
      host: the address to listen on; 0.0.0.0 lets other machines look.
      port: 0 takes any free one.
      browser: open a browser (--no-browser to leave that to you).
      screenshots: the folder for screenshots.
    """

    source: tyro.conf.Positional[str | None] = None
    pool: str | None = None
    method: Method | None = None
    num_objects: int | None = None
    support: str | None = None
    native: bool = False
    host: str = "localhost"
    port: int = 8080
    browser: bool = True
    screenshots: Path = Path("out/screenshots")

    def run(self) -> int:
        """Runs the command; the exit status. The web viewer runs until Ctrl-C."""
        return _show_native(self) if self.native else _serve(self)

    @property
    def live(self) -> LiveConfig:
        """What to sample from where no bank says it."""
        from cluttergen_jax.sources import LiveConfig

        return LiveConfig(self.pool, self.method, self.num_objects, self.support)


def _first(own: int | None, numbers: Sequence[int]) -> int:
    return int(numbers[0]) if own is None else own


def _serve(args: View) -> int:
    from cluttergen_jax.sources import open_source
    from cluttergen_jax.viewer.server import free_port, open_server
    from cluttergen_jax.viewer.viewer import Viewer

    # What cannot work is said before anything is compiled.
    free_port(args.host, args.port)
    print(f"opening    {args.source or 'scenes made on the spot'}", flush=True)
    source, own = open_source(args.source, args.live)
    first = _first(own, source.numbers)
    if first not in source.numbers:
        raise BankError(f"{source.name} has no scene {first}", f"{source.numbers[0]} to {source.numbers[-1]}")
    server = open_server(args.host, args.port, f"cluttergen: {source.name}")
    viewer = Viewer(source, server, first, args.screenshots)
    url = f"http://{'localhost' if args.host == '0.0.0.0' else args.host}:{server.get_port()}"
    print(f"viewer     {url} (Ctrl-C ends it)", flush=True)
    if notice := source.notice():
        print(f"first      {notice}", flush=True)
    if args.browser:
        webbrowser.open(url)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        print("\nviewer     ended")
    finally:
        viewer.close()
    return 0


def _show_native(args: View) -> int:
    from cluttergen_jax.sources import open_source
    from cluttergen_jax.viewer.native import check_display, show_native

    check_display()
    source, own = open_source(args.source, args.live)
    recording = source.still(_first(own, source.numbers))
    model, qpos = native_model(recording)
    print(f"{recording.title}: {len(recording.placed)} objects; the window's Reset puts them back")
    show_native(model, qpos)
    return 0


def native_model(recording: Recording) -> tuple[mujoco.MjModel, np.ndarray]:
    """The finished scene as a model with surfaces, light and a floor that carries, and its qpos f64[nq]."""
    from cluttergen_jax.render.assets import scene_spec
    from cluttergen_jax.render.lighting import FLOOR

    placed = recording.placed
    poses = np.asarray(recording.poses[placed], np.float64)
    spec, qpos = scene_spec([recording.objects[index] for index in placed], poses, recording.support)
    # What falls off the table is to stay in sight.
    spec.geom(FLOOR).contype = spec.geom(FLOOR).conaffinity = 1
    # Where the window's camera looks first, and from how far.
    spec.stat.center = (*recording.region.center, recording.support.top + 0.05)
    spec.stat.extent = float(2 * np.hypot(*recording.region.half_extents))
    for body, pose in zip((each for each in spec.bodies if each.joints), poses, strict=True):
        body.pos, body.quat = pose[:3], pose[3:]
    return spec.compile(), qpos
