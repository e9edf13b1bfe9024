"""Reinforcement learning: a MuJoCo robot as a dm_control entity, and trajectory tracking as a `dm_env` environment."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
