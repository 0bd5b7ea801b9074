"""Sources of live frames: files in a loop, OpenCV, and GenICam by GenTL or Aravis.

A source is a generator of shots: it opens its camera when the first one is asked for, raises
`SourceError` as soon as the camera is gone, and gives it back when it is closed. Pixels are copied
before the camera gets its buffer back.
"""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import FlatError, LightFieldError
from lfcal.runtime.image_formats import IMAGE_SUFFIXES, RAW_SUFFIX, VIDEO_FORMATS
from lfcal.runtime.packages import check_package

from ..sequence.frames import open_frames

__all__ = ["Shot", "SourceError", "open_source", "silence_opencv", "to_flat"]

# A camera that gives no frame for so long [s] is taken for unplugged.
_PATIENCE = 5.0
# Frames of files are kept for the next round if all of them take no more bytes.
_MOST_KEPT = 1 << 29
_FORMAT = re.compile(r"(Mono|Bayer(?:RG|BG|GR|GB)|RGBa?|BGRa?)(8|10|12|14|16)(p|Packed)?")


# Channels of pixels in colour, in the order red, green, blue.
_ORDERS = {"RGB": [0, 1, 2], "BGR": [2, 1, 0]}


class SourceError(LightFieldError, OSError):
    """A source of live frames cannot be opened, or gives no more frames."""


@dataclass(frozen=True)
class Shot:
    """One frame of a source."""

    pixels: NDArray[Any]  # (h, w) or (h, w, 3) uint8 or uint16
    mosaic: str | None = None  # its colour filters, where the source names them
    white: float | None = None  # its largest value, where that is less than the type holds
    encoded: bool | None = None  # whether it is encoded for display, where the source tells it
    lost: int = 0  # frames that the source has lost since the one before
    ticks: int | None = None  # the clock of the camera [ns]
    number: int = 0  # since the start
    arrived: float = 0.0  # by the monotonic clock [s]
    time: float = 0.0  # since 1970 [s]
    recorded: bool = False  # whether it goes into a recording
    waits: bool = False  # whether the source waits with its next frame, as files do


def open_source(
    name: str, pixel_format: str | None = None, rate: float | None = None
) -> Iterator[Shot]:
    """The frames of a source by its name (docs/live.md); `rate` [1/s] is for files.

    GenICam cameras are set to a `pixel_format` such as `"Mono12"`, if it is given.
    """
    if name.startswith("arv:"):
        return _read_aravis(name, pixel_format)
    if re.search(r"\.cti(:|$)", name):
        return _read_gentl(name, pixel_format)
    if pixel_format is not None:
        raise SourceError(f"{name}: --pixel-format is for GenICam cameras; leave it out")
    path = Path(name).expanduser()
    if path.is_dir() or (
        path.suffix.lower() in {*IMAGE_SUFFIXES, *VIDEO_FORMATS, RAW_SUFFIX} and "://" not in name
    ):
        return _play_files(path, rate)
    return _read_opencv(name)


def _play_files(path: Path, rate: float | None) -> Iterator[Shot]:
    """Frames of files, again and again; damaged ones are lost."""
    frames = open_frames([path])
    step = 1 / float(rate or frames.rate or Fraction(10))
    kept: list[NDArray[Any]] | None = []
    complete = False
    due = time.monotonic()
    while True:
        lost = 0
        error = None
        for item in kept if complete and kept else frames:
            try:
                pixels = item if isinstance(item, np.ndarray) else item.read()
            except FlatError as wrong:
                lost = lost + 1
                error = wrong
                continue
            if kept is not None and not complete:
                kept.append(pixels)
                if len(kept) * pixels.nbytes > _MOST_KEPT:
                    kept = None
            time.sleep(max(0.0, due - time.monotonic()))
            due = max(due + step, time.monotonic())
            yield Shot(pixels, lost=lost, waits=True)
            lost = 0
        if error is not None and not kept:
            raise SourceError(str(error))
        complete = error is None and kept is not None


def silence_opencv() -> None:
    """Let OpenCV report nothing itself."""
    import cv2

    # Since OpenCV 4.13 the function is in a module of its own.
    getattr(cv2.utils, "logging", cv2).setLogLevel(0)


def _read_opencv(name: str) -> Iterator[Shot]:
    import cv2

    # This program reports errors itself, once.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    silence_opencv()
    if name.isdigit():
        device = cv2.VideoCapture(int(name))
    elif " ! " in name:
        if not cv2.videoio_registry.hasBackend(cv2.CAP_GSTREAMER):
            raise SourceError(
                f"{name}: this OpenCV is built without GStreamer, as those of PyPI are; use "
                "Debian's"
            )
        device = cv2.VideoCapture(name, cv2.CAP_GSTREAMER)
    elif "://" in name:
        wait = int(1000 * _PATIENCE)
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, wait, cv2.CAP_PROP_READ_TIMEOUT_MSEC, wait]
        device = cv2.VideoCapture(name, cv2.CAP_FFMPEG, limits)
    else:
        device = cv2.VideoCapture(name)
    try:
        if not device.isOpened():
            raise SourceError(f"{name}: OpenCV finds no camera, stream or video there")
        device.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        while True:
            good, frame = device.read()
            if not good:
                raise SourceError(f"{name}: gives no more frames")
            if frame.ndim == 3:
                frame = cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
            yield Shot(np.ascontiguousarray(frame))
    finally:
        device.release()


