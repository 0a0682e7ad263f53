"""Gyros: one file a device, a pure codec beside a thin driver."""
