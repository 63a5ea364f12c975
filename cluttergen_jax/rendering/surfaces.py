"""Images of wood, marble, cloth and the like, made of noise: they tile, and the same seed gives the same."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from PIL import Image

SIDE = 1024
"""Pixels of an image's side."""
Rgb = tuple[float, float, float]


def _blur(frequencies: np.ndarray, size: float) -> np.ndarray:
    """What a Gaussian blur by so many pixels leaves of each frequency along an axis."""
    return np.asarray(np.exp(-2 * np.pi**2 * (size * frequencies) ** 2))


def _blurs(along: float, across: float) -> tuple[np.ndarray, np.ndarray]:
    """What is left of each frequency down the image, f64[SIDE], and along its rows, f64[SIDE // 2 + 1]."""
    return _blur(np.fft.fftfreq(SIDE), across), _blur(np.fft.rfftfreq(SIDE), along)


def _filter_noise(rng: np.random.Generator, kept: np.ndarray) -> np.ndarray:
    """f64[SIDE, SIDE]: periodic noise of mean 0 and deviation 1 with these shares of its frequencies."""
    soft = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(SIDE, SIDE))) * kept, (SIDE, SIDE))
    return np.asarray((soft - soft.mean()) / soft.std())


def _noise(rng: np.random.Generator, along: float, across: float) -> np.ndarray:
    """Noise whose grains are so many pixels along x and across it."""
    return _filter_noise(rng, np.outer(*_blurs(along, across)))


