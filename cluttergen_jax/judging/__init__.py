"""The neutral judge: anybody's scenes by one strict rule."""
