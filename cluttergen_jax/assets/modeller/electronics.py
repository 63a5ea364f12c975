"""What has a plug or a battery: laptop, mouse, keyboard, desk phone, camera, alarm clock, remote control."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller.draw import (
    BLACK,
    BLUE,
    BRIGHT,
    CHARCOAL,
    DARK,
    GOLD,
    GREEN,
    GREY,
    NAVY,
    ORANGE,
    PAPER,
    RED,
    SILVER,
    SKY,
    STEEL,
    TEAL,
    WHITE,
    YELLOW,
    Draw,
    assemble,
)
from cluttergen_jax.assets.modeller.solids import (
    above,
    box,
    cylinder,
    extrude,
    facing,
    hull,
    lettering,
    rounded_box,
    rounded_rect,
    smooth_path,
    tube,
    union,
    upright,
)
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.geometry import at_height

DISPLAY = (0.70, 0.80, 0.66)


def key(width: float, depth: float, height: float, center: Sequence[float]) -> Manifold:
    """A key cap that narrows upwards, its foot sunk 0.5 mm below z = 0."""
    corners = [(sx * width / 2, sy * depth / 2) for sx in (-1, 1) for sy in (-1, 1)]
    low = [(center[0] + x, center[1] + y, -0.0005) for x, y in corners]
    high = [(center[0] + 0.8 * x, center[1] + 0.8 * y, height) for x, y in corners]
    return hull(low + high)


def key_grid(
    columns: int, rows: int, size: Sequence[float], height: float, center: Sequence[float] = (0, 0)
) -> list[list[Manifold]]:
    """Keys over a rectangle `size` (x, y): rows from the back to the front, each a list of keys."""
    pitch_x = size[0] / columns
    pitch_y = size[1] / rows
    return [
        [
            key(
                0.86 * pitch_x,
                0.84 * pitch_y,
                height,
                (
                    center[0] + (i - (columns - 1) / 2) * pitch_x,
                    center[1] + ((rows - 1) / 2 - j) * pitch_y,
                ),
            )
            for i in range(columns)
        ]
        for j in range(rows)
    ]


def wedge(width: float, depth: float, front: float, back: float) -> tuple[np.ndarray, float]:
    """The corners of a block whose top slopes, f64[8, 3], and the slope in degrees."""
    corners = [
        (sx * width / 2, sy * depth / 2, z)
        for sx in (-1, 1)
        for sy, top in ((-1, front), (1, back))
        for z in (0.0, top)
    ]
    return np.array(corners), float(np.degrees(np.arctan2(back - front, depth)))


def _on_slope(solid: Manifold, front: float, back: float, slope: float) -> Manifold:
    """A solid drawn on z = 0 laid onto a wedge's top."""
    return solid.rotate((slope, 0, 0)).translate((0, 0, (front + back) / 2))


