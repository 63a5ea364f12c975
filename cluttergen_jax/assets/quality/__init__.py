"""How well convex parts stand for a solid: their distance from it, and whether cavities stay open."""
