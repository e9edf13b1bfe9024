"""Other users of the machine: what they put into folders for compiled code is never loaded, and never written to.

The packages are copied to where nobody may write, as an administrator installs them; a user without rights then imports them
with a cache folder that somebody else owns, that everybody may write, or that is a link.
"""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Sequence
from pathlib import Path

from tests.faults.doors import NOBODY, ROOT, environment, process
from tests.faults.judge import Outcome
from tests.faults.pool import Part

KINDS = ("owned by another", "writable by all", "a link to another's", "in TMPDIR, owned by another", "nobody's business")
_CODE = """
import os, sys
opened = []
sys.addaudithook(lambda e, a: opened.append(str(a[0])) if e in ("open", "os.mkdir", "os.rename") else None)
import ssmr._jit
from ssmr.models.kinematic import KinematicParameters
print("\\n".join(p for p in opened if ".nb" in p or "numba" in p))
print("folder", getattr(ssmr._jit, "_FOLDER", ""))
"""


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases there are; none where one cannot become another user."""
    return dict.fromkeys(KINDS, 1) if os.getuid() == 0 and shutil.which("setpriv") else {}


def run(kind: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Let a user without rights import the package with a cache folder that is not his alone."""
    folder.chmod(0o755)
    installed, home, temporary = (folder / name for name in ("installed", "home", "tmp"))
    planted = _lay_out(kind, folder)
    script = folder / "probe.py"
    script.write_text(_CODE)
    env = environment(
        HOME=str(home), TMPDIR=str(temporary), XDG_CACHE_HOME=None, NUMBA_CACHE_DIR=None, PYTHONDONTWRITEBYTECODE="1"
    )
    env["PYTHONPATH"] = f"{installed}{os.pathsep}{folder}"
    out = process(f"cache folder {kind}", ["probe"], home, env=env, as_nobody=True)
    used = out.stdout.split("folder ")[-1].strip()
    for path in planted:
        if used and (Path(used).is_relative_to(path) or Path(used).resolve().is_relative_to(path)):
            out.fault("false claim", f"compiled code is cached in {path.name}, which is not the user's alone")
    if used and os.path.isdir(used) and os.stat(used).st_mode & 0o077:
        out.fault("false claim", f"{used} can be entered by others")
    if kind == "nobody's business" and not used:
        out.fault("false claim", "nothing is cached though the user has a folder of his own")
    out.folder = None
    return out, (0,)


def _lay_out(kind: str, folder: Path) -> list[Path]:
    """Install the package, make a home, and return the folders that the user must not trust."""
    home, temporary, foreign = (folder / name for name in ("home", "tmp", "foreign"))
    shutil.copytree(ROOT / "ssmr", folder / "installed" / "ssmr", ignore=shutil.ignore_patterns("__pycache__"))
    own = home / ".cache" / "ssmr"
    for path in (home, temporary, foreign, own.parent):
        path.mkdir()
    for path in (home, own.parent):
        os.chown(path, NOBODY, NOBODY)
    temporary.chmod(0o1777)
    planted = {"a link to another's": foreign, "in TMPDIR, owned by another": temporary / f"ssmr-{NOBODY}"}.get(kind, own)
    if kind == "a link to another's":
        own.symlink_to(foreign)
    elif kind != "nobody's business":
        planted.mkdir()
    else:
        return []
    planted.chmod(0o777)
    if kind == "writable by all":
        os.chown(planted, NOBODY, NOBODY)
    return [planted]


PART = Part(plan, run)