def _clouds(rng: np.random.Generator, largest: float, stretch: float = 1.0) -> np.ndarray:
    """Noise of all sizes, from `largest` pixels down, the smaller the fainter."""
    kept = np.zeros((SIDE, SIDE // 2 + 1))
    strength = 1.0
    size = largest
    while size > 0.7:
        down, right = _blurs(size * stretch, size)
        kept += np.outer(strength / np.sqrt((down**2).sum() * (right**2).sum()) * down, right)
        strength *= 0.55
        size /= 2
    return _filter_noise(rng, kept)


def _mix(one: Rgb, other: Rgb, share: np.ndarray) -> np.ndarray:
    return np.asarray(one) + np.clip(share, 0, 1)[..., None] * (np.asarray(other) - np.asarray(one))


def _grain(rng: np.random.Generator) -> np.ndarray:
    """f64[SIDE, SIDE]: how dark wood is whose boards run along x; some rings, fibres, and pores."""
    rows = np.arange(SIDE)[:, None] / SIDE
    bend = _clouds(rng, 90, 9)
    rings = np.sin(2 * np.pi * (9 * rows + 1.1 * bend)) + 0.5 * np.sin(
        2 * np.pi * (23 * rows + 2.3 * bend)
    )
    fibres = _noise(rng, 45, 0.8)
    pores = np.maximum(_noise(rng, 14, 0.55) - 1.4, 0)
    return np.asarray(0.42 + 0.13 * rings + 0.09 * fibres + 0.16 * pores)


def _wood(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    return _mix(light, dark, _grain(rng))


def _planks(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    number = 7
    edges = np.round(np.linspace(0, SIDE, number + 1)).astype(int)
    out = np.empty((SIDE, SIDE, 3))
    whole = _grain(rng)
    for low, high in itertools.pairwise(edges):
        shifted = np.roll(whole, tuple(rng.integers(0, SIDE, 2)), (0, 1))[low:high]
        board = _mix(light, dark, shifted + rng.normal(0, 0.10)) * rng.uniform(0.93, 1.05)
        joint = int(rng.integers(0, SIDE))
        board[:2] *= 0.45
        board[:, joint : joint + 2] *= 0.45
        out[low:high] = board
    return out


def _marble(rng: np.random.Generator, ground: Rgb, vein: Rgb) -> np.ndarray:
    warp = _clouds(rng, 160)
    lines = np.exp(-np.abs(warp + 0.25 * _clouds(rng, 60)) * 9) * np.clip(
        0.7 + 0.5 * _noise(rng, 90, 90), 0, 1
    )
    fine = np.exp(-np.abs(_clouds(rng, 110)) * 22) * 0.35
    return _mix(ground, vein, 0.75 * lines + fine + 0.10 * (0.5 + 0.5 * _clouds(rng, 140)))


def _weave(rng: np.random.Generator) -> np.ndarray:
    steps = np.arange(SIDE)
    warp = np.abs(np.sin(np.pi * steps / 8))
    across = np.add.outer(steps // 8, steps // 8) % 2
    height = np.where(across, warp[:, None], warp[None, :])
    return np.asarray(height + 0.18 * _noise(rng, 20, 1.2) + 0.18 * _noise(rng, 1.2, 20))


def _cloth(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    return _mix(dark, light, 0.25 + 0.6 * _weave(rng))


def _checks(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    band = (np.arange(SIDE) // 64) % 2
    share = 0.5 * (band[:, None] + band[None, :])
    return _mix(light, dark, share) * (0.82 + 0.18 * np.clip(_weave(rng), 0, 1))[..., None]


def _steel(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    return _mix(light, dark, 0.5 + 0.10 * _noise(rng, 160, 0.7) + 0.05 * _noise(rng, 30, 0.6))


def _paper(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    return _mix(light, dark, 0.25 + 0.06 * _noise(rng, 1, 1) + 0.05 * _clouds(rng, 40))


def _plaster(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    return _mix(light, dark, 0.35 + 0.16 * _clouds(rng, 200) + 0.04 * _noise(rng, 1.5, 1.5))


def _concrete(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    holes = np.maximum(_noise(rng, 2, 2) - 2.6, 0)
    return _mix(light, dark, 0.4 + 0.22 * _clouds(rng, 180) + 0.9 * holes)


def _terrazzo(rng: np.random.Generator, ground: Rgb, chip: Rgb) -> np.ndarray:
    field = _noise(rng, 5, 5)
    out = _mix(ground, ground, field)
    for level in (-1.35, 1.35):
        is_chip = field > level if level > 0 else field < level
        shade = np.round(2 * _noise(rng, 14, 14)) / 4
        colour = _mix(chip, ground, 0.25 + 0.3 * shade) * (0.8 if level < 0 else 1.05)
        out = np.where(is_chip[..., None], colour, out)
    return out


def _tiles(rng: np.random.Generator, tile: Rgb, joint: Rgb) -> np.ndarray:
    steps = np.arange(SIDE) % (SIDE // 4)
    is_joint = np.minimum(steps, SIDE // 4 - steps) < 4
    share = (is_joint[:, None] | is_joint[None, :]).astype(float)
    tone = np.kron(rng.uniform(0.94, 1.04, (4, 4)), np.ones((SIDE // 4, SIDE // 4)))
    plain = np.asarray(tile) * (tone + 0.015 * _clouds(rng, 60))[..., None]
    return plain + share[..., None] * (np.asarray(joint) - plain)


def _paint(rng: np.random.Generator, light: Rgb, dark: Rgb) -> np.ndarray:
    return _mix(light, dark, 0.15 + 0.03 * _clouds(rng, 60))


_KINDS: dict[str, Callable[[np.random.Generator, Rgb, Rgb], np.ndarray]] = {
    "wood": _wood,
    "planks": _planks,
    "marble": _marble,
    "cloth": _cloth,
    "checks": _checks,
    "steel": _steel,
    "paper": _paper,
    "plaster": _plaster,
    "concrete": _concrete,
    "terrazzo": _terrazzo,
    "tiles": _tiles,
    "paint": _paint,
}
KINDS = tuple(_KINDS)
"""What a surface can be of."""


def draw_surface(kind: str, colours: tuple[Rgb, Rgb], seed: int) -> np.ndarray:
    """u8[1024, 1024, 3], sRGB: an image of a kind in two colours; boards and threads run along x."""
    rng = np.random.default_rng((seed, KINDS.index(kind)))
    pixels = _KINDS[kind](rng, *colours)
    return np.round(255 * np.clip(pixels, 0, 1)).astype(np.uint8)


def on_white(image: Image.Image) -> Image.Image:
    """The image, but what is transparent in it is white, as on a page."""
    if not image.has_transparency_data:
        return image
    paper = Image.new("RGBA", image.size, "white")
    paper.alpha_composite(image.convert("RGBA"))
    return paper.convert("RGB")
