"""One finished scene: what stands where, as a value, as an MJCF text and inside another model's specification."""
