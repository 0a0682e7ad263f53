"""Noise and inference: arrays in, arrays out; used by fit, diagnosis, drives and report alike."""
