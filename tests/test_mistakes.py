"""Every program answers a user's mistake with status 2 and a message, and leaves no file."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from tests.appendices import is_possible
from tests.bag_factory import poses_at, write
from tests.drive_train_logs import in_the_air
from validation import cli
from validation.cli.__main__ import program_named
from validation.files.csv_logs import write_csv

FIT = "fit coulomb --to traj4"
FIVE = "--wheelbase 0.5 --track 0.6 --wheel-radius 0.15 --wheel-width 0.1 --mass 60"
MISTAKES = {
    "compare traj9": "traj1, traj2, traj3, traj4",
    "compare traj4@gazebo": "there are: mujoco",
    "compare traj4 --plants mujoco,gazebo": "unknown plant 'gazebo'; there are: mujoco, improved",
    "compare traj4 --profile nosuch": "thesis-lab",
    "compare traj4 --robot tank": "no robot 'tank'; there are: husky, jackal",
    "compare missing.csv": "missing.csv",
    "compare log.bag": "log.bag: this is no bag that can be read",
    "compare no_pose.csv": "x, y, yaw",
    "compare bare.csv --input wheels": "enc_left, enc_right",
    "compare traj4 --input wheels": "recording",
    "compare bare.csv --from 99": "0 to 0.2 s",
    "compare traj4 --horizons 6,2": "increase",
    "compare traj4 --seed -1": "seed must lie within 0 and 9223372036854775807, got -1",
    "compare traj4 --workers 0": "workers must lie within 1 and 4096, got 0",
    "compare traj4 --plant mujoco": "--plant",
    "compare": "SOURCE",
    "compare traj4 --plants improved --reference improved --out file": (
        "no folder that can be written"
    ),
    "compare traj4 --view --no-rerun": "--view",
    "fit coulomb --to traj9": "no source 'traj9'",
    f"{FIT} --free mu_s": "coulomb has no parameter 'mu_s' to fit; there are: u_x, mu_c",
    f"{FIT} --bounds gain=90:20": "bounds of gain are 90 and 20",
    f"{FIT} --bounds gain=1": "NAME=LOW:HIGH",
    f"{FIT} --guess gain=900": "gain = 900 N m s/rad lies outside its bounds, 10.0334 to 495.768",
    f"{FIT} --guess wheel_lag=0.1": "wheel_lag, which is not free",
    f"{FIT} --fix gain": "NAME=X",
    f"{FIT} --free gain --fix gain=50": "a space needs parameters",
    f"{FIT} --population 3": "population",
    f"{FIT} --held-out traj4": "cannot be held out",
    f"{FIT} --objective horizon --horizons 500": "no window",
    f"{FIT} --profile profile.toml --out .": "has a profile.toml already, which would be lost",
    f"{FIT} --out others": "has a fit.png already, which would be lost",
    "compare traj4 --out others": "has a compare.json already, which would be lost",
    "robots check husky --out others": "has a robot.png already, which would be lost",
    "tune pid --out others": "has a checkpoint.npz already, which would be lost",
    f"{FIT} --yaw-weight -1": "yaw_weight",
    "fit kinematic --to bare.csv --input wheels": "no column enc_left, enc_right",
    "fit kinematic --to traj4@kinematic --held-out ring.csv": "error: ring.csv: ",
    "fit mujoco --to traj4 --free yaw_inertia --bounds yaw_inertia=1:9": "no rigid body",
    "track pid nosuch": "nosuch",
    "track pid": "REFERENCE",
    "track pid line --controller mine.py:Mine": "line",
    "track pid line --plant gazebo": "unknown plant 'gazebo'",
    "track pid line --gains manual": "no pid gains 'manual'",
    "track pid line --speed 1.5": "asks for 1.5 m/s",
    "track pid line --start 0,0": "start is (0.0, 0.0), wanted tuple[float, float, float]",
    "track pid line --start 0,0,30": "start has a yaw of 30 rad",
    "track pid eight@0.5 --speed 0.4": "two speeds are given",
    "tune pid --free q_x": "pid has no gain 'q_x' to tune",
    "tune pid --bounds k_p_y=2:1": "bounds of k_p_y are 2 and 1",
    "tune pid --reference circle@fast": "REFERENCE@SPEED",
    "tune pid --reference ''": "no reference is named",
    "tune pid --guard -1": "guard",
    "recordings info nowhere.bag": "nowhere.bag: there is no such file",
    "recordings info .": "no ROS 2 bag: there is no metadata.yaml",
    "recordings info drive.csv --limits perid=20": "unknown limit 'perid'; there are: table_size, ",
    "recordings convert drive.csv --out x.xls": (
        "no format has the ending '.xls'; there are: .csv, .tum"
    ),
    "recordings convert drive.csv --out drive.csv": "is the log itself, or a part of it",
    "recordings convert drive.csv --rate -3": "rate -3.0 must be positive [Hz]",
    "recordings convert drive.csv --from 99": "nothing was logged in 99 to inf s",
    "recordings convert drive.csv --topics odom=/odom": "topics names the topics of a bag",
    "recordings convert drive.bag --topics odom": "must be ROLE=TOPIC",
    "recordings convert drive.bag --topics odom=/nowhere": (
        "there is no topic /nowhere; there are: /pose"
    ),
    "recordings convert drive.bag --unbias": "unbias needs a gyro",
    "recordings convert cut.bag": "no bag that can be read, or a damaged one",
    "recordings convert log.txt": "there are no numbers; wanted lines of 8 numbers",
    "robots check nowhere": "no robot 'nowhere'; there are: husky, jackal",
    "robots check bad.toml": "bad.toml",
    "robots check .": "this is a folder",
    f"robots new husky {FIVE}": "belongs to a robot that comes with the package",
    f"robots new 'my robot' {FIVE}": "wanted letters, digits",
    f"robots new x {FIVE} --wheelbase -1": "[geometry] wheelbase = -1.0 lies outside",
    "robots new x": "--wheelbase",
    "robots import bad.toml": "this is no XML",
    "robots import nowhere.urdf": "there is no such file",
    "robots draw": "draw",
    "replicate --only 5.1": "is no section",
    "ros sim --seed -1": "seed must lie within 0 and 9223372036854775807, got -1",
    "ros sim --profile nobody": "no profile 'nobody'",
    "ros sim --ros 1": "invalid choice '1'",
    "ros control pid line --ros noetic": "invalid choice 'noetic'",
    "ros sim --domain 300": "the domain (--domain, ROS_DOMAIN_ID) is 300, must be 0 to 232",
    "ros sim --interface lo/><x": "an interface is a name",
    "ros control pid line --speed 0.5 --v-limit 0.3": "asks for 0.5 m/s; the limit is 0.3 m/s",
    "ros control pid line --patience 0": "--patience 0 s",
    "ros control pid line --ros 2 --namespace 4wd": "a letter first",
    "study contact --only nothing": "nothing",
    "study contact --out file/deep": "name another",
    "study drivetrain": "recording",
    "study drivetrain --ground missing.csv": "missing.csv: there is no such file",
    "study drivetrain --recording up.csv --torque-constant 0": "torque_constant",
    "study transfer --quick --controllers pdi": "unknown controller 'pdi'",
    "study transfer --quick --controllers pid:gone": "no pid gains 'gone'",
    "study transfer --quick --controllers mpc": "there is no choice among mpc",
    "study transfer --quick --controllers pid,pid:tuned": "two controllers are called 'pid tuned'",
    "study transfer --quick --references eihgt": "no reference 'eihgt'",
    "study transfer --quick --plants improvd": "unknown plant 'improvd'",
    "study transfer --quick --plants mujoco": "plants names none besides mujoco",
    "calibrate two_rows.csv --robot husky --plants kinematic": "two_rows: 0.1 s without a gap",
    "compare traj4 --robot pipe.toml": "this is a pipe, wanted a file",
}
"""Each command, and the words that its message on standard error must hold."""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with logs, and with files that are none."""
    folder = tmp_path_factory.mktemp("mistakes")
    rows = "0,0,0,0,0,0\n0.1,0,0,0,0,0\n0.2,0,0,0,0,0\n"
    (folder / "bare.csv").write_text(f"t,cmd_v,cmd_w,x,y,yaw\n{rows}")
    (folder / "no_pose.csv").write_text("t,cmd_v,cmd_w\n0,0,0\n0.1,0,0\n0.2,0,0\n")
    (folder / "ring.csv").symlink_to(folder / "ring.csv")
    for name in ("log.txt", "log.bag", "file", "profile.toml"):
        (folder / name).touch()
    (folder / "bad.toml").write_text("name = 1")
    wheels = "t,enc_left,enc_right,x,y,yaw,gyro_z\n0,1,1,0,0,0,0\n0.1,1,1,0.02,0,0,0\n"
    (folder / "two_rows.csv").write_text(wheels)
    os.mkfifo(folder / "pipe.toml")
    (folder / "others").mkdir()
    for name in ("fit.png", "compare.json", "robot.png", "checkpoint.npz"):
        (folder / "others" / name).write_text("of somebody else")
    write_csv(in_the_air(), folder / "up.csv")
    write_csv(
        {"t": 0.05 * np.arange(200), "x": np.zeros(200), "battery": np.ones(200)},
        folder / "drive.csv",
    )
    bag = write(folder, "ros1", poses_at())
    (folder / "cut.bag").write_bytes(bag.read_bytes()[:-700])
    return folder


@pytest.mark.parametrize("command", [*filter(is_possible, MISTAKES)])
def test_a_mistake_has_a_clear_message_and_leaves_nothing(
    command: str, place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process, for speed; the status of real ones is looked at in other files."""
    if "--namespace" in command and not find_spec("cyclonedds"):
        pytest.skip("the extra 'ros2' is not installed")
    monkeypatch.chdir(place)
    program, *arguments = shlex.split(command)
    before = {path: path.stat().st_mtime_ns for path in place.rglob("*") if path.is_file()}
    with pytest.raises(SystemExit) as left:
        cli.run_command(program_named(program), f"python -m validation.{program}", arguments)
    message = capsys.readouterr().err
    assert left.value.code == cli.EXIT_USER_ERROR
    # what is wrong with the command line itself stands in a box of tyro
    is_line = message.startswith("error: ") and message.count("\n") == 1
    assert is_line or "For full helptext" in message
    assert MISTAKES[command] in " ".join(re.sub("[╭╮╰╯│─]", " ", message).split())
    assert {path: path.stat().st_mtime_ns for path in place.rglob("*") if path.is_file()} == before
    shutil.rmtree(place / "runs", ignore_errors=True)