def laptop(vary: Draw) -> Shape:
    """An open laptop, keyboard towards -y."""
    width = vary(0.300, 0.08)
    depth = vary(0.205, 0.06)
    base = 0.016
    lid = 0.007
    lean = vary(16.0, 0.4)
    pose = {"rotate": (-lean, 0, 0), "move": (0, depth / 2 - 0.006, base - 0.004)}

    def raise_lid(solid: Manifold) -> Manifold:
        return solid.rotate(pose["rotate"]).translate(pose["move"])

    screen_size = (width, lid, 0.96 * depth)
    screen = box((0.93 * width, 0.002, 0.82 * depth), (0, -lid / 2), 0.10 * depth)
    windows = [
        (
            box(
                (0.40 * width, 0.002, 0.46 * depth),
                (-0.16 * width, -lid / 2 - 0.0006),
                0.33 * depth,
            ),
            WHITE,
        ),
        (
            box(
                (0.40 * width, 0.002, 0.06 * depth),
                (-0.16 * width, -lid / 2 - 0.0010),
                0.76 * depth,
            ),
            ORANGE,
        ),
        (
            box(
                (0.24 * width, 0.002, 0.30 * depth), (0.24 * width, -lid / 2 - 0.0006), 0.42 * depth
            ),
            YELLOW,
        ),
    ]
    deck = (0.86 * width, 0.42 * depth)
    grid = key_grid(13, 5, deck, 0.0016, (0, 0.16 * depth))
    grid[4][3:9] = [
        key(0.44 * deck[0], 0.84 * deck[1] / 5, 0.0016, (-0.03 * width, -0.008 * depth))
    ]
    keys = union(*[one for row in grid for one in row]).translate((0, 0, base))
    pad = box((0.34 * width, 0.27 * depth, 0.001), (0, -0.29 * depth), base - 0.0006)
    shell = rounded_box((width, depth, base), 0.003) + raise_lid(rounded_box(screen_size, 0.003))
    return assemble(
        pieces=(
            (shell, vary.color(SILVER, GREY, CHARCOAL, STEEL, NAVY)),
            (keys, vary.color(BLACK, CHARCOAL, spread=0.02)),
            (pad, vary.color(STEEL, GREY) if vary.rng else GREY),
            (raise_lid(screen), vary.choose(NAVY, TEAL, BLACK)),
            *[(raise_lid(solid), color) for solid, color in windows],
        ),
        parts=(
            part.box((width, depth, base)),
            part.rotate_part(part.box(screen_size), pose["rotate"], pose["move"]),
        ),
        mass=vary(1.4, 0.15),
    )


def mouse(vary: Draw) -> Shape:
    """A computer mouse with two buttons and a wheel, its front towards -y."""
    size = np.array([vary(0.063, 0.1), vary(0.108, 0.1), vary(0.037, 0.1)])
    # Each level: height, share of width, share of length, and how far it sits back.
    levels = np.array(
        [(0, 0.90, 0.93, 0), (0.30, 1, 1, 0), (0.68, 0.84, 0.84, 0.03), (1, 0.40, 0.36, 0.09)]
    )
    body = hull(_mouse_skin(smooth_path(levels, 13), 40) * size)
    core = hull(_mouse_skin(smooth_path(levels, 13), 40) * size * (0.90, 0.93, 0.93))
    seam = 0.06 * size[1]
    groove = box((0.0018, 0.6 * size[1], 1.0), (0, seam - 0.3 * size[1]), 0.45 * size[2])
    split = box((1.0, 0.0016, 1.0), (0, seam), 0.45 * size[2])
    # Buttons and body are thin over a core: faces deep inside would be sampled as if they were seen.
    front = (body - core) ^ box((1.0, 1.0, 1.0), (0, seam - 0.5), 0.45 * size[2])
    wheel = cylinder(0.012, 0.008, -0.004, segments=24).rotate((0, 90, 0))
    wheel = wheel.translate((0, -0.24 * size[1], 0.60 * size[2])) - core
    feet = _mouse_skin(levels[:1], 4)
    lifted = _mouse_skin(levels, 8) + (0, 0, 0.03) * (np.arange(32) < 8)[:, None]
    outline = np.concatenate([feet, lifted[:8], lifted[8:24], lifted[24::2]]) * size
    return assemble(
        label="computer mouse",
        pieces=(
            (
                body - front - ((groove + split) - core),
                vary.color(CHARCOAL, WHITE, GREY, *BRIGHT[:2]),
            ),
            (front - groove - split, vary.color(GREY, CHARCOAL, BLACK)),
            (wheel, vary.color(RED, BLUE, GREEN, BLACK)),
        ),
        parts=(part.hull(outline),),
        mass=vary(0.10, 0.2),
    )


