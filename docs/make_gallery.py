"""Draw the pictures of docs/first_comparison.md, each with the example that stands beside it.

Usage: `python docs/make_gallery.py [NAME ...]`, all where none is named. An example runs in an
empty folder; its picture is made 800 px wide.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from pictures import stamp_of
from PIL import Image

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
OUT = Path(__file__).parent / "img" / "gallery"
WIDTH = 800
PICTURES = {
    "first_steps.ipynb": "first_steps/track.png",
    "compare_plants.py": "compare_plants/compare.png",
    "fit_a_log.py": "fit_a_log.png",
    "other_robots.py": "other_robots.png",
    "sweep.py": "sweep.png",
    "own_controller.py": "own_controller/Chase/track.png",
    "sensitivity.py": "sensitivity.png",
}
"""Picture that each example makes, in its folder runs/examples."""


def program_of(path: Path) -> str:
    """Return an example as a program; of a notebook the cells of code."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return text
    cells = json.loads(text)["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")


def main(names: list[str]) -> None:
    """Run examples and keep their pictures."""
    OUT.mkdir(exist_ok=True)
    for name in names or PICTURES:
        with tempfile.TemporaryDirectory() as folder:
            program = Path(folder) / f"{Path(name).stem}.py"
            program.write_text(program_of(EXAMPLES / name), encoding="utf-8")
            subprocess.run([sys.executable, program.name], cwd=folder, check=True)
            with Image.open(Path(folder) / "runs" / "examples" / PICTURES[name]) as picture:
                size = WIDTH, round(WIDTH * picture.height / picture.width)
                small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        stamp = stamp_of(f"make_gallery.py {name}")
        small.save(OUT / f"{Path(name).stem}.webp", quality=80, exif=stamp)


if __name__ == "__main__":
    main(sys.argv[1:])
