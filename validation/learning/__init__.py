"""The Husky for reinforcement learning: a dm_control entity and a dm_env environment."""
