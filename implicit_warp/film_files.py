"""Films on disk: GIF by Pillow, MP4 (H.264) by ffmpeg, which comes with imageio-ffmpeg's wheel.

Files are written under a temporary name and renamed, so that a film that was not finished leaves
nothing behind.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np

from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.files import atomic_write, refuse_target
from implicit_warp.films import Film
from implicit_warp.render.picture import pillow

FILMS = (".mp4", ".gif")
"""Suffixes that `write_film` takes."""

_QUALITY = "17"
"""ffmpeg's constant rate factor: 18 is taken for visually lossless."""

Progress = Callable[[int, int, str], None]


def refuse_film(path: str | Path, size: tuple[int, int], fps: float) -> None:
    """Raise before the work if such a film cannot be written there.

    Raises:
        InputError: another suffix or a folder that is not there; an odd width or height for an
            MP4, whose colours are stored for squares of two by two pixels; more frames a second
            than a GIF can tell apart.
        MissingDependency: ffmpeg for an MP4, or Pillow for a GIF, is not installed.
    """
    refuse_target(path, FILMS)
    if Path(path).suffix.lower() == ".mp4":
        if any(n % 2 for n in size):
            raise InputError(
                "size", size, "an MP4 needs an even width and height", "add a pixel where it is odd"
            )
        _ffmpeg()
        return
    pillow("Image")
    if fps > 50:
        raise InputError("fps", fps, "a GIF shows at most 50 frames a second", "write an .mp4")


def write_film(film: Film, path: str | Path, progress: Progress | None = None) -> None:
    """Make the frames of a film and write them, `.mp4` or `.gif`; it plays for ever where a format
    can say so (GIF).

    A GIF has frames of whole hundredths of a second and 256 colours, taken from the first picture
    and the one in the middle; its frames are held in memory until it is written.

    Args:
        film: what to write.
        path: where to.
        progress: called with (frames done, frames in all, text).

    Raises:
        InputError, MissingDependency: as `refuse_film`; and whatever the frames raise.
    """
    path = Path(path)
    refuse_film(path, film.size, film.fps)
    write = _write_mp4 if path.suffix.lower() == ".mp4" else _write_gif
    with atomic_write(path) as temporary:
        write(film, temporary, progress or (lambda done, total, text: None))


def _write_mp4(film: Film, path: Path, progress: Progress) -> None:
    ffmpeg = _ffmpeg()
    writer = ffmpeg.write_frames(
        str(path),
        film.size,
        fps=film.fps,
        codec="libx264",
        pix_fmt_out="yuv420p",
        macro_block_size=2,
        quality=None,
        ffmpeg_log_level="error",
        output_params=[
            *("-crf", _QUALITY, "-preset", "medium", "-movflags", "+faststart"),
            # Players guess the matrix of untagged films by their size, and colours shift.
            *("-vf", "scale=out_color_matrix=bt709:out_range=tv", "-colorspace", "bt709"),
            *("-color_primaries", "bt709", "-color_trc", "bt709", "-f", "mp4"),
        ],
    )
    writer.send(None)
    try:
        for k, frame in enumerate(film):
            writer.send(np.ascontiguousarray(frame))
            progress(k + 1, len(film), "frames")
    finally:
        writer.close()


def _write_gif(film: Film, path: Path, progress: Progress) -> None:
    image = pillow("Image")
    frames = []
    for k, frame in enumerate(film):
        frames.append(image.fromarray(frame))
        progress(k + 1, len(film), "frames")
    width, height = film.size
    both = image.new("RGB", (width, 2 * height))
    both.paste(frames[0], (0, 0))
    both.paste(frames[len(frames) // 2], (0, height))
    palette = both.quantize(256, method=image.Quantize.MAXCOVERAGE, kmeans=2)
    # One palette for all, and an ordered pattern where it lacks a colour: what does not move does
    # not flicker, and takes no room.
    small = [_ordered(np.asarray(f), image).quantize(palette=palette, dither=0) for f in frames]
    # Rounded one by one, so that the whole takes the time it should.
    ends = np.rint(np.arange(1, len(small) + 1) * 100 / film.fps)
    durations = (10 * np.diff(ends, prepend=0)).astype(int).tolist()
    small[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=small[1:],
        duration=durations,
        loop=0,
        optimize=False,
        disposal=1,
    )


def _ordered(frame: np.ndarray, image: ModuleType):
    """A frame with a fine fixed pattern added, before its colours are reduced."""
    from implicit_warp.render.sampling import ordered

    height, width = frame.shape[:2]
    pattern = np.tile((ordered(8) + 0.5) / 64 - 0.5, (-(-height // 8), -(-width // 8)))
    patterned = frame + 5.0 * pattern[:height, :width, None]
    return image.fromarray(np.clip(np.rint(patterned), 0, 255).astype(np.uint8))


def _ffmpeg() -> ModuleType:
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise MissingDependency(
            "imageio-ffmpeg",
            "an MP4 film",
            'Install it with `pip install "implicit_warp[film]"`, or write a .gif',
        ) from error
    return imageio_ffmpeg
