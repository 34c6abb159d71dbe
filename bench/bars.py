# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is aimed at, beside what was measured: a line each, of which the page makes a table."""

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
    print(f'{MARK}{what} | {f"{value:.3g} {unit}".rstrip()} | '
          f'{"at least" if least else "at most"} {f"{aim:g} {unit}".rstrip()} | '
          f'{"met" if met else "missed"}', flush=True)
    return met
