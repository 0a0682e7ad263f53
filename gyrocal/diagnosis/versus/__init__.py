"""A recording against somebody's own simulation of it: what to add to that simulation."""
