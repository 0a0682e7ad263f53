"""The paper's calibration: data sets, surface, noise, and what they can carry."""
