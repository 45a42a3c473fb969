"""The one error of the commands, and how any failure is put into one line."""

from __future__ import annotations

import errno

from maslam.errors import MaslamError


class ToolError(MaslamError):
    """A folder, file or option that a command cannot use; the message says which and why in one line."""


class EarlierResultError(ToolError):
    """A result of something else stands where a new one is to be written; the message names ``--overwrite``, which
    Python calls ``overwrite=True``."""

    def in_python(self) -> EarlierResultError:
        """The same for who calls a function."""
        return EarlierResultError(str(self).replace("--overwrite", "overwrite=True"))


class UsageError(ToolError):
    """Options that do not fit together: exit code 2 instead of 1."""


class UnknownName(UsageError):
    """An option, a command, a setting or a choice that there is not; the message says what was probably meant."""


_CURES = {
    errno.EMFILE: "too many files are open at once: allow more (ulimit -n 1024), or use fewer --workers",
    errno.EAGAIN: "the system starts no further process or thread: allow more (ulimit -u), or use fewer --workers",
    errno.ENOMEM: "out of memory: use fewer --workers, or allow more (ulimit -v, the container's limit)",
}
"""Of errors whose own words name neither cause nor cure."""
_NO_MEMORY = ("failed to map segment", "cannot allocate memory", "Cannot allocate memory")


def describe(error: Exception) -> str:
    """One line for people: our own errors say everything themselves; an unexpected one is named, with the way to
    learn more.
    """
    text = " ".join(str(error).split())
    if isinstance(error, MaslamError):
        return text
    if isinstance(error, OSError):
        reason = _CURES.get(error.errno or 0) or error.strerror or text
        return f"{error.filename}: {reason}" if error.filename else reason
    if isinstance(error, ModuleNotFoundError):
        return f"{text}: `maslam doctor` shows what is missing"
    if isinstance(error, MemoryError) or (isinstance(error, ImportError) and any(w in text for w in _NO_MEMORY)):
        return f"out of memory (ulimit -v, or the container's limit?): {text or 'no more can be had'}"
    return f"unexpected {type(error).__name__}: {text or 'no message'} (--debug shows where)"
