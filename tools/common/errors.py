"""The one exception root of the commands, and how any failure is put into one line."""

from __future__ import annotations

from maslam.backend.errors import BackendError
from maslam.descriptors.errors import DescriptorError
from maslam.frontend.errors import FrontendError
from maslam.mas.errors import MasError


class ToolError(RuntimeError):
    """A folder, file or option that a command cannot use; the message says which and why in one line."""


class UsageError(ToolError):
    """Options that do not fit together: exit code 2 instead of 1."""


class UnknownName(UsageError):
    """An option, a command, a setting or a choice that there is not; the message says what was probably meant."""


SAY_IT_THEMSELVES = (FrontendError, DescriptorError, BackendError, MasError, ToolError)


def describe(error: Exception) -> str:
    """One line for people: our own errors say everything themselves; an unexpected one is named, with the way to
    learn more.
    """
    text = " ".join(str(error).split())
    if isinstance(error, SAY_IT_THEMSELVES):
        return text
    if isinstance(error, OSError):
        reason = error.strerror or text
        return f"{error.filename}: {reason}" if error.filename else reason
    if isinstance(error, ModuleNotFoundError):
        return f"{text}: `maslam doctor` shows what is missing"
    return f"unexpected {type(error).__name__}: {text or 'no message'} (--debug shows where)"
