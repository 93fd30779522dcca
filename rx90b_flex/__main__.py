"""The command line, also as ``python -m rx90b_flex``."""

import sys


def main() -> None:
    """Load it and run it; an interrupt while it loads ends in a line, too."""
    try:
        from rx90b_flex.cli import main as run
    except KeyboardInterrupt:
        print("rx90b-flex: interrupted; nothing was written", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
