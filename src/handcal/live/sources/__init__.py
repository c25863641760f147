"""Where readings come from: one file a source. Each makes batches in SI for a session."""
