"""Studies of the suite `downstream`: how often what is proposed, seen or moved is right, and why."""
