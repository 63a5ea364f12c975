"""A small cupboard with a door and a drawer, as URDF and as MJCF; more can be put into its way."""

from pathlib import Path

WIDTH = 0.5
DEPTH = 0.4
HEIGHT = 0.7
FLOOR = 0.02
"""Metres: the upper face of the bottom board behind the door."""
DRAWER = 0.45
"""Metres: the upper face of the drawer's bottom."""

# Middle and size of each board, in the frame of its link.
_BOARDS = {
    "carcass": [
        ("0 0 0.01", "0.5 0.4 0.02"),
        ("0 0 0.69", "0.5 0.4 0.02"),
        ("0 0.005 0.41", "0.46 0.37 0.02"),
        ("-0.24 0 0.35", "0.02 0.4 0.66"),
        ("0.24 0 0.35", "0.02 0.4 0.66"),
        ("0 0.19 0.35", "0.46 0.02 0.66"),
    ],
    "drawer": [
        ("0 0 0.005", "0.44 0.34 0.01"),
        ("0 0.165 0.06", "0.44 0.01 0.1"),
        ("-0.215 0 0.06", "0.01 0.34 0.1"),
        ("0.215 0 0.06", "0.01 0.34 0.1"),
        ("0 -0.202 0.1", "0.5 0.02 0.22"),
    ],
    "door": [("0.25 -0.012 0.2", "0.49 0.02 0.4")],
}
_POST = ("-0.1 -0.42 0.15", "0.04 0.04 0.3")
"""It stands where the door swings, not where it is open or closed."""


def _boards(has_post: bool) -> dict[str, list[tuple[str, str]]]:
    return {**_BOARDS, "carcass": _BOARDS["carcass"] + [_POST] * has_post}


def cupboard_urdf(folder: Path, has_post: bool = False, has_limits: bool = True) -> Path:
    """Its file; the door's joint is `swing`, the drawer's `rail`."""
    links = "".join(
        f'<link name="{link}">'
        + "".join(
            f'<{tag}><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></{tag}>'
            for at, size in boards
            for tag in ("visual", "collision")
        )
        + "</link>"
        for link, boards in _boards(has_post).items()
    )
    limit = '<limit lower="0" upper="2.4" effort="1" velocity="1"/>' if has_limits else ""
    joints = f"""
<joint name="rail" type="prismatic"><parent link="carcass"/><child link="drawer"/>
  <origin xyz="0 -0.01 0.44"/><axis xyz="0 -1 0"/>
  <limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
<joint name="swing" type="{"revolute" if has_limits else "continuous"}">
  <parent link="carcass"/><child link="door"/>
  <origin xyz="-0.25 -0.2 0"/><axis xyz="0 0 -1"/>{limit}</joint>"""
    path = folder / "cupboard_file.urdf"
    path.write_text(f'<robot name="cupboard_file">{links}{joints}</robot>')
    return path


def cupboard_mjcf(folder: Path, has_post: bool = False) -> Path:
    """The same as MJCF."""

    def geoms(link: str) -> str:
        return "".join(
            f'<geom type="box" pos="{at}" size="{" ".join(str(float(each) / 2) for each in size.split())}"/>'
            for at, size in _boards(has_post)[link]
        )

    path = folder / "cupboard_file.xml"
    path.write_text(
        f"""<mujoco><compiler angle="radian"/><worldbody><body name="carcass">{geoms("carcass")}
  <body name="drawer" pos="0 -0.01 0.44"><joint name="rail" type="slide" axis="0 -1 0" range="0 0.3"/>
    {geoms("drawer")}</body>
  <body name="door" pos="-0.25 -0.2 0"><joint name="swing" axis="0 0 -1" range="0 2.4"/>
    {geoms("door")}</body>
</body></worldbody></mujoco>"""
    )
    return path
