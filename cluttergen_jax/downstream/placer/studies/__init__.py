"""Studies of stable placement: what decides how often what a placer proposes stands."""
