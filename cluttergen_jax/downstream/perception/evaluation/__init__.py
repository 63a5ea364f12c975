"""How well perception does: masks, poses and certainty against what is true."""
