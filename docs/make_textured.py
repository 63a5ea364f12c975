"""Makes a pool of textured objects, and its picture in the README: python docs/make_textured.py [FOLDER].

Cartons, cans, crockery, books and a globe: printed with Pillow, written into FOLDER/meshes as OBJ with MTL
and PNG, or as GLB. Then it does what a user would:

    cluttergen import FOLDER/meshes --pool printed
    cluttergen generate --pool printed --num-objects 8 --num-scenes 8 --method clear --out FOLDER/scenes
    cluttergen render FOLDER/scenes --sheet

Two minutes on two cores. Everything here is made of numbers and may be used like the rest of this project.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont

import cluttergen_jax as cg

HERE = Path(__file__).parent / "images"
Colour = tuple[int, int, int]
CREAM = (246, 240, 224)
INK = (40, 40, 48)
RED = (196, 44, 40)
BLUE = (38, 84, 160)
GREEN = (46, 130, 84)
YELLOW = (244, 190, 46)
BROWN = (112, 66, 40)
STEEL = (176, 180, 186)
Surface = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Vertices f[V, 3] in metres, triangles i[F, 3], and uv f[V, 2] with v up the image."""


def carton(size: Sequence[float]) -> Surface:
    """A box; its six sides lie in the image as three columns and two rows.

    Front (-y), back (+y) and top above; left (-x), right (+x) and bottom below; each upright.
    """
    x, y, z = np.array(size) / 2
    corners = {
        "front": [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z)],
        "back": [(x, y, -z), (-x, y, -z), (-x, y, z), (x, y, z)],
        "top": [(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)],
        "left": [(-x, y, -z), (-x, -y, -z), (-x, -y, z), (-x, y, z)],
        "right": [(x, -y, -z), (x, y, -z), (x, y, z), (x, -y, z)],
        "bottom": [(-x, y, -z), (x, y, -z), (x, -y, -z), (-x, -y, -z)],
    }
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    uv = [(square + np.array([k % 3, 1 - k // 3])) / (3, 2) for k in range(6)]
    faces = [
        (4 * k + a, 4 * k + b, 4 * k + c) for k in range(6) for a, b, c in ((0, 1, 2), (0, 2, 3))
    ]
    return (
        np.concatenate([np.array(each) for each in corners.values()]),
        np.array(faces),
        np.concatenate(uv),
    )


def turned(profile: Sequence[tuple[float, float]], sections: int = 64) -> Surface:
    """What a lathe makes of a profile of (radius, height), from the axis outside and back to the axis.

    u goes around, v along the profile by its length. Counter-clockwise seen from outside if the profile
    begins below.
    """
    line = np.array(profile)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    angle = np.linspace(0, 2 * np.pi, sections + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([r * ring, np.full(len(ring), z)]) for r, z in line])
    u, v = np.meshgrid(np.linspace(0, 1, sections + 1), along / along[-1])
    faces = []
    for row in range(len(line) - 1):
        for k in range(sections):
            a = row * (sections + 1) + k
            b = (row + 1) * (sections + 1) + k
            faces += [(a, a + 1, b + 1)] * int(line[row, 0] > 0) + [(a, b + 1, b)] * int(
                line[row + 1, 0] > 0
            )
    return vertices, np.array(faces), np.column_stack([u.ravel(), v.ravel()])


def word(
    image: Image.Image, text: str, colour: Colour, box: Sequence[float], turn: int = 0
) -> None:
    """Writes a word as large as a box (left, top, right, bottom; shares of the image) allows."""
    left, top, right, bottom = (
        round(s * n) for s, n in zip(box, (*image.size, *image.size), strict=True)
    )
    size = (right - left, bottom - top)[:: -1 if turn % 180 else 1]
    height = size[1]
    while height > 8 and ImageFont.load_default(height).getlength(text) > size[0]:
        height -= 2
    paper = Image.new("L", size, 0)
    ImageDraw.Draw(paper).text(
        (size[0] / 2, size[1] / 2), text, 255, ImageFont.load_default(height), anchor="mm"
    )
    paper = paper.rotate(turn, expand=True)
    image.paste(colour, (left, top), paper)


def printed(
    size: Sequence[float], title: str, below: str, paper: Colour, band: Colour
) -> Image.Image:
    """A carton's print: its name on every side, a band of another colour, a disc on the front."""
    sheet = Image.new("RGB", (960, 640), paper)
    for k in range(6):
        side = Image.new("RGB", (320, 320), paper)
        draw = ImageDraw.Draw(side)
        draw.rectangle((0, 224, 320, 320), fill=band)
        if k < 2:
            draw.ellipse((70, 96, 250, 216), fill=band)
            word(side, below, paper, (0.25, 0.36, 0.75, 0.62))
        word(side, title, band, (0.06, 0.05, 0.94, 0.28))
        word(side, below, paper, (0.1, 0.76, 0.9, 0.94))
        sheet.paste(side, (320 * (k % 3), 320 * (k // 3)))
    return sheet


def bands(
    colours: Sequence[tuple[float, Colour]], size: tuple[int, int] = (1024, 512)
) -> Image.Image:
    """Stripes from the image's bottom up, each with the share at which it ends."""
    image = Image.new("RGB", size)
    draw = ImageDraw.Draw(image)
    start = 0.0
    for end, colour in colours:
        draw.rectangle(
            (0, round((1 - end) * size[1]), size[0], round((1 - start) * size[1])), fill=colour
        )
        start = end
    return image


def label(title: str, paper: Colour, ink: Colour) -> Image.Image:
    """A can's: metal at both ends, the name twice around."""
    image = bands([(0.27, STEEL), (0.30, ink), (0.70, paper), (0.73, ink), (1.0, STEEL)])
    for start in (0.0, 0.5):
        word(image, title, ink, (start + 0.06, 0.34, start + 0.44, 0.66))
    return image


def dotted(ground: Colour, dot: Colour) -> Image.Image:
    """Dots in rows."""
    image = Image.new("RGB", (1024, 512), ground)
    draw = ImageDraw.Draw(image)
    for row, column in np.ndindex(8, 16):
        x = 64 * column + 32 * (row % 2)
        y = 64 * row + 32
        draw.ellipse((x - 14, y - 14, x + 14, y + 14), fill=dot)
    return image


def world() -> Image.Image:
    """Sea, and land where a few waves add up."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 1024, endpoint=False), np.linspace(-1, 1, 512))
    rng = np.random.default_rng(4)
    height = np.zeros_like(u)
    for around in range(1, 6):
        for along in range(1, 5):
            a, b, c = rng.normal(size=3)
            height += (a * np.cos(around * u + c) + b * np.sin(around * u)) * np.sin(
                along * np.pi * v + c
            )
    pixels = np.where((height > 2.2)[..., None], (96, 150, 82), (58, 116, 178))
    pixels[(height > 6.5)] = (190, 160, 104)
    pixels[np.abs(v) > 0.86] = (238, 242, 246)
    pixels[(np.abs(np.sin(6 * u)) < 0.03) & (np.abs(v) < 0.86)] = (228, 232, 238)
    # The profile begins with the stand.
    pixels[v > 0.38] = BROWN
    return Image.fromarray(pixels.astype(np.uint8))


def wood() -> Image.Image:
    """Grain along x, a darker rim of end grain."""
    x, y = np.meshgrid(np.linspace(0, 1, 960), np.linspace(0, 1, 640))
    rings = np.sin(60 * (y + 0.05 * np.sin(7 * x) + 0.02 * np.sin(23 * x + 9 * y)))
    tone = 0.82 + 0.10 * rings[..., None]
    return Image.fromarray((tone * (206, 158, 104)).clip(0, 255).astype(np.uint8))


def cover(title: str, cloth: Colour) -> Image.Image:
    """A book that lies: its title on top, cloth along the spine, pages at the other three sides."""
    sheet = Image.new("RGB", (960, 640), cloth)
    draw = ImageDraw.Draw(sheet)
    for left, top in ((320, 0), (0, 320), (320, 320)):
        for row in range(0, 320, 8):
            tone = CREAM if row % 16 else (214, 206, 186)
            draw.rectangle((left, top + row, left + 319, top + row + 7), fill=tone)
    draw.rectangle((660, 20, 940, 300), outline=YELLOW, width=6)
    word(sheet, title, YELLOW, (0.71, 0.12, 0.96, 0.26))
    word(sheet, title, YELLOW, (0.04, 0.10, 0.30, 0.40))
    return sheet


def ball_on_foot(radius: float, foot: float) -> list[tuple[float, float]]:
    """The profile of a globe on a turned foot."""
    angle = np.linspace(-1.25, np.pi / 2, 28)
    ball = [(radius * np.cos(a), foot + 0.95 * radius + radius * np.sin(a)) for a in angle[:-1]]
    return [
        (0, 0),
        (0.62 * radius, 0),
        (0.62 * radius, 0.3 * foot),
        *ball,
        (0, foot + 1.95 * radius),
    ]


BOWL = [
    (0, 0),
    (0.035, 0),
    (0.06, 0.02),
    (0.075, 0.055),
    (0.071, 0.055),
    (0.057, 0.024),
    (0.034, 0.005),
    (0, 0.005),
]
PLATE = [(0, 0), (0.07, 0), (0.115, 0.018), (0.113, 0.021), (0.07, 0.006), (0, 0.006)]
CUP = [(0, 0), (0.033, 0), (0.04, 0.095), (0.037, 0.095), (0.030, 0.004), (0, 0.004)]


def can(radius: float, height: float) -> Surface:
    """A cylinder whose label is in the middle of the image."""
    return turned([(0, 0), (radius, 0), (radius, height), (0, height)])


OBJECTS: dict[str, Callable[[], tuple[Surface, Image.Image]]] = {
    "oat_flakes": lambda: (
        carton(s := (0.15, 0.055, 0.21)),
        printed(s, "OATS", "500 g", CREAM, RED),
    ),
    "tea_box": lambda: (
        carton(s := (0.13, 0.07, 0.08)),
        printed(s, "TEA", "25 bags", YELLOW, GREEN),
    ),
    "soap_carton": lambda: (
        carton(s := (0.09, 0.06, 0.035)),
        printed(s, "SOAP", "mild", CREAM, BLUE),
    ),
    "tomato_can": lambda: (can(0.036, 0.1), label("TOMATOES", CREAM, RED)),
    "pea_can": lambda: (can(0.042, 0.08), label("PEAS", YELLOW, GREEN)),
    "striped_cup": lambda: (
        turned(CUP),
        bands(
            [
                (0.14, CREAM),
                *((0.14 + 0.04 * (k + 1), (BLUE, CREAM)[k % 2]) for k in range(9)),
                (1, CREAM),
            ]
        ),
    ),
    "dotted_bowl": lambda: (turned(BOWL), dotted(BLUE, CREAM)),
    "ringed_plate": lambda: (
        turned(PLATE),
        bands([(0.50, CREAM), (0.56, BLUE), (0.60, CREAM), (0.64, RED), (1, CREAM)]),
    ),
    "globe": lambda: (turned(ball_on_foot(0.055, 0.03)), world()),
    "chopping_board": lambda: (carton((0.22, 0.14, 0.018)), wood()),
    "atlas": lambda: (carton((0.15, 0.2, 0.03)), cover("ATLAS", BLUE)),
    "novel": lambda: (carton((0.12, 0.18, 0.024)), cover("A NOVEL", RED)),
}


def write(folder: Path) -> None:
    """Writes every object: with an even number as OBJ, MTL and PNG, with an odd one as GLB."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, (name, make) in enumerate(OBJECTS.items()):
        (vertices, faces, uv), image = make()
        if number % 2:
            # glTF has y up.
            vertices = vertices[:, [0, 2, 1]] * (1, 1, -1)
            material: object = trimesh.visual.material.PBRMaterial(
                name=name, baseColorTexture=image, metallicFactor=0.0
            )
        else:
            material = trimesh.visual.material.SimpleMaterial(
                name=name, image=image, diffuse=(255, 255, 255)
            )
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        mesh = trimesh.Trimesh(vertices, faces, visual=visual, process=False)
        if number % 2:
            trimesh.Scene(mesh).export(str(folder / f"{name}.glb"))
        else:
            mesh.export(str(folder / f"{name}.obj"), mtl_name=f"{name}.mtl")


def main(folder: Path) -> None:
    """Makes meshes, pool, scenes and the picture."""
    write(folder / "meshes")
    cg.import_pool(folder / "meshes", "printed", force=True)
    table = "table-0.50x0.60"
    bank = cg.generate(
        folder / "scenes",
        pool="printed",
        support=table,
        method="clear",
        num_objects=8,
        num_scenes=8,
    )
    cg.render(
        bank.path, folder, sheet=True, picture=False, scenes=range(8), size=(400, 300), columns=4
    )
    sheet = Image.open(folder / "scenes-sheet.png").convert(
        "P", palette=Image.Palette.ADAPTIVE, colors=256
    )
    sheet.save(HERE / "textured.png", optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/textured"))
