"""Escapes control characters in texts from files, so that they are safe to print."""


def visible(text: object) -> str:
    """A text whose control and formatting characters are shown as escapes.

    Names in files and of files may hold characters that steer a terminal or turn the direction of
    writing. Line feeds stay. HTML is escaped besides, by `html.escape`.
    """
    return "".join(
        one if one.isprintable() or one == "\n" else one.encode("unicode_escape").decode()
        for one in str(text)
    )
