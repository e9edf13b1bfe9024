"""The MuJoCo robot on a ROS 2 graph, and controllers for a robot there: `sim`, `control`."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
