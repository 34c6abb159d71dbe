# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The files of a folder as images of which the spots are known, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from os import PathLike
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.image import CentroidConfig
from starcal_ros.imaging.centroids import Centroids, of_picture
from starcal_ros.imaging.files import ImageFileError, image_files, is_image, load, pictures
from starcal_ros.imaging.picture import Picture
from starcal_ros.messages.cdr import RecordError
from starcal_ros.recording import stills
from starcal_ros.recording.bag_files import METADATA
from starcal_ros.workflows.still_images.said import by_text

_WORTH_S = 6.0          # of measuring that are left, for which workers are started
_MOST_AT_ONCE = 8       # files: an image of 24 Mpx takes some 0.5 GB


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
    focal_px : float or None
        Focal length that the file tells [px].
    path : Path
        File.
    plane : int
        Which image of it, from 0.
    """

    name: str
    shape: tuple[int, int]
    centroids: Centroids
    taken: datetime | None
    focal_px: float | None
    path: Path
    plane: int


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


_OfFile = tuple[MeasuredFolder, list[tuple[str, str]]]
"""What a file holds, and its name with each note."""


def measure(folder: str | PathLike[str], config: CentroidConfig, mask: NDArray[np.bool_] | None,
            on_progress: Callable[[float], None]) -> MeasuredFolder:
    """Find the spots in the images of a folder.

    Parameters
    ----------
    folder : path
        With images as `imaging.files` reads them, or a recording that has nothing else.
    config : CentroidConfig
        How spots are measured.
    mask : (height, width) bool array, optional
        Pixels of the camera that are looked at.
    on_progress : callable
        Called with the part done, 0 to 1.

    Raises
    ------
    ImageFileError
        Where there is no image.
    """
    found = MeasuredFolder()
    paths = [Path(folder)] if is_recording(folder) else image_files(folder)
    notes: list[tuple[str, str]] = []
    for k, (part, said) in enumerate(_parts(paths, config, mask), start=1):
        found.images.extend(part.images)
        found.left_out.update(part.left_out)
        notes.extend(said)
        on_progress(k / len(paths))
    found.notices.extend(f'{names}: {note}' for names, note in by_text(notes))
    return found


def _parts(paths: Sequence[Path], config: CentroidConfig, mask: NDArray[np.bool_] | None
           ) -> Iterator[_OfFile]:
    """Yield what each file gives, in their order; several at once where that saves time."""
    done, begin = 0, perf_counter()
    while done < len(paths):
        yield _measure_file(paths[done], config, mask)
        done += 1
        if (perf_counter() - begin) / done * (len(paths) - done) > _WORTH_S:
            break
    else:
        return
    from concurrent.futures.process import BrokenProcessPool
    import joblib
    try:
        for part in joblib.Parallel(
                n_jobs=min(joblib.effective_n_jobs(-1), _MOST_AT_ONCE), return_as='generator')(
                joblib.delayed(_measure_file)(path, config, mask) for path in paths[done:]):
            yield part
            done += 1
    except BrokenProcessPool:           # no room for so many at once
        for path in paths[done:]:
            yield _measure_file(path, config, mask)


def is_recording(path: str | PathLike[str]) -> bool:
    """Tell a recording, one file or a folder of rosbag2, from a folder of images."""
    path = Path(path)
    return path.is_file() or path.is_dir() and any(
        file.name == METADATA or file.suffix in ('.mcap', '.db3') for file in path.iterdir())


def pictures_of(path: Path) -> Iterator[Picture | str]:
    """Yield the images of a file or a recording, or what is wrong with one of them.

    Raises
    ------
    ImageFileError
        As `imaging.files.pictures`, and where a recording can not be read.
    """
    if is_image(path) or not is_recording(path):
        yield from pictures(path)
        return
    try:
        yield from stills.pictures(path)
    except RecordError as error:
        raise ImageFileError(str(error)) from None


def read_mask(path: str | PathLike[str]) -> NDArray[np.bool_]:
    """Return the pixels that are looked at: those that are not black in an image.

    Raises
    ------
    ImageFileError
        Where it is no image.
    """
    return np.asarray(load(path).shown > 0.0)


def _masked(picture: Picture, mask: NDArray[np.bool_] | None) -> Picture:
    """Return a picture of which nothing is known where a mask is black."""
    if mask is None:
        return picture
    if mask.shape != picture.shape:
        raise ValueError(f'the mask has {mask.shape[1]} x {mask.shape[0]} pixels, the image '
                         f'{picture.shape[1]} x {picture.shape[0]}')
    return picture.masked(mask)


def _measure_file(path: Path, config: CentroidConfig, mask: NDArray[np.bool_] | None
                  ) -> _OfFile:
    found = MeasuredFolder()
    planes: list[Measured | str] = []
    notes: set[str] = set()
    try:
        for picture in pictures_of(path):
            if isinstance(picture, str):
                planes.append(picture)
                continue
            notes.add(picture.note)
            try:
                planes.append(Measured(path.name, picture.shape,
                                       of_picture(_masked(picture, mask), config),
                                       picture.taken, picture.focal_px, path, len(planes)))
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
    return found, [(path.name, note) for note in sorted(filter(None, notes))]
