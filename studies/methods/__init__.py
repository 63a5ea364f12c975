"""Tables and figures of placement methods, a module each or a few that belong together."""
