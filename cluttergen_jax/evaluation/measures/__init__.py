"""Measures of finished scenes: pure functions of arrays, no command line.

All take scenes by object index: poses f[N, K, 7] (world, metres, wxyz) and is_placed bool[N, K], K objects
in the compiled world; `arrangement.by_object` makes them of slots.

arrangement: scenes by object index, positions in the queried region. diversity: scenes as points of a space
with a distance, nearest neighbours, Vendi score, entropy in plan view, boxes. scene_models, simulate: plain
MuJoCo models of what stands, and running them. robustness: creep, shake, tilted gravity, changed physics.
contacts: forces and who rests on whom.
"""
