"""Methods: who chooses the poses. `table` has them by name; nothing heavy is imported for it."""
