"""Lists in one option: names or numbers with commas between them."""


def listed(name: str, text: str) -> tuple[str, ...]:
    """Return the parts of a text; refuse an empty one."""
    from ..errors import InputError
    from ..text import shown

    parts = tuple(part.strip() for part in text.split(","))
    if not all(parts):
        raise InputError(
            f"--{name.replace('_', '-')} {shown(text)}", "names with commas between them"
        )
    return parts


def numbers(name: str, text: str) -> tuple[float, ...]:
    """Return the numbers of a text, with commas or blanks between them."""
    from ..errors import InputError
    from ..text import shown

    try:
        return tuple(float(part) for part in text.replace(",", " ").split())
    except ValueError as error:
        option = f"--{name.replace('_', '-')} {shown(text)}"
        raise InputError(option, "numbers with commas between them") from error
