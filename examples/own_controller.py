"""A control law of one's own, beside the tuned LQR, on the improved model and on MuJoCo."""

import math

from validation.track import track


class Chase:
    """Drive towards the moving target, faster the farther it is ahead."""

    def __init__(self, mission):
        self.limit = mission.drive.v_max

    def command(self, now):
        """Return speed [m/s] and yaw rate [rad/s].

        `now` is described in ssmr/control/mission.py.
        """
        x = now.target.x - now.seen.x
        y = now.target.y - now.seen.y
        ahead = math.cos(now.seen.yaw) * x + math.sin(now.seen.yaw) * y
        left = math.cos(now.seen.yaw) * y - math.sin(now.seen.yaw) * x
        return min(max(now.target.v + ahead, 0.0), self.limit), now.target.w + 4.0 * left


if __name__ == "__main__":
    for controller in (f"{__file__}:Chase", "lqr", "mpc"):
        run = track(
            controller, "slalom", plant=("improved", "mujoco"), profile="thesis-lab", speed=0.4
        )
        print(run.table())
        run.save(f"runs/examples/own_controller/{run.controller}", recording=False)
