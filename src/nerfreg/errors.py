"""The one exception that a user is meant to read."""


class NerfregError(Exception):
    """Bad input: one line that says what is wrong, where (file, key, value) and what to do.

    Raised at the border, once. The command line prints the line and exits with code 2.
    """