def _mouse_skin(levels: np.ndarray, num: int) -> np.ndarray:
    """Rounded outlines of `num` corners at each level, in shares of the size: f64[L * num, 3]."""
    turns = np.linspace(0, 2 * np.pi, num, endpoint=False) + np.pi / num
    x, y = (np.sign(c) * np.abs(c) ** 0.8 / 2 for c in (np.cos(turns), np.sin(turns)))
    rings = [
        np.column_stack([x * wide, y * long + back, np.full(num, z)])
        for z, wide, long, back in levels
    ]
    return np.concatenate(rings)


def keyboard(vary: Draw) -> Shape:
    """A compact computer keyboard, its space bar towards -y."""
    width = vary(0.330, 0.1)
    depth = vary(0.125, 0.06)
    front = 0.011
    back = vary(0.021, 0.15)
    travel = 0.006
    corners, slope = wedge(width, depth, front, back)
    columns = int(vary.rng.integers(12, 16)) if vary.rng else 14
    area = (width - 0.014, depth - 0.014)
    grid = key_grid(columns, 5, area, travel)
    row = -0.4 * area[1]
    bar = [key(0.46 * area[0], 0.168 * area[1], travel, (-0.02 * area[0], row))]
    grid[4] = [one for k, one in enumerate(grid[4]) if abs((k + 0.5) / columns - 0.48) > 0.26] + bar
    accent = [grid[0][0], grid[2][-1]]
    grey = [
        *grid[0][-2:],
        *grid[1][:1],
        *grid[2][:1],
        *grid[3][:1],
        *grid[3][-1:],
        *grid[4][:3],
        *grid[4][-4:-1],
    ]
    plain = [
        one for line in grid for one in line if all(one is not other for other in accent + grey)
    ]
    tops = corners[corners[:, 2] > 0] * (0.955, 0.90, 1) + (0, 0, 0.85 * travel)
    return assemble(
        label="computer keyboard",
        pieces=(
            (hull(corners), vary.color(CHARCOAL, BLACK, SILVER, NAVY)),
            (
                _on_slope(union(*plain), front, back, slope),
                vary.color(WHITE, PAPER, SKY, spread=0.03),
            ),
            (_on_slope(union(*grey), front, back, slope), vary.color(GREY, TEAL)),
            (
                _on_slope(union(*accent), front, back, slope),
                vary.color(ORANGE, RED, BLUE, GREEN),
            ),
        ),
        parts=(part.hull(corners, tops),),
        mass=vary(0.65, 0.2),
    )


def calculator(vary: Draw) -> Shape:
    """A desk calculator, its display at the back."""
    width = vary(0.098, 0.12)
    depth = vary(0.150, 0.1)
    front = 0.015
    back = vary(0.034, 0.2)
    corners, slope = wedge(width, depth, front, back)
    grid = key_grid(4, 5, (0.86 * width, 0.58 * depth), 0.005, (0, -0.16 * depth))
    frame = box((0.84 * width, 0.21 * depth, 0.003), (0, 0.31 * depth), -0.001)
    glass = box((0.76 * width, 0.15 * depth, 0.001), (0, 0.31 * depth), 0.0016)
    number = "".join(
        str(d)
        for d in (vary.rng.choice([0, 1, 2, 3, 4, 5, 7, 8, 9], 5) if vary.rng else [1, 2, 3, 4, 5])
    )
    digits = lettering(number, 0.085 * depth).translate((0.08 * width, 0.31 * depth, 0.0026))
    operators = [grid[j][3] for j in range(4)]
    numbers = [grid[j][i] for j in range(1, 5) for i in range(3)]
    tinted = [
        (union(*numbers), vary.color(WHITE, PAPER, spread=0.02)),
        (union(*operators), GREY),
        (union(*grid[0][:3]), vary.color(RED, ORANGE)),
        (grid[4][3], vary.color(ORANGE, BLUE, GREEN)),
        (frame, BLACK),
        (glass, DISPLAY),
        (digits, BLACK),
    ]
    tops = corners[corners[:, 2] > 0] * (0.86, 0.88, 1) + (0, 0, 0.003)
    return assemble(
        pieces=(
            (hull(corners), vary.color(CHARCOAL, NAVY, TEAL, *BRIGHT)),
            *[(_on_slope(solid, front, back, slope), color) for solid, color in tinted],
        ),
        parts=(part.hull(corners, tops),),
        mass=vary(0.22, 0.2),
    )


