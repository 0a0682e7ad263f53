"""Rate tables: one file a device; the driver, the wire it speaks, and the same wire seen from the device."""
