"""The one exception that is the user's to mend."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used.

    Its one sentence says what was found, what was expected, and how to mend it. The command line
    prints the sentence and exits with code 2, without a traceback.
    """