def desk_phone(vary: Draw) -> Shape:
    """A desk telephone, its handset lying on the left of the keypad."""
    width = vary(0.185, 0.08)
    depth = vary(0.195, 0.08)
    front = 0.028
    back = vary(0.066, 0.15)
    corners, slope = wedge(width, depth, front, back)
    pad = key_grid(3, 4, (0.36 * width, 0.40 * depth), 0.005, (0.22 * width, -0.20 * depth))
    display = box((0.42 * width, 0.22 * depth, 0.006), (0.22 * width, 0.24 * depth), -0.001)
    glass = box((0.38 * width, 0.17 * depth, 0.001), (0.22 * width, 0.24 * depth), 0.0046)
    time = lettering("12:45", 0.07 * depth).translate((0.22 * width, 0.24 * depth, 0.0056))
    left = -0.26 * width
    reach = 0.42 * depth
    ends = [((0.050, 0.050, 0.030), (left, s * reach), -0.001) for s in (-1, 1)]
    grip = ((0.036, 2 * reach, 0.017), (left, 0), 0.020)
    cradle = box((0.024, 0.020, 0.027), (left, 0), -0.001)
    handset = union(*[rounded_box(size, 0.008, at, z) for size, at, z in (*ends, grip)])
    turn = (slope, 0, 0)
    lift = (0, 0, (front + back) / 2)
    tinted = [
        (union(*[one for row in pad for one in row]), WHITE),
        (display, BLACK),
        (glass, DISPLAY),
        (time, BLACK),
        (cradle - handset, BLACK),
        (handset, vary.color(RED, CHARCOAL, GREY, BLACK)),
    ]
    return assemble(
        label="desk telephone",
        pieces=(
            (
                hull(corners),
                vary.color(CHARCOAL, *DARK, RED, GREEN, PAPER),
            ),
            *[(_on_slope(solid, front, back, slope), color) for solid, color in tinted],
        ),
        parts=(
            part.hull(corners),
            *[part.rotate_part(part.box(size, at, z), turn, lift) for size, at, z in (*ends, grip)],
            part.rotate_part(
                part.box((0.40 * width, 0.22 * depth, 0.006), (0.22 * width, 0.24 * depth), -0.001),
                turn,
                lift,
            ),
        ),
        mass=vary(0.85, 0.15),
    )


GLASS = (0.12, 0.16, 0.30)


def alarm_clock(vary: Draw) -> Shape:
    """A twin-bell alarm clock on two feet, its face towards -y."""
    radius = vary(0.048, 0.12)
    depth = vary(0.046, 0.12)
    middle = radius + 0.012
    front = -depth / 2
    case = facing(radius, depth, (0, middle), front)
    body = case - facing(radius - 0.005, 0.004, (0, middle), front)
    bells, bell_parts = _bells(radius, middle, vary(33.0, 0.1))
    foot = [(0.004, 0), (0.020, 0), (0.014, 0.006), (-0.002, 0.030), (-0.010, 0.026)]
    feet = [
        part.upright([(s * (0.48 * radius + x), z) for x, z in foot], 0.9 * depth) for s in (-1, 1)
    ]
    top = middle + radius
    bell = 0.5 * radius
    arch = [
        (x * bell, 0, top + 0.006 + z * bell)
        for x, z in ((-0.9, 0.55), (-0.6, 1.1), (0.6, 1.1), (0.9, 0.55))
    ]
    hammer = box((0.008, 0.006, 0.020), z=top - 0.002) + box((0.022, 0.008, 0.008), z=top + 0.014)
    metal = vary.color(GOLD, SILVER, STEEL)
    stand = union(hammer, *[hull(foot.vertices) for foot in feet]) - case
    return assemble(
        pieces=(
            (body, vary.color(RED, TEAL, *BRIGHT, CHARCOAL)),
            (facing(radius - 0.006, 0.001, (0, middle), front + 0.0035), WHITE),
            (_dial(vary, radius).translate((0, front + 0.003, middle)), BLACK),
            (union(*bells, tube(arch, 0.003)), metal),
            (stand, metal if vary.rng else GREY),
        ),
        parts=(
            part.facing(radius, depth, 16, (0, middle)),
            *bell_parts,
            *feet,
            *part.sweep(arch[1:3], 0.004),
            part.box((0.020, 0.008, 0.022), z=top),
        ),
        mass=vary(0.30, 0.2),
    )


