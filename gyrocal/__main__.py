"""``python -m gyrocal`` is the command ``gyrocal``."""

from gyrocal.cli import main

main()
