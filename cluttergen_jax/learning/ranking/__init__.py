"""The decision process as a choice among candidate poses that geometry has found."""
