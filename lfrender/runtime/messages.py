"""Texts of errors that other libraries raise."""

__all__ = ["one_line"]

# Characters of a text that are shown: decoders print pages.
_LONGEST = 200


def one_line(error: BaseException) -> str:
    """The text of an error on one line, or its kind if it has none."""
    return " ".join(str(error).split())[:_LONGEST] or type(error).__name__
