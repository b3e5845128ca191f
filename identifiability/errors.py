"""The one exception that is the user's to mend."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used: one sentence that says what was found, what was expected, how to mend it.

    The command line prints the sentence and exits with code 2, without a traceback.
    """
