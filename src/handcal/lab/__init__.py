"""Laboratory methods on the same catalogue of effects: known inputs, the gravity norm, and more."""
