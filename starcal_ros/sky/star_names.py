# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The names of bright stars, as the IAU Catalog of Star Names has them, by Hipparcos number."""

from __future__ import annotations

NAMES = {
    32349: 'Sirius', 30438: 'Canopus', 69673: 'Arcturus', 71683: 'Rigil Kentaurus', 91262: 'Vega',
    24608: 'Capella', 24436: 'Rigel', 37279: 'Procyon', 7588: 'Achernar', 27989: 'Betelgeuse',
    68702: 'Hadar', 97649: 'Altair', 60718: 'Acrux', 21421: 'Aldebaran', 80763: 'Antares',
    65474: 'Spica', 37826: 'Pollux', 113368: 'Fomalhaut', 102098: 'Deneb', 62434: 'Mimosa',
    49669: 'Regulus', 33579: 'Adhara', 85927: 'Shaula', 36850: 'Castor', 61084: 'Gacrux',
    25336: 'Bellatrix', 25428: 'Elnath', 45238: 'Miaplacidus', 26311: 'Alnilam',
    109268: 'Alnair', 26727: 'Alnitak', 62956: 'Alioth', 54061: 'Dubhe', 15863: 'Mirfak',
    34444: 'Wezen', 90185: 'Kaus Australis', 41037: 'Avior', 67301: 'Alkaid', 86228: 'Sargas',
    28360: 'Menkalinan', 82273: 'Atria', 31681: 'Alhena', 100751: 'Peacock', 42913: 'Alsephina',
    30324: 'Mirzam', 46390: 'Alphard', 11767: 'Polaris', 9884: 'Hamal', 3419: 'Diphda',
    65378: 'Mizar', 92855: 'Nunki', 68933: 'Menkent', 5447: 'Mirach', 677: 'Alpheratz',
    86032: 'Rasalhague', 72607: 'Kochab', 27366: 'Saiph', 57632: 'Denebola', 14576: 'Algol',
    76267: 'Alphecca', 25930: 'Mintaka', 100453: 'Sadr', 87833: 'Eltanin', 3179: 'Schedar',
    39429: 'Naos', 45556: 'Aspidiske', 44816: 'Suhail', 746: 'Caph', 72105: 'Izar',
    78401: 'Dschubba', 53910: 'Merak', 2081: 'Ankaa', 107315: 'Enif', 113881: 'Scheat',
    84012: 'Sabik', 58001: 'Phecda', 35904: 'Aludra', 113963: 'Markab', 105199: 'Alderamin',
    17702: 'Alcyone', 59774: 'Megrez', 8903: 'Sheratan', 14135: 'Menkar', 1067: 'Algenib',
    95947: 'Albireo', 6686: 'Ruchbah', 112122: 'Tiaki', 61932: 'Muhlifain', 50583: 'Algieba',
    9640: 'Almach'}
"""By number: names of stars that are brighter than Hp 3.4."""


def name_of(hip: int) -> str:
    """Return what a star is called, by its number where it has no name here."""
    return NAMES.get(hip, f'HIP {hip}')
