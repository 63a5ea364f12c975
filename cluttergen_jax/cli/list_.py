"""`cluttergen list`: what can be named."""

from __future__ import annotations

from dataclasses import dataclass

from cluttergen_jax.errors import ClutterGenError


@dataclass(frozen=True)
class List:
    """List pools and their objects, supports, layouts, robots and checkpoints.

    Example: `cluttergen list`
    """

    def run(self) -> int:
        from cluttergen_jax.assets.pool import ALL, EMBEDDED, list_pools, read_pool
        from cluttergen_jax.assets.support_file import list_supports
        from cluttergen_jax.downstream.robot.description import find_robot, list_robots
        from cluttergen_jax.generation.layouts import list_layouts, read_layout
        from cluttergen_jax.learning.policies.embedded import list_policies

        print("pools")
        for name, path in list_pools().items():
            try:
                pool = read_pool(path)
                names = ", ".join(f"{n}*" if pool[n].flags else n for n in pool.names)
                print(f"  {name:12} {len(pool):3} objects: {names}")
            except ClutterGenError as error:
                print(f"  {name:12} damaged: {error}")
        print(f"  {ALL:12}     the union of {', '.join(EMBEDDED)}")
        print(
            "  (* flagged: `cluttergen inspect POOL` says why; a+b is the union of two, a~mug leaves mug out)"
        )
        print("supports")
        for name in list_supports():
            print(f"  {name}")
        print(
            "  table-WxD[xH] is a cuboid of that size in metres, such as table-0.40x0.50; bin-WxD[xH],"
        )
        print(
            "  tote-WxD[xH] and tray-WxD[xH] are containers of that size inside, such as bin-0.50x0.30x0.20"
        )
        print("layouts, of `cluttergen generate --layout`")
        for name in list_layouts():
            print(f"  {name:20} {len(read_layout(name).relations)} relations")
        print("robots, of `cluttergen robot` and `cluttergen rearrange`")
        for name in list_robots():
            try:
                find_robot(name)
                print(f"  {name}")
            except ClutterGenError as error:
                print(f"  {name:12} {error}")
        print("trained checkpoints, POOL-METHOD, or METHOD alone where one serves any pool")
        for name in list_policies():
            print(f"  {name}")
        if not list_policies():
            print("  none yet: cluttergen train makes one")
        return 0
