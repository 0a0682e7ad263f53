"""Locate the mismatch, name the physics left out, model it, show the fit improve."""