def to_flat(name: str, data: NDArray[Any], width: int, height: int) -> Shot:
    """A copy of the frame of a GenICam camera, by the name of its pixel format (PFNC).

    Pixels of 8 bits, of 10 to 16 in two bytes, and of 12 in three bytes for two are read: grey,
    colours, and Bayer mosaics. SourceError for others.
    """
    found = _FORMAT.fullmatch(name)
    colours, bits, packed = found.groups() if found else ("", "", None)
    if not found or (packed and data.dtype == np.uint8 and bits != "12"):
        raise SourceError(
            f"pixels of the camera of kind {name} are not read; set Mono8, Mono12, BayerRG8 or "
            "the like"
        )
    if packed and data.dtype == np.uint8:
        # Two pixels are three bytes; the last one of an odd number has two.
        if width * height % 2 and data.size == (width * height * 3 + 1) // 2:
            data = np.append(data, np.uint8(0))
        triples = data[: data.size // 3 * 3].reshape(-1, 3)
        first, middle, last = (part.astype(np.uint16) for part in triples.T)
        # PFNC has the low bits first, GigE Vision 1 ("Packed") the high ones.
        low = middle & 0xF
        one = first << 4 | low
        if packed == "p":
            one = first | low << 8
        values = np.stack([one, last << 4 | middle >> 4], 1).ravel()
    else:
        data = data.view(np.uint8)
        values = data
        if bits != "8":
            values = data[: data.size // 2 * 2].view("<u2")
    order = _ORDERS.get(colours[:3], [0])
    channels = len(colours) if len(order) > 1 else 1
    if values.size < width * height * channels:
        raise SourceError(f"the camera gave a frame of {data.nbytes:,} bytes, which is incomplete")
    pixels = values[: width * height * channels].reshape((height, width, channels))
    filters = {"RG": "RGGB", "BG": "BGGR", "GR": "GRBG", "GB": "GBRG"}.get(
        colours.removeprefix("Bayer")
    )
    white = None if bits in ("8", "16") else float(2 ** int(bits) - 1)
    return Shot(np.array(pixels[:, :, order].squeeze(), order="C"), filters, white, encoded=False)


def _counted(shot: Shot, number: int, before: int | None, ticks: int | None) -> Shot:
    """A frame with the number of those that are missing between its number and that of the one
    `before`.
    """
    lost = 0
    # Numbers of GigE Vision 1 begin again after 65535.
    if before is not None and number > before:
        lost = number - before - 1
    return replace(shot, lost=lost, ticks=ticks)


def _read_gentl(name: str, pixel_format: str | None) -> Iterator[Shot]:
    check_package("harvesters", f"{name}: GenTL producers need", SourceError)
    from genicam.genapi import GenericException as FeatureError
    from genicam.gentl import GenericException, TimeoutException
    from harvesters.core import Harvester

    producer, _, wanted = name.partition(".cti")
    harvester = Harvester()
    camera = None
    before = None
    try:
        if not Path(f"{producer}.cti").is_file():
            raise SourceError(f"{producer}.cti: there is no such GenTL producer")
        harvester.add_file(f"{producer}.cti")
        harvester.update()
        devices = [device.id_ for device in harvester.device_info_list]
        device = next((found for found in devices if wanted[1:] in ("", found)), None)
        if device is None:
            raise SourceError(
                f"{name}: no such camera; this producer finds {', '.join(devices) or 'none'}"
            )
        interrupt = signal.getsignal(signal.SIGINT)
        camera = harvester.create({"id_": device})
        # The library takes Ctrl-C for itself.
        if current_thread() is main_thread():
            signal.signal(signal.SIGINT, interrupt)
        if pixel_format:
            camera.remote_device.node_map.PixelFormat.value = pixel_format
        camera.start()
        while True:
            with camera.fetch(timeout=_PATIENCE) as buffer:
                part = buffer.payload.components[0]
                number = buffer.frame_id
                ticks = None
                with suppress(GenericException):
                    ticks = buffer.timestamp_ns
                shot = to_flat(part.data_format, part.data, part.width, part.height)
            yield _counted(shot, number, before, ticks)
            before = number
    except TimeoutException as error:
        raise SourceError(f"{name}: no frame for {_PATIENCE:g} s") from error
    except (GenericException, FeatureError) as error:
        raise SourceError(f"{name}: {error}") from error
    finally:
        with suppress(GenericException):
            if camera is not None:
                camera.destroy()
            harvester.reset()


def _read_aravis(name: str, pixel_format: str | None) -> Iterator[Shot]:
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, GLib
    except (ImportError, ValueError) as error:
        raise SourceError(
            f"{name}: needs Aravis for Python: apt install gir1.2-aravis-0.8 python3-gi, and an "
            "environment made with "
            "python3 -m venv --system-site-packages"
        ) from error
    camera = None
    before = None
    try:
        camera = Aravis.Camera.new(name.removeprefix("arv:") or None)
        if pixel_format:
            camera.set_pixel_format_from_string(pixel_format)
        stream = camera.create_stream(None, None)
        kind = camera.get_pixel_format_as_string()
        for _ in range(4):
            stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
        camera.start_acquisition()
        while True:
            buffer = stream.timeout_pop_buffer(int(1e6 * _PATIENCE))
            if buffer is None:
                raise SourceError(f"{name}: no frame for {_PATIENCE:g} s")
            shot = None
            number = buffer.get_frame_id()
            ticks = buffer.get_timestamp()
            if buffer.get_status() == Aravis.BufferStatus.SUCCESS:
                size = buffer.get_image_width(), buffer.get_image_height()
                shot = to_flat(kind, np.frombuffer(buffer.get_data(), np.uint8), *size)
            stream.push_buffer(buffer)
            if shot is not None:
                yield _counted(shot, number, before, ticks)
                before = number
    except GLib.Error as error:
        raise SourceError(f"{name}: {error.message}") from error
    finally:
        if camera is not None:
            with suppress(GLib.Error):
                camera.stop_acquisition()
