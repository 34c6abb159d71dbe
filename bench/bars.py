# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What was measured, beside what is aimed at: a line each, of which the page makes a table."""

MARK = 'aim: '


def told(what: str, value: float, aim: float, unit: str = '', least: bool = False) -> bool:
    """Print what was measured and what is aimed at, at most or at least; return whether it is met.

    Parameters
    ----------
    what : str
        Was measured; it says all that the table says of it.
    value, aim : float
    unit : str
        Of both.
    least : bool
        Whether more is better.
    """
    met = value >= aim if least else value <= aim
    bound = f'{"at least" if least else "at most"} {aim:g} {unit}'.rstrip()
    noted(what, f'{value:.3g} {unit}'.rstrip(), bound, met)
    return met


def noted(what: str, value: str, bound: str = '', met: bool = True) -> None:
    """Print a row of the table: what was measured, what is aimed at, and the value."""
    print(f'{MARK}{what} | {bound} | {value if met else f"**{value}**"}', flush=True)
