"""Warnings for users: commands print them, a line each, where those of libraries stay unsaid."""


class InputWarning(UserWarning):
    """Something that a user brings is not used, or not as it is."""
