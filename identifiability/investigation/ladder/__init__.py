"""What was found missing, effect by effect: how the error falls, and what else was tried."""
