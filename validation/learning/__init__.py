"""Reinforcement learning: trajectory tracking on MuJoCo for `dm_env`, Gymnasium and dm_control."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
