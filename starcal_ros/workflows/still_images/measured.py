# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The files of a folder as images of which the spots are known, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime
from os import PathLike
from pathlib import Path

from starcal_ros.config.image import CentroidConfig
from starcal_ros.imaging.centroids import Centroids, of_picture
from starcal_ros.imaging.files import ImageFileError, image_files, pictures


@dataclass(frozen=True)
class Measured:
    """An image of which only the spots are kept.

    Attributes
    ----------
    name : str
        File, and which image of it where it holds several.
    shape : (int, int)
        Height and width [px].
    centroids : Centroids
        In pixels of the camera.
    taken : datetime or None
        When.
    """

    name: str
    shape: tuple[int, int]
    centroids: Centroids
    taken: datetime | None


@dataclass(frozen=True)
class MeasuredFolder:
    """What a folder holds.

    Attributes
    ----------
    images : list of Measured
        In the order of their names.
    left_out : dict
        Files and images that can not be measured, by name, with the reason.
    notices : list of str
        What a user should know of the others.
    """

    images: list[Measured] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)


def measure(folder: str | PathLike[str], config: CentroidConfig,
            on_progress: Callable[[float], None]) -> MeasuredFolder:
    """Find the spots in the images of a folder.

    Parameters
    ----------
    folder : path
        With images as `imaging.files` reads them.
    config : CentroidConfig
        How spots are measured.
    on_progress : callable
        Called with the part done, 0 to 1.

    Raises
    ------
    ImageFileError
        Where there is no image.
    """
    found = MeasuredFolder()
    paths = image_files(folder)
    for k, path in enumerate(paths):
        _measure_file(path, config, found)
        on_progress((k + 1) / len(paths))
    return found


def _measure_file(path: Path, config: CentroidConfig, found: MeasuredFolder) -> None:
    planes: list[Measured | str] = []
    notes: set[str] = set()
    try:
        for picture in pictures(path):
            notes.add(picture.note)
            try:
                planes.append(Measured(path.name, picture.shape, of_picture(picture, config),
                                       picture.taken))
            except ValueError as error:             # of the extraction
                planes.append(str(error))
    except ImageFileError as error:
        found.left_out[path.name] = str(error).removeprefix(f'{path}: ')
    several = len(planes) > 1
    for k, plane in enumerate(planes):
        name = f'{path.name}[{k}]' if several else path.name
        if isinstance(plane, str):
            found.left_out[name] = plane
        else:
            found.images.append(replace(plane, name=name))
    if several:
        notes.add(f'{len(planes)} images, each taken as one')
    found.notices.extend(f'{path.name}: {note}' for note in sorted(filter(None, notes)))
