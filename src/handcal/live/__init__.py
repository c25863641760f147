"""A device as it moves: readings arrive in batches and are recorded as they come, the turn that
tells most is asked for, and all is explained at the end. ``session`` is what every source feeds;
``sources/`` has one file a source."""
