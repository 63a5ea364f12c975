"""What a camera sees of a scene: cameras, depth and labels by rays, noise, partial height maps; no JAX."""
