"""The command line as ``python -m rx90b_flex``."""

from rx90b_flex.cli import main

main()
