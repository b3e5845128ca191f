"""Numbers in sentences."""

from identifiability.numerals import number


def told_apart(a: float, b: float) -> tuple[str, str]:
    """Two numbers with as many digits as it takes to tell them apart, at least two."""
    for digits in range(2, 7):
        x, y = number(a, digits), number(b, digits)
        if x != y:
            break
    return x, y


def probability(p: float) -> str:
    """A p value in words."""
    return "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"
