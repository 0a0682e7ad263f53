"""What is on disk: run directory, data-set table, drive log. Crash-safe writers, strict readers."""
