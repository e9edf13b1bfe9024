"""Draw the pictures of README and of these pages anew, each with a stamp of today's code.

The stamp is in the file's EXIF data: Software has the version and the commit, ImageDescription the
command. Most pictures also say the version in their footer.

Run from the project's root: `python docs/pictures.py NAME … [--data FOLDER]`. `--list` says how
each is made and how long it takes. `quick` names all that take less than two minutes and need no
recording, `all` every one. Draw from a clean commit, so that its name tells the code. FOLDER has
the recordings (*.csv), also in folders of it.
"""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from matplotlib.font_manager import findfont
from PIL import ExifTags, Image, ImageDraw, ImageFont

from validation import output

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
IMAGES = DOCS / "img"
TILE, GRASS, RAISED, WARTHOG = (
    f"{name}_train.csv"
    for name in ("husky_tile", "husky_wet_grass", "husky_wheels_up", "warthog_grass")
)


@dataclass(frozen=True)
class Picture:
    """This says how a picture is made."""

    command: str
    """A program with its options, or a script of this folder; recordings by the names of their
    files."""
    minutes: float
    """This says how long the drawing takes on two cores."""
    written: str = ""
    """The file that a program writes; a script writes the picture itself."""
    unsigned: bool = True
    """Whether it does not say the versions itself."""
    ending: str = "png"
    """The ending of its file in img; scripts stamp those that are no PNG."""

    def recordings(self) -> list[str]:
        """Return the names of the recordings that it needs."""
        return re.findall(r"\w+_train\.csv", self.command)


PICTURES = {
    "architecture": Picture("make_architecture_figure.py", 0.1, ending="svg"),
    "centre_of_mass": Picture("make_centre_of_mass_figure.py", 0.1),
    "contact": Picture("make_figures.py", 0.5),
    "drivetrain": Picture(
        f"study drivetrain --recording {RAISED} --ground {GRASS}", 1.0, "study.png", unsigned=False
    ),
    "four_wheel": Picture("make_four_wheel_figure.py", 1.0),
    "learning": Picture("examples/learn_to_track.py", 4.0, "learning.png"),
    "ppo": Picture("examples/learn_with_ppo.py", 3.0, "ppo.png"),
    "printed_parameters": Picture("make_printed_figure.py", 1.0),
    "references": Picture("make_references_figure.py", 0.1),
    "results": Picture("replicate", 60.0, "replicate.png", unsigned=False),
    "robot": Picture("robots check warthog", 0.2, "robot.png"),
    "sideways_drift": Picture("make_contact_figures.py", 1.0),
    "tile": Picture("make_identification_figures.py", 0.1),
    "track": Picture(
        "track lqr-scheduled generic --gains tuned --plant improved,mujoco",
        0.5,
        "track.png",
        unsigned=False,
    ),
    "track-mpc": Picture(
        "track mpc slalom --speed 0.5 --no-noise --plant improved,mujoco",
        0.5,
        "track.png",
        unsigned=False,
    ),
    "traj4": Picture("compare traj4", 0.3, "compare.png", unsigned=False),
    "transfer": Picture("study transfer", 15.0, "study.png", unsigned=False),
    "viewer": Picture("compare traj4", 0.5, "compare.rrd"),
    "warthog": Picture(f"make_warthog_figure.py {WARTHOG}", 2.0),
    "wet_grass": Picture(f"make_wet_grass_figure.py {TILE} {GRASS}", 3.0),
    "husky": Picture("make_moving_picture.py", 0.8, ending="webp"),
    "gallery/first_steps": Picture("make_gallery.py first_steps.ipynb", 0.5, ending="webp"),
    **{
        f"gallery/{name}": Picture(f"make_gallery.py {name}.py", 0.5, ending="webp")
        for name in (
            "compare_plants",
            "fit_a_log",
            "other_robots",
            "own_controller",
            "sensitivity",
            "sweep",
        )
    },
}


def ask_git(*words: str) -> str:
    """Return what git says of this project."""
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def stamp_of(command: str) -> Image.Exif:
    """Return EXIF data that say which code drew a picture, and by which command."""
    commit = ask_git("rev-parse", "--short", "HEAD")
    if ask_git("status", "--porcelain", "--", ":!docs/img"):
        commit += ", changed"
    version = output.list_versions()["ssmr-testbed"]
    exif = Image.Exif()
    exif[ExifTags.Base.Software] = f"ssmr-testbed {version}, commit {commit}"
    exif[ExifTags.Base.ImageDescription] = command
    return exif


def sign(picture: Path) -> None:
    """Add a line with the versions below a picture."""
    measured = output.list_versions()
    text = " · ".join(f"{name} {measured[name]}" for name in ("ssmr-testbed", "mujoco"))
    drawn = Image.open(picture).convert("RGB")
    size = max(11, drawn.width // 120)
    page = Image.new("RGB", (drawn.width, drawn.height + 2 * size), "white")
    page.paste(drawn)
    font = ImageFont.truetype(findfont("DejaVu Sans"), size)
    ImageDraw.Draw(page).text((size, drawn.height + size // 3), text, "#737373", font)
    page.save(picture)


def photograph(recording: Path, picture: Path) -> None:
    """Write what the rerun viewer shows of a recording; no display is needed."""
    from rerun.experimental import ViewerClient

    viewer = ViewerClient.spawn(headless=True, port=9977)
    viewer.open(str(recording))
    time.sleep(20.0)
    viewer.save_screenshot(str(picture))
    viewer.quit()


def run_script(words: list[str]) -> None:
    """Run a script of this folder."""
    kept = sys.argv
    sys.argv = [str(DOCS / words[0]), *words[1:]]
    try:
        runpy.run_path(sys.argv[0], run_name="__main__")
    finally:
        sys.argv = kept


def draw(name: str, data: Path | None) -> None:
    """Draw one picture."""
    made = PICTURES[name]
    words = shlex.split(made.command)
    for recording in made.recordings():
        there = str(next((data or Path()).rglob(recording)))
        words = [
            word.replace(recording, there) if word.startswith(recording) else word for word in words
        ]
    with tempfile.TemporaryDirectory() as folder:
        if words[0].endswith(".py"):
            run_script([*words, *([folder] if made.written else [])])
        else:
            command = [sys.executable, "-m", f"validation.{words[0]}", *words[1:], "--out", folder]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        if name == "viewer":
            photograph(Path(folder) / made.written, IMAGES / "viewer.png")
        elif made.written:
            shutil.copyfile(Path(folder) / made.written, IMAGES / f"{name}.png")
    if made.ending == "png":
        file = IMAGES / f"{name}.png"
        if made.unsigned:
            sign(file)
        with Image.open(file) as drawn:
            drawn.save(file, exif=stamp_of(made.command), optimize=True)


def main() -> None:
    """Draw what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*PICTURES, "quick", "all"], metavar="NAME")
    parser.add_argument("--data", type=Path, help="folder with the recordings")
    parser.add_argument(
        "--list", action="store_true", help="say how each picture is made, and draw nothing"
    )
    commanded = parser.parse_args()
    quick = [
        name for name, made in PICTURES.items() if made.minutes < 2.0 and not made.recordings()
    ]
    groups = {"quick": quick, "all": list(PICTURES)}
    names = dict.fromkeys(one for name in commanded.names for one in groups.get(name, [name]))
    if commanded.list or not names:
        for name, made in PICTURES.items():
            print(f"{name:20} {made.minutes:5.1f} min  {made.command}")
        return
    for name in names:
        print(name, flush=True)
        draw(name, commanded.data)


if __name__ == "__main__":
    main()
