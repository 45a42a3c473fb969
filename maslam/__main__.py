"""``python -m maslam``: the command ``maslam``."""

import sys

from maslam.tools.cli import main

if __name__ == "__main__":
    sys.exit(main())
