"""What is done once errors are known: correct readings, conceal an effect, keep a device's file."""