def _bells(radius: float, middle: float, degrees: float) -> tuple[list[Manifold], list[Mesh]]:
    """Two bells on stalks, leaning out to either side of a round case, and their parts."""
    bell = 0.50 * radius
    away = radius + 0.010
    cap = above(Manifold.sphere(bell, 48)).scale((1, 1, 0.85)) + cylinder(
        0.003, 0.014, z=-0.013, segments=12
    )
    dome = part.disc([(bell, 0), (0.72 * bell, 0.6 * bell), (0, 0.88 * bell)], 10)
    solids = []
    parts = []
    for side in (-1, 1):
        turn = np.radians(side * degrees)
        at = (away * np.sin(turn), 0.0, middle + away * np.cos(turn))
        solids.append(cap.rotate((0, side * degrees, 0)).translate(at))
        parts.append(part.rotate_part(dome, (0, side * degrees, 0), at))
    return solids, parts


def _dial(vary: Draw, radius: float) -> Manifold:
    """Twelve marks and two hands, around the origin, facing -y."""
    marks = [
        box((0.0022, 0.001, 0.007), z=radius - 0.016).rotate((0, 30 * k, 0)) for k in range(12)
    ]
    turns = vary.within((-58.0, 60.0), 0, 360)
    hands = [
        box((0.0032, 0.001, reach * radius), z=-0.004).rotate((0, float(turn), 0))
        for reach, turn in zip((0.48, 0.70), turns, strict=True)
    ]
    return union(*marks, *hands, facing(0.004, 0.002, (0, 0), -0.001))


def camera(vary: Draw) -> Shape:
    """A camera with a lens towards -y, a viewfinder hump and a grip."""
    width = vary(0.132, 0.08)
    depth = vary(0.048, 0.1)
    height = vary(0.082, 0.08)
    lens = vary(0.031, 0.08)
    reach = vary(0.040, 0.25)
    x = 0.10 * width
    front = -depth / 2
    middle = 0.49 * height
    at = (x, middle)
    nose = front - reach
    band = box((1.0, 1.0, 0.54 * height), z=0.20 * height)

    def block(inset: float) -> Manifold:
        outline = rounded_rect(width - 2 * inset, depth - 2 * inset, 0.010 - inset)
        return extrude(outline, height - 2 * inset, inset)

    barrel = union(facing(lens, reach, at, nose + 0.006), facing(lens - 0.003, reach, at, nose))
    grip = rounded_box(
        (0.030, 0.026, 0.92 * height), 0.008, (0.017 - width / 2, front - 0.004), 0.02 * height
    )
    hump = [(x - 0.026, height - 0.0015), (x + 0.026, height - 0.0015)]
    hump += [(x + 0.016, height + 0.020), (x - 0.016, height + 0.020)]
    prism = upright(hump, 0.68 * depth)
    inner = block(0.001) + prism.translate((0, 0, -0.001)).scale((1, 0.94, 1))
    # All of the dark body is one solid and the trim is a thin shell over it: nothing lies hidden inside.
    dark = union(inner, block(-0.001) ^ band, barrel, grip) - facing(lens - 0.007, 0.006, at, nose)
    shell = block(0.0) + prism - inner - band - facing(lens, 1.0, at, -1.0) - grip
    rings = [
        facing(lens + 0.0012, 0.004, at, front - share * reach)
        - facing(lens - 0.001, 1.0, at, -0.5)
        for share in (0.35, 0.62)
    ]
    knobs = [
        cylinder(radius, rise, z=height - 0.001, center=(share * width, 0), segments=24)
        for radius, rise, share in ((0.010, 0.008, 0.40), (0.007, 0.006, -0.40))
    ]
    trim = vary.color(SILVER, STEEL, CHARCOAL, GOLD)
    return assemble(
        pieces=(
            (dark, vary.color(BLACK, *DARK, (0.42, 0.24, 0.15), spread=0.02)),
            (union(shell, *rings), trim),
            (facing(lens - 0.0075, 0.003, at, nose + 0.004), GLASS),
            (
                union(*knobs),
                vary.color(RED, BLACK, ORANGE),
            ),
            (
                box((0.020, 0.002, 0.010), (x, -0.34 * depth - 0.0005), height + 0.005),
                WHITE,
            ),
        ),
        parts=(
            part.box((width, depth, height)),
            part.upright(hump, 0.68 * depth),
            part.rotate_part(
                part.disc([(lens, 0), (lens, reach)], 14), (90, 0, 0), (x, front, middle)
            ),
            part.box(
                (0.028, 0.022, 0.90 * height), (0.017 - width / 2, front - 0.005), 0.03 * height
            ),
        ),
        mass=vary(0.55, 0.2),
    )


