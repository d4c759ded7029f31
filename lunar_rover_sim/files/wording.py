"""Words of messages and reports."""


def counted(count: int, thing: str) -> str:
    """Return `1 world`, `2 worlds`: a number, and a noun whose plural ends in s."""
    return f'{count} {thing}' if count == 1 else f'{count} {thing}s'
