"""The command line, also as ``python -m rx90b_flex``."""

import sys

from rx90b_flex.interrupts import interruptible, is_interrupt


def main() -> None:
    """Load it and run it; an interrupt while it loads ends in a line, too."""
    failed: BaseException | None = None
    try:
        with interruptible():
            from rx90b_flex.cli import main as run
    except BaseException as error:
        failed = error
    if is_interrupt(failed):
        print("rx90b-flex: interrupted; nothing was written", file=sys.stderr)
        sys.exit(130)
    if failed is not None:
        raise failed
    run()


if __name__ == "__main__":
    main()
