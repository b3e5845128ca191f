"""Numbers in sentences."""


def short(x: float, digits: int = 2) -> str:
    """A number with so many significant digits, without an exponent unless it is very small."""
    return f"{float(f'{x:.{digits}g}'):.10g}"


def told_apart(a: float, b: float) -> tuple[str, str]:
    """Two numbers with as many digits as it takes to tell them apart, at least two."""
    for digits in range(2, 7):
        x, y = short(a, digits), short(b, digits)
        if x != y:
            break
    return x, y


def probability(p: float) -> str:
    """A p value in words."""
    return "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"
