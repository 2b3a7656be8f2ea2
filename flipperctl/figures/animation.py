"""Moving pictures as files: GIF, or MP4 with the extra ``flipperctl[video]``.

In: frames, each with the time for which it is shown. Out: a file, whole or none; equal frames give
equal files.
"""

from __future__ import annotations

import importlib.util
import io
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.errors import FlipperctlError, missing_extra
from flipperctl.text.files import OutputKind, check_output, write_bytes

Frame = tuple[NDArray[np.uint8], float]
"""A picture (H, W, 3), and the time for which it is shown [s]."""
SHOWN = 0.04
"""Time for which frames are shown; players treat less than 0.02 s a frame of a GIF as 0.1 s [s]."""
LAST = 1.5
"""Time for which the last frame is shown before the film begins again [s]."""
_MP4 = ".mp4"
_MARK = b"film by flipperctl"
"""Comment in each film, by which an earlier one is recognised."""
FILM = OutputKind("a film", (".gif", _MP4), re.compile(_MARK))
_COLOURS = 63
"""Number of colours of a GIF, without the one that marks unchanged pixels [-]."""
_LOOKED_AT = 9
"""Number of frames that the colours are taken from [-]."""


def check_film(path: Path) -> None:
    """Check, before long work, that a film can be written to ``path``.

    Raises:
        MissingExtraError: an MP4 needs imageio-ffmpeg, which is not installed.
        OutputError: see ``check_output``.
    """
    check_output(path, FILM)
    if path.suffix.lower() == _MP4 and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise missing_extra(f"{path}: .gif needs no package; .mp4", "imageio-ffmpeg")


def write_film(path: Path, frames: Iterable[Frame]) -> None:
    """Write the frames, all of the size of the first one; see ``check_film``."""
    check_film(path)
    encode = _mp4 if path.suffix.lower() == _MP4 else _gif
    write_bytes(path, encode(frames))


def _gif(frames: Iterable[Frame]) -> bytes:
    """Return a GIF that repeats, in the colours that some of its frames have."""
    from PIL import Image

    # Frames wait in compressed form, since the palette is needed before the first is written.
    packed, durations, shape = list[bytes](), list[int](), (0, 0, 0)
    for picture, shown in frames:
        shape = picture.shape
        packed.append(zlib.compress(picture.tobytes(), 1))
        durations.append(round(1000 * shown))  # [ms]

    def pictures(indices: Sequence[int]) -> Iterator[Image.Image]:
        for index in indices:
            pixels = np.frombuffer(zlib.decompress(packed[index]), np.uint8)
            yield Image.fromarray(pixels.reshape(shape))

    # One palette for all frames, taken from some of them, so that still ground does not flicker
    count = len(packed)
    some = sorted({round(at) for at in np.linspace(0, count - 1, min(count, _LOOKED_AT))})
    sheet = np.concatenate([np.asarray(picture)[::2, ::2] for picture in pictures(some)])
    palette = Image.fromarray(sheet).quantize(_COLOURS, dither=Image.Dither.NONE)

    def quantized(indices: Sequence[int]) -> Iterator[Image.Image]:
        for picture in pictures(indices):
            yield picture.quantize(palette=palette, dither=Image.Dither.NONE)

    (first,), buffer = quantized([0]), io.BytesIO()
    more: dict[str, Any] = {"append_images": quantized(range(1, count)), "duration": durations}
    first.save(buffer, "GIF", save_all=True, loop=0, comment=_MARK, **more)
    return buffer.getvalue()


def _mp4(frames: Iterable[Frame]) -> bytes:
    """Return an MP4 (H.264), with a frame every ``SHOWN``."""
    import imageio_ffmpeg

    writer, due = None, 0.0
    options = ["-crf", "20", "-metadata", f"comment={_MARK.decode()}", "-fflags", "+bitexact"]
    with TemporaryDirectory(prefix="flipperctl-") as folder:
        file = Path(folder) / f"film{_MP4}"
        try:
            for picture, shown in frames:
                tall, wide = (side // 2 * 2 for side in picture.shape[:2])  # even, for H.264
                if writer is None:
                    writer = imageio_ffmpeg.write_frames(
                        str(file), (wide, tall), fps=1 / SHOWN, quality=None, codec="libx264",
                        macro_block_size=1, output_params=options, ffmpeg_log_level="error",
                    )  # fmt: skip
                    writer.send(None)
                # The rate is constant, so that a longer pause repeats its frame.
                due += shown
                pixels = picture[:tall, :wide].tobytes()
                while due > SHOWN / 2:
                    writer.send(pixels)
                    due -= SHOWN
            if writer is not None:
                writer.close()
            return file.read_bytes()
        except OSError as error:
            raise FlipperctlError(f"ffmpeg cannot write a film: {error}") from error
