"""How the arm moves: inverse kinematics, paths around what stands, time laws, and the motors."""
