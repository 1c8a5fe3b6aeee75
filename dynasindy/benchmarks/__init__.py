"""Measurements against other software: one module each, with a `main(argv)`."""
