"""The command ``maslam``, also as ``python -m maslam``."""

import sys

_INTERRUPTED = 130


def main() -> int:
    """Run the command line; an interrupt while its modules are loaded is one line, too."""
    try:
        from maslam.tools.cli import main as command
    except KeyboardInterrupt:
        sys.stderr.write("maslam: interrupted before it began\n")
        return _INTERRUPTED
    return command()


if __name__ == "__main__":
    sys.exit(main())
