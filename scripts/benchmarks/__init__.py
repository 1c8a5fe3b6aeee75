"""Measurements against other software: one module each, with a `main(argv)`; `instruments` is what they share."""
