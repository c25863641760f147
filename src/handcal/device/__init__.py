"""What is done to readings once errors are known: correct them, conceal an effect, predict them."""
