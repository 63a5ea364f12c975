"""Measures of finished scenes: pure functions of arrays, no command line.

All take scenes by object index: poses f[N, K, 7] (world, metres, wxyz) and is_placed bool[N, K], K objects
in the compiled world; `judging.scene_models.by_object` makes them of slots.

diversity: scenes as points of a space with a distance, nearest neighbours, Vendi score, entropy in plan view,
boxes. How firmly scenes stand is measured in `judging`.
"""
