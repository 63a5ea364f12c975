"""Pictures of objects, supports and scenes that need no world: for `cluttergen inspect` and for looking."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from cluttergen_jax.assets.doors import are_closed
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.mjcf import (
    VISUAL_GROUP,
    add_material,
    new_spec,
    populated_spec,
    set_surface,
)
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import Pool
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.progress import track
from cluttergen_jax.rendering.camera import axes, fit_camera
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.rendering.gl import gl_context
from cluttergen_jax.rendering.lighting import add_lighting
from cluttergen_jax.rendering.look import Look
from cluttergen_jax.rendering.picture import distinct_colour, render_model
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.rendering.sheet import Ring, contact_sheet, with_rings

_WIDTH = 480
_HEIGHT = 240
_SHEET_SAMPLES = 200
_FEWEST_SAMPLES = 6
_SHADOWS = 1024
"""Pixels of a shadow map a side: enough for so small a picture."""


def _add_surface(spec: mujoco.MjSpec, name: str, piece: Piece, offset: np.ndarray) -> None:
    surface = spec.add_mesh(name=name)
    if len(piece.mesh.faces):
        set_surface(surface, piece)
        surface.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    else:
        surface.uservert = piece.mesh.vertices.astype(np.float32).ravel()
        surface.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        pos=offset,
        rgba=piece.rgba,
        material=add_material(spec, piece),
        contype=0,
        conaffinity=0,
        group=VISUAL_GROUP,
    )


def render_object(
    asset: ObjectAsset,
    *,
    width: int = _WIDTH,
    height: int = _HEIGHT,
    samples: int = 16,
    trails: Sequence[Trail] | None = None,
) -> np.ndarray:
    """uint8[height, width, 3]: the object's surfaces, and right of them its parts in distinct colours.

    Args:
      trails: lines in the object's frame, metres, drawn about the surfaces; the parts are left out then,
        but of an object without surfaces.
    """
    spec = new_spec(StabilityConfig().timestep, ContactConfig())
    half = asset.half_extents
    view = CameraView(azimuth=115.0, elevation=-24.0, field_of_view=18.0)
    right = axes(view.azimuth, view.elevation)[0]
    # Half the object's width as it is seen, and a little room.
    shift = right * (1.12 * float(np.abs(right) @ half) if trails is None else 0.0)
    lift = np.array([0.0, 0.0, half[2]])
    for index, piece in enumerate(asset.pieces):
        _add_surface(spec, f"piece-{index}", piece, lift - shift)
    for index, part in enumerate(asset.parts if trails is None or not asset.pieces else ()):
        hull = Piece(Mesh.points(part.vertices), distinct_colour(index))
        _add_surface(spec, f"part-{index}", hull, lift + shift)
    add_lighting(spec).visual.quality.shadowsize = _SHADOWS
    return render_model(
        spec.compile(),
        camera=view,
        width=width,
        height=height,
        samples=samples,
        trails=[replace(trail, points=trail.points + lift) for trail in trails or ()],
    )


def object_sheet(
    objects: Sequence[ObjectAsset], columns: int = 4, samples: int | None = None
) -> np.ndarray:
    """A contact sheet: every object's surfaces beside its collision parts, and its name beneath.

    Args:
      samples: pictures averaged for each; None takes 16, and fewer of more than a dozen objects.
    """
    samples = samples or max(_FEWEST_SAMPLES, min(16, _SHEET_SAMPLES // max(len(objects), 1)))
    # A context for each object would be most of the time.
    with gl_context(_WIDTH, _HEIGHT):
        images = [render_object(asset, samples=samples) for asset in objects]
    captions = [f"{asset.name} (parts: {len(asset.parts)})" for asset in objects]
    return contact_sheet(images, captions, columns)


_SURFACE_VIEW = CameraView(elevation=-20.0)
_LIFTED = 0.003
_SUPPORT_WIDTH = 760
_SUPPORT_HEIGHT = 620


def support_sheet(support: SupportAsset) -> np.ndarray:
    """A support with its surfaces outlined and numbered, and beside it its collision.

    Thick lines are outlines and the edges of holes, thin ones the regions queried by default.
    """
    spec, qpos = scene_spec((), np.zeros((0, 7)), support)
    points = np.concatenate([piece.mesh.vertices for piece in support.collision_pieces])
    trails = []
    spots = []
    for number, surface in enumerate(support.surfaces):
        rgb = distinct_colour(number)[:3]
        rings = [(np.array(ring), 0.004) for ring in (surface.outline, *surface.holes)]
        for ring, radius in (*rings, (surface.region.corners, 0.0015)):
            lifted = np.column_stack([np.vstack([ring, ring[:1]]), np.full(len(ring) + 1, _LIFTED)])
            trails.append(Trail(transform_points(surface.pose, lifted), rgb, radius=radius))
        spots.append(transform_points(surface.pose, np.array([*surface.region.center, 0.0])))
    images = []
    draw = partial(
        render_model,
        spec.compile(),
        qpos,
        width=_SUPPORT_WIDTH,
        height=_SUPPORT_HEIGHT,
        focus=points,
        samples=24,
    )
    for view in (_SURFACE_VIEW, replace(_SURFACE_VIEW, azimuth=_SURFACE_VIEW.azimuth + 180.0)):
        image = draw(camera=view, trails=trails)
        seen = fit_camera(points, view, _SUPPORT_WIDTH, _SUPPORT_HEIGHT).project(np.array(spots))[0]
        labels = [
            Ring(
                (float(x), float(y)),
                (2.0, 2.0),
                distinct_colour(number)[:3],
                f"{number + 1} {each.name}",
            )
            for number, ((x, y), each) in enumerate(zip(seen, support.surfaces, strict=True))
        ]
        images.append(with_rings(image, labels))
    images.append(draw(camera=_SURFACE_VIEW, hulls=True))
    solids = f"collision: {len(support.boxes)} boxes, {len(support.parts)} convex parts"
    return contact_sheet(images, ["surfaces", "from behind", solids], 3)


def scene_spec(
    assets: Sequence[ObjectAsset],
    poses: np.ndarray,
    support: SupportAsset | None,
    look: Look | None = None,
) -> tuple[mujoco.MjSpec, np.ndarray]:
    """A lit specification of objects on a support, and its qpos.

    Args:
      assets: K objects; the same one may come twice.
      poses: f[K, 7], position then wxyz, world frame.
      support: None leaves only the floor.
      look: whose floor and light they have; see `add_lighting`.

    Raises:
      ConfigError: not one pose per object.
    """
    poses = np.asarray(poses, np.float64)
    if poses.shape != (len(assets), 7):
        raise ConfigError(
            f"poses of shape {poses.shape} for {len(assets)} objects", f"({len(assets)}, 7)"
        )
    names = [f"{index:02d}-{asset.name}" for index, asset in enumerate(assets)]
    contact = ContactConfig()
    spec = populated_spec(
        names, assets, support, StabilityConfig().timestep, contact, poses=poses, visual=True
    )
    return add_lighting(spec, look), poses.ravel()


def render_scene(
    assets: Sequence[ObjectAsset],
    poses: np.ndarray,
    support: SupportAsset | None,
    *,
    camera: CameraView | None = None,
    close: bool = False,
    width: int = 640,
    height: int = 480,
    hulls: bool = False,
    samples: int = 32,
) -> np.ndarray:
    """Draws objects standing on a support.

    Args:
      assets, poses, support: as for `scene_spec`.
      camera: None is the default view.
      close: fit the view to the objects and the region instead of the whole support.
      width, height, hulls, samples: as for `render_model`.

    Returns:
      uint8[height, width, 3].
    """
    spec, qpos = scene_spec(assets, poses, support)
    return render_model(
        spec.compile(),
        qpos,
        camera=camera or CameraView(),
        width=width,
        height=height,
        hulls=hulls,
        focus=close_points(assets, poses, support) if close else None,
        samples=samples,
    )


def close_points(
    assets: Sequence[ObjectAsset], poses: np.ndarray, support: SupportAsset | None
) -> np.ndarray:
    """f64[P, 3]: all corners of the objects' collision parts and of the support's region, world frame.

    Of a support that scenes close: all its corners, as nothing of what is in it is seen.

    Raises:
      ConfigError: there are neither objects nor a support.
    """
    points = []
    if support is not None:
        points.append(support.region_points[1:])
        if are_closed(support):
            points.extend(piece.mesh.vertices for piece in support.collision_pieces)
    for asset, pose in zip(assets, np.asarray(poses, np.float64), strict=True):
        points.extend(transform_points(pose, part.vertices) for part in asset.parts)
    if not points:
        raise ConfigError("a close view of neither objects nor a support")
    return np.concatenate(points)


_PAGE_WIDTH = 400
_PAGE_HEIGHT = 200
_SAMPLES = 4
_JPEG = 82
_STYLE = """
body { font: 14px/1.45 system-ui, sans-serif; margin: 1.5em auto; max-width: 1300px; color: #28303a; }
input[type=search] { font: inherit; padding: .3em .6em; width: 22em; }
main { display: grid; grid-template-columns: repeat(auto-fill, minmax(410px, 1fr)); gap: 14px; }
article { border: 1px solid #d8dce2; border-radius: 6px; overflow: hidden; }
article.flagged { border-color: #c2410c; }
article img { width: 100%; display: block; background: #eee; }
article div { padding: .5em .8em; }
h2 { font-size: 15px; margin: 0; }
p { margin: .2em 0; color: #555d68; }
p.flag { color: #c2410c; }
"""
_SCRIPT = """
const find = document.getElementById("find"), flagged = document.getElementById("flagged");
function show() {
  const words = find.value.toLowerCase().split(/\\s+/);
  for (const each of document.querySelectorAll("article")) {
    const is = words.every(word => each.textContent.toLowerCase().includes(word));
    each.hidden = !is || (flagged.checked && !each.classList.contains("flagged"));
  }
}
find.oninput = flagged.onchange = show;
"""


def write_pool_report(path: Path, pool: Pool, objects: Sequence[ObjectAsset] | None = None) -> Path:
    """Draws objects of a pool into one HTML file, which needs no other: flagged ones come first.

    Args:
      objects: all of the pool's if None.

    Raises:
      RendererError: nothing here can draw.
    """
    chosen = pool.objects if objects is None else objects
    cards: list[tuple[bool, str]] = []
    # A context for each object would be most of the time.
    with gl_context(_PAGE_WIDTH, _PAGE_HEIGHT):
        for asset in track(chosen, path.name, len(chosen), "object"):
            cards.append((not asset.flags, _card(asset)))
    body = "\n".join(card for _, card in sorted(cards, key=lambda pair: pair[0]))
    flagged = sum(not is_sound for is_sound, _ in cards)
    title = f"Pool {pool.name}"
    licence = html.escape(pool.licence or "not stated")
    text = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style></head><body>
<h1>{title}</h1>
<p>{len(cards)} objects, {flagged} flagged; licence: {licence}. Left: surfaces; right: collision parts.</p>
<p><input id="find" type="search" placeholder="name, label, flag ...">
<label><input id="flagged" type="checkbox"> flagged alone</label></p>
<main>
{body}
</main><script>{_SCRIPT}</script></body></html>
"""
    write_atomically(path, text.encode())
    return path


def _card(asset: ObjectAsset) -> str:
    image = render_object(asset, width=_PAGE_WIDTH, height=_PAGE_HEIGHT, samples=_SAMPLES)
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="JPEG", quality=_JPEG)
    picture = base64.b64encode(buffer.getvalue()).decode()
    flags = "".join(f'<p class="flag">{html.escape(flag)}</p>' for flag in asset.flags)
    notes = "".join(f"<p>{html.escape(note)}</p>" for note in asset.notes)
    size = " x ".join(f"{2000 * half:.0f}" for half in asset.half_extents)
    quality = asset.quality
    provenance = asset.provenance
    measured = [f"{size} mm", f"{asset.mass:.3g} kg", f"{len(asset.parts)} parts"]
    if quality.deviation is not None:
        measured.append(f"deviation {100 * quality.deviation:.1f} %")
    if quality.solo_rate is not None:
        measured.append(f"stands alone {100 * quality.solo_rate:.0f} %")
    kind = " class=flagged" if asset.flags else ""
    label = f"{asset.label} ({asset.synset})" if asset.synset else asset.label
    told = "".join(f"<p>{html.escape(line)}</p>" for line in (label, "; ".join(measured)))
    origin = f"{provenance.source}; {provenance.licence or 'licence not stated'}"
    return (
        f'<article{kind}><img loading="lazy" alt="" src="data:image/jpeg;base64,{picture}"><div>'
        f"<h2>{html.escape(asset.name)}</h2>{told}{flags}{notes}<p>{html.escape(origin)}</p></div></article>"
    )
