"""The bench: profile, plan, clock, safety, runner; gyros, tables, chambers; and the virtual bench."""
