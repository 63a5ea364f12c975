"""A pool as one HTML page to scroll through: each object's surfaces beside its parts, and its measures."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import Pool
from cluttergen_jax.files import write_atomically
from cluttergen_jax.progress import track
from cluttergen_jax.rendering.assets import render_object
from cluttergen_jax.rendering.gl import gl_context

_WIDTH = 400
_HEIGHT = 200
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
    with gl_context(_WIDTH, _HEIGHT):
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
    image = render_object(asset, width=_WIDTH, height=_HEIGHT, samples=_SAMPLES)
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