def remote_control(vary: Draw) -> Shape:
    """A television remote lying on its back, its far end towards +y."""
    width = vary(0.048, 0.12)
    length = vary(0.175, 0.12)
    height = vary(0.020, 0.15)
    foot = rounded_rect(0.9 * width, 0.96 * length, 0.010)
    waist = rounded_rect(width, length, 0.012)
    levels = ((foot, 0.0), (waist, 0.5 * height), (foot, height))
    body = hull(*[at_height(outline, z) for outline, z in levels])
    step = 0.27 * width

    def button(column: float, row: float, radius: float = 0.0043) -> Manifold:
        """A round button: columns count from the middle, rows from the far end."""
        at = (column * step, (0.5 - row) * length)
        return cylinder(radius, 0.003, z=height - 0.0006, top=0.88 * radius, center=at, segments=20)

    numbers = [button(c, 0.17 + 0.065 * r) for r in range(4) for c in (-1, 0, 1)]
    inner = cylinder(0.17 * width, 1.0, center=(0, -0.03 * length))
    ring = button(0, 0.53, 0.30 * width) - inner
    keys = [button(c, row) for row in (0.82, 0.885) for c in (-1, 0, 1)]
    tinted = [
        (button(-1, 0.075, 0.005), RED),
        (union(*numbers, button(0, 0.53, 0.10 * width)), WHITE),
        (union(ring, *keys, button(1, 0.075)), GREY),
        *[
            (button(0.72 * (k - 1.5), 0.735, 0.0036), color)
            for k, color in enumerate((RED, GREEN, YELLOW, BLUE))
        ],
    ]
    footing = [(sx * 0.42 * width, sy * 0.45 * length, 0.0) for sx in (-1, 1) for sy in (-1, 1)]
    sides = [
        (sx * width * a, sy * length * b, z)
        for sx in (-0.5, 0.5)
        for sy in (-0.5, 0.5)
        for a, b, z in (
            (1, 0.95, 0.5 * height),
            (0.8, 1, 0.5 * height),
            (0.87, 0.94, height + 0.001),
        )
    ]
    return assemble(
        pieces=(
            (body, vary.color(CHARCOAL, *DARK, NAVY, STEEL)),
            *[(s, c) for s, c in tinted],
        ),
        parts=(part.hull(footing + sides),),
        mass=vary(0.14, 0.2),
    )
