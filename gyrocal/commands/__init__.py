"""What the long commands run: input is read, an engine called, and what came of it given to `gyrocal.report` to write."""
