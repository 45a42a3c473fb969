"""The links to the five folders: a checkout may lack them."""

from __future__ import annotations

import sys
from os.path import basename, dirname, isdir, join

_SAID = (
    "this checkout lacks the symbolic links in maslam/: git config core.symlinks true, then git checkout -- maslam "
    "(on Windows with developer mode); or install a wheel"
)


def check_links() -> None:
    """Refuse a checkout whose links are plain files, as git for Windows writes them by default: an ``ImportError``, and
    on the command line a line and exit code 1.
    """
    if isdir(join(dirname(__file__), "tools")):
        return
    if basename(sys.argv[0]).removesuffix(".exe") in {"maslam", "-m"}:
        raise SystemExit(f"maslam: {_SAID}")
    raise ImportError(_SAID)
