"""A phone as it moves: readings arrive in batches, are recorded as they come, and explained at
the end. ``session`` is what every source feeds; ``sources/`` has one file a source."""
