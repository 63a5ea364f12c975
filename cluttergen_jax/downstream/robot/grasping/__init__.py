"""How a hand can hold an object: grasps found on its collision parts, each tried in simulation."""
